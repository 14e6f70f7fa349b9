"""Settings of an exploration that a simulator object contains."""

from __future__ import annotations

from typing import Any

from cornercase.drivers._resolve import check_drivers
from cornercase.drivers._serialization import require_storable_drivers
from cornercase.simulators import SIMULATORS, Simulator
from cornercase.simulators._base import COMMON_OPTIONS
from cornercase.simulators._common_options import split_common_options


def extract_exploration_settings(simulator: Simulator | str) -> dict[str, Any]:
    """Return the settings of an exploration that a simulator contains, by name.

    The settings are the simulator itself and, if given, time step, duration, effect of collisions, and drivers. Raises
    `InputError` if `simulator` is an unknown name or not a simulator, or if a study cannot store one of the drivers.
    """
    stripped, options = split_common_options(simulator, dict.fromkeys(COMMON_OPTIONS))
    if isinstance(stripped, str):
        SIMULATORS.get_factory(stripped.partition(":")[0])
    require_storable_drivers(check_drivers(options["drivers"]))
    return {"simulator": stripped, **{name: value for name, value in options.items() if value is not None}}
