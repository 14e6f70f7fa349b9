"""Parameters of the built-in drivers, and the presets ``cautious``, ``normal`` and ``aggressive``."""

from __future__ import annotations

import math
from typing import NamedTuple

from cornercase._common.errors import InputError


class Behaviour(NamedTuple):
    """Parameters of the built-in driver.

    Attributes
    ----------
    max_speed : float
        Speed in m/s that the driver wants if the scenario sets none.
    target_share : float
        Fraction of the scenario's target speed that the driver wants.
    lateral_acceleration : float
        Highest lateral acceleration in m/s², which limits the speed in curves.
    acceleration, comfortable_deceleration, max_deceleration : float
        Highest acceleration, usual deceleration and highest deceleration in m/s².
    time_headway : float
        Time gap in s to the leader.
    min_gap : float
        Gap in m to the leader at rest.
    safety_time : float
        Smallest time in s that the driver leaves between its own box and another box at the same position.
    braking_distance : float
        Distance in m from the corridor of a crossing entity at which the driver wants to stop when it yields.
    lateral_margin : float
        Width in m by which the driver's own corridor exceeds its box on either side.
    standing_caution : float
        Fraction of the wanted speed at which the driver passes a pedestrian or cyclist who stands beside the corridor.
    reaction_time : float
        Time in s for which the driver must see an entity, and a conflict with it, before it reacts.
    memory : float
        Time in s for which the driver remembers an entity that is out of sight.
    field_of_view : float
        Full angle of the field of view in rad.
    sight_range : float
        Distance in m up to which the driver sees.
    horizon : float
        Time in s for which the driver predicts the motion of others.

    Examples
    --------
    Most behaviours are a preset with a few changes:

    >>> from cornercase.drivers import NORMAL
    >>> tailgating = NORMAL._replace(time_headway=0.5, min_gap=1.0)
    >>> tailgating, tailgating.sight_range
    (NORMAL._replace(time_headway=0.5, min_gap=1.0), 100.0)
    """

    max_speed: float
    target_share: float
    lateral_acceleration: float
    acceleration: float
    comfortable_deceleration: float
    max_deceleration: float
    time_headway: float
    min_gap: float
    safety_time: float
    braking_distance: float
    lateral_margin: float
    standing_caution: float
    reaction_time: float
    memory: float
    field_of_view: float
    sight_range: float
    horizon: float

    def __repr__(self) -> str:
        preset, changes = self.nearest_preset()
        options = ", ".join(f"{name}={value!r}" for name, value in changes.items())
        return f"{preset.upper()}._replace({options})" if changes else preset.upper()

    def nearest_preset(self) -> tuple[str, dict[str, float]]:
        """Return the preset with the most parameters in common, and the parameters that differ.

        Returns
        -------
        str
            ``"normal"``, ``"cautious"`` or ``"aggressive"``.
        dict of str to float
        """
        own = self._asdict()
        presets = {"normal": NORMAL, "cautious": CAUTIOUS, "aggressive": AGGRESSIVE}
        changes = {
            name: {key: own[key] for key, value in preset._asdict().items() if own[key] != value}
            for name, preset in presets.items()
        }
        nearest = min(changes, key=lambda name: len(changes[name]))
        return nearest, changes[nearest]


CAUTIOUS = Behaviour(
    max_speed=40.0 / 3.6,
    target_share=0.8,
    lateral_acceleration=2.0,
    acceleration=1.2,
    comfortable_deceleration=2.0,
    max_deceleration=8.0,
    time_headway=2.0,
    min_gap=3.0,
    safety_time=3.0,
    braking_distance=6.0,
    lateral_margin=0.5,
    standing_caution=0.5,
    reaction_time=0.5,
    memory=1.0,
    field_of_view=math.radians(220.0),
    sight_range=100.0,
    horizon=8.0,
)
"""Parameters of the driver ``cautious``."""

NORMAL = CAUTIOUS._replace(
    max_speed=50.0 / 3.6,
    target_share=1.0,
    lateral_acceleration=3.0,
    acceleration=2.0,
    comfortable_deceleration=2.5,
    time_headway=1.5,
    min_gap=2.0,
    safety_time=2.0,
    braking_distance=5.0,
    lateral_margin=0.35,
    standing_caution=1.0,
)
"""Parameters of the driver ``normal``."""

AGGRESSIVE = NORMAL._replace(
    max_speed=70.0 / 3.6,
    lateral_acceleration=4.5,
    acceleration=3.0,
    comfortable_deceleration=3.5,
    time_headway=0.9,
    min_gap=1.5,
    safety_time=1.0,
    braking_distance=4.0,
    lateral_margin=0.2,
)
"""Parameters of the driver ``aggressive``."""


class FollowParameters(NamedTuple):
    """Parameters of `SimpleDriver` with their defaults; `SimpleDriver` documents the parameters."""

    acceleration: float = 3.0
    comfortable_deceleration: float = 3.0
    max_deceleration: float = 4.0
    time_headway: float = 0.8
    min_gap: float = 1.5
    reaction_time: float = 2.5
    sight_range: float = 60.0


def check_parameter(name: str, value: float, allow_zero: bool) -> None:
    """Raise `InputError` unless the value is finite and positive, or zero if that is allowed."""
    if not math.isfinite(value) or value < 0.0 or (value == 0.0 and not allow_zero):
        requirement = "of 0 or more" if allow_zero else "above zero"
        raise InputError(f"The driver's {name} is {value:g}; it has to be a finite number {requirement}.")
