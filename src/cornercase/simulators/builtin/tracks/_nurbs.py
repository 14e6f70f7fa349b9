"""Rational B-spline curves (NURBS)."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray

# As in esmini, the influence of control points, from which times follow, is sampled about every metre and a small step
# of the parameter further. The curve has 8 points per sample.
_SAMPLE_SPACING: Final = 1.0
_PARAMETER_STEP: Final = 0.001
_POINTS_PER_SAMPLE: Final = 8
_MAX_SAMPLES: Final = 4_000
# Maximum number of weights (control points times samples) held at once.
_MAX_WEIGHTS: Final = 10_000_000
# m; a smaller derivative has no direction.
_MIN_DERIVATIVE: Final = 1e-9


def evaluate_nurbs(
    x: FloatArray, y: FloatArray, time: FloatArray, weights: FloatArray, knots: FloatArray, order: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return x, y (m), tangent directions (rad) and times (s) at points along a NURBS, shape (N, points) each.

    `x`, `y` and `time` of the C control points have shape (N, C) for N scenarios. `order` is the degree plus one; there
    are C + order knots. The curve has the time of a control point at the point where the influence of this control
    point is largest. Times in between are interpolated. The last point occurs at least twice, and more often if
    another scenario has more points.
    """
    # Imported late: slow to import, and rarely needed.
    from scipy.interpolate import BSpline

    basis = BSpline(knots, np.eye(len(weights)), order - 1)
    begin, end = knots[order - 1], knots[len(weights)]
    # Per scenario, so that results do not depend on the batch.
    length = np.zeros(len(x))
    for k in range(x.shape[1] - 1):
        length += np.hypot(x[:, k + 1] - x[:, k], y[:, k + 1] - y[:, k])
    max_samples = max(min(_MAX_SAMPLES, _MAX_WEIGHTS // (_POINTS_PER_SAMPLE * len(weights))), 1)
    counts = 1 + np.clip(np.nan_to_num(length / _SAMPLE_SPACING), 0.0, max_samples).astype(np.int64)
    results = np.empty((4, len(x), _POINTS_PER_SAMPLE * int(counts.max()) + 2))
    for count in np.unique(counts):
        rows = counts == count
        coarse, u = np.linspace(begin, end, count + 1), np.linspace(begin, end, _POINTS_PER_SAMPLE * count + 1)
        value, slope = basis(u) * weights, basis(u, 1) * weights
        total, change = value.sum(axis=1), slope.sum(axis=1)
        px, py = _weighted_sums(x[rows], value) / total, _weighted_sums(y[rows], value) / total
        dx = (_weighted_sums(x[rows], slope) - px * change) / total
        dy = (_weighted_sums(y[rows], slope) - py * change) / total
        step = min(_PARAMETER_STEP, float(coarse[1] - coarse[0]))
        ahead = np.append(coarse[:-1] + step, coarse[-1] - step)
        times = _weighted_sums(time[rows], _time_weights(u, coarse[basis(ahead).argmax(axis=0)]).T)
        for values, target in zip((px, py, _tangent_directions(px, py, dx, dy), times), results, strict=True):
            target[rows, : u.size] = values
            target[rows, u.size :] = values[:, -1:]
    return results[0], results[1], results[2], results[3]


def _tangent_directions(x: FloatArray, y: FloatArray, dx: FloatArray, dy: FloatArray) -> FloatArray:
    """Return unwrapped tangent directions in rad from the derivatives of a curve, shape (N, points)."""
    # If control points coincide, the derivative vanishes. Then the direction to the next point is used.
    is_singular = np.hypot(dx, dy) < _MIN_DERIVATIVE
    if is_singular.any():
        ahead_x, ahead_y = (
            np.diff(coordinate, axis=1, append=2.0 * coordinate[:, -1:] - coordinate[:, -2:-1]) for coordinate in (x, y)
        )
        dx, dy = np.where(is_singular, ahead_x, dx), np.where(is_singular, ahead_y, dy)
    return np.unwrap(np.arctan2(dy, dx), axis=1)


def _weighted_sums(controls: FloatArray, weights: FloatArray) -> FloatArray:
    """Return weighted sums of control points, shape (N, S), from control points (N, C) and weights (S, C)."""
    # A matrix product would round differently for one scenario than for many.
    result = np.zeros((len(controls), len(weights)))
    for k in range(controls.shape[1]):
        result += controls[:, k, None] * weights[:, k]
    return result


def _time_weights(u: FloatArray, peaks: FloatArray) -> FloatArray:
    """Return the weight of each control point for the time at each parameter value `u`, shape (C, points).

    `peaks` are the parameter values at which the influence of control points is largest.
    """
    return np.stack([np.interp(u, peaks, row) for row in np.eye(len(peaks))])
