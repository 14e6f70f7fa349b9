"""How a driven entity sees other entities: in coordinates along its path, and in axes fixed to the driven entity."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import Final

from cornercase._common.numba.angles import wrap_angle
from cornercase._common.numba.kernel import kernel
from cornercase.drivers._kernels.path_projection import project_point, project_point_nearby

X, Y, TURN, GAP, CLOSING, LATERAL, IN_PATH, ALONG = range(8)
"""Columns of the view of an object, as in `ObjectView`; `ALONG` is the distance along the path in m."""
N_COLUMNS: Final = 8
NO_LEADER: Final = -1


@kernel(error_model="numpy")
def look(
    distance, path_x, path_y, path_heading, max_chord, box,
    own_distance, x, y, heading, speed, others_x, others_y, others_heading, others_speed, others_boxes,
    active, own, objects, leader,
):  # fmt: skip
    """Fill in what the ego sees of A objects in N scenarios: `own` (N, 3), `objects` (N, A, 8) and `leader` (N,).

    In scenarios that are not `active` (N,), nothing is seen: numbers are NaN.

    The arrays of the path have shape (1, P) or (N, P). `box` (3,) and `others_boxes` (3, A) are length, width and
    centre in m. `own` is the ego's distance along the path, the ego's offset to the left of the path, and the direction
    of the path next to the ego. The columns of `objects` are the constants `X` to `ALONG` of this module. `leader` is
    the index of the nearest object that is ahead and overlaps the ego's path; -1 if there is none.
    """
    length, width, center = box
    for n in range(x.shape[0]):
        if not active[n]:
            own[n], objects[n], leader[n] = math.nan, math.nan, NO_LEADER
            objects[n, :, IN_PATH] = 0.0
            continue
        row = n if distance.shape[0] > 1 else 0
        path = distance[row], path_x[row], path_y[row], path_heading[row], max_chord[row]
        own[n, 0], own[n, 1], own[n, 2], _ = project_point_nearby(*path, own_distance[n], x[n], y[n])
        cos, sin = math.cos(heading[n]), math.sin(heading[n])
        leader[n], least_gap, least_distance = NO_LEADER, math.inf, math.inf
        for a in range(others_x.shape[1]):
            half_length, half_width = 0.5 * others_boxes[0, a], 0.5 * others_boxes[1, a]
            x_a = others_x[n, a] + others_boxes[2, a] * math.cos(others_heading[n, a])
            y_a = others_y[n, a] + others_boxes[2, a] * math.sin(others_heading[n, a])
            seen = objects[n, a]
            seen[:] = math.nan
            seen[IN_PATH] = 0.0
            dx, dy = x_a - x[n], y_a - y[n]
            seen[X], seen[Y] = dx * cos + dy * sin, dy * cos - dx * sin
            seen[TURN] = wrap_angle(others_heading[n, a] - heading[n])
            along, lateral, direction, is_next_to = project_point(*path, own_distance[n], x_a, y_a)
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
