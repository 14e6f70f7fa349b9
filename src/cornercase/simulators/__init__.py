"""Simulators by name."""

from cornercase.simulators.base import SIMULATORS, Availability, Simulator
from cornercase.simulators.builtin import BuiltinSimulator
from cornercase.simulators.carla import CarlaSimulator
from cornercase.simulators.carmaker import CarMakerSimulator
from cornercase.simulators.esmini import EsminiSimulator
from cornercase.simulators.sumo import SumoSimulator

SIMULATORS.register("builtin", BuiltinSimulator)
SIMULATORS.register("carla", CarlaSimulator)
SIMULATORS.register("carmaker", CarMakerSimulator)
SIMULATORS.register("esmini", EsminiSimulator)
SIMULATORS.register("sumo", SumoSimulator)


def availabilities() -> dict[str, Availability]:
    """Whether each simulator can run here, by name; of other packages' what they tell."""
    found = {}
    for name in SIMULATORS.names():
        tell = getattr(SIMULATORS.factory(name), "availability", None)
        found[name] = Availability("", "", ()) if tell is None else tell()
    return found


__all__ = [
    "SIMULATORS",
    "Availability",
    "BuiltinSimulator",
    "CarMakerSimulator",
    "CarlaSimulator",
    "EsminiSimulator",
    "Simulator",
    "SumoSimulator",
    "availabilities",
]
