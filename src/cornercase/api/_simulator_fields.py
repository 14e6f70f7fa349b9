"""Settings of an exploration that a simulator object contains."""

from __future__ import annotations

from typing import Any

from cornercase.simulators import SIMULATORS, Simulator
from cornercase.simulators._base import COMMON_OPTIONS
from cornercase.simulators._common_options import split_common_options


def simulator_fields(simulator: Simulator | str) -> dict[str, Any]:
    """Return the settings of an exploration that a simulator object contains, by name.

    These are the simulator, and, if they were given, time step, duration, effect of collisions, and drivers. Raises
    `InputError` for an unknown name, or if the argument is no simulator.
    """
    stripped, options = split_common_options(simulator, dict.fromkeys(COMMON_OPTIONS))
    if isinstance(stripped, str):
        SIMULATORS.get_factory(stripped.partition(":")[0])
    return {"simulator": stripped, **{name: value for name, value in options.items() if value is not None}}
