"""Compiled computation of the worst time to collision, vectorized over blocks of instants."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math

import numpy as np

from cornercase._common.numba.kernel import kernel

# Instants per block; loops over a block have no branches, so that the compiler vectorizes them.
_BLOCK = 64
_ITERATIONS = 100


@kernel(error_model="numpy")
def wttc_of_recording(x, y, heading, speed, center_offset, ego_row, other_row, radius, growth, out):
    """Write the worst time to collision of two entities, given by their rows, at each instant to `out`, shape (T,).

    The centre of each box is `center_offset` ahead of its reference point. `radius` is the sum of the radii of the
    circles around both boxes, and `growth` is the sum of the greatest accelerations of both entities.
    """
    position, velocity = np.empty((2, _BLOCK)), np.empty((2, _BLOCK))
    radii, growths = np.full(_BLOCK, radius), np.full(_BLOCK, growth)
    for first in range(0, len(out), _BLOCK):
        count = min(_BLOCK, len(out) - first)
        for k in range(count):
            i = first + k
            cos_a, sin_a = math.cos(heading[ego_row, i]), math.sin(heading[ego_row, i])
            cos_b, sin_b = math.cos(heading[other_row, i]), math.sin(heading[other_row, i])
            position[0, k] = (x[other_row, i] + center_offset[other_row] * cos_b) - (
                x[ego_row, i] + center_offset[ego_row] * cos_a
            )
            position[1, k] = (y[other_row, i] + center_offset[other_row] * sin_b) - (
                y[ego_row, i] + center_offset[ego_row] * sin_a
            )
            velocity[0, k] = speed[other_row, i] * cos_b - speed[ego_row, i] * cos_a
            velocity[1, k] = speed[other_row, i] * sin_b - speed[ego_row, i] * sin_a
        _solve_block(position, velocity, radii, growths, count, out[first : first + count])


@kernel(error_model="numpy")
def wttc_of_circles(position, velocity, radius, growth, out):
    """Write the worst time to collision of n pairs of growing circles to `out`, shape (n,).

    `position` and `velocity`, shape (n, 2), are those of one circle relative to the other. `radius` is the sum of both
    radii and `growth` the sum of both greatest accelerations, shape (n,).
    """
    positions, velocities = np.empty((2, _BLOCK)), np.empty((2, _BLOCK))
    radii, growths = np.empty(_BLOCK), np.empty(_BLOCK)
    for first in range(0, len(out), _BLOCK):
        count = min(_BLOCK, len(out) - first)
        for k in range(count):
            for axis in range(2):
                positions[axis, k] = position[first + k, axis]
                velocities[axis, k] = velocity[first + k, axis]
            radii[k] = radius[first + k]
            growths[k] = growth[first + k]
        _solve_block(positions, velocities, radii, growths, count, out[first : first + count])


@kernel(error_model="numpy")
def _solve_block(position, velocity, radius, growth, count, out):
    squared_gap, bend, closing = np.empty(count), np.empty(count), np.empty(count)
    gain, size, is_early = np.empty(count), np.empty(count), np.empty(count)
    peak_time, time = np.empty(count), np.empty(count)
    for k in range(count):
        px, py, vx, vy = position[0, k], position[1, k], velocity[0, k], velocity[1, k]
        distance = math.sqrt(px * px + py * py)
        squared_gap[k] = (distance - radius[k]) * (distance + radius[k])
        square = vx * vx + vy * vy
        closing[k] = -(px * vx + py * vy)
        bend[k] = square - radius[k] * growth[k]
        gain[k] = 0.5 * growth[k] * growth[k]
        size[k] = square
    _first_maximum_of_quartic(bend, gain, closing, peak_time)
    for k in range(count):
        square, t = size[k], peak_time[k]
        peak = ((0.5 * gain[k] * t * t - bend[k]) * t + 2.0 * closing[k]) * t - squared_gap[k]
        squares = squared_gap[k] + radius[k] * radius[k]
        # Circles that only graze count as touching: the tolerance covers rounding errors in the maximum.
        rises = (bend[k] > 0.0) & (closing[k] > 0.0)
        grazes = rises & (peak >= -1e-14 * (squares + square * t * t))
        is_early[k] = 1.0 if grazes else 0.0
        curvature = 2.0 * bend[k] - 6.0 * gain[k] * t * t
        drop = math.sqrt(2.0 * max(peak, 0.0) / (curvature if curvature > 0.0 else 1.0))
        from_left = t - drop if curvature > 0.0 else 0.0
        speed = math.sqrt(square)
        gap = max(math.sqrt(squares) - radius[k], 0.0)
        from_right = (speed + math.sqrt(square + 2.0 * growth[k] * gap)) / growth[k]
        time[k] = min(max(from_left, 0.0), t) if grazes else from_right
    for _ in range(_ITERATIONS):
        moves = 0
        for k in range(count):
            t = time[k]
            value = ((0.5 * gain[k] * t * t - bend[k]) * t + 2.0 * closing[k]) * t - squared_gap[k]
            slope = (2.0 * gain[k] * t * t - 2.0 * bend[k]) * t + 2.0 * closing[k]
            from_below = is_early[k] > 0.0
            step = value / slope if (value < 0.0) == from_below else 0.0
            moved = t - step
            # Keep Newton's step below the maximum and above 0; ignore a step that is NaN.
            bounded = (
                (peak_time[k] if moved > peak_time[k] else moved) if from_below else (0.0 if moved < 0.0 else moved)
            )
            bounded = bounded if bounded == bounded else t
            moves += 1 if (abs(bounded - t) > 4e-15 * t) & (squared_gap[k] > 0.0) else 0
            time[k] = bounded
        if moves == 0:
            break
    for k in range(count):
        t = time[k] if (is_early[k] > 0.0) | (growth[k] > 0.0) else math.inf
        t = 0.0 if squared_gap[k] <= 0.0 else t
        total = squared_gap[k] + size[k] + closing[k] + radius[k] + growth[k]
        out[k] = t if total == total else math.nan


@kernel(error_model="numpy")
def _first_maximum_of_quartic(bend, gain, closing, out):
    """Write the time t of the maximum of each quartic ``gain t⁴/2 - bend t² + 2 closing t`` to `out`.

    The first maximum, before the inflection, is computed. Half the slope of the quartic, ``gain t³ - bend t +
    closing``, is convex and falls up to the inflection. So Newton's method reaches the first root of the slope from the
    left.
    """
    for k in range(len(out)):
        out[k] = closing[k] / bend[k]
    for _ in range(_ITERATIONS):
        moves = 0
        for k in range(len(out)):
            t = out[k]
            slope = 3.0 * gain[k] * t * t - bend[k]
            value = (gain[k] * t * t - bend[k]) * t + closing[k]
            moved = t - value / slope
            rises = (bend[k] > 0.0) & (closing[k] > 0.0)
            continues = rises & (slope < 0.0) & (moved - t > 1e-9 * t)
            out[k] = moved if continues else t
            moves += 1 if continues else 0
        if moves == 0:
            break
    for k in range(len(out)):
        inflection = math.sqrt(max(bend[k], 0.0) / (3.0 * gain[k])) if gain[k] > 0.0 else math.inf
        out[k] = inflection if out[k] > inflection else out[k]
