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
    ("builtin", "builtin._simulator:Builtin"),
    ("carla", "carla._simulator:Carla"),
    ("carmaker", "carmaker._simulator:CarMaker"),
    ("esmini", "esmini._simulator:Esmini"),
    ("sumo", "sumo._simulator:Sumo"),
):
    SIMULATORS.register(_name, f"cornercase.simulators.{_target}")


def list_simulators() -> dict[str, Availability]:
    """Return for each simulator, by its name, whether the simulator can run on this machine.

    Returns
    -------
    dict of str to Availability
        Availability of each simulator, by name; includes simulators of other packages. A simulator that cannot be
        loaded is not available.

    Examples
    --------
    >>> from cornercase.simulators import list_simulators
    >>> {name: found.problem for name, found in list_simulators().items()}["builtin"]
    ''
    """
    result = {}
    for name in SIMULATORS.names():
        try:
            result[name] = simulator_availability(name)
        except InputError as error:
            result[name] = Availability(problem=str(error))
    return result


def simulator_availability(simulator: str | Simulator) -> Availability:
    """Return whether a simulator, by its name or an object, can run on this machine."""
    simulator_class = SIMULATORS.get_class(simulator)
    name = simulator if isinstance(simulator, str) else simulator.name
    with convert_plugin_errors(f"The simulator '{name}'", simulator_class, "in availability"):
        return simulator_class.availability()
