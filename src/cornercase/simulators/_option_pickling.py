"""Pickling of a simulator's options, which may contain drivers of the user, to send them to another process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import cloudpickle

from cornercase._common.current_folder import unpickle_with_current_folder
from cornercase._common.errors import InputError
from cornercase._common.registry import Registry
from cornercase._common.text.sanitize import format_exception
from cornercase.drivers import DRIVERS, SENSORS, VEHICLES, Driver
from cornercase.drivers._registry import SEPARATOR
from cornercase.drivers._resolve import driver_by_name
from cornercase.drivers._serialization import serialize_driver, user_driver_spec
from cornercase.simulators._base import Simulator
from cornercase.simulators._registry import SIMULATORS

_DRIVERS_OPTION: Final = "drivers"
_DRIVER_REGISTRIES: Final[tuple[Registry[Any], ...]] = (DRIVERS, SENSORS, VEHICLES)


@dataclass(frozen=True)
class DriverSpec:
    """Name of a driver (``"package.module:Class"`` with options), from which another process creates the driver.

    `description` is the serialized driver, which must be the same for the driver that the other process creates.
    """

    name: str
    description: str | dict[str, Any]

    @classmethod
    def from_driver(cls, driver: str | Driver) -> str | Driver | DriverSpec:
        """Return what to send to another process: a `DriverSpec` if the driver was created from the name of a class.

        Any other driver is returned unchanged.
        """
        name = user_driver_spec(driver)
        return driver if isinstance(driver, str) or name is None else cls(name, serialize_driver(driver))

    def create(self) -> Driver:
        """Create the driver in this process; `InputError` if this fails, or if the driver differs from the sender's."""
        driver = driver_by_name(self.name)
        if serialize_driver(driver) != self.description:
            raise InputError(
                f"The driver '{self.name}' has changed since the command started (its file or settings); run the"
                " command again."
            )
        return driver


def pickle_simulator(simulator: str | type[Simulator], options: Mapping[str, Any]) -> bytes:
    """Pickle a simulator (name or class) and its options; see `DriverSpec` for drivers that are sent as names.

    Classes that this program itself registered under a sent name are sent too. Classes that the main script or a
    notebook defines are sent with their code, since another process cannot import them. Raises `InputError` if a driver
    or another option cannot be pickled.
    """
    drivers = {
        entity: DriverSpec.from_driver(driver_spec)
        for entity, driver_spec in (options.get(_DRIVERS_OPTION) or {}).items()
    }
    sent = {**options, _DRIVERS_OPTION: drivers} if drivers else dict(options)
    names = [spec.name if isinstance(spec, DriverSpec) else spec for spec in drivers.values()]
    parts = [part for name in names if isinstance(name, str) for part in name.split(SEPARATOR)]
    registrations = SIMULATORS.export([simulator]), *(registry.export(parts) for registry in _DRIVER_REGISTRIES)
    try:
        return bytes(cloudpickle.dumps((registrations, simulator, sent)))
    except Exception as error:
        for entity, driver in drivers.items():
            _require_picklable(entity, driver)
        raise InputError(
            f"The options of the simulator cannot be sent to another process ({format_exception(error)})."
        ) from error


def unpickle_simulator(content: bytes) -> tuple[str | type[Simulator], dict[str, Any]]:
    """Return the name or class of a simulator and its options, from the bytes of `pickle_simulator`.

    Modules of the user that are not installed are looked up in the current folder. Raises `InputError` if a driver
    cannot be created.
    """
    registrations, simulator, options = unpickle_with_current_folder(content)
    for registry, registered in zip((SIMULATORS, *_DRIVER_REGISTRIES), registrations, strict=True):
        registry.restore(registered)
    return simulator, _create_drivers_from_specs(options)


def _require_picklable(entity: str, driver: Any) -> None:
    try:
        cloudpickle.dumps(driver)
    except Exception as error:
        cls = type(driver)
        attributes = getattr(driver, "__dict__", {}).items()
        culprits = [f"its attribute '{name}'" for name, value in attributes if not _is_picklable(value)]
        culprit = next(iter(culprits), "the driver")
        reason = format_exception(error)
        raise InputError(
            f"`drivers` {entity}: the driver {cls.__module__}:{cls.__qualname__} cannot be sent to another process,"
            f" which `workers`, `timeout` and `cluster` require: {culprit} cannot be pickled ({reason}). Create it in"
            f" start(), give the class by name ({entity}=package.module:Class), or define __getstate__."
        ) from error


def _is_picklable(value: Any) -> bool:
    try:
        cloudpickle.dumps(value)
    except Exception:
        return False
    return True


def _create_drivers_from_specs(options: dict[str, Any]) -> dict[str, Any]:
    """Replace each `DriverSpec` in received options by a driver; `InputError` if a driver cannot be created."""
    drivers = options.get(_DRIVERS_OPTION)
    if not drivers:
        return options
    created = {
        entity: driver.create() if isinstance(driver, DriverSpec) else driver for entity, driver in drivers.items()
    }
    return {**options, _DRIVERS_OPTION: created}
