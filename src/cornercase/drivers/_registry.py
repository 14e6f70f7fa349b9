"""Drivers by name."""

from __future__ import annotations

from typing import Final

from cornercase._common.registry import Registry
from cornercase.drivers._base import Driver

DRIVERS: Final[Registry[Driver]] = Registry("driver", "cornercase.drivers")
"""Drivers by name."""

for _preset in ("cautious", "normal", "aggressive"):
    DRIVERS.register(_preset, f"cornercase.drivers._behaviour:{_preset}")
DRIVERS.register("simple", "cornercase.drivers._simple:SimpleDriver")
DRIVERS.register("fmu", "cornercase.drivers.fmu._driver:fmu_from_text")
for _reference in ("cc-human", "fsm", "rss", "reg157"):
    DRIVERS.register(
        _reference, "cornercase.drivers.references.r157._reference_driver:ReferenceDriver", name=_reference
    )


SEPARATOR: Final = " + "
"""What joins a driver, its sensors and its vehicle in a text."""


def split_spec(spec: str) -> tuple[str, tuple[str, ...]]:
    """Return the driver, and the sensors and the vehicle, in a text; each with its options."""
    driver, *equipment = (part.strip() for part in spec.split(SEPARATOR))
    return driver, tuple(equipment)


def is_registered_driver(name: str) -> bool:
    """Check whether a name (with or without options and equipment) belongs to a registered driver."""
    return split_spec(name)[0].partition(":")[0] in DRIVERS
