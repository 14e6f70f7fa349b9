"""Rational B-spline curves."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray

_MOST_SAMPLES: Final = 100_000


def nurbs_points(
    x: FloatArray,
    y: FloatArray,
    time: FloatArray,
    weights: FloatArray,
    knots: FloatArray,
    order: int,
    samples: int = 1000,
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
    """
    # Imported here, since it takes time and few files have such curves.
    from scipy.interpolate import BSpline

    basis = BSpline(knots, np.eye(len(weights)), order - 1)
    u = np.linspace(knots[order - 1], knots[len(weights)], samples)
    value, slope = basis(u) * weights, basis(u, 1) * weights
    total, change = value.sum(axis=1), slope.sum(axis=1)
    px, py = _mixed(x, value) / total, _mixed(y, value) / total
    dx, dy = (_mixed(x, slope) - px * change) / total, (_mixed(y, slope) - py * change) / total
    # Sampled about every 1 m, as in esmini: the times depend on it.
    length = np.zeros(len(x))
    for k in range(x.shape[1] - 1):
        length += np.hypot(x[:, k + 1] - x[:, k], y[:, k + 1] - y[:, k])
    counts = 2 + np.clip(np.nan_to_num(length), 0.0, _MOST_SAMPLES).astype(np.int64)
    clock = np.zeros_like(px)
    for count in np.unique(counts):
        coarse = np.linspace(u[0], u[-1], int(count))
        peaks = coarse[(basis(coarse) * weights).argmax(axis=0)]
        # One hat function for each control point.
        hats = np.stack([np.interp(u, peaks, row) for row in np.eye(len(weights))])
        clock[counts == count] = _mixed(time[counts == count], hats.T)
    return px, py, np.unwrap(np.arctan2(dy, dx), axis=1), clock


def _mixed(controls: FloatArray, shares: FloatArray) -> FloatArray:
    """Sums of control points by their shares at each sample, (N, C) and (S, C) to (N, S).

    A product of matrices would round otherwise for one scenario than for many.
    """
    result = np.zeros((len(controls), len(shares)))
    for k in range(controls.shape[1]):
        result += controls[:, k, None] * shares[:, k]
    return result
