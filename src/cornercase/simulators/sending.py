"""Send simulator options with users' drivers to another process."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.texts import in_one_line
from cornercase.drivers import Driver, describe_driver, given_name, named_driver

_DRIVERS: Final = "drivers"


@dataclass(frozen=True)
class GivenDriver:
    """Name of a driver (``"package.module:Class"`` with options), and description of the driver it stands for."""

    name: str
    description: str | dict[str, Any]

    @classmethod
    def from_driver(cls, driver: str | Driver) -> str | Driver | GivenDriver:
        """Return what to send for a driver: itself if it was given as an object or is a preset's name."""
        name = given_name(driver)
        return driver if isinstance(driver, str) or name is None else cls(name, describe_driver(driver))

    def make(self) -> Driver:
        """Create the driver in this process; `InputError` if it cannot be, or differs from the sender's."""
        driver = named_driver(self.name)
        if describe_driver(driver) != self.description:
            raise InputError(
                f"The driver '{self.name}' has changed since the command started (its file or settings); run the"
                " command again."
            )
        return driver


def packed_options(options: Mapping[str, Any], dumps: Callable[[Any], bytes]) -> bytes:
    """Pickle the options of a simulator by `dumps`; the receiver creates drivers that were given by class name.

    Raises `InputError` if a driver or another option cannot be pickled.
    """
    drivers = {
        entity: GivenDriver.from_driver(driver_spec) for entity, driver_spec in (options.get(_DRIVERS) or {}).items()
    }
    sent = {**options, _DRIVERS: drivers} if drivers else dict(options)
    try:
        return dumps(sent)
    except Exception as error:
        for entity, driver in drivers.items():
            _require_picklable(entity, driver, dumps)
        raise InputError(
            f"The options of the simulator cannot be sent to another process ({in_one_line(error)})."
        ) from error


def _require_picklable(entity: str, driver: Any, dumps: Callable[[Any], bytes]) -> None:
    try:
        dumps(driver)
    except Exception as error:
        cls = type(driver)
        culprit = next(
            (f"its attribute '{name}'" for name, value in _attributes(driver) if not _can(dumps, value)), "it"
        )
        reason = in_one_line(error)
        raise InputError(
            f"`drivers` {entity}: the driver {cls.__module__}:{cls.__qualname__} cannot be sent to another process,"
            f" which `workers`, `timeout` and `cluster` require: {culprit} cannot be pickled ({reason}). Create that in"
            f" start(), give the class by name ({entity}=package.module:Class), or define __getstate__."
        ) from error


def _attributes(driver: Any) -> list[tuple[str, Any]]:
    return list(getattr(driver, "__dict__", {}).items())


def _can(dumps: Callable[[Any], bytes], value: Any) -> bool:
    try:
        dumps(value)
    except Exception:
        return False
    return True


def with_drivers_made(options: dict[str, Any]) -> dict[str, Any]:
    """Create the drivers that received options only name; `InputError` if that fails."""
    drivers = options.get(_DRIVERS)
    if not drivers:
        return options
    created = {
        entity: driver.make() if isinstance(driver, GivenDriver) else driver for entity, driver in drivers.items()
    }
    return {**options, _DRIVERS: created}
