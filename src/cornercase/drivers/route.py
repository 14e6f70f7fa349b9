"""The path as the driver model plans on it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cornercase.drivers.base import Path
from cornercase.typing import FloatArray

# Spacing of the places at which boxes are tested, in m; contacts are refined between them.
_STEP = 0.5
_FASTEST = 100.0


class Route(NamedTuple):
    """A path at equal distances.

    Attributes
    ----------
    step : float
        m between samples.
    x, y, heading, cos, sin : ndarray of float64, shape (R,)
        m, rad, 1, 1.
    squared_speed : ndarray of float64, shape (R,)
        Square of the highest speed from which the curves ahead can be taken, in m²/s²; the lowest within one
        step.
    """

    step: float
    x: FloatArray
    y: FloatArray
    heading: FloatArray
    cos: FloatArray
    sin: FloatArray
    squared_speed: FloatArray


def plan_route(path: Path, *, lateral_acceleration: float, deceleration: float) -> Route:
    """Resample a path and find how fast its curves can be taken.

    At each place the speed v satisfies v² |κ| ≤ a_lat, and v² ≤ v_c² + 2 b d for each place at a distance d
    ahead whose own limit is v_c.

    Parameters
    ----------
    path : Path
    lateral_acceleration, deceleration : float
        a_lat and b in m/s².

    Returns
    -------
    Route
    """
    here = path.distance
    in_curve = lateral_acceleration / np.maximum(np.abs(path.curvature), lateral_acceleration / _FASTEST**2)
    from_start = in_curve + 2.0 * deceleration * here
    squared = np.minimum.accumulate(from_start[::-1])[::-1] - 2.0 * deceleration * here
    count = max(2, int(np.ceil(here[-1] / _STEP)) + 1)
    at = np.linspace(0.0, here[-1], count)
    heading = np.interp(at, here, path.heading)
    step = float(at[1])
    # The lowest around each sample, so that what is interpolated is nowhere above the limit of the path.
    first = np.searchsorted(here, at - step)
    last = np.searchsorted(here, at + step, "right")
    lowest = [squared[i:j].min() for i, j in zip(first.tolist(), last.tolist(), strict=True)]
    return Route(
        step,
        np.interp(at, here, path.x),
        np.interp(at, here, path.y),
        heading,
        np.cos(heading),
        np.sin(heading),
        np.minimum(lowest, np.interp(at, here, squared)),
    )
