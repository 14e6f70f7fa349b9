"""Project points onto the path of a driven entity."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import Final

import numpy as np

from cornercase._common.numba.kernel import kernel
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers._base import DrivenPath

# m along the path, from the driven entity, in which the nearest point is searched.
_BEHIND: Final = 100.0
_AHEAD: Final = 300.0
# The nearest of some samples bounds how far away the nearest of all is.
_STRIDE: Final = 64


def project_onto_path(
    path: DrivenPath, own_distance: FloatArray, x: FloatArray, y: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Return where points (N, A) are along a path: distance along it, offset to the left, its direction, (N, A) each.

    The last array tells which points are next to it from 100 m behind to 300 m ahead of `own_distance` (N,); others are
    projected onto the straight line beyond the nearest end. NaN for points that are NaN.
    """
    shape = np.shape(x)
    along, offset, direction = np.empty(shape), np.empty(shape), np.empty(shape)
    is_within = np.empty(shape, dtype=np.bool_)
    own, x, y = (np.ascontiguousarray(a, dtype=np.float64) for a in (own_distance, x, y))
    _project(*path.rows, own, x, y, along, offset, direction, is_within)
    return along, offset, direction, is_within


@kernel(error_model="numpy")
def _project(distance, path_x, path_y, heading, max_chord, own, x, y, along, offset, direction, is_within):
    for n in range(x.shape[0]):
        row = n if distance.shape[0] > 1 else 0
        path = distance[row], path_x[row], path_y[row], heading[row], max_chord[row]
        for a in range(x.shape[1]):
            along[n, a], offset[n, a], direction[n, a], is_within[n, a] = project_point(*path, own[n], x[n, a], y[n, a])


@kernel(error_model="numpy")
def project_point(distance, path_x, path_y, heading, max_chord, own_distance, x, y):
    """Return where a point is along a path: distance along it, offset to the left, its direction, whether next to it.

    It is searched from 100 m behind to 300 m ahead of `own_distance`. A point that is not next to the path there is
    projected onto the straight line beyond the nearer end. `max_chord` is the largest distance of two samples in m.
    """
    if not (math.isfinite(x) and math.isfinite(y)):
        return math.nan, math.nan, math.nan, False
    first = max(np.searchsorted(distance, own_distance - _BEHIND) - 1, 0)
    last = min(np.searchsorted(distance, own_distance + _AHEAD) + 1, distance.size - 1)
    bound = math.inf
    for k in range(first, last + 1, _STRIDE):
        bound = min(bound, math.hypot(x - path_x[k], y - path_y[k]))
    best, nearest, k = math.inf, first, first
    while k <= last:
        gap = math.hypot(x - path_x[k], y - path_y[k])
        if gap < best:
            best, nearest, bound = gap, k, min(bound, gap)
        # No sample in between can be nearer.
        k += max(int((1.0 - 1e-9) * (gap - bound) / max_chord), 1)
    best = math.inf
    along, offset, direction, is_next_to = math.nan, math.nan, math.nan, False
    for k in range(max(nearest - 1, first), min(nearest + 1, last)):
        chord_x, chord_y = path_x[k + 1] - path_x[k], path_y[k + 1] - path_y[k]
        length = math.hypot(chord_x, chord_y)
        dx, dy = x - path_x[k], y - path_y[k]
        ahead = (dx * chord_x + dy * chord_y) / length
        share = min(max(ahead / length, 0.0), 1.0)
        squared = (dx - share * chord_x) ** 2 + (dy - share * chord_y) ** 2
        if squared < best:
            best = squared
            is_beyond = (ahead < 0.0 and k == first) or (ahead > length and k + 1 == last)
            part = ahead / length if is_beyond else share
            along = distance[k] + part * (distance[k + 1] - distance[k])
            direction = heading[k] + share * (heading[k + 1] - heading[k])
            offset = (dy * chord_x - dx * chord_y) / length
            if not is_beyond and share != ahead / length:
                # At a corner, the point is next to neither chord.
                offset = math.copysign(math.sqrt(squared), offset)
            is_next_to = not is_beyond
    return along, offset, direction, is_next_to
