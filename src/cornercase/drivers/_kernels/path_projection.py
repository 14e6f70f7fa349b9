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
# Samples between those that are looked at first; bound of the distance of two samples per m along the path.
_STRIDE: Final = 16
_LONGEST_CHORD: Final = 1.05


def project_onto_path(
    path: DrivenPath, own_distance: FloatArray, x: FloatArray, y: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Return where points (N, A) are along a path: distance along it, offset to the left, its direction, (N, A) each.

    The last array tells which points are next to it from 100 m behind to 300 m ahead of `own_distance` (N,); others are
    projected onto the straight line beyond the nearest end.
    """
    arrays = (np.ascontiguousarray(np.atleast_2d(a)) for a in (path.distance, path.x, path.y, path.heading))
    shape = np.shape(x)
    along, offset, direction = np.empty(shape), np.empty(shape), np.empty(shape)
    is_within = np.empty(shape, dtype=np.bool_)
    own, x, y = (np.ascontiguousarray(a, dtype=np.float64) for a in (own_distance, x, y))
    _project(*arrays, own, x, y, along, offset, direction, is_within)
    return along, offset, direction, is_within


@kernel(error_model="numpy")
def _project(distance, path_x, path_y, heading, own, x, y, along, offset, direction, is_within):
    for n in range(x.shape[0]):
        row = n if distance.shape[0] > 1 else 0
        stations = distance[row]
        first = max(np.searchsorted(stations, own[n] - _BEHIND) - 1, 0)
        last = min(np.searchsorted(stations, own[n] + _AHEAD) + 1, stations.size - 1)
        for a in range(x.shape[1]):
            best, nearest = math.inf, first
            for k in range(first, last + 1, _STRIDE):
                squared = (x[n, a] - path_x[row, k]) ** 2 + (y[n, a] - path_y[row, k]) ** 2
                if squared < best:
                    best, nearest = squared, k
            k = first
            while k <= last:
                squared = (x[n, a] - path_x[row, k]) ** 2 + (y[n, a] - path_y[row, k]) ** 2
                if squared < best or (squared == best and k < nearest):
                    best, nearest = squared, k
                # No sample that is nearer on the path than this can be nearer to the point than the best one.
                skipped = (math.sqrt(squared) - math.sqrt(best)) / _LONGEST_CHORD
                k += 1
                if skipped > 2.0:
                    k = max(k, np.searchsorted(stations, stations[k - 1] + skipped))
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
