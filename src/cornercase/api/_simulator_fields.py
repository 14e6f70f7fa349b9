"""Fields of an exploration's configuration that a simulator stands for."""

from __future__ import annotations

from typing import Any, Final

from cornercase._common.validation import check_str
from cornercase.simulators import SIMULATORS

_RUN_SETTINGS: Final = ("time_step", "duration", "on_collision", "drivers")


def simulator_fields(simulator: object) -> dict[str, Any]:
    """Return ``simulator`` and, if it is an object, its time step, duration, effect of collisions and drivers."""
    if isinstance(simulator, str):
        SIMULATORS.get_factory(check_str("simulator", simulator).partition(":")[0])
        return {"simulator": simulator}
    settings = {name: getattr(simulator, name) for name in _RUN_SETTINGS if getattr(simulator, name, None) is not None}
    return {"simulator": str(simulator), **settings}
