"""Simulators by name."""

from __future__ import annotations

from typing import Final

from cornercase._common.registry import Registry
from cornercase.simulators.base import Availability, Simulator

SIMULATORS: Final[Registry[Simulator]] = Registry("simulator", "cornercase.simulators")
"""Simulators by name."""

for _name, _place in (
    ("builtin", "builtin.simulator:BuiltinSimulator"),
    ("carla", "carla.simulator:CarlaSimulator"),
    ("carmaker", "carmaker.simulator:CarMakerSimulator"),
    ("esmini", "esmini:EsminiSimulator"),
    ("sumo", "sumo.simulator:SumoSimulator"),
):
    SIMULATORS.register(_name, f"cornercase.simulators.{_place}")


def availabilities() -> dict[str, Availability]:
    """Whether each simulator can run here, by name; of other packages' what they tell."""
    found = {}
    for name in SIMULATORS.names():
        tell = getattr(SIMULATORS.factory(name), "availability", None)
        found[name] = Availability("", "", ()) if tell is None else tell()
    return found


def told(name: str) -> tuple[str, ...]:
    """What a simulator wants to be told beside the options that all have, as its class attribute ``told`` says.

    That is ``worker``, the number of the worker in which it runs, and ``ego``, the entity that is it.
    """
    wanted: tuple[str, ...] = getattr(SIMULATORS.factory(name.partition(":")[0]), "told", ())
    return wanted
