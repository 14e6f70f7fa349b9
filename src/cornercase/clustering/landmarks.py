"""Clustering of many scenarios by landmarks, so that nothing grows with the square of their number.

Every scenario is compared with a few landmarks only. The landmarks are clustered, and the others join their clusters.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from cornercase._common.progress import ProgressBar
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering.clusters import Clustering
from cornercase.clustering.density import join_nearest, order_by_size
from cornercase.clustering.estimator import ScenarioClustering
from cornercase.clustering.places import PlacedDistances, Placing
from cornercase.dtw import distance_matrix, distances_to

MOST_COMPARED: Final = 2000
"""Largest number of scenarios for which all pairs are compared; with more, each is compared with the landmarks."""
LANDMARKS: Final = 500
"""Number of landmarks."""
# Scenarios, other than landmarks, on which the error of the embedding is measured.
_JUDGING: Final = 200
# Scenarios that are compared with the landmarks at a time; takes some seconds.
_AT_ONCE: Final = 1000


@dataclass(frozen=True, eq=False)
class Compared:
    """Clusters and embedding of scenarios that were compared with landmarks.

    `embedding`, shape (n, p), are coordinates for `EmbeddedDistances`; `landmark_distances`, shape (m, m), are the
    distances of the landmarks; `embedding_error` is the mean absolute error of embedded distances between other
    scenarios, as a share of the mean distance.
    """

    clustering: Clustering
    places: FloatArray
    between: FloatArray
    error: float


@dataclass(eq=False)
class Comparing:
    """DTW comparison of downsampled series; distances are multiplied by the stride `stride`.

    `window` is in instants; `progress` is the label of a bar, None for no bar; `seconds` is the time spent so far.
    """

    series: Sequence[FloatArray]
    every: int
    window: int | None
    client: Any = None
    progress: str | None = None
    seconds: float = 0.0

    def between(self, some: IntArray, *, shown: bool = False) -> FloatArray:
        """Return the distances between some scenarios, shape (m, m)."""
        start = time.monotonic()
        selected_series = [self.series[i] for i in some.tolist()]
        # Single precision is several times as fast, and its seventh digit decides nothing here.
        distances = distance_matrix(
            selected_series,
            window=self.window,
            dtype="float32",
            progress=shown and self.progress is not None,
            **self._elsewhere,
        ).astype(np.float64)
        self.seconds += time.monotonic() - start
        return distances * self.every if self.every > 1 else distances

    def to(self, landmarks: IntArray, some: IntArray) -> FloatArray:
        """Return the distances from some scenarios to the landmarks, shape (n, m)."""
        rows, columns = ([self.series[i] for i in indices.tolist()] for indices in (some, landmarks))
        start = time.monotonic()
        distances = distances_to(rows, columns, window=self.window, dtype="float32", **self._elsewhere).astype(
            np.float64
        )
        self.seconds += time.monotonic() - start
        return distances * self.every

    @property
    def _elsewhere(self) -> dict[str, Any]:
        return {} if self.client is None else {"client": self.client}


def draw_landmarks(count: int) -> IntArray:
    """Draw landmark scenarios at random, in rising order; so they are dense where scenarios are."""
    drawn = np.random.default_rng(0).choice(count, min(LANDMARKS, count), replace=False)
    return np.sort(drawn).astype(np.int64)


def find_by_landmarks(comparing: Comparing, model: ScenarioClustering) -> Compared:
    """Cluster the landmarks with the settings of `model`, and assign all other scenarios to their clusters."""
    landmarks = draw_landmarks(len(comparing.series))
    landmark_distances = comparing.between(landmarks)
    fitted = ScenarioClustering(**{**model.get_params(), "landmarks": None}).fit(landmark_distances)
    clustering, coordinates, error = _joined(comparing, landmarks, landmark_distances, fitted)
    return Compared(
        replace(clustering, labels=order_by_size(clustering.labels)), coordinates, landmark_distances, error
    )


def join_landmarks(
    comparing: Comparing, landmarks: IntArray, between: FloatArray, known: Clustering, labels: IntArray
) -> Compared:
    """Assign scenarios to clusters of an earlier analysis; landmarks keep their `labels`, shape (m,)."""
    dimensions = known.embedding.shape[1]
    fitted = ScenarioClustering(known.gamma, known.eps, known.min_samples, dimensions, method=known.method).fit(between)
    fitted.result_ = replace(fitted.result_, labels=labels)
    clustering, coordinates, error = _joined(comparing, landmarks, between, fitted)
    return Compared(replace(clustering, candidates=known.candidates), coordinates, between, error)


def _joined(
    comparing: Comparing, landmarks: IntArray, between: FloatArray, fitted: ScenarioClustering
) -> tuple[Clustering, FloatArray, float]:
    """Clusters and coordinates of all scenarios, and the error of embedded distances."""
    n = len(comparing.series)
    clustering, embedder = fitted.result_, Placing(between)
    labels, embedding = np.empty(n, dtype=np.int64), np.empty((n, clustering.embedding.shape[1]))
    blocks = []
    bar = ProgressBar(n, f"by {comparing.progress}", "scenarios") if comparing.progress else None
    try:
        for first in range(0, n, _AT_ONCE):
            batch = np.arange(first, min(first + _AT_ONCE, n))
            to_landmarks = comparing.to(landmarks, batch)
            embedding[batch] = fitted.transform(to_landmarks)
            labels[batch] = join_nearest(embedding[batch], clustering)
            blocks.append(embedder.place(to_landmarks))
            if bar:
                bar.update(first + len(batch), "")
    finally:
        if bar:
            bar.stop()
    embedding[landmarks], labels[landmarks] = clustering.embedding, clustering.labels
    coordinates = np.concatenate(blocks)
    non_landmarks = np.setdiff1d(np.arange(n), landmarks)
    sample = non_landmarks[np.linspace(0, len(non_landmarks) - 1, min(_JUDGING, len(non_landmarks))).astype(np.int64)]
    kernel_error = error = 0.0
    if len(sample) > 1:
        true, estimated = comparing.between(sample), PlacedDistances(coordinates[sample])[:]
        error = float(np.abs(true - estimated).sum() / max(float(true.sum()), 1e-300))
        kernel_error = fitted.kernel_lost(comparing.to(landmarks, sample), true)
    extended = replace(clustering, labels=labels, embedding=embedding, landmarks=landmarks, error=kernel_error)
    return extended, coordinates, error
