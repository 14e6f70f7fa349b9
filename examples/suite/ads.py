"""The system under test: a planner of speeds, and the few lines by which it drives in cornercase.

Put your own planner in the place of `SpeedPlanner`, and let `UnderTest` tell it what it wants to know.
"""

from __future__ import annotations

import numpy as np

from cornercase.drivers import Driver, Situation

# What the planner decides by; a change of any of them is another version of it.
PARAMETERS = {
    "reaction_time": 0.3,  # s
    "headway": 1.5,  # s, to who is ahead
    "min_gap": 2.0,  # m, to who is ahead
    "margin": 1.2,  # m, from its own side: who comes nearer is taken for one in its lane
    "acceleration": 1.5,  # m/s²
    "comfortable_deceleration": 2.0,  # m/s²
    "max_deceleration": 8.0,  # m/s²
}


class SpeedPlanner:
    """Keeps a speed, and a gap to who is ahead. It knows nothing of cornercase; each vehicle has its own."""

    def __init__(self, parameters: dict[str, float]) -> None:
        self._parameters = parameters
        self._seen: list[tuple[float, float, float]] = []

    def plan(self, time: float, speed: float, wanted: float, gap: float, other_speed: float) -> float:
        """Acceleration in m/s², by gap (m) and speed (m/s) of who is ahead; the gap is infinite where nobody is."""
        own = self._parameters
        self._seen.append((time, gap, other_speed))
        while len(self._seen) > 1 and self._seen[1][0] <= time - own["reaction_time"] + 1e-9:
            self._seen.pop(0)
        seen, gap, other_speed = self._seen[0]
        free = min(max(wanted - speed, -own["comfortable_deceleration"]), own["acceleration"])
        if seen > time - own["reaction_time"] + 1e-9 or gap == float("inf"):
            return free
        room, closing = max(gap - own["min_gap"], 0.1), speed - other_speed
        needed = max(closing, 0.0) ** 2 / (2.0 * room)
        if needed > own["comfortable_deceleration"]:
            return max(-1.2 * needed, -own["max_deceleration"])
        following = 0.3 * (room - own["headway"] * speed) / own["headway"] - 0.5 * closing
        return max(min(free, following), -own["max_deceleration"])


class UnderTest(Driver):
    """Lets a planner drive in each scenario of a batch.

    What stands in `settings` is stored with each study, so that a study never goes on with another version.
    """

    settings = {"driver": "speed planner", **PARAMETERS}

    def start(self, scenarios: int, others: int) -> None:
        """Begin a batch: one planner for each scenario, as none may know of the others."""
        self._planners = [SpeedPlanner(PARAMETERS) for _ in range(scenarios)]

    def acceleration(self, situation: Situation) -> np.ndarray:
        """Ask the planner of each scenario that is to be driven now."""
        now, found = situation, np.zeros(len(situation.speed))
        # Places of the others' boxes along the ego's heading and across it, from box to box, shape (N, A).
        x, y = now.others_x - now.x[:, None], now.others_y - now.y[:, None]
        cos, sin = np.cos(now.heading)[:, None], np.sin(now.heading)[:, None]
        lengths, widths = (now.others_length + now.length) / 2, (now.others_width + now.width) / 2
        ahead = cos * x + sin * y + now.others_center_x - now.center_x - lengths
        aside = np.abs(cos * y - sin * x) - widths
        gaps = np.where((aside < PARAMETERS["margin"]) & (ahead > -lengths), ahead, np.inf)
        for k in np.flatnonzero(now.active):
            first = int(gaps[k].argmin())
            found[k] = self._planners[k].plan(
                now.time, now.speed[k], now.target_speed[k], gaps[k, first], now.others_speed[k, first]
            )
        return found
