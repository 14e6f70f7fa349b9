"""Rational B-spline curves."""

from __future__ import annotations

import numpy as np

from cornercase._common.typing import FloatArray


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
    px, py = x @ value.T / total, y @ value.T / total
    dx, dy = (x @ slope.T - px * change) / total, (y @ slope.T - py * change) / total
    # Sampled about every 1 m, as in esmini: the times depend on it.
    coarse = np.linspace(u[0], u[-1], 2 + int(np.hypot(np.diff(x), np.diff(y)).sum(axis=1).mean()))
    peaks = coarse[(basis(coarse) * weights).argmax(axis=0)]
    # One hat function for each control point.
    hats = np.stack([np.interp(u, peaks, row) for row in np.eye(len(weights))])
    return px, py, np.unwrap(np.arctan2(dy, dx), axis=1), time @ hats
