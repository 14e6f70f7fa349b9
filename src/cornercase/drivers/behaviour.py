"""The built-in driver: plans its speed, follows, gives way, and knows only what it has seen."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers.base import DrivenPath, Driver, Situation
from cornercase.drivers.route import Route, plan_route
from cornercase.drivers.traffic import Boxes, Conflicts, Driven
from cornercase.drivers.visibility import Perception, in_sight
from cornercase.drivers.yielding import decide

_VULNERABLE = ("pedestrian", "bicycle")


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


class BehaviourDriver(Driver):
    """Driver with a `Behaviour`.

    It takes the lowest of the accelerations that its own plan, each entity that it follows and each entity
    that it gives way to would let it have; see ``docs/drivers.md``.

    Parameters
    ----------
    behaviour : Behaviour, default NORMAL

    Raises
    ------
    InputError
        A parameter is out of range.
    """

    def __init__(self, behaviour: Behaviour = NORMAL) -> None:
        _check(behaviour)
        self._behaviour = behaviour
        self.settings = {"driver": "behaviour", **behaviour._asdict()}
        self.start(0, 0)

    def start(self, scenarios: int, others: int) -> None:
        """Forget everything; what follows is a batch of N `scenarios` with A `others` in each."""
        self._perception = Perception(scenarios, others, self._behaviour.reaction_time, self._behaviour.memory)
        shape = (scenarios, others)
        self._conflicts = Conflicts(np.full(shape, np.inf), np.zeros(shape, dtype=np.bool_))
        # The path is kept with its route: while it exists, no other object can have its id.
        self._routes: dict[int, tuple[DrivenPath, Route]] = {}

    @property
    def known(self) -> BoolArray:
        """Entities that the driver knows of, ndarray of bool, shape (N, A)."""
        return self._perception.state.known

    @property
    def yielding(self) -> BoolArray:
        """To whom the driver gives way, shape (N, A)."""
        return self._conflicts.yielding

    def acceleration(self, situation: Situation) -> FloatArray:
        """Acceleration along the path in m/s², shape (N,); 0 in scenarios that are not active."""
        s, seen = situation, self._perception
        behaviour = self._behaviour
        sight = in_sight(s, field_of_view=behaviour.field_of_view, sight_range=behaviour.sight_range)
        seen.update(s, sight)
        vulnerable = np.array([kind in _VULNERABLE for kind in s.others_kind], dtype=np.bool_)
        dense = np.ascontiguousarray
        driven = Driven(
            distance=dense(s.distance),
            x=dense(s.x),
            y=dense(s.y),
            heading=dense(s.heading),
            speed=dense(s.speed),
            target_speed=dense(s.target_speed),
            half_length=0.5 * s.length,
            half_width=0.5 * s.width,
            center_x=s.center_x,
        )
        boxes = Boxes(0.5 * s.others_length, 0.5 * s.others_width, dense(s.others_center_x), vulnerable)
        result: FloatArray = decide(
            behaviour, self._route(s.path), s.time, s.time_step, dense(s.active), driven, seen.state, boxes,
            self._conflicts,
        )  # fmt: skip
        return result

    def _route(self, path: DrivenPath) -> Route:
        if id(path) not in self._routes:
            route = plan_route(
                path,
                lateral_acceleration=self._behaviour.lateral_acceleration,
                deceleration=self._behaviour.comfortable_deceleration,
            )
            self._routes[id(path)] = (path, route)
        return self._routes[id(path)][1]


def _check(behaviour: Behaviour) -> None:
    may_be_zero = {
        "standing_caution",
        "reaction_time",
        "memory",
        "lateral_margin",
        "braking_distance",
        "safety_time",
    }
    for name, value in behaviour._asdict().items():
        if not math.isfinite(value) or value < 0.0 or (value == 0.0 and name not in may_be_zero):
            raise InputError(f"The driver's {name} is {value}; it has to be a finite number above zero.")


def preset(name: Literal["cautious", "normal", "aggressive"]) -> BehaviourDriver:
    """Return a driver with the behaviour of a name."""
    return BehaviourDriver({"cautious": CAUTIOUS, "normal": NORMAL, "aggressive": AGGRESSIVE}[name])
