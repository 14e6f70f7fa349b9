"""Clustering of very many scenarios by landmarks; time and memory do not grow with the square of their number.

Landmarks, some random scenarios, are compared with each other and clustered. The other scenarios are compared only with
a few landmarks, the anchors. The distances to all landmarks are estimated from the distances to the anchors. Finally,
the other scenarios join the clusters of the landmarks.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from cornercase._common.progress import ProgressBar
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering._anchors import LandmarkDistanceEstimator
from cornercase.clustering._clustering import Clustering
from cornercase.clustering._density import assign_to_nearest_cluster, renumber_by_size
from cornercase.clustering._embedding import EmbeddedDistances, LandmarkMDS
from cornercase.clustering._scenario_clustering import ScenarioClustering
from cornercase.dtw import distance_matrix, distances_to

MAX_ALL_PAIRS: Final = 2000
"""Largest number of scenarios for which all pairs are compared.

If there are more, each scenario is compared with some landmarks only.
"""
N_LANDMARKS: Final = 500
"""Number of landmarks: random scenarios that are compared with each other."""
# Scenarios, other than landmarks, on which the error of the embedding is measured.
_N_ERROR_SCENARIOS: Final = 200
# Scenarios that are compared with the anchors at a time; takes some seconds.
_BATCH_SIZE: Final = 1000


@dataclass(frozen=True, eq=False)
class LandmarkClustering:
    """Clusters and embedding of n scenarios by their distances to m landmarks.

    `embedding`, shape (n, p), has the coordinates for `EmbeddedDistances`. `landmark_distances`, shape (m, m), are the
    distances between the landmarks. `embedding_error` is the mean absolute error of the embedded distances between
    scenarios that are no landmarks, as a share of the mean distance.
    """

    clustering: Clustering
    embedding: FloatArray
    landmark_distances: FloatArray
    embedding_error: float


@dataclass(eq=False)
class PairwiseComparer:
    """Comparison of scenarios by DTW of their downsampled series.

    Downsampling keeps every `stride`-th instant, and the last one. A distance is a sum over instants, so distances are
    multiplied by `stride`, to be comparable to distances of full series. `window` is a number of downsampled instants.
    `progress` is the label of a progress bar; None for no bar. `seconds` is the time spent so far.
    """

    series: Sequence[FloatArray]
    stride: int
    window: int | None
    client: Any = None
    progress: str | None = None
    seconds: float = 0.0

    def distances_between(self, scenario_indices: IntArray, *, show_progress: bool = False) -> FloatArray:
        """Return the distances between some scenarios, shape (m, m)."""
        start = time.monotonic()
        selected_series = [self.series[i] for i in scenario_indices.tolist()]
        # Single precision is several times as fast, and its seventh digit decides nothing here.
        distances = distance_matrix(
            selected_series,
            window=self.window,
            dtype="float32",
            progress=show_progress and self.progress is not None,
            **self._client_options,
        ).astype(np.float64)
        self.seconds += time.monotonic() - start
        return distances * self.stride if self.stride > 1 else distances

    def distances_to(self, anchors: IntArray, scenario_indices: IntArray) -> FloatArray:
        """Return the distances from some scenarios to the anchors, shape (n, a)."""
        rows, columns = ([self.series[i] for i in indices.tolist()] for indices in (scenario_indices, anchors))
        start = time.monotonic()
        distances = distances_to(rows, columns, window=self.window, dtype="float32", **self._client_options).astype(
            np.float64
        )
        self.seconds += time.monotonic() - start
        return distances * self.stride

    @property
    def _client_options(self) -> dict[str, Any]:
        return {} if self.client is None else {"client": self.client}


def draw_landmarks(n_scenarios: int) -> IntArray:
    """Draw scenarios at random as landmarks, and return their indices in rising order."""
    drawn = np.random.default_rng(0).choice(n_scenarios, min(N_LANDMARKS, n_scenarios), replace=False)
    return np.sort(drawn).astype(np.int64)


def cluster_by_landmarks(comparer: PairwiseComparer, model: ScenarioClustering) -> LandmarkClustering:
    """Cluster the landmarks with the settings of `model`; assign each other scenario to a cluster or to noise."""
    landmarks = draw_landmarks(len(comparer.series))
    landmark_distances = comparer.distances_between(landmarks)
    fitted = ScenarioClustering(**{**model.get_params(), "landmarks": None}).fit(landmark_distances)
    clustering, coordinates, error = _assign_all_to_landmark_clusters(comparer, landmarks, landmark_distances, fitted)
    return LandmarkClustering(
        replace(clustering, labels=renumber_by_size(clustering.labels)), coordinates, landmark_distances, error
    )


def assign_by_landmarks(
    comparer: PairwiseComparer,
    landmarks: IntArray,
    landmark_distances: FloatArray,
    existing: Clustering,
    labels: IntArray,
) -> LandmarkClustering:
    """Assign scenarios to the clusters of an earlier analysis by their distances to landmarks.

    `existing` are the clusters of the earlier analysis. `labels`, shape (m,), are the clusters of the landmarks; a
    landmark stays in its cluster.
    """
    dimensions = existing.embedding.shape[1]
    fitted = ScenarioClustering(
        existing.gamma, existing.eps, existing.min_samples, dimensions, method=existing.method
    ).fit(landmark_distances)
    fitted.result_ = replace(fitted.result_, labels=labels)
    clustering, coordinates, error = _assign_all_to_landmark_clusters(comparer, landmarks, landmark_distances, fitted)
    return LandmarkClustering(
        replace(clustering, candidates=existing.candidates), coordinates, landmark_distances, error
    )


def _assign_all_to_landmark_clusters(
    comparer: PairwiseComparer, landmarks: IntArray, landmark_distances: FloatArray, fitted: ScenarioClustering
) -> tuple[Clustering, FloatArray, float]:
    """Assign all scenarios to the clusters of the landmarks.

    Returns the clusters, the coordinates of the scenarios for `EmbeddedDistances`, and the error of these distances.
    """
    n = len(comparer.series)
    clustering, embedder = fitted.result_, LandmarkMDS(landmark_distances)
    completion = LandmarkDistanceEstimator(landmark_distances)
    landmark_coordinates = embedder.embed(landmark_distances)
    labels, embedding = np.empty(n, dtype=np.int64), np.empty((n, clustering.embedding.shape[1]))
    coordinates = np.empty((n, landmark_coordinates.shape[1]))
    labels[landmarks], embedding[landmarks] = clustering.labels, clustering.embedding
    coordinates[landmarks] = landmark_coordinates
    others = np.setdiff1d(np.arange(n), landmarks)
    sample = np.linspace(0, len(others) - 1, min(_N_ERROR_SCENARIOS, len(others))).astype(np.int64)
    sampled_rows = []
    bar = ProgressBar(n, f"by {comparer.progress}", "scenarios") if comparer.progress else None
    try:
        for first in range(0, len(others), _BATCH_SIZE):
            batch = others[first : first + _BATCH_SIZE]
            to_landmarks = completion.estimate_to_all_landmarks(
                comparer.distances_to(landmarks[completion.anchors], batch)
            )
            embedding[batch] = fitted.transform(to_landmarks)
            labels[batch] = assign_to_nearest_cluster(embedding[batch], clustering)
            coordinates[batch] = embedder.embed(to_landmarks)
            sampled_rows.append(to_landmarks[np.isin(batch, others[sample])])
            if bar:
                bar.update(len(landmarks) + first + len(batch), "")
    finally:
        if bar:
            bar.stop()
    kernel_error = error = 0.0
    if len(sample) > 1:
        true, estimated = comparer.distances_between(others[sample]), EmbeddedDistances(coordinates[others[sample]])[:]
        error = float(np.abs(true - estimated).sum() / max(float(true.sum()), 1e-300))
        kernel_error = fitted.kernel_approximation_error(np.concatenate(sampled_rows), true)
    extended = replace(clustering, labels=labels, embedding=embedding, landmarks=landmarks, error=kernel_error)
    return extended, coordinates, error
