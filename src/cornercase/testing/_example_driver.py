"""Example of a user's driving function, for checks of simulators."""

from __future__ import annotations

from typing import Final

from cornercase.drivers import Control, SystemUnderTest, View

# m/s, m and s: speed on a free road, and gap to a leader.
_TARGET_SPEED, _STANDING_GAP, _TIME_GAP = 10.0, 3.0, 1.0
# m/s²
_ACCELERATION, _DECELERATION, _MAX_DECELERATION = 1.5, 2.0, 6.0
# m; smaller gaps count as this gap.
_SMALLEST_GAP: Final = 0.1


class CarFollowing(SystemUnderTest):
    """Intelligent driver model with a desired speed of 10 m/s, which stops behind a standing vehicle ahead."""

    def step(self, view: View, dt: float) -> Control:
        """Return the acceleration in m/s² for a view of the traffic."""
        speed, leader = view.ego.speed, view.leader
        effort = 1.0 - (max(speed, 0.0) / _TARGET_SPEED) ** 4
        if leader is not None:
            closing = speed * leader.closing / (2.0 * (_ACCELERATION * _DECELERATION) ** 0.5)
            wanted_gap = _STANDING_GAP + max(0.0, speed * _TIME_GAP + closing)
            effort -= (wanted_gap / max(leader.gap, _SMALLEST_GAP)) ** 2
        return Control(acceleration=max(_ACCELERATION * effort, -_MAX_DECELERATION))
