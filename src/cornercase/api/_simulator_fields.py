"""Settings of an exploration that a simulator object contains."""

from __future__ import annotations

from typing import Any, Final

from cornercase._common.configurable import given_options
from cornercase.simulators import SIMULATORS, Simulator
from cornercase.simulators._common_options import split_common_options

_RUN_SETTINGS: Final = {"time_step": None, "duration": None, "on_collision": None, "drivers": None}


def simulator_fields(simulator: Simulator | str) -> dict[str, Any]:
    """Return the settings of an exploration that a simulator object contains, by name.

    These are the simulator, and, if they were given, time step, duration, effect of collisions, and drivers. Raises
    `InputError` for an unknown name, or if the argument is no simulator.
    """
    stripped, _ = split_common_options(simulator, _RUN_SETTINGS)
    if isinstance(stripped, str):
        SIMULATORS.get_factory(stripped.partition(":")[0])
        return {"simulator": stripped}
    own = {name: value for name, value in given_options(simulator).items() if name in _RUN_SETTINGS}
    return {"simulator": stripped, **own}
