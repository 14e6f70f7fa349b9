"""What a driven entity sees: others along its path and in its own axes."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import Final

import numpy as np

from cornercase._common.numba.kernel import kernel

# m along the path, from the driven entity, in which the nearest point is searched.
_BEHIND: Final = 100.0
_AHEAD: Final = 300.0
# The nearest of some samples bounds how far away the nearest of all is.
_STRIDE: Final = 64

X, Y, TURN, GAP, CLOSING, LATERAL, IN_PATH, ALONG = range(8)
"""Columns of what is seen of an object, as in `ObjectView`; `ALONG` is the distance along the path in m."""
N_COLUMNS: Final = 8
NO_LEADER: Final = -1


@kernel(error_model="numpy")
def _project(distance, path_x, path_y, heading, max_chord, own_distance, x, y):
    """Return where a point is along a path: distance along it, offset to the left, its direction, whether next to it.

    It is searched from 100 m behind to 300 m ahead of `own_distance`. A point that is not next to the path there is
    projected onto the straight line beyond the nearer end. `max_chord` is the largest distance of two samples in m.
    """
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


@kernel(error_model="numpy")
def project_onto_path(distance, path_x, path_y, heading, max_chord, own_distance, x, y, along, lateral):
    """Fill in distance along one path and offset to the left for points (N, A); NaN if not next to it."""
    for n in range(x.shape[0]):
        for a in range(x.shape[1]):
            along[n, a] = lateral[n, a] = math.nan
            if math.isfinite(x[n, a]) and math.isfinite(y[n, a]):
                projected = _project(distance, path_x, path_y, heading, max_chord, own_distance[n], x[n, a], y[n, a])
                if projected[3]:
                    along[n, a], lateral[n, a] = projected[0], projected[1]


@kernel(error_model="numpy")
def look(
    distance, path_x, path_y, path_heading, max_chord, box,
    own_distance, x, y, heading, speed, others_x, others_y, others_heading, others_speed, others_boxes,
    own, objects, leader,
):  # fmt: skip
    """Fill in what is seen in N scenarios: `own` (N, 3), `objects` (N, A, 8) and `leader` (N,).

    A path has arrays (1, P) or (N, P). `box` and `others_boxes` (3, A) are lengths, widths and centres. `own` is along,
    offset and direction of the path there. A leader is the index of the nearest object ahead in the path.
    """
    length, width, center = box
    for n in range(x.shape[0]):
        row = n if distance.shape[0] > 1 else 0
        path = distance[row], path_x[row], path_y[row], path_heading[row], max_chord[row]
        if not (math.isfinite(x[n]) and math.isfinite(y[n])):
            own[n], objects[n], leader[n] = math.nan, math.nan, NO_LEADER
            continue
        own[n, 0], own[n, 1], own[n, 2], _ = _project(*path, own_distance[n], x[n], y[n])
        cos, sin = math.cos(heading[n]), math.sin(heading[n])
        leader[n], least_gap, least_distance = NO_LEADER, math.inf, math.inf
        for a in range(others_x.shape[1]):
            half_length, half_width = 0.5 * others_boxes[0, a], 0.5 * others_boxes[1, a]
            x_a = others_x[n, a] + others_boxes[2, a] * math.cos(others_heading[n, a])
            y_a = others_y[n, a] + others_boxes[2, a] * math.sin(others_heading[n, a])
            seen = objects[n, a]
            seen[:] = math.nan
            seen[IN_PATH] = 0.0
            if not (math.isfinite(x_a) and math.isfinite(y_a)):
                continue
            dx, dy = x_a - x[n], y_a - y[n]
            seen[X], seen[Y] = dx * cos + dy * sin, dy * cos - dx * sin
            seen[TURN] = (others_heading[n, a] - heading[n] + math.pi) % (2.0 * math.pi) - math.pi
            along, lateral, direction, is_next_to = _project(*path, own_distance[n], x_a, y_a)
            if not is_next_to:
                continue
            seen[ALONG], seen[LATERAL] = along, lateral
            turn = others_heading[n, a] - direction
            turned_cos, turned_sin = abs(math.cos(turn)), abs(math.sin(turn))
            ahead = along - own[n, 0] - center
            side = 1.0 if ahead > 0.0 else -1.0 if ahead < 0.0 else 0.0
            gap = abs(ahead) - half_length * turned_cos - half_width * turned_sin - 0.5 * length
            seen[GAP] = side * max(gap, 0.0)
            seen[CLOSING] = side * (speed[n] - others_speed[n, a] * math.cos(turn))
            seen[IN_PATH] = abs(lateral) < half_length * turned_sin + half_width * turned_cos + 0.5 * width
            if seen[IN_PATH] and seen[GAP] >= 0.0 and seen[X] > 0.0:
                far = math.hypot(dx, dy)
                if seen[GAP] < least_gap or (seen[GAP] == least_gap and far < least_distance):
                    leader[n], least_gap, least_distance = a, seen[GAP], far
