"""Name of the preset that is nearest to a driver, such as ``normal:horizon=4``."""

from __future__ import annotations

from collections.abc import Mapping

from cornercase._common.errors import InputError
from cornercase.drivers._base import Driver
from cornercase.drivers._compiled import CompiledDriver
from cornercase.drivers._registry import DRIVERS, is_registered_driver


def nearest_preset_name(driver: str | Driver | Mapping[str, object]) -> str:
    """Return the name of the preset nearest to a driver, with options for the parameters that differ.

    `driver` is a name, a driver, or a driver's settings as stored in a study. Raises `InputError` if the driver is not
    one of cornercase's own drivers with parameters.
    """
    if isinstance(driver, str):
        preset_parameters(driver)
        return driver
    settings = dict(driver.settings if isinstance(driver, Driver) else driver)
    driver_kind = settings.get("driver")
    bases = {"behaviour": ("normal", "cautious", "aggressive"), "simple": ("simple",)}.get(str(driver_kind), ())
    candidates: list[tuple[int, str]] = []
    for base in bases:
        defaults = preset_parameters(base)
        # A user's class derived from a built-in driver may decide differently.
        if set(settings) != {"driver", *defaults} or not (isinstance(driver, Mapping) or _is_built_in(driver)):
            continue
        changed = {name: value for name, value in settings.items() if name in defaults and value != defaults[name]}
        options = ",".join(f"{name}={value!r}" for name, value in changed.items())
        candidates.append((len(changed), f"{base}:{options}" if options else base))
    if not candidates:
        raise InputError(f"The driver {driver_kind} has no mutants, as its parameters are unknown.")
    name = min(candidates, key=lambda candidate: candidate[0])[1]
    preset_parameters(name)
    return name


def _is_built_in(driver: Driver) -> bool:
    return type(driver).__module__.startswith("cornercase.drivers.")


def preset_parameters(driver: str) -> dict[str, float]:
    """Return the parameters of a preset such as ``normal:horizon=4``; raises `InputError` for any other driver."""
    created = DRIVERS.create(driver) if is_registered_driver(driver) else None
    if not isinstance(created, CompiledDriver):
        raise InputError(
            f"The driver {driver} has no mutants, as its parameters are unknown; use cautious, normal, aggressive"
            " or simple."
        )
    return {name: float(value) for name, value in created.settings.items() if isinstance(value, int | float)}
