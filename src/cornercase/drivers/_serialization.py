"""Descriptions of drivers: as JSON values for studies, as text, and as a command line option."""

from __future__ import annotations

import hashlib
import inspect
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final
from weakref import WeakKeyDictionary

from cornercase._common.configurable import (
    Configurable,
    format_option_value,
    given_scalar_options,
    require_storable_options,
)
from cornercase._common.errors import InputError
from cornercase._common.plugin_errors import is_built_in, unwrap_factory
from cornercase.drivers._base import Driver
from cornercase.drivers._equipment import EquippedDriver
from cornercase.drivers._preset_name import nearest_preset_name
from cornercase.drivers._registry import DRIVERS, SEPARATOR, is_registered_driver, split_spec
from cornercase.drivers._system_under_test import PerScenarioDriver, SystemUnderTest
from cornercase.drivers.references.r157._models import REFERENCES

# Attribute in which a driver created by name stores its name and options.
_SPEC_ATTRIBUTE: Final = "_cornercase_name"
_CHECKSUM_DIGITS: Final = 8
_checksums: Final[WeakKeyDictionary[type, str]] = WeakKeyDictionary()


def record_driver_spec(driver: Driver, name: str, options: Mapping[str, object]) -> None:
    """Store on a driver the name and the options that it was created with.

    Raises `InputError` if there are options and the driver has no ``__dict__`` to store them.
    """
    try:
        vars(_unwrap(driver))[_SPEC_ATTRIBUTE] = (name, dict(sorted(options.items())))
    except TypeError:
        if options:
            raise InputError(
                f"The driver '{name}' takes no options, since its class has __slots__ and no __dict__ to keep them;"
                " derive the class from cornercase.drivers.Driver."
            ) from None


def recorded_options(driver: object) -> Mapping[str, object]:
    """Return the options of a driver that was created from a name and options; empty for any other driver."""
    _, options = getattr(driver, "__dict__", {}).get(_SPEC_ATTRIBUTE, ("", {}))
    return dict(options)


def remove_driver_spec(driver: Driver) -> Driver:
    """Remove the stored name and options from a driver, so that simulators treat the driver as an object.

    A simulator runs such a driver in the process that calls the simulator, instead of in child processes.
    """
    vars(_unwrap(driver.driver if isinstance(driver, EquippedDriver) else driver)).pop(_SPEC_ATTRIBUTE, None)
    return driver


def serialize_driver(driver: str | Driver) -> str | dict[str, Any]:
    """Return plain JSON values that describe a driver.

    A driver given by name is described by this name, and a driver of cornercase by its settings. A driver of the user
    is described by a dict: ``driver`` is the name, or the class as ``"package.module:Class"``; ``options`` are the
    options from which the driver was created, if known; ``sha256`` is the checksum of the file that defines the class,
    if there is a file; ``settings`` are the driver's own settings, if the class defines settings.
    """
    if isinstance(driver, str):
        return driver
    if isinstance(driver, EquippedDriver):
        inner = serialize_driver(driver.driver)
        return {
            **({"driver": inner} if isinstance(inner, str) else inner),
            "equipment": [str(part) for part in driver.equipment],
        }
    own = _unwrap(driver)
    cls = type(own)
    class_path = f"{cls.__module__}:{cls.__qualname__}"
    spec = getattr(own, "__dict__", {}).get(_SPEC_ATTRIBUTE)
    if cls.__module__.startswith("cornercase.") and (spec is None or is_registered_driver(spec[0])):
        return dict(own.settings)
    given = dict(sorted(given_scalar_options(own).items())) if isinstance(own, Configurable) else {}
    name, options = (class_path, given or None) if spec is None else spec
    description: dict[str, Any] = {"driver": name}
    if options is not None:
        description["options"] = dict(options)
    if checksum := _source_file_checksum(cls):
        description["sha256"] = checksum
    if own.settings != {"driver": class_path}:
        description["settings"] = dict(own.settings)
    return description


def require_storable_drivers(drivers: Mapping[str, object]) -> None:
    """Raise `InputError` for a user's own driver with an option that a study can neither store nor compare.

    For an option with an entry of the same name in the driver's `settings`, the study stores this entry instead.
    """
    for driver in drivers.values():
        own = _unwrap(driver.driver if isinstance(driver, EquippedDriver) else driver)
        if isinstance(own, Driver | SystemUnderTest) and not is_built_in(own):
            hint = "give numbers, texts, True or False, or add an entry of this name to the driver's `settings`"
            require_storable_options(own, own.settings, hint)


def _unwrap(driver: object) -> Any:
    """Return the user's object behind an adapter (`PerScenarioDriver`), or the driver itself."""
    return driver.prototype if isinstance(driver, PerScenarioDriver) else driver


def _source_file_checksum(cls: type) -> str:
    """Return the SHA-256 of the file that defines a class; an empty text if there is no file.

    The file is read once for each class. For a class in the main script, only the lines of the class count, so that
    the rest of the script may change before the script continues a study.
    """
    # A module edited in the meantime is not reloaded.
    if cls not in _checksums:
        file = getattr(sys.modules.get(cls.__module__), "__file__", None)
        content = None
        with suppress(OSError, TypeError):
            is_script = cls.__module__ == "__main__"
            content = inspect.getsource(cls).encode() if is_script else Path(file or "").read_bytes()
        _checksums[cls] = "" if content is None else hashlib.sha256(content).hexdigest()
    return _checksums[cls]


def driver_command_option(description: object) -> str | None:
    """Return the command line option that creates a driver again, such as ``"my_aeb:Aeb:reaction=0.3"``.

    Returns None if no command line option can create the driver, as for most drivers that are given as objects.
    `description` is a serialized driver from the file of a study, so its content is not trusted.
    """
    if isinstance(description, str):
        return description
    if not isinstance(description, Mapping):
        return None
    if isinstance(equipment := description.get("equipment"), list | tuple):
        inner = {key: value for key, value in description.items() if key != "equipment"}
        command = driver_command_option(inner["driver"] if [*inner] == ["driver"] else inner)
        return None if command is None else SEPARATOR.join([command, *map(str, equipment)])
    name, options = description.get("driver"), description.get("options")
    # A class of a script or a notebook cannot be named.
    if isinstance(name, str) and isinstance(options, Mapping) and not name.startswith("__main__:"):
        return ":".join(
            [name, ",".join(f"{key}={format_option_value(value)}" for key, value in options.items())]
            if options
            else [name]
        )
    with suppress(InputError):
        return nearest_preset_name(description)
    # Never create an object of another package because a study names it.
    delay = description.get("delay")
    if isinstance(name, str) and name in REFERENCES and len(description) == 2 and isinstance(delay, int | float):
        return f"{name}:delay={delay}"
    return None


def user_driver_spec(driver: str | Driver) -> str | None:
    """Return the name with options of a user's own driver that was created by name, such as ``"my_aeb:Aeb"``.

    Returns None for drivers of cornercase and for drivers that were given as objects. A `driver` that is given as a
    name must be registered; otherwise raises `InputError`.
    """
    if isinstance(driver, str):
        factory = DRIVERS.get_factory(split_spec(driver)[0].partition(":")[0])
        return None if is_built_in(unwrap_factory(factory)) else driver
    if isinstance(driver, EquippedDriver):
        inner = user_driver_spec(driver.driver)
        return None if inner is None else SEPARATOR.join([inner, *map(str, driver.equipment)])
    driver = _unwrap(driver)
    spec = getattr(driver, "__dict__", {}).get(_SPEC_ATTRIBUTE)
    if spec is None or is_built_in(type(driver)):
        return None
    name, options = spec
    return driver_command_option({"driver": name, "options": options})


def format_driver(description: object) -> str:
    """Format a serialized driver as text, such as ``"my_aeb:Aeb, reaction=0.3, sha256 1234abcd…"``."""
    if isinstance(description, str):
        return description
    if not isinstance(description, Mapping):
        return "that of the scenario file" if description is None else str(description)
    if isinstance(equipment := description.get("equipment"), list | tuple):
        inner = {key: value for key, value in description.items() if key != "equipment"}
        return SEPARATOR.join(
            [format_driver(inner["driver"] if [*inner] == ["driver"] else inner), *map(str, equipment)]
        )
    checksum, options = description.get("sha256"), description.get("options")
    if checksum is None and options is None and (command := driver_command_option(description)) is not None:
        return command
    parts = [str(description.get("driver", "a driver"))]
    if isinstance(options, Mapping):
        parts += [f"{key}={format_option_value(value)}" for key, value in options.items()]
    else:
        # Without options, only the settings distinguish a driver from others.
        settings = description.get("settings")
        values = settings if isinstance(settings, Mapping) else description
        parts += [
            f"{key}={format_option_value(value)}" for key, value in values.items() if key not in ("driver", "sha256")
        ]
    if isinstance(checksum, str):
        parts.append(f"sha256 {checksum[:_CHECKSUM_DIGITS]}…")
    return ", ".join(parts)


def iter_driver_changes(stored: object, current: object) -> Iterator[tuple[str, str, str, bool]]:
    """Yield (entity, before, now, only_file_changed) for each entity whose driver has changed.

    `stored` and `current` hold the serialized driver of each entity. `before` and `now` describe the two drivers as
    text. `only_file_changed` is True if only the file that defines the driver's class has changed.
    """
    old, new = (dict(drivers) if isinstance(drivers, Mapping) else {} for drivers in (stored, current))
    for entity in sorted({*old, *new}):
        before, after = old.get(entity), new.get(entity)
        if before != after:
            are_mappings = isinstance(before, Mapping) and isinstance(after, Mapping)
            only_file_changed = are_mappings and _without_checksum(before) == _without_checksum(after)
            yield entity, format_driver(before), format_driver(after), only_file_changed


def _without_checksum(description: Any) -> dict[str, object]:
    return {key: value for key, value in description.items() if key != "sha256"}
