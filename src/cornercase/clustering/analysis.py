"""An analysis: how the scenarios of a study cluster by one aspect, as it is stored and read back."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering.clusters import Candidate, Clustering
from cornercase.clustering.profiles import Profile
from cornercase.clustering.rules import Rule
from cornercase.study import Study


@dataclass(frozen=True, eq=False, repr=False)
class Analysis:
    """Clusters of a study's scenarios by one aspect.

    The distances are not among it, as there are n × n of them; `read_distances` gives them.

    Attributes
    ----------
    by : str
        The aspect: ``"ego-trajectory"`` or the name of a metric.
    ids : ndarray of int64, shape (n,)
        Scenarios.
    clustering : Clustering
        Their clusters, in the order of `ids`.
    fitted : ndarray of int64, shape (m,)
        Scenarios that the clusters were found from; the others have joined them since.
    profiles : tuple of Profile
        What the scenarios of each cluster have in common, noise last; empty in a study of an early version.
    """

    by: str
    ids: IntArray
    clustering: Clustering
    fitted: IntArray
    profiles: tuple[Profile, ...]

    @property
    def labels(self) -> IntArray:
        """Cluster of each scenario, shape (n,); the largest is 0, -1 is noise."""
        return self.clustering.labels

    @property
    def sizes(self) -> list[int]:
        """Number of scenarios in each cluster, without noise."""
        counts = np.bincount(self.labels[self.labels >= 0], minlength=self.clustering.n_clusters)
        return [int(count) for count in counts]

    def rows_of(self, scenarios: IntArray | list[int]) -> IntArray:
        """Rows of some scenarios in `ids`.

        Parameters
        ----------
        scenarios : ndarray of int64 or list of int, shape (m,)
            Ids; those that were not analysed are left out.

        Returns
        -------
        ndarray of int64, shape (k,)
            Rows, in the order of the ids.
        """
        place = {scenario: row for row, scenario in enumerate(self.ids.tolist())}
        return np.array([place[int(one)] for one in scenarios if int(one) in place], dtype=np.int64)

    def __repr__(self) -> str:
        found = self.clustering
        return (
            f"Analysis(by {self.by}: {len(self.ids)} scenarios, clusters of {self.sizes}, {found.noise:.0%} noise,"
            f" {found.method}, gamma={found.gamma:.4g}, eps={found.eps:.4g}, min_samples={found.min_samples})"
        )


def save_analysis(study: Study, analysis: Analysis, distances: FloatArray) -> None:
    """Store an analysis in a study, in place of the one by the same aspect.

    Parameters
    ----------
    study : Study
        Open for writing.
    analysis : Analysis
        What was found.
    distances : ndarray of float64, shape (n, n)
        Distances that the scenarios were clustered by.
    """
    found = analysis.clustering
    arrays = {
        "ids": analysis.ids,
        "distances": distances,
        "labels": found.labels,
        "embedding": found.embedding,
        "landmarks": found.landmarks,
    }
    info = {
        "gamma": found.gamma,
        "eps": found.eps,
        "min_samples": found.min_samples,
        "scale": found.scale,
        "explained": found.explained,
        "method": found.method,
        "stability": found.stability,
        "landmarks": len(found.landmarks),
        "error": found.error,
        "candidates": [asdict(one) for one in found.candidates],
        "fitted": analysis.fitted.tolist(),
        "profiles": [asdict(one) for one in analysis.profiles],
    }
    study.save_analysis(analysis.by, arrays, info)


def read_analysis(study: Study, by: str) -> Analysis:
    """Read back what `analyze` found.

    Parameters
    ----------
    study : Study
        Analysed before.
    by : str
        Aspect.

    Returns
    -------
    Analysis
        As `analyze` gave it.

    Raises
    ------
    InputError
        The study was not analysed by it.
    """
    arrays, info = study.analysis(by, "ids", "labels", "embedding", "landmarks")
    clustering = Clustering(
        labels=arrays["labels"],
        embedding=arrays["embedding"],
        gamma=info["gamma"],
        eps=info["eps"],
        min_samples=info["min_samples"],
        scale=info["scale"],
        explained=info["explained"],
        candidates=tuple(Candidate(**one) for one in info["candidates"]),
        method=info["method"],
        landmarks=arrays["landmarks"],
        error=info["error"],
    )
    profiles = tuple(
        Profile(
            cluster=one["cluster"],
            size=one["size"],
            scores={name: (low, middle, high) for name, (low, middle, high) in one["scores"].items()},
            outcomes=one["outcomes"],
            rules=tuple(Rule(**rule) for rule in one["rules"]),
        )
        for one in info["profiles"]
    )
    return Analysis(by, arrays["ids"], clustering, np.array(info["fitted"], dtype=np.int64), profiles)


def read_analyses(study: Study) -> dict[str, Analysis]:
    """Read back all analyses of a study.

    Parameters
    ----------
    study : Study
        Analysed before.

    Returns
    -------
    dict of str to Analysis
        By aspect: the ego's trajectory first, then the metrics.
    """
    return {by: read_analysis(study, by) for by in study.analyses()}


def read_distances(study: Study, by: str) -> FloatArray:
    """Read the distances that scenarios were clustered by.

    Parameters
    ----------
    study : Study
        Analysed before.
    by : str
        Aspect.

    Returns
    -------
    ndarray of float64, shape (n, n)
        Dynamic Time Warping between the scenarios in `Analysis.ids`, in the unit of the aspect.

    Raises
    ------
    InputError
        The study was not analysed by it.
    """
    arrays, _ = study.analysis(by, "distances")
    distances: FloatArray = arrays["distances"]
    return distances
