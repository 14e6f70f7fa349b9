"""Parameters of the built-in driver, and the presets."""

from __future__ import annotations

import math
from typing import NamedTuple

from cornercase._common.errors import InputError


class Behaviour(NamedTuple):
    """Parameters of the built-in driver.

    Attributes
    ----------
    max_speed : float
        m/s; wanted where the scenario asks for no speed.
    target_share : float
        Part of the speed asked for by the scenario that the driver wants.
    lateral_acceleration : float
        m/s²; limits the speed in curves.
    acceleration, comfortable_deceleration, max_deceleration : float
        m/s².
    time_headway : float
        s, to the one it follows.
    min_gap : float
        m, to the one it follows, at rest.
    safety_time : float
        s between its own box and another's in the same place, whoever comes first.
    braking_distance : float
        m that it wants to stop ahead of the corridor of the one it gives way to.
    lateral_margin : float
        m on either side by which its own corridor is wider than its box.
    standing_caution : float
        Part of the wanted speed at which it passes a pedestrian or cyclist who stands beside the corridor.
    reaction_time : float
        s for which it has to see an entity, and see that their ways conflict, before it reacts.
    memory : float
        s for which it remembers an entity that it no longer sees.
    field_of_view : float
        rad, full angle.
    sight_range : float
        m.
    horizon : float
        s for which it foresees the others' motion.
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


class Keeping(NamedTuple):
    """Parameters of the driver that keeps its speed and its distance.

    Attributes
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

    acceleration: float = 3.0
    comfortable_deceleration: float = 3.0
    max_deceleration: float = 4.0
    time_headway: float = 0.8
    min_gap: float = 1.5
    reaction_time: float = 2.5
    sight_range: float = 60.0


def require_parameter(name: str, value: float, may_be_zero: bool) -> None:
    """Refuse a value that no parameter of a driver can have.

    Parameters
    ----------
    name : str
    value : float
    may_be_zero : bool
        Whether 0 is a value of it.

    Raises
    ------
    InputError
        It is not finite, or below zero, or zero where it may not be.
    """
    if not math.isfinite(value) or value < 0.0 or (value == 0.0 and not may_be_zero):
        least = "of 0 or more" if may_be_zero else "above zero"
        raise InputError(f"The driver's {name} is {value:g}; it has to be a finite number {least}.")
