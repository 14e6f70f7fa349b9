"""Distances to many landmarks from those to a few of them, the anchors."""

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


class DistanceCompletion:
    """Completes the distances from scenarios to some anchors by those to all landmarks.

    The squared distance of a point to any other one is linear in its squared distances to points that span the space,
    and DTW distances are nearly squared Euclidean. The linear map is fitted to the distances between the landmarks,
    shape (m, m), by least squares. `anchors` are the indices of landmarks that are far from one another, rising.
    """

    def __init__(self, landmark_distances: FloatArray) -> None:
        self._fit(landmark_distances, _choose_distant(landmark_distances, N_ANCHORS))
        error = np.abs(self.complete(landmark_distances[:, self.anchors]) - landmark_distances)
        if np.median(error) > _MAX_ERROR * np.median(landmark_distances):
            # As where one landmark is so far away that its distances hide all others.
            self._fit(landmark_distances, np.arange(len(landmark_distances)))

    def _fit(self, landmark_distances: FloatArray, anchors: IntArray) -> None:
        self.anchors = anchors
        to_anchors = landmark_distances[:, anchors]
        self._means, self._anchor_means = landmark_distances.mean(axis=0), to_anchors.mean(axis=0)
        with single_threaded_blas():
            self._map = np.linalg.lstsq(
                to_anchors - self._anchor_means, landmark_distances - self._means, rcond=_DIRECTION_TOLERANCE
            )[0]

    def complete(self, to_anchors: FloatArray) -> FloatArray:
        """Return the distances from scenarios to all landmarks, shape (n, m); those to the anchors stay as they are."""
        with single_threaded_blas():
            distances: FloatArray = (to_anchors - self._anchor_means) @ self._map
        distances += self._means
        np.maximum(distances, 0.0, out=distances)
        distances[:, self.anchors] = to_anchors
        return distances


def _choose_distant(distances: FloatArray, count: int) -> IntArray:
    """Choose `count` scenarios, each the farthest from those chosen before; return rising indices."""
    chosen: list[int] = []
    nearest = np.full(len(distances), np.inf)
    for _ in range(min(count, len(distances))):
        chosen.append(int(nearest.argmax()))
        np.minimum(nearest, distances[chosen[-1]], out=nearest)
        nearest[chosen] = -1.0
    return np.sort(np.array(chosen, dtype=np.int64))
