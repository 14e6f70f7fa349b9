"""Drivers by name. Their compiled parts are loaded when a driver is asked for."""

from __future__ import annotations

from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from cornercase.drivers.base import DRIVERS, Driver, Path, Situation
from cornercase.drivers.loading import load_driver, named_driver
from cornercase.drivers.simple import SimpleDriver

if TYPE_CHECKING:
    from cornercase.drivers.behaviour import AGGRESSIVE, CAUTIOUS, NORMAL, Behaviour, BehaviourDriver

_LATER: Final = ("AGGRESSIVE", "CAUTIOUS", "NORMAL", "Behaviour", "BehaviourDriver")


def _behaviour(preset: str) -> Driver:
    from cornercase.drivers import behaviour

    driver: Driver = behaviour.BehaviourDriver(getattr(behaviour, preset))
    return driver


DRIVERS.register("cautious", partial(_behaviour, "CAUTIOUS"))
DRIVERS.register("normal", partial(_behaviour, "NORMAL"))
DRIVERS.register("aggressive", partial(_behaviour, "AGGRESSIVE"))
DRIVERS.register("simple", SimpleDriver)

__all__ = [
    "AGGRESSIVE",
    "CAUTIOUS",
    "DRIVERS",
    "NORMAL",
    "Behaviour",
    "BehaviourDriver",
    "Driver",
    "Path",
    "SimpleDriver",
    "Situation",
    "load_driver",
    "named_driver",
]


def __getattr__(name: str) -> Any:
    if name in _LATER:
        return getattr(import_module("cornercase.drivers.behaviour"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
