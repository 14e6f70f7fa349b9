"""Drivers by name."""

from functools import partial

from cornercase.drivers.base import DRIVERS, Driver, Path, Situation
from cornercase.drivers.behaviour import AGGRESSIVE, CAUTIOUS, NORMAL, Behaviour, BehaviourDriver
from cornercase.drivers.loading import load_driver, named_driver
from cornercase.drivers.simple import SimpleDriver

DRIVERS.register("cautious", partial(BehaviourDriver, CAUTIOUS))
DRIVERS.register("normal", partial(BehaviourDriver, NORMAL))
DRIVERS.register("aggressive", partial(BehaviourDriver, AGGRESSIVE))
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
