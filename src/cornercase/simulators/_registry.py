"""Registry of simulators."""

from __future__ import annotations

from typing import Final

from cornercase._common.errors import InputError
from cornercase._common.plugin_errors import convert_plugin_errors
from cornercase._common.registry import Registry
from cornercase.simulators._base import Availability, Simulator

SIMULATORS: Final[Registry[Simulator]] = Registry("simulator", "cornercase.simulators", Simulator)
"""Simulators by name; each is a subclass of `Simulator`."""

for _name, _target in (
    ("builtin", "builtin._simulator:BuiltinSimulator"),
    ("carla", "carla._simulator:CarlaSimulator"),
    ("carmaker", "carmaker._simulator:CarMakerSimulator"),
    ("esmini", "esmini._simulator:EsminiSimulator"),
    ("sumo", "sumo._simulator:SumoSimulator"),
):
    SIMULATORS.register(_name, f"cornercase.simulators.{_target}")


def list_simulators() -> dict[str, Availability]:
    """Return which simulators can run on this machine.

    Returns
    -------
    dict of str to Availability
        By name, including other packages' simulators. One that cannot be loaded is not available.
    """
    result = {}
    for name in SIMULATORS.names():
        try:
            simulator_class = SIMULATORS.get_class(name)
            with convert_plugin_errors(f"The simulator '{name}'", simulator_class, "in availability"):
                result[name] = simulator_class.availability()
        except InputError as error:
            result[name] = Availability(problem=str(error))
    return result
