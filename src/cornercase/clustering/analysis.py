"""How alike the scenarios of a study are: by behaviour and by criticality."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.clustering.aspects import aspects_of, series_of
from cornercase.clustering.clusters import Candidate, Clustering, ClusteringMethod
from cornercase.clustering.estimator import ScenarioClustering, cluster
from cornercase.clustering.outcomes import tell_outcome
from cornercase.clustering.profiles import Profile, describe_clusters
from cornercase.dtw import distance_matrix
from cornercase.study import Study


@dataclass(frozen=True)
class Analysis:
    """Clusters of a study's scenarios.

    Attributes
    ----------
    by : str
        ``"ego-trajectory"`` or the name of a metric.
    ids : ndarray of int64, shape (n,)
        Scenarios.
    distances : ndarray of float64, shape (n, n)
        Dynamic Time Warping.
    clustering : Clustering
    profiles : tuple of Profile
        What is alike within each cluster.
    """

    by: str
    ids: IntArray
    distances: FloatArray
    clustering: Clustering
    profiles: tuple[Profile, ...]

    @property
    def sizes(self) -> list[int]:
        """Number of scenarios in each cluster."""
        labels = self.clustering.labels
        return np.bincount(labels[labels >= 0]).tolist() if (labels >= 0).any() else []


def analyze_study(
    study: Study,
    by: Sequence[str] | None = None,
    *,
    gamma: float | Literal["auto"] = "auto",
    eps: float | Literal["auto"] = "auto",
    min_samples: int | Literal["auto"] = "auto",
    method: ClusteringMethod = "dbscan",
    keep: bool = False,
    progress: bool = False,
) -> dict[str, Analysis]:
    """Cluster the scenarios of a study, and store the result in it.

    The paper's section "Scenario Clustering": DTW distance matrix, RBF kernel PCA to three dimensions, DBSCAN.

    Parameters
    ----------
    study : Study
        Open for writing.
    by : sequence of str, optional
        ``"ego-trajectory"`` and metrics; all by default.
    gamma, eps : float or "auto"
    min_samples : int or "auto"
    method : {"dbscan", "hdbscan"}
        As of `cornercase.clustering.cluster`.
    keep : bool, default False
        Keep the clusters that the study has, and let only scenarios that were run since join them, as of
        `cornercase.clustering.ScenarioClustering.predict`.
    progress : bool, default False

    Returns
    -------
    dict of str to Analysis

    Raises
    ------
    InputError
        Fewer than two scenarios were run, or the study holds no such metric.
    """
    ids = np.array([row.id for row in study.done()], dtype=np.int64)
    if len(ids) < 2:
        raise InputError(f"{study.path}: holds {len(ids)} scenarios that were run; at least 2 can be clustered.")
    outcomes = [tell_outcome(study.recording(i), study.meta.ego, study.meta.other) for i in ids.tolist()]
    study.save_outcomes(dict(zip(ids.tolist(), outcomes, strict=True)))
    results = {}
    for name in by or aspects_of(study):
        begun = time.monotonic()
        distances = distance_matrix(series_of(study, name), progress=progress)
        measured = time.monotonic()
        fitted = np.ones(len(ids), dtype=np.bool_)
        if keep and name in study.analyses():
            found, fitted = _joined(study, name, ids, distances)
        else:
            found = cluster(distances, gamma=gamma, eps=eps, min_samples=min_samples, method=method)
        described = describe_clusters(study, found.labels, outcomes)
        results[name] = Analysis(name, ids, distances, found, described)
        study.save_analysis(
            name,
            {"ids": ids, "distances": distances, "labels": found.labels, "embedding": found.embedding},
            _info(found) | {"fitted": ids[fitted].tolist(), "profiles": [asdict(one) for one in described]},
        )
        study.add_elapsed("compare", measured - begun)
        study.add_elapsed("cluster", time.monotonic() - measured)
    return results


def _joined(study: Study, name: str, ids: IntArray, distances: FloatArray) -> tuple[Clustering, BoolArray]:
    """Clusters that a study has, joined by the scenarios that were run since, and of which they were found."""
    _, info = study.analysis(name, "ids")
    # Scenarios that failed before have run since at times; so the earlier ones need not be the first.
    earlier = np.isin(ids, info["fitted"])
    model = ScenarioClustering(info["gamma"], info["eps"], info["min_samples"], method=info["method"]).fit(
        distances[np.ix_(earlier, earlier)]
    )
    labels, embedding = np.empty(len(ids), dtype=np.int64), np.empty((len(ids), model.n_components))
    labels[earlier], embedding[earlier] = model.labels_, model.embedding_
    to_earlier = distances[np.ix_(~earlier, earlier)]
    labels[~earlier], embedding[~earlier] = model.predict(to_earlier), model.transform(to_earlier)
    candidates = tuple(Candidate(**one) for one in info["candidates"])
    return replace(model.result_, labels=labels, embedding=embedding, candidates=candidates), earlier


def _info(found: Clustering) -> dict[str, Any]:
    return {
        "gamma": found.gamma,
        "eps": found.eps,
        "min_samples": found.min_samples,
        "scale": found.scale,
        "explained": found.explained,
        "method": found.method,
        "stability": found.stability,
        "landmarks": len(found.landmarks),
        "error": found.error,
        "candidates": [asdict(candidate) for candidate in found.candidates],
    }
