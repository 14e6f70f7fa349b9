"""Lane change of a vehicle: its lateral offset over time, and the motion that follows from it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase.drivers._base import DrivenPath
from cornercase.drivers._path_tracking import PosesOnPath, locate_on_path

DURATION: Final = 4.0
"""Time in s that a lane change takes at 5 m/s or more."""
# m/s; below this speed a change takes longer, in proportion, so that the vehicle does not slide sideways.
_FULL_SPEED: Final = 5.0
# m; a vehicle that lags behind the profile has arrived when it is this near to it.
_ARRIVED: Final = 0.3


@dataclass
class LaneChange:
    """Change of a vehicle to another lane: `path` is the path along the new lane.

    The vehicle starts `start_offset` m to the left of this path. The planned offset from the path shrinks to 0 as a
    quintic polynomial of `progress`, with lateral speed and acceleration 0 at both ends. `progress` is the elapsed
    share of the change, from 0 to 1; below 5 m/s it grows more slowly. `distance` is the approximate position of the
    vehicle along the path in m.

    Source of the polynomial: M. Werling et al., "Optimal trajectory generation for dynamic street scenarios in a Frenét
    frame", ICRA 2010.
    """

    path: DrivenPath
    distance: float
    start_offset: float
    progress: float = 0.0

    @classmethod
    def begin(cls, path: DrivenPath, x: float, y: float) -> LaneChange:
        """Create a change to the lane with this path, which begins at the position `x`, `y` in m."""
        nearest = int(np.argmin(np.hypot(path.x - x, path.y - y)))
        change = cls(path, float(path.distance[nearest]), 0.0)
        change.start_offset = float(change._locate(x, y, 0.0).offset[0])
        return change

    def advance(self, speed: float, dt: float) -> None:
        """Advance the progress of the change by a time step `dt` in s, at a speed in m/s."""
        self.progress = min(self.progress + dt / DURATION * min(abs(speed) / _FULL_SPEED, 1.0), 1.0)

    def move(self, x: float, y: float, speed: float, dt: float) -> tuple[float, float, float]:
        """Return x, y and heading after a time step `dt` in s of exact motion along the change, at a speed in m/s."""
        at = float(self._locate(x, y, 0.0).along[0])
        before = self._offset()
        self.advance(speed, dt)
        across, step = self._offset() - before, speed * dt
        ahead = math.sqrt(max(step * step - across * across, 0.0))
        stations, path = self.path.distance, self.path
        bend = float(np.interp(at + 0.5 * ahead, stations, path.curvature))
        self.distance = at + ahead / max(1.0 - bend * 0.5 * (before + self._offset()), 0.1)
        on_x, on_y, direction = (
            float(np.interp(self.distance, stations, values)) for values in (path.x, path.y, path.heading)
        )
        offset, slope = self._offset(), self._slope(speed)
        heading = direction + math.asin(min(max(slope, -1.0), 1.0))
        return on_x - offset * math.sin(direction), on_y + offset * math.cos(direction), heading

    def advance_and_locate(
        self, x: float, y: float, heading: float, speed: float, dt: float, response: float
    ) -> PosesOnPath:
        """Advance the change by a time step `dt` in s, and return how the given pose deviates from the planned motion.

        A controller uses the result to steer along the planned motion. `response` is the time in s by which the wheels
        lag behind; the curvature in the result is that of the planned motion after this time.
        """
        pose = self._locate(x, y, heading, speed * (0.5 * dt + response))
        self.distance = float(pose.along[0])
        self.advance(speed, dt)
        turn = math.asin(min(max(self._slope(speed), -1.0), 1.0))
        later = LaneChange(self.path, self.distance, self.start_offset, self.progress)
        later.advance(speed, response)
        bend = later._bend(speed)
        return PosesOnPath(pose.along, pose.offset - self._offset(), pose.turn - turn, pose.curvature + bend)

    def has_arrived(self, offset: float) -> bool:
        """Return whether the change is over and the vehicle is near the planned motion, `offset` m away from it."""
        return self.progress >= 1.0 and abs(offset) < _ARRIVED

    def _locate(self, x: float, y: float, heading: float, ahead: float = 0.0) -> PosesOnPath:
        return locate_on_path(self.path, *(np.array([value]) for value in (self.distance, x, y, heading, ahead)))

    def _offset(self) -> float:
        p = self.progress
        return self.start_offset * (1.0 - p * p * p * (10.0 - 15.0 * p + 6.0 * p * p))

    def _rate(self, speed: float) -> float:
        """Return the progress per m of motion."""
        return 1.0 / (DURATION * max(abs(speed), _FULL_SPEED))

    def _slope(self, speed: float) -> float:
        """Return the lateral motion per m of motion."""
        p = self.progress
        return -30.0 * self.start_offset * p * p * (1.0 - p) ** 2 * self._rate(speed)

    def _bend(self, speed: float) -> float:
        """Return the curvature of the planned motion relative to the path in 1/m."""
        p = self.progress
        return -60.0 * self.start_offset * p * (1.0 - p) * (1.0 - 2.0 * p) * self._rate(speed) ** 2
