"""Estimate of a scenario's distances to all landmarks from its distances to a few landmarks, the anchors."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.numba.blas import single_threaded_blas
from cornercase._common.typing import FloatArray, IntArray

N_ANCHORS: Final = 100
"""Number of landmarks that each scenario is compared with."""
# Directions with a smaller share of the largest singular value are rounding errors of single-precision distances.
_DIRECTION_TOLERANCE: Final = 1e-6
# Largest median error of the fit, as a share of the median distance, with which anchors stand for all landmarks.
_MAX_ERROR: Final = 0.1


class LandmarkDistanceEstimator:
    """Linear model of a scenario's distances to all landmarks, given its distances to some landmarks, the anchors.

    Landmarks are scenarios that were all compared with each other: `landmark_distances`, shape (m, m), are the
    distances between them. A linear model is possible since DTW distances are nearly squared Euclidean distances. In
    Euclidean space, the squared distances from a point to some points that span the space determine, linearly, its
    squared distance to any other point. The model is fitted to `landmark_distances` by least squares. `anchors` are the
    indices of landmarks that are far from one another, in rising order. If the model is too inexact, all landmarks are
    anchors.
    """

    def __init__(self, landmark_distances: FloatArray) -> None:
        self._fit(landmark_distances, _choose_distant(landmark_distances, N_ANCHORS))
        error = np.abs(self.estimate_to_all_landmarks(landmark_distances[:, self.anchors]) - landmark_distances)
        if np.median(error) > _MAX_ERROR * np.median(landmark_distances):
            # For example, one landmark may be so far away that its distances outweigh all other distances.
            self._fit(landmark_distances, np.arange(len(landmark_distances)))

    def _fit(self, landmark_distances: FloatArray, anchors: IntArray) -> None:
        self.anchors = anchors
        to_anchors = landmark_distances[:, anchors]
        self._means, self._anchor_means = landmark_distances.mean(axis=0), to_anchors.mean(axis=0)
        with single_threaded_blas():
            self._map = np.linalg.lstsq(
                to_anchors - self._anchor_means, landmark_distances - self._means, rcond=_DIRECTION_TOLERANCE
            )[0]

    def estimate_to_all_landmarks(self, to_anchors: FloatArray) -> FloatArray:
        """Return the distances from scenarios to all landmarks, shape (n, m), given the distances to the anchors.

        The given distances are kept in the result; all other distances are estimates.
        """
        with single_threaded_blas():
            distances: FloatArray = (to_anchors - self._anchor_means) @ self._map
        distances += self._means
        np.maximum(distances, 0.0, out=distances)
        distances[:, self.anchors] = to_anchors
        return distances


def _choose_distant(distances: FloatArray, count: int) -> IntArray:
    """Choose `count` scenarios, each as far as possible from those chosen before; return indices in rising order."""
    chosen: list[int] = []
    nearest = np.full(len(distances), np.inf)
    for _ in range(min(count, len(distances))):
        chosen.append(int(nearest.argmax()))
        np.minimum(nearest, distances[chosen[-1]], out=nearest)
        nearest[chosen] = -1.0
    return np.sort(np.array(chosen, dtype=np.int64))
