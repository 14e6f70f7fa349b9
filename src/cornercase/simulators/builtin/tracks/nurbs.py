"""Rational B-spline curves."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray

# A control point's influence is looked for about once in so many m, and so much of the curve's parameter beyond, as in
# esmini: the times depend on it. In between there are so many points.
_SPACING: Final = 1.0
_AHEAD: Final = 0.001
_FINER: Final = 8
_MOST_SAMPLES: Final = 4_000
# Influences of all control points at all samples that are held at once.
_MOST_INFLUENCES: Final = 10_000_000
# A derivative below this, in m, has no direction.
_STILL: Final = 1e-9


def nurbs_points(
    x: FloatArray, y: FloatArray, time: FloatArray, weights: FloatArray, knots: FloatArray, order: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Points of a rational B-spline curve, the direction of its tangent there, and when they are reached.

    The time of a control point is reached where its influence is largest; between these places it grows evenly.

    Parameters
    ----------
    x, y : ndarray of float64, shape (N, C)
        Control points in m.
    time : ndarray of float64, shape (N, C)
        s.
    weights : ndarray of float64, shape (C,)
    knots : ndarray of float64, shape (C + order,)
    order : int
        Degree plus one.

    Returns
    -------
    tuple of ndarray of float64, each (N, samples)
        The last point is repeated, once at least, and where another scenario has more of them.
    """
    # Imported here, since it takes time and few files have such curves.
    from scipy.interpolate import BSpline

    basis = BSpline(knots, np.eye(len(weights)), order - 1)
    begin, end = knots[order - 1], knots[len(weights)]
    # Each scenario by its own length alone.
    length = np.zeros(len(x))
    for k in range(x.shape[1] - 1):
        length += np.hypot(x[:, k + 1] - x[:, k], y[:, k + 1] - y[:, k])
    most = max(min(_MOST_SAMPLES, _MOST_INFLUENCES // (_FINER * len(weights))), 1)
    counts = 1 + np.clip(np.nan_to_num(length / _SPACING), 0.0, most).astype(np.int64)
    found = np.empty((4, len(x), _FINER * int(counts.max()) + 2))
    for count in np.unique(counts):
        rows = counts == count
        coarse, u = np.linspace(begin, end, count + 1), np.linspace(begin, end, _FINER * count + 1)
        value, slope = basis(u) * weights, basis(u, 1) * weights
        total, change = value.sum(axis=1), slope.sum(axis=1)
        px, py = _mixed(x[rows], value) / total, _mixed(y[rows], value) / total
        dx, dy = (_mixed(x[rows], slope) - px * change) / total, (_mixed(y[rows], slope) - py * change) / total
        step = min(_AHEAD, float(coarse[1] - coarse[0]))
        ahead = np.append(coarse[:-1] + step, coarse[-1] - step)
        clock = _mixed(time[rows], _shares(u, coarse[basis(ahead).argmax(axis=0)]).T)
        for part, held in zip((px, py, _headings(px, py, dx, dy), clock), found, strict=True):
            held[rows, : u.size] = part
            held[rows, u.size :] = part[:, -1:]
    return found[0], found[1], found[2], found[3]


def _headings(x: FloatArray, y: FloatArray, dx: FloatArray, dy: FloatArray) -> FloatArray:
    """Direction of a curve at its points, unwrapped, given its derivative there, each (N, S)."""
    # Where control points coincide the derivative is nothing, and the curve leads to its next point.
    still = np.hypot(dx, dy) < _STILL
    if still.any():
        ahead_x, ahead_y = (np.diff(one, axis=1, append=2.0 * one[:, -1:] - one[:, -2:-1]) for one in (x, y))
        dx, dy = np.where(still, ahead_x, dx), np.where(still, ahead_y, dy)
    return np.unwrap(np.arctan2(dy, dx), axis=1)


def _mixed(controls: FloatArray, shares: FloatArray) -> FloatArray:
    """Sums of control points by their shares at each sample, (N, C) and (S, C) to (N, S).

    A product of matrices would round otherwise for one scenario than for many.
    """
    result = np.zeros((len(controls), len(shares)))
    for k in range(controls.shape[1]):
        result += controls[:, k, None] * shares[:, k]
    return result


def _shares(u: FloatArray, peaks: FloatArray) -> FloatArray:
    """Share of each control point in the time at each parameter, shape (C, samples)."""
    return np.stack([np.interp(u, peaks, row) for row in np.eye(len(peaks))])
