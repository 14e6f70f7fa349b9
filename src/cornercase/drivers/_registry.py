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
for _reference in ("cc-human", "fsm", "rss", "reg157"):
    DRIVERS.register(
        _reference, "cornercase.drivers.references.r157._reference_driver:ReferenceDriver", name=_reference
    )


def is_registered_driver(name: str) -> bool:
    """Check whether a name (with or without options) belongs to a registered driver."""
    return name.partition(":")[0] in DRIVERS
