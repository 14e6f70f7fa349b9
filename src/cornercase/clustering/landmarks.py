"""Clusters of many scenarios by their distances to a few, the landmarks: nothing grows with the square of their number.

Every scenario is compared with the landmarks only. The clusters of these are found as ever, and the others join them.
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
"""Scenarios of which all pairs are compared; of more, all are compared with the landmarks."""
LANDMARKS: Final = 500
"""Number of landmarks."""
# Scenarios beside the landmarks that tell how good the approximation is.
_JUDGING: Final = 200
# Scenarios that are compared with the landmarks at a time: some seconds of work.
_AT_ONCE: Final = 1000


@dataclass(frozen=True, eq=False)
class Compared:
    """What is known of scenarios that were compared with landmarks.

    Attributes
    ----------
    clustering : Clustering
        Of all scenarios.
    places : ndarray of float64, shape (n, p)
        As `PlacedDistances` takes them.
    between : ndarray of float64, shape (m, m)
        Distances of the landmarks.
    error : float
        Mean difference between distances that follow from places and true ones, over the mean of the true ones; between
        scenarios that are no landmarks.
    """

    clustering: Clustering
    places: FloatArray
    between: FloatArray
    error: float


@dataclass(eq=False)
class Comparing:
    """Series to compare, and how.

    Attributes
    ----------
    series : sequence of ndarray of float64
        Of each scenario, thinned.
    every : int
        Of how many instants one was taken, which the distances are multiplied by.
    window : int or None
        As in `cornercase.dtw.distance_matrix`.
    client : distributed.Client or None
        Whose workers compute.
    progress : str or None
        What is compared, for a bar; None for no bar.
    seconds : float
        s; time spent so far.
    """

    series: Sequence[FloatArray]
    every: int
    window: int | None
    client: Any = None
    progress: str | None = None
    seconds: float = 0.0

    def between(self, some: IntArray, *, shown: bool = False) -> FloatArray:
        """Compare some scenarios with each other.

        Parameters
        ----------
        some : ndarray of int64, shape (m,)
            Indices.
        shown : bool, default False
            Show a bar, where one is wanted.

        Returns
        -------
        ndarray of float64, shape (m, m)
        """
        begun = time.monotonic()
        chosen = [self.series[i] for i in some.tolist()]
        # In single precision, several times as fast: the seventh digit of a distance decides nothing here.
        found = distance_matrix(
            chosen, window=self.window, dtype="float32", progress=shown and self.progress is not None, **self._elsewhere
        ).astype(np.float64)
        self.seconds += time.monotonic() - begun
        return found * self.every if self.every > 1 else found

    def to(self, landmarks: IntArray, some: IntArray) -> FloatArray:
        """Compare some scenarios with the landmarks.

        Parameters
        ----------
        landmarks : ndarray of int64, shape (m,)
            Indices.
        some : ndarray of int64, shape (n,)
            Indices.

        Returns
        -------
        ndarray of float64, shape (n, m)
        """
        rows, columns = ([self.series[i] for i in which.tolist()] for which in (some, landmarks))
        begun = time.monotonic()
        found = distances_to(rows, columns, window=self.window, dtype="float32", **self._elsewhere).astype(np.float64)
        self.seconds += time.monotonic() - begun
        return found * self.every

    @property
    def _elsewhere(self) -> dict[str, Any]:
        return {} if self.client is None else {"client": self.client}


def draw_landmarks(count: int) -> IntArray:
    """Draw the scenarios that all are compared with.

    Parameters
    ----------
    count : int
        Number of scenarios.

    Returns
    -------
    ndarray of int64, shape (m,)
        Indices, rising: drawn at random, as a kind of scenario is a dense region and landmarks have to be dense where
        scenarios are.
    """
    drawn = np.random.default_rng(0).choice(count, min(LANDMARKS, count), replace=False)
    return np.sort(drawn).astype(np.int64)


def find_by_landmarks(comparing: Comparing, model: ScenarioClustering) -> Compared:
    """Cluster scenarios by landmarks.

    Parameters
    ----------
    comparing : Comparing
        The scenarios.
    model : ScenarioClustering
        Settings.

    Returns
    -------
    Compared
    """
    landmarks = draw_landmarks(len(comparing.series))
    between = comparing.between(landmarks)
    fitted = ScenarioClustering(**{**model.get_params(), "landmarks": None}).fit(between)
    found, places, error = _joined(comparing, landmarks, between, fitted)
    return Compared(replace(found, labels=order_by_size(found.labels)), places, between, error)


def join_landmarks(
    comparing: Comparing, landmarks: IntArray, between: FloatArray, known: Clustering, labels: IntArray
) -> Compared:
    """Let scenarios join clusters that were found of landmarks.

    Parameters
    ----------
    comparing : Comparing
        The scenarios, landmarks included.
    landmarks : ndarray of int64, shape (m,)
        Indices.
    between : ndarray of float64, shape (m, m)
        Their distances.
    known : Clustering
        What was found before.
    labels : ndarray of int64, shape (m,)
        Clusters of the landmarks.

    Returns
    -------
    Compared
        The landmarks are in the clusters that they were in.
    """
    axes = known.embedding.shape[1]
    fitted = ScenarioClustering(known.gamma, known.eps, known.min_samples, axes, method=known.method).fit(between)
    fitted.result_ = replace(fitted.result_, labels=labels)
    found, places, error = _joined(comparing, landmarks, between, fitted)
    return Compared(replace(found, candidates=known.candidates), places, between, error)


def _joined(
    comparing: Comparing, landmarks: IntArray, between: FloatArray, fitted: ScenarioClustering
) -> tuple[Clustering, FloatArray, float]:
    """Clusters and places of all scenarios, and how far distances that follow from places are from true ones."""
    n = len(comparing.series)
    known, placing = fitted.result_, Placing(between)
    labels, embedding = np.empty(n, dtype=np.int64), np.empty((n, known.embedding.shape[1]))
    blocks = []
    bar = ProgressBar(n, f"by {comparing.progress}", "scenarios") if comparing.progress else None
    try:
        for first in range(0, n, _AT_ONCE):
            some = np.arange(first, min(first + _AT_ONCE, n))
            to_landmarks = comparing.to(landmarks, some)
            embedding[some] = fitted.transform(to_landmarks)
            labels[some] = join_nearest(embedding[some], known)
            blocks.append(placing.place(to_landmarks))
            if bar:
                bar.update(first + len(some), "")
    finally:
        if bar:
            bar.stop()
    embedding[landmarks], labels[landmarks] = known.embedding, known.labels
    places = np.concatenate(blocks)
    others = np.setdiff1d(np.arange(n), landmarks)
    some = others[np.linspace(0, len(others) - 1, min(_JUDGING, len(others))).astype(np.int64)]
    kernel_error = error = 0.0
    if len(some) > 1:
        true, placed = comparing.between(some), PlacedDistances(places[some])[:]
        error = float(np.abs(true - placed).sum() / max(float(true.sum()), 1e-300))
        kernel_error = fitted.kernel_lost(comparing.to(landmarks, some), true)
    found = replace(known, labels=labels, embedding=embedding, landmarks=landmarks, error=kernel_error)
    return found, places, error
