"""Suggestion of points downhill from local minima of the scores."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from cornercase._common.typing import FloatArray, IntArray
from cornercase.study._criterion import Criterion

# Greatest distance of a minimum from the threshold, relative to its depth below the neighbouring scores.
_MAX_RELATIVE_HEIGHT: Final = 3.0


def suggest_below_local_minima(
    points: FloatArray, scores: FloatArray, criterion: Criterion, max_count: int | None = None
) -> FloatArray:
    """Suggest points downhill from local minima of the scores above the threshold, shape (m, e), most promising first.

    A further critical region may be near such a minimum. Without these points, a search for the boundary would stay at
    the known boundary: a Gaussian process of all scores, which are mostly flat, takes the minimum for noise.

    The neighbours of a scenario are the 2 e scenarios nearest to it, where e is the number of coordinates. A scenario
    is a local minimum if it is not critical, and its score is lower than those of all neighbours. Its score must be
    near the threshold: at most three times as far from it as from the median score of the neighbours. The suggested
    point lies downhill from the minimum, along the slope of a plane through minimum and neighbours, at half the
    distance to the nearest neighbour.

    `points` (n, e) are encoded scenarios that were run. `scores` (n,) are lower for more critical scenarios; NaN for a
    failed scenario counts as the highest score. At most `max_count` points are returned, by default all.
    """
    count = 2 * points.shape[1]
    if len(points) <= count:
        return points[:0]
    scores = np.where(np.isnan(scores), np.nanmax(scores), scores)
    distance, near = map(np.asarray, cKDTree(points).query(points, k=count + 1))
    neighbour_scores = scores[near[:, 1:]]
    height, depth = criterion.margins(scores), np.median(neighbour_scores, axis=1) - scores
    minima = np.flatnonzero(
        (height > 0.0) & (scores < neighbour_scores.min(axis=1)) & (height <= _MAX_RELATIVE_HEIGHT * depth)
    )
    minima = minima[np.argsort(height[minima] / depth[minima], kind="stable")][:max_count]
    suggestions = np.empty((len(minima), points.shape[1]))
    for k, i in enumerate(minima):
        others = near[i, 1:]
        slope = np.linalg.lstsq(points[others] - points[i], scores[others] - scores[i], rcond=None)[0]
        suggestions[k] = points[i] - 0.5 * distance[i, 1] * slope / max(float(np.linalg.norm(slope)), 1e-12)
    return suggestions


def indices_below_local_minima(
    points: FloatArray, scores: FloatArray, criterion: Criterion, candidates: FloatArray, max_count: int
) -> IntArray:
    """Return the index of the nearest candidate for each point that `suggest_below_local_minima` suggests.

    `candidates` (k, e) are encoded; there are at most `max_count` suggested points.
    """
    suggestions = suggest_below_local_minima(points, scores, criterion, max_count)
    if not len(suggestions) or not len(candidates):
        return np.zeros(0, dtype=np.int64)
    # For so few points, a tree of all candidates would be slower.
    return np.asarray(cdist(suggestions, candidates, "sqeuclidean").argmin(axis=1))
