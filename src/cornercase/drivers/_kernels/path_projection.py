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
# Samples of a first look; m that are skipped at once, at least; rounding errors of distances in m.
_N_COARSE: Final = 64
_LEAP: Final = 1.0
_ROUNDING: Final = 1e-6


def project_onto_path(
    path: DrivenPath, own_distance: FloatArray, x: FloatArray, y: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Return where points (N, A) are along a path: distance along it, offset to the left, its direction, (N, A) each.

    The last array tells which points are next to it from 100 m behind to 300 m ahead of `own_distance` (N,); others are
    projected onto the straight line beyond the nearest end.
    """
    arrays = (
        np.ascontiguousarray(np.atleast_2d(a)) for a in (path.distance, path.x, path.y, path.heading, path.chord_sum)
    )
    shape = np.shape(x)
    along, offset, direction = np.empty(shape), np.empty(shape), np.empty(shape)
    is_within = np.empty(shape, dtype=np.bool_)
    own, x, y = (np.ascontiguousarray(a, dtype=np.float64) for a in (own_distance, x, y))
    _project(*arrays, own, x, y, along, offset, direction, is_within)
    return along, offset, direction, is_within


@kernel(error_model="numpy")
def _project(distance, path_x, path_y, heading, chord_sum, own, x, y, along, offset, direction, is_within):
    for n in range(x.shape[0]):
        row = n if distance.shape[0] > 1 else 0
        stations = distance[row]
        first = max(np.searchsorted(stations, own[n] - _BEHIND) - 1, 0)
        last = min(np.searchsorted(stations, own[n] + _AHEAD) + 1, stations.size - 1)
        stride = (last - first) // _N_COARSE + 1
        for a in range(x.shape[1]):
            best, nearest = math.inf, first
            bound = math.inf
            for k in range(first, last + 1, stride):
                bound = min(bound, (x[n, a] - path_x[row, k]) ** 2 + (y[n, a] - path_y[row, k]) ** 2)
            bound, k = math.sqrt(bound), first
            while k <= last:
                dx, dy = x[n, a] - path_x[row, k], y[n, a] - path_y[row, k]
                squared = dx * dx + dy * dy
                if squared < best:
                    best, nearest = squared, k
                # Samples less far along the path from here cannot be nearer than the best.
                spare = math.sqrt(squared) - min(math.sqrt(best), bound) - _ROUNDING
                if spare > _LEAP:
                    k += np.searchsorted(chord_sum[row, k : last + 1], chord_sum[row, k] + spare)
                else:
                    k += 1
            best = math.inf
            is_within[n, a] = False
            for k in range(max(nearest - 1, first), min(nearest + 1, last)):
                chord_x, chord_y = path_x[row, k + 1] - path_x[row, k], path_y[row, k + 1] - path_y[row, k]
                length = math.hypot(chord_x, chord_y)
                dx, dy = x[n, a] - path_x[row, k], y[n, a] - path_y[row, k]
                ahead = (dx * chord_x + dy * chord_y) / length
                share = min(max(ahead / length, 0.0), 1.0)
                squared = (dx - share * chord_x) ** 2 + (dy - share * chord_y) ** 2
                if squared < best:
                    best = squared
                    # Beyond an end of the path it goes straight on.
                    is_beyond = (ahead < 0.0 and k == first) or (ahead > length and k + 1 == last)
                    part = ahead / length if is_beyond else share
                    along[n, a] = stations[k] + part * (stations[k + 1] - stations[k])
                    turn = heading[row, k] + share * (heading[row, k + 1] - heading[row, k])
                    direction[n, a] = turn
                    offset[n, a] = (dy * chord_x - dx * chord_y) / length
                    if not is_beyond and share != ahead / length:
                        # At a corner, the point is next to neither chord.
                        offset[n, a] = math.copysign(math.sqrt(squared), offset[n, a])
                    is_within[n, a] = not is_beyond
