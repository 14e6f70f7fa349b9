"""Motion of an ego along a trajectory that its driver gives: exact, or with a steered vehicle."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Final

import numpy as np

from cornercase._common.geometry.boxes import wrap_angle
from cornercase._common.typing import FloatArray
from cornercase.drivers._base import DrivenPath
from cornercase.drivers._controls import Trajectory
from cornercase.drivers._path_tracking import locate_on_path, steer_along_path

FINAL_DECELERATION: Final = 3.0
"""Deceleration in m/s² with which the ego stops after the end of its trajectory."""
# s; time in which a vehicle makes up for a delay or a wrong speed.
_CATCH_UP: Final = 0.5
# m; points that are nearer to the one before do not count, and smaller steps have no direction.
_STANDSTILL: Final = 1e-4
# s; tolerance of the clock.
_CLOCK: Final = 1e-6


class FollowedTrajectory:
    """Trajectory that an ego follows, beginning at the position `x`, `y` at `time`.

    `given` is the trajectory as the driver gave it. Until the first instant of `given`, the ego goes straight to
    the first point. If the next point lies behind the ego, an ego that `may_reverse` drives backwards; any other ego
    turns around.
    """

    def __init__(self, given: Trajectory, time: float, x: float, y: float, *, may_reverse: bool) -> None:
        self.given, self._may_reverse = given, may_reverse
        self._time, self._x, self._y = given.time, given.x, given.y
        if given.time[0] > time + _CLOCK:
            self._time = np.concatenate([[time], given.time])
            self._x, self._y = np.concatenate([[x], given.x]), np.concatenate([[y], given.y])
        self._distance = 0.0
        self._headings = None if given.heading is None else np.unwrap(given.heading)

    def move(
        self, time: float, x: float, y: float, heading: float, speed: float, dt: float
    ) -> tuple[float, float, float, float]:
        """Return x, y, heading and speed at the end of a time step of `dt` s, exactly on the trajectory."""
        if self._is_over(time + dt):
            speed = math.copysign(max(abs(speed) - FINAL_DECELERATION * dt, 0.0), speed) or 0.0
            return x + speed * dt * math.cos(heading), y + speed * dt * math.sin(heading), heading, speed
        to_x, to_y = (float(np.interp(time + dt, self._time, values)) for values in (self._x, self._y))
        step, is_given = math.hypot(to_x - x, to_y - y), time + dt > self.given.time[0] - _CLOCK
        motion = math.atan2(to_y - y, to_x - x) if step > _STANDSTILL else heading
        direction = motion
        if is_given and self._headings is not None:
            direction = float(np.interp(time + dt, self.given.time, self._headings))
        elif self._may_reverse and math.cos(motion - heading) < 0.0:
            direction += math.pi
        speed = step / dt
        if is_given and self.given.speed is not None:
            speed = float(np.interp(time + dt, self.given.time, self.given.speed))
        elif step > _STANDSTILL and math.cos(motion - direction) < 0.0:
            speed = -speed
        return to_x, to_y, heading + float(wrap_angle(direction - heading)), speed

    def track(
        self,
        time: float,
        x: float,
        y: float,
        heading: float,
        speed: float,
        dt: float,
        wheelbase: float,
        response: float,
    ) -> tuple[float, float]:
        """Return the acceleration in m/s² and the front wheel angle in rad that steer a vehicle along the trajectory.

        `response` is the time in s by which the wheels lag behind a requested angle.
        """
        if self._path is None or self._is_over(time + dt):
            return -min(FINAL_DECELERATION, speed / dt), 0.0
        ahead = speed * (0.5 * dt + response)
        pose = locate_on_path(self._path, *(np.array([value]) for value in (self._distance, x, y, heading, ahead)))
        self._distance = float(pose.along[0])
        now, then = np.interp([time, time + dt], self._time, self._travelled).tolist()
        wanted, feedforward = (then - now) / dt, 0.0
        if self.given.speed is not None:
            wanted, later = np.interp([time, time + dt], self.given.time, self.given.speed).tolist()
            feedforward = (later - wanted) / dt
        acceleration = feedforward + 2.0 * (wanted - speed) / _CATCH_UP + (now - self._distance) / _CATCH_UP**2
        return acceleration, float(steer_along_path(pose, np.array([speed]), wheelbase, response)[0])

    def _is_over(self, time: float) -> bool:
        return time > float(self._time[-1]) + _CLOCK

    @cached_property
    def _travelled(self) -> FloatArray:
        """Distance in m of each point of the trajectory from the first point, along the line through the points."""
        steps = np.hypot(np.diff(self._x), np.diff(self._y))
        return np.concatenate([[0.0], np.cumsum(np.where(steps > _STANDSTILL, steps, 0.0))])

    @cached_property
    def _path(self) -> DrivenPath | None:
        """Path through the points; None if all points are at the same position."""
        keep = np.concatenate([[True], np.diff(self._travelled) > 0.0])
        distance, x, y = self._travelled[keep], self._x[keep], self._y[keep]
        if len(distance) < 2:
            return None
        heading = np.unwrap(np.arctan2(np.gradient(y, distance), np.gradient(x, distance)))
        return DrivenPath(distance, x, y, heading, np.gradient(heading, distance))
