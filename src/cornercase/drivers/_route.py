"""Routes: paths that are resampled for the speed planning of a driver."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.drivers._base import DrivenPath

ROUTE_STEP: Final = 0.5
"""Largest distance between samples of a route in m; reduced so that it divides the length of the route."""

_MAX_SPEED = 100.0

# Largest deviation in m per sample of a straight line.
_STRAIGHT_TOLERANCE = 1e-10


class Route(NamedTuple):
    """Path sampled at R equal distances for speed planning, with one row for all scenarios or N rows for N scenarios.

    `step` (N,): distance along the path between samples in m. `x`, `y` (N, R): positions of the samples in m. `cos`,
    `sin` (N, R): cosine and sine of the heading at the samples. `max_speed_squared` (N, R): square of the highest speed
    that the curves ahead allow, in m²/s²: at each sample, the lowest value within one step before and after the sample,
    so that interpolation never gives more than the curves allow. If the path has no sample within one step, the value
    of its next sample counts. `straight_count` (N, R): number of next samples that
    lie straight ahead of a sample. `max_spacing` (N,): largest straight distance between two consecutive samples in m.
    `max_turn` (N,): largest length of the difference between the unit vectors (cos, sin) of two consecutive samples.
    """

    step: FloatArray
    x: FloatArray
    y: FloatArray
    cos: FloatArray
    sin: FloatArray
    max_speed_squared: FloatArray
    straight_count: FloatArray
    max_spacing: FloatArray
    max_turn: FloatArray


def plan_route(
    path: DrivenPath,
    *,
    lateral_acceleration: float | FloatArray,
    deceleration: float | FloatArray,
) -> Route:
    """Resample a path at equal distances, and compute the highest speed that its curves allow.

    The result has one row for each scenario, or a single row if path and limits are given once for all scenarios.

    The highest speed v at a point with curvature κ satisfies v² |κ| ≤ a_lat. To brake in time for curves, v also
    satisfies v² ≤ v_c² + 2 b d for each point at a distance d ahead whose curvature allows the speed v_c. Here a_lat is
    `lateral_acceleration` and b is `deceleration`, in m/s².
    """
    arrays = [np.atleast_2d(array) for array in (path.distance, path.x, path.y, path.heading, path.curvature)]
    n_rows = max(len(arrays[0]), np.size(lateral_acceleration), np.size(deceleration))
    arrays = [np.broadcast_to(array, (n_rows, array.shape[1])) for array in arrays]
    limits = [np.broadcast_to(limit, n_rows).tolist() for limit in (lateral_acceleration, deceleration)]
    planned = [
        _plan_path_row(row, lateral, braking, count_route_samples(path))
        for *row, lateral, braking in zip(*arrays, *limits, strict=True)
    ]
    step, *curves = (np.array(column) for column in zip(*planned, strict=True))
    x, y, cos, sin, squared_speed = curves
    longest, sharpest = (np.hypot(np.diff(a), np.diff(b)).max(axis=1) for a, b in ((x, y), (cos, sin)))
    straight = np.array([_count_straight_samples(*row) for row in zip(step, x, y, cos, sin, strict=True)])
    return Route(step, x, y, cos, sin, squared_speed, straight, longest, sharpest)


def count_route_samples(path: DrivenPath) -> int:
    """Return the number of samples in each row of the `Route` of a path."""
    return max(2, int(np.ceil(path.distance.max() / ROUTE_STEP)) + 1)


def _count_straight_samples(step: float, x: FloatArray, y: FloatArray, cos: FloatArray, sin: FloatArray) -> FloatArray:
    """Return, for each sample of a route, how many of the next samples lie on a straight line in its direction."""
    position_error = np.hypot(np.diff(x) - step * cos[:-1], np.diff(y) - step * sin[:-1])
    direction_change = np.hypot(np.diff(cos), np.diff(sin))
    ends = np.append(
        np.flatnonzero((position_error > _STRAIGHT_TOLERANCE) | (direction_change > _STRAIGHT_TOLERANCE)), len(x) - 1
    )
    samples = np.arange(len(x))
    counts: FloatArray = (ends[np.searchsorted(ends, samples)] - samples).astype(np.float64)
    return counts


def _plan_path_row(
    row: Sequence[FloatArray],
    lateral_acceleration: float,
    deceleration: float,
    count: int,
) -> tuple[float, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    distance, x, y, heading, curvature = row
    in_curve = lateral_acceleration / np.maximum(np.abs(curvature), lateral_acceleration / _MAX_SPEED**2)
    from_start = in_curve + 2.0 * deceleration * distance
    squared = np.minimum.accumulate(from_start[::-1])[::-1] - 2.0 * deceleration * distance
    sample_distance = np.linspace(0.0, distance[-1], count)
    sample_heading = np.interp(sample_distance, distance, heading)
    step = float(sample_distance[1])
    # Use the lowest limit around each sample, so that interpolation never exceeds the path's limit.
    window = np.stack(
        [np.searchsorted(distance, sample_distance - step), np.searchsorted(distance, sample_distance + step, "right")],
        axis=1,
    )
    lowest = np.minimum.reduceat(np.append(squared, np.inf), window.ravel())[::2]
    squared_speed = np.minimum(lowest, np.interp(sample_distance, distance, squared))
    return (
        step,
        np.interp(sample_distance, distance, x),
        np.interp(sample_distance, distance, y),
        np.cos(sample_heading),
        np.sin(sample_heading),
        squared_speed,
    )
