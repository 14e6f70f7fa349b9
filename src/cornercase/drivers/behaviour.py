"""The built-in driver: plans its speed, follows, gives way, and knows only what it has seen."""

from __future__ import annotations

import math
from typing import Literal

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray
from cornercase.drivers.fleet import CompiledDriver
from cornercase.drivers.parameters import AGGRESSIVE, CAUTIOUS, NORMAL, Behaviour
from cornercase.drivers.traffic import BEHAVIOUR, KNOWN, YIELDING


class BehaviourDriver(CompiledDriver):
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

    kind = BEHAVIOUR

    def __init__(self, behaviour: Behaviour = NORMAL) -> None:
        _check(behaviour)
        self.settings = {"driver": "behaviour", **behaviour._asdict()}
        self.parameters = tuple(behaviour)
        self.start(0, 0)

    @property
    def known(self) -> BoolArray:
        """Entities that the driver knows of, ndarray of bool, shape (N, A)."""
        return self._fleet.awareness[0, :, KNOWN]

    @property
    def yielding(self) -> BoolArray:
        """To whom the driver gives way, shape (N, A)."""
        return self._fleet.awareness[0, :, YIELDING]


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
