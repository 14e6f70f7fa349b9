"""Perception of the reference drivers: motion of other entities along and across the path."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
from scipy.spatial import KDTree

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.drivers._base import DrivenPath, Situation
from cornercase.drivers.references.r157._models import URGENT_TIME_TO_COLLISION, RelativeMotion, time_to_collision
from cornercase.drivers.references.r157._scenarios import WANDERING

# Distance in m between the samples of a path.
_SPACING = 0.5
# Number of scenarios processed at once if the path differs between them.
_CHUNK_SIZE = 256
# Tolerance in m, so that rounding does not make a vehicle at exactly the safe distance unsafe; and speed in m/s below
# which the gap counts as constant.
_GAP_TOLERANCE, _MIN_CLOSING_SPEED = 1e-3, 0.1


class RelativeMotionTracker:
    """Tracker of the motion of A other entities relative to the ego's path, in N scenarios over time."""

    def __init__(self, scenarios: int, others: int) -> None:
        self._time = np.full(scenarios, np.nan)
        self._x, self._y = np.full((2, scenarios, others), np.nan)
        self._was_seen, self._was_next_to, self._was_ahead = np.zeros((3, scenarios, others), dtype=np.bool_)

    def track_relative_motion(self, situation: Situation, acceleration: FloatArray) -> RelativeMotion:
        """Return the relative motion in this time step, shape (N, A), and update the history of active scenarios.

        Gaps are NaN if an entity does not exist, or is hidden behind a vehicle in the middle of the corridor.
        `acceleration` (N,) is the acceleration of the driver in m/s².
        """
        s = situation
        line = _sampled_path(s.path)
        own_along, own_aside, _ = line.project(*_box_center(s.x, s.y, s.heading, s.center_x))
        x, y = _box_center(s.others_x, s.others_y, s.others_heading, s.others_center_x)
        along, lateral_position, direction = line.project(x, y)
        angle = s.others_heading - direction
        half_length, half_width = 0.5 * s.others_length, 0.5 * s.others_width
        reach = 0.5 * s.length + half_length * np.abs(np.cos(angle)) + half_width * np.abs(np.sin(angle))
        breadth = 0.5 * s.width + half_length * np.abs(np.sin(angle)) + half_width * np.abs(np.cos(angle))
        lateral_distance = lateral_position - own_aside[:, None]
        speed_along, speed_aside = self._velocity(s, x, y, direction)
        gap, lateral_gap = along - own_along[:, None] - reach, np.abs(lateral_distance) - breadth
        hidden = _find_hidden(gap, np.abs(lateral_distance), lateral_gap < 0.0)
        gap = np.where(hidden, np.nan, gap + _GAP_TOLERANCE)
        view = RelativeMotion(
            gap=gap,
            lateral_gap=np.where(hidden, np.nan, lateral_gap),
            approach_speed=-np.sign(lateral_distance) * speed_aside,
            speed=np.broadcast_to(s.speed[:, None], gap.shape),
            other_speed=speed_along,
            acceleration=np.broadcast_to(acceleration[:, None], gap.shape),
            total_length=2.0 * reach,
            was_ahead=np.zeros(gap.shape, dtype=np.bool_),
        )
        self._update_history(s, x, y, view)
        closing = s.speed[:, None] - speed_along > _MIN_CLOSING_SPEED
        return view._replace(was_ahead=self._was_ahead & closing)

    def _velocity(
        self, situation: Situation, x: FloatArray, y: FloatArray, direction: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the speeds of the others along and across the path in m/s.

        The speeds follow from the previous positions, or from heading and speed if no previous position is known.
        """
        has_previous = np.isclose(
            self._time, situation.time - situation.time_step, rtol=0.0, atol=1e-3 * situation.time_step
        )[:, None]
        has_previous = has_previous & np.isfinite(self._x)
        speed_x = np.where(
            has_previous, (x - self._x) / situation.time_step, situation.others_speed * np.cos(situation.others_heading)
        )
        speed_y = np.where(
            has_previous, (y - self._y) / situation.time_step, situation.others_speed * np.sin(situation.others_heading)
        )
        cos, sin = np.cos(direction), np.sin(direction)
        return speed_x * cos + speed_y * sin, speed_y * cos - speed_x * sin

    def _update_history(self, situation: Situation, x: FloatArray, y: FloatArray, motion: RelativeMotion) -> None:
        visible = np.isfinite(motion.gap)
        in_corridor = motion.lateral_gap < 0.0
        cuts_in = in_corridor & self._was_seen & self._was_next_to
        in_good_time = cuts_in & (time_to_collision(motion) > URGENT_TIME_TO_COLLISION)
        is_ahead = in_corridor & (in_good_time | ~self._was_seen | (self._was_ahead & ~cuts_in))
        active = situation.active
        self._was_ahead[active] = is_ahead[active]
        self._was_seen[active] = visible[active]
        self._was_next_to[active] = (visible & ~in_corridor)[active]
        self._x[active], self._y[active], self._time[active] = x[active], y[active], situation.time


class _ProjectionPath:
    """Finely sampled path onto which points are projected."""

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

    def project(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Project points onto the path: return distance along the path, distance to its left, and direction in rad.

        Distances are in m. All arrays have the shape (N,) or (N, A) for N scenarios and A entities.
        """
        is_present = np.isfinite(x) & np.isfinite(y)
        known_x, known_y = np.where(is_present, x, 0.0), np.where(is_present, y, 0.0)
        if self._tree is not None:
            _, nearest = self._tree.query(np.stack((known_x, known_y), axis=-1))
            along, line_x, line_y, heading = (
                column[nearest] for column in (self._along, self._x, self._y, self._heading)
            )
        else:
            nearest = self._nearest_samples(known_x.reshape(len(x), -1), known_y.reshape(len(x), -1))
            columns = (self._along, self._x, self._y, self._heading)
            along, line_x, line_y, heading = (
                np.take_along_axis(column, nearest, axis=1).reshape(x.shape) for column in columns
            )
        cos, sin = np.cos(heading), np.sin(heading)
        from_x, from_y = x - line_x, y - line_y
        return along + from_x * cos + from_y * sin, from_y * cos - from_x * sin, heading

    def _nearest_samples(self, x: FloatArray, y: FloatArray) -> IntArray:
        nearest = np.empty(x.shape, dtype=np.int64)
        for first in range(0, len(x), _CHUNK_SIZE):
            rows = slice(first, first + _CHUNK_SIZE)
            for k in range(x.shape[1]):
                squared_distance = (self._x[rows] - x[rows, k, None]) ** 2 + (self._y[rows] - y[rows, k, None]) ** 2
                nearest[rows, k] = squared_distance.argmin(axis=1)
        return nearest


_PATH_CACHE: WeakKeyDictionary[DrivenPath, _ProjectionPath] = WeakKeyDictionary()


def _sampled_path(path: DrivenPath) -> _ProjectionPath:
    if path not in _PATH_CACHE:
        _PATH_CACHE[path] = _ProjectionPath(path)
    return _PATH_CACHE[path]


def _box_center(
    x: FloatArray, y: FloatArray, heading: FloatArray, center_x: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    """Return the centre of a box whose reference point is at (x, y)."""
    return x + center_x * np.cos(heading), y + center_x * np.sin(heading)


def _find_hidden(gap: FloatArray, lateral_distance: FloatArray, in_corridor: BoolArray) -> BoolArray:
    """Return which entities in the corridor are behind a nearer entity in the middle of the corridor, bool (N, A)."""
    gaps = np.where((lateral_distance <= WANDERING) & (gap > 0.0), gap, np.inf)
    nearest = gaps.min(axis=1, keepdims=True, initial=np.inf)
    return np.asarray(in_corridor & (gap > nearest))
