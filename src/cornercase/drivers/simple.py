"""A road user that keeps its speed and its distance, and never gives way."""

from __future__ import annotations

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.drivers.base import Driver, Situation


class SimpleDriver(Driver):
    """Goes at the speed that the scenario asks for, and brakes for what is straight ahead in its own lane.

    It is inattentive, and looks neither left nor right: other traffic of the kind that a test puts in an ego's way.
    The distance is kept by the Intelligent Driver Model (Treiber, Hennecke and Helbing 2000).

    Parameters
    ----------
    acceleration, comfortable_deceleration, max_deceleration : float
        m/s².
    time_headway : float
        s.
    min_gap : float
        m.
    reaction_time : float
        s for which something has to be ahead before it reacts.
    sight_range : float
        m.
    """

    def __init__(
        self,
        *,
        acceleration: float = 3.0,
        comfortable_deceleration: float = 3.0,
        max_deceleration: float = 4.0,
        time_headway: float = 0.8,
        min_gap: float = 1.5,
        reaction_time: float = 2.5,
        sight_range: float = 60.0,
    ) -> None:
        self._acceleration, self._deceleration = acceleration, comfortable_deceleration
        self._hardest, self._headway, self._min_gap = max_deceleration, time_headway, min_gap
        self._reaction_time, self._range = reaction_time, sight_range
        self.settings = {
            "driver": "simple",
            "acceleration": acceleration,
            "comfortable_deceleration": comfortable_deceleration,
            "max_deceleration": max_deceleration,
            "time_headway": time_headway,
            "min_gap": min_gap,
            "reaction_time": reaction_time,
            "sight_range": sight_range,
        }
        self.start(0, 0)

    def start(self, scenarios: int, others: int) -> None:
        """Forget everything; what follows is a batch of N `scenarios` with A `others` in each."""
        self._ahead_for = np.zeros((scenarios, others))

    def acceleration(self, situation: Situation) -> FloatArray:
        """Acceleration along the path in m/s², shape (N,)."""
        s = situation
        wanted = np.where(np.isfinite(s.target_speed), s.target_speed, s.speed)
        free = np.clip((wanted - s.speed) / s.time_step, -self._deceleration, self._acceleration)
        if self._ahead_for.shape[1] == 0:
            return free
        gap, closing = self._ahead(s)
        ahead = np.isfinite(gap)
        grown = np.where(ahead, self._ahead_for + s.time_step, 0.0)
        self._ahead_for = np.where(s.active[:, None], grown, self._ahead_for)
        reacts = ahead & (self._ahead_for > self._reaction_time)
        speed = s.speed[:, None]
        kept = self._min_gap + np.maximum(
            0.0,
            speed * self._headway + speed * closing / (2.0 * np.sqrt(self._acceleration * self._deceleration)),
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            share = speed / np.maximum(wanted, 0.1)[:, None]
            following = self._acceleration * (1.0 - share**4 - (kept / np.maximum(gap, 0.1)) ** 2)
        slowest = np.where(reacts, following, np.inf).min(axis=1)
        return np.clip(np.minimum(free, slowest), -self._hardest, self._acceleration)

    def _ahead(self, s: Situation) -> tuple[FloatArray, FloatArray]:
        """Gap to what is in the lane ahead, infinite where nothing is, and closing speed, each (N, A)."""
        cos, sin = np.cos(s.heading)[:, None], np.sin(s.heading)[:, None]
        x = s.others_x + s.others_center_x * np.cos(s.others_heading) - s.x[:, None] - s.center_x * cos
        y = s.others_y + s.others_center_x * np.sin(s.others_heading) - s.y[:, None] - s.center_x * sin
        along, across = cos * x + sin * y, np.abs(cos * y - sin * x)
        turn_cos = np.cos(s.others_heading - s.heading[:, None])
        turn_sin = np.abs(np.sin(s.others_heading - s.heading[:, None]))
        reach = 0.5 * (s.others_length * np.abs(turn_cos) + s.others_width * turn_sin)
        half = 0.5 * (s.others_length * turn_sin + s.others_width * np.abs(turn_cos))
        gap = along - reach - 0.5 * s.length
        inside = (across < half + 0.5 * s.width) & (along > 0.0) & (gap < self._range)
        return np.where(inside, gap, np.inf), s.speed[:, None] - s.others_speed * turn_cos
