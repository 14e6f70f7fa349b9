"""Registry of drivers, and texts that name a driver with its sensors and its vehicle model."""

from __future__ import annotations

from typing import Final

from cornercase._common.platform import split_command
from cornercase._common.registry import Registry
from cornercase.drivers._base import Driver

DRIVERS: Final[Registry[Driver]] = Registry("driver", "cornercase.drivers")
"""Drivers by name."""

for _preset in ("cautious", "normal", "aggressive"):
    DRIVERS.register(_preset, f"cornercase.drivers._behaviour:{_preset}")
DRIVERS.register("simple", "cornercase.drivers._simple:SimpleDriver")
DRIVERS.register("fmu", "cornercase.drivers.fmu._driver:fmu_from_text")
DRIVERS.register("exec", "cornercase.drivers.process._process_function:ProcessFunction")
for _reference in ("cc-human", "fsm", "rss", "reg157"):
    DRIVERS.register(
        _reference, "cornercase.drivers.references.r157._reference_driver:ReferenceDriver", name=_reference
    )


SEPARATOR: Final = " + "
"""Text between a driver, its sensors and its vehicle model, as in ``"normal + radar"``."""


def split_spec(spec: str) -> tuple[str, tuple[str, ...]]:
    """Split a text such as ``"normal + radar:range=120"`` into the driver, and its sensors and vehicle model.

    In the command of a program (``exec:``), a quoted `` + `` belongs to the command.
    """
    driver, *equipment = spec.split(SEPARATOR)
    while equipment and driver.lstrip().startswith("exec:") and _is_quote_open(driver):
        driver += SEPARATOR + equipment.pop(0)
    return driver.strip(), tuple(part.strip() for part in equipment)


def _is_quote_open(command: str) -> bool:
    try:
        split_command(command)
    except ValueError:
        return True
    return False


def is_registered_driver(name: str) -> bool:
    """Check whether a name (with or without options, sensors and vehicle) belongs to a registered driver."""
    return split_spec(name)[0].partition(":")[0] in DRIVERS
