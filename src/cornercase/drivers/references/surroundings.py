"""Perception of the reference drivers: motion of others along and across the path."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
from scipy.spatial import KDTree

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.drivers.base import DrivenPath, Situation
from cornercase.drivers.references.encounters import WANDERING
from cornercase.drivers.references.models import URGENT, View, time_to_collision

_SPACING = 0.5
# Number of scenarios processed at once if the path differs between them.
_AT_ONCE = 256
# Tolerance in m, so that rounding does not make a vehicle at exactly the safe distance unsafe; and speed in m/s below
# which the gap counts as constant.
_HAIR, _SLOWLY = 1e-3, 0.1


class Surroundings:
    """Track of N scenarios with A others from one time step to the next."""

    def __init__(self, scenarios: int, others: int) -> None:
        self._time = np.full(scenarios, np.nan)
        self._x, self._y = np.full((2, scenarios, others), np.nan)
        self._seen, self._beside, self._ahead = np.zeros((3, scenarios, others), dtype=np.bool_)

    def view(self, situation: Situation, acceleration: FloatArray) -> View:
        """Compute the relative motion, shape (N, A), and remember it for active scenarios.

        NaN if another does not exist, or is hidden behind a vehicle in the middle of the corridor. `acceleration` (N,)
        is that of the driver in m/s².
        """
        s = situation
        line = _line_of(s.path)
        own_along, own_aside, _ = line.places(*_middle(s.x, s.y, s.heading, s.center_x))
        x, y = _middle(s.others_x, s.others_y, s.others_heading, s.others_center_x)
        along, lateral_position, direction = line.places(x, y)
        angle = s.others_heading - direction
        half_length, half_width = 0.5 * s.others_length, 0.5 * s.others_width
        reach = 0.5 * s.length + half_length * np.abs(np.cos(angle)) + half_width * np.abs(np.sin(angle))
        breadth = 0.5 * s.width + half_length * np.abs(np.sin(angle)) + half_width * np.abs(np.cos(angle))
        lateral_distance = lateral_position - own_aside[:, None]
        speed_along, speed_aside = self._velocity(s, x, y, direction)
        gap, lateral_gap = along - own_along[:, None] - reach, np.abs(lateral_distance) - breadth
        hidden = _hidden(gap, np.abs(lateral_distance), lateral_gap < 0.0)
        gap = np.where(hidden, np.nan, gap + _HAIR)
        view = View(
            gap=gap,
            lateral_gap=np.where(hidden, np.nan, lateral_gap),
            inward=-np.sign(lateral_distance) * speed_aside,
            speed=np.broadcast_to(s.speed[:, None], gap.shape),
            other_speed=speed_along,
            acceleration=np.broadcast_to(acceleration[:, None], gap.shape),
            lengths=2.0 * reach,
            ahead=np.zeros(gap.shape, dtype=np.bool_),
        )
        self._remember(s, x, y, view)
        closing = s.speed[:, None] - speed_along > _SLOWLY
        return view._replace(ahead=self._ahead & closing)

    def _velocity(
        self, s: Situation, x: FloatArray, y: FloatArray, direction: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Speeds along and across the path in m/s, from the previous step if known, else from heading and speed."""
        has_previous = np.isclose(self._time, s.time - s.time_step, rtol=0.0, atol=1e-3 * s.time_step)[:, None]
        has_previous = has_previous & np.isfinite(self._x)
        speed_x = np.where(has_previous, (x - self._x) / s.time_step, s.others_speed * np.cos(s.others_heading))
        speed_y = np.where(has_previous, (y - self._y) / s.time_step, s.others_speed * np.sin(s.others_heading))
        cos, sin = np.cos(direction), np.sin(direction)
        return speed_x * cos + speed_y * sin, speed_y * cos - speed_x * sin

    def _remember(self, s: Situation, x: FloatArray, y: FloatArray, view: View) -> None:
        visible = np.isfinite(view.gap)
        in_corridor = view.lateral_gap < 0.0
        cuts_in = in_corridor & self._seen & self._beside
        in_good_time = cuts_in & (time_to_collision(view) > URGENT)
        is_ahead = in_corridor & (in_good_time | ~self._seen | (self._ahead & ~cuts_in))
        active = s.active
        self._ahead[active] = is_ahead[active]
        self._seen[active] = visible[active]
        self._beside[active] = (visible & ~in_corridor)[active]
        self._x[active], self._y[active], self._time[active] = x[active], y[active], s.time


class _Line:
    """A finely sampled path, onto which points are projected."""

    def __init__(self, path: DrivenPath) -> None:
        columns = (path.distance, path.x, path.y, path.heading)
        if all(column.ndim == 1 or (column == column[0]).all() for column in columns):
            distance, x, y, heading = (column if column.ndim == 1 else column[0] for column in columns)
            self._along = np.linspace(0.0, distance[-1], max(int(np.ceil(distance[-1] / _SPACING)) + 1, 2))
            self._x, self._y, self._heading = (np.interp(self._along, distance, column) for column in (x, y, heading))
            self._tree: KDTree[None, None] | None = KDTree(np.stack((self._x, self._y), axis=1))
        else:
            self._along, self._x, self._y, self._heading = columns
            self._tree = None

    def places(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Distance along the path and to its left in m, and its direction in rad, each of shape (N,) or (N, A)."""
        is_present = np.isfinite(x) & np.isfinite(y)
        known_x, known_y = np.where(is_present, x, 0.0), np.where(is_present, y, 0.0)
        if self._tree is not None:
            _, nearest = self._tree.query(np.stack((known_x, known_y), axis=-1))
            along, line_x, line_y, heading = (
                column[nearest] for column in (self._along, self._x, self._y, self._heading)
            )
        else:
            nearest = self._nearest_in_each(known_x.reshape(len(x), -1), known_y.reshape(len(x), -1))
            columns = (self._along, self._x, self._y, self._heading)
            along, line_x, line_y, heading = (
                np.take_along_axis(column, nearest, axis=1).reshape(x.shape) for column in columns
            )
        cos, sin = np.cos(heading), np.sin(heading)
        from_x, from_y = x - line_x, y - line_y
        return along + from_x * cos + from_y * sin, from_y * cos - from_x * sin, heading

    def _nearest_in_each(self, x: FloatArray, y: FloatArray) -> IntArray:
        nearest = np.empty(x.shape, dtype=np.int64)
        for first in range(0, len(x), _AT_ONCE):
            rows = slice(first, first + _AT_ONCE)
            for k in range(x.shape[1]):
                squared_distance = (self._x[rows] - x[rows, k, None]) ** 2 + (self._y[rows] - y[rows, k, None]) ** 2
                nearest[rows, k] = squared_distance.argmin(axis=1)
        return nearest


_LINES: WeakKeyDictionary[DrivenPath, _Line] = WeakKeyDictionary()


def _line_of(path: DrivenPath) -> _Line:
    if path not in _LINES:
        _LINES[path] = _Line(path)
    return _LINES[path]


def _middle(
    x: FloatArray, y: FloatArray, heading: FloatArray, center_x: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    """Centre of a box whose reference point is at (x, y)."""
    return x + center_x * np.cos(heading), y + center_x * np.sin(heading)


def _hidden(gap: FloatArray, off: FloatArray, in_the_way: BoolArray) -> BoolArray:
    """Entities in the corridor behind a nearer one in the middle of it, bool (N, A)."""
    gaps = np.where((off <= WANDERING) & (gap > 0.0), gap, np.inf)
    nearest = gaps.min(axis=1, keepdims=True, initial=np.inf)
    return np.asarray(in_the_way & (gap > nearest))
