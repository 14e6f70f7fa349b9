"""An analysis: how the scenarios of a study cluster by one aspect, as it is stored and read back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering.agreement import agree_with_critical
from cornercase.clustering.clusters import Candidate, Clustering
from cornercase.clustering.places import Distances, PlacedDistances
from cornercase.clustering.profiles import Profile
from cornercase.clustering.rules import Rule
from cornercase.study import Study, damage_told, made, require


@dataclass(frozen=True, eq=False, repr=False)
class Analysis:
    """Clusters of a study's scenarios by one aspect.

    The distances are not among it, as there are many; `read_distances` gives them.

    Attributes
    ----------
    by : str
        The aspect: one of `cornercase.clustering.ASPECTS`, or the name of a metric.
    unit : str
        Of the distances; ``"1"`` for none.
    window : float or None
        s; how far apart in time two instants may be that were matched; None for any.
    ids : ndarray of int64, shape (n,)
        Scenarios.
    clustering : Clustering
        Their clusters, in the order of `ids`.
    fitted : ndarray of int64, shape (m,)
        Scenarios that the clusters were found from; the others have joined them since.
    profiles : tuple of Profile
        What the scenarios of each cluster have in common, noise last; empty in a study of an early version.
    tells : mapping of str to float
        How much the clusters say of what happened: by fact the adjusted mutual information, as in
        `cornercase.clustering.agreement.agree_with_facts`; empty in a study of an early version.
    every : int
        Of so many instants one was compared.
    inexact : float or None
        Mean error of the distances between scenarios that are no landmarks, as a share of the mean distance, where
        they follow from places; None where all pairs were compared.
    """

    by: str
    unit: str
    window: float | None
    ids: IntArray
    clustering: Clustering
    fitted: IntArray
    profiles: tuple[Profile, ...]
    tells: Mapping[str, float] = field(default_factory=dict)
    every: int = 1
    inexact: float | None = None

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


def stored_analysis(
    study: Study, analysis: Analysis, compared: FloatArray, distances: Distances
) -> tuple[dict[str, npt.ArrayLike], dict[str, Any]]:
    """Give what a study stores of an analysis.

    Parameters
    ----------
    study : Study
        That it is of.
    analysis : Analysis
        What was found.
    compared : ndarray of float64, shape (n, n) or (m, m)
        Distances that the clusters were found by: between all scenarios, or the landmarks.
    distances : ndarray of float64, shape (n, n), or PlacedDistances
        Between all scenarios.

    Returns
    -------
    arrays : dict of str to array_like
    info : dict
        As `save_analysis` of a study's writer takes them.
    """
    found = analysis.clustering
    arrays: dict[str, npt.ArrayLike] = {"ids": analysis.ids, "distances": compared}
    if isinstance(distances, PlacedDistances):
        arrays = {"ids": analysis.ids, "between": compared, "places": distances.places}
    arrays |= {
        "labels": found.labels,
        "embedding": found.embedding,
        "landmarks": found.landmarks,
    }
    info = {
        "unit": analysis.unit,
        "window": analysis.window,
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
        "tells": dict(analysis.tells),
    }
    if analysis.inexact is not None:
        info |= {"every": analysis.every, "inexact": analysis.inexact}
    if study.critical != study.meta.critical:
        info["critical_threshold"] = study.critical
    return arrays, info


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
    run = {row.id for row in study.done()}
    arrays, info = study.analysis(by, "ids", "labels", "embedding", "landmarks")
    with damage_told(study.path):
        ids, labels, embedding = arrays["ids"], arrays["labels"], arrays["embedding"]
        n = len(ids)
        require(all(one.dtype.kind == "i" for one in (ids, labels, arrays["landmarks"])), "numbers that are not whole")
        require(
            ids.ndim == 1 and set(ids.tolist()) <= run and len(set(ids.tolist())) == n, "scenarios that were not run"
        )
        require(n > 0, "an analysis of no scenario")
        require(labels.shape == (n,) and bool((labels >= -1).all()) and labels.max(initial=-1) < n, "labels of others")
        require(embedding.ndim == 2 and len(embedding) == n and embedding.dtype.kind == "f", "an embedding of others")
        window = None if info["window"] is None else float(info["window"])
        tells = {str(fact): float(mutual) for fact, mutual in info["tells"].items()}
        found, fitted, profiles = _clustering(arrays, info), _numbers(info["fitted"]), _profiles(info)
        kinds, sizes = np.unique(labels, return_counts=True)
        described = sorted((one.cluster, one.size) for one in profiles)
        require(described in ([], list(zip(kinds.tolist(), sizes.tolist(), strict=True))), "profiles of other clusters")
        require({one.example for one in profiles} <= {None, *ids.tolist()}, "an example of no scenario")
        require(isinstance(info["unit"], str), "a unit that is no text")
        every, inexact = int(info.get("every", 1)), info.get("inexact")
        require(every >= 1, "no instants that were compared")
        inexact = None if inexact is None else float(inexact)
        analysis = Analysis(by, info["unit"], window, ids, found, fitted, profiles, tells, every, inexact)
        threshold = info.get("critical_threshold", study.meta.critical)
    if not tells or threshold == study.critical:
        return analysis
    facts = {fact: mutual for fact, mutual in tells.items() if fact != "critical"}
    return replace(analysis, tells=facts | agree_with_critical(study, ids, labels))


def _numbers(plain: list[int]) -> IntArray:
    return np.array([int(one) for one in plain], dtype=np.int64)


def _clustering(arrays: Mapping[str, Any], info: Mapping[str, Any]) -> Clustering:
    numbers = {name: float(info[name]) for name in ("gamma", "eps", "scale", "explained", "error")}
    require(info["method"] in ("dbscan", "hdbscan"), "clusters that were found in no known way")
    return Clustering(
        labels=arrays["labels"],
        embedding=arrays["embedding"],
        min_samples=int(info["min_samples"]),
        candidates=tuple(made(Candidate, one) for one in info["candidates"]),
        method=info["method"],
        landmarks=arrays["landmarks"],
        **numbers,
    )


def _profiles(info: Mapping[str, Any]) -> tuple[Profile, ...]:
    found = []
    for one in info["profiles"]:
        scores = {name: (float(low), float(mid), float(high)) for name, (low, mid, high) in one["scores"].items()}
        outcomes = {outcome: int(count) for outcome, count in one["outcomes"].items()}
        require(min(outcomes.values(), default=0) >= 0, "fewer than no scenarios")
        rules = tuple(made(Rule, rule) for rule in one["rules"])
        found.append(made(Profile, {**one, "scores": scores, "outcomes": outcomes, "rules": rules}))
    return tuple(found)


def read_analyses(study: Study) -> dict[str, Analysis]:
    """Read back all analyses of a study.

    Parameters
    ----------
    study : Study
        Analysed before.

    Returns
    -------
    dict of str to Analysis
        By aspect: the ego's trajectory first, the metrics last.
    """
    return {by: read_analysis(study, by) for by in study.analyses()}


def read_distances(study: Study, by: str) -> Distances:
    """Read the distances that scenarios were clustered by.

    Parameters
    ----------
    study : Study
        Analysed before.
    by : str
        Aspect.

    Returns
    -------
    ndarray of float64, shape (n, n), or PlacedDistances
        Dynamic Time Warping between the scenarios in `Analysis.ids`, in the unit of the aspect. Where scenarios were
        compared with landmarks only, they are made of the places of the scenarios when they are asked for.

    Raises
    ------
    InputError
        The study was not analysed by it.
    """
    if is_placed(study, by):
        arrays, _ = study.analysis(by, "ids", "places")
        with damage_told(study.path):
            places = arrays["places"]
            require(places.ndim == 2 and len(places) == len(arrays["ids"]), "places of other scenarios")
            require(places.dtype.kind == "f" and bool(np.isfinite(places).all()), "places that are none")
            return PlacedDistances(places)
    arrays, _ = study.analysis(by, "ids", "distances")
    distances: FloatArray = arrays["distances"]
    with damage_told(study.path):
        _require_distances(distances, len(arrays["ids"]))
    return distances


def read_between(study: Study, by: str) -> FloatArray:
    """Read the distances of the scenarios that the others were compared with.

    Parameters
    ----------
    study : Study
        Analysed before, with landmarks.
    by : str
        Aspect.

    Returns
    -------
    ndarray of float64, shape (m, m)
        Between the landmarks.

    Raises
    ------
    InputError
        The study was not analysed by it, or without landmarks.
    """
    arrays, _ = study.analysis(by, "landmarks", "between")
    distances: FloatArray = arrays["between"]
    with damage_told(study.path):
        _require_distances(distances, len(arrays["landmarks"]))
    return distances


def is_placed(study: Study, by: str) -> bool:
    """Say whether the scenarios of an analysis were compared with landmarks only.

    Parameters
    ----------
    study : Study
        Analysed before.
    by : str
        Aspect.

    Returns
    -------
    bool

    Raises
    ------
    InputError
        The study was not analysed by it.
    """
    return study.analysis(by, "ids")[1].get("inexact") is not None


def _require_distances(distances: FloatArray, n: int) -> None:
    require(distances.shape == (n, n) and distances.dtype.kind == "f", "distances of other scenarios")
    require(bool(np.isfinite(distances).all()) and bool((distances >= 0.0).all()), "distances that are none")
