"""The path as the driver model plans on it."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.drivers.base import DrivenPath

STEP: Final = 0.5
"""m between the samples of a route, or the next less that divides its length.

Boxes are tested at places this far apart; contacts are refined in between.
"""

_FASTEST = 100.0

# m from sample to sample by which a straight line may fail to be one.
_STRAIGHT = 1e-10


class Route(NamedTuple):
    """A path at equal distances, in one row for all scenarios or in one for each.

    Attributes
    ----------
    step : ndarray of float64, shape (N,)
        m between samples.
    x, y, cos, sin : ndarray of float64, shape (N, R)
        m, m, 1, 1.
    squared_speed : ndarray of float64, shape (N, R)
        Square of the highest speed from which the curves ahead can be taken, in m²/s²; the lowest within one
        step.
    straight : ndarray of float64, shape (N, R)
        How many samples follow in a straight line.
    longest, sharpest : ndarray of float64, shape (N,)
        Largest distance between two samples that follow each other in m, and between the ends of their directions,
        taken as unit vectors.
    """

    step: FloatArray
    x: FloatArray
    y: FloatArray
    cos: FloatArray
    sin: FloatArray
    squared_speed: FloatArray
    straight: FloatArray
    longest: FloatArray
    sharpest: FloatArray


def plan_route(
    path: DrivenPath, *, lateral_acceleration: float, deceleration: float, rows: IntArray | None = None
) -> Route:
    """Resample a path and find how fast its curves can be taken.

    At each place the speed v satisfies v² |κ| ≤ a_lat, and v² ≤ v_c² + 2 b d for each place at a distance d
    ahead whose own limit is v_c.

    Parameters
    ----------
    path : DrivenPath
    lateral_acceleration, deceleration : float
        a_lat and b in m/s².
    rows : ndarray of int64, shape (R,), optional
        Of a path that runs otherwise in each scenario, those to plan; all if not given.

    Returns
    -------
    Route
        With R rows in place of N, if `rows` are given.
    """
    arrays = [np.atleast_2d(array) for array in (path.distance, path.x, path.y, path.heading, path.curvature)]
    if rows is not None:
        arrays = [array[rows] for array in arrays]
    planned = [
        _plan_row(row, lateral_acceleration, deceleration, count_samples(path)) for row in zip(*arrays, strict=True)
    ]
    step, *curves = (np.array(column) for column in zip(*planned, strict=True))
    x, y, cos, sin, squared_speed = curves
    longest, sharpest = (np.hypot(np.diff(a), np.diff(b)).max(axis=1) for a, b in ((x, y), (cos, sin)))
    straight = np.array([_straight(*row) for row in zip(step, x, y, cos, sin, strict=True)])
    return Route(step, x, y, cos, sin, squared_speed, straight, longest, sharpest)


def count_samples(path: DrivenPath) -> int:
    """Say how many samples a row of a path's `Route` has.

    Parameters
    ----------
    path : DrivenPath

    Returns
    -------
    int
    """
    return max(2, int(np.ceil(path.distance.max() / STEP)) + 1)


def _straight(step: float, x: FloatArray, y: FloatArray, cos: FloatArray, sin: FloatArray) -> FloatArray:
    """How many samples of a row follow each in a straight line, in its direction."""
    off = np.hypot(np.diff(x) - step * cos[:-1], np.diff(y) - step * sin[:-1])
    turned = np.hypot(np.diff(cos), np.diff(sin))
    ends = np.append(np.flatnonzero((off > _STRAIGHT) | (turned > _STRAIGHT)), len(x) - 1)
    every = np.arange(len(x))
    following: FloatArray = (ends[np.searchsorted(ends, every)] - every).astype(np.float64)
    return following


def _plan_row(
    row: tuple[FloatArray, ...],
    lateral_acceleration: float,
    deceleration: float,
    count: int,
) -> tuple[float, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    here, x, y, heading, curvature = row
    in_curve = lateral_acceleration / np.maximum(np.abs(curvature), lateral_acceleration / _FASTEST**2)
    from_start = in_curve + 2.0 * deceleration * here
    squared = np.minimum.accumulate(from_start[::-1])[::-1] - 2.0 * deceleration * here
    at = np.linspace(0.0, here[-1], count)
    towards = np.interp(at, here, heading)
    step = float(at[1])
    # The lowest limit around each sample, so that interpolation never exceeds the path's limit.
    around = np.stack([np.searchsorted(here, at - step), np.searchsorted(here, at + step, "right")], axis=1)
    lowest = np.minimum.reduceat(np.append(squared, np.inf), around.ravel())[::2]
    squared_speed = np.minimum(lowest, np.interp(at, here, squared))
    return step, np.interp(at, here, x), np.interp(at, here, y), np.cos(towards), np.sin(towards), squared_speed
