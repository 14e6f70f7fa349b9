"""Create drivers from names, such as those on the command line."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Protocol, TypeAlias, TypeGuard, runtime_checkable

from cornercase._common.current_folder import import_from_current_folder
from cornercase._common.errors import InputError, suggest_name
from cornercase._common.plugin_errors import is_built_in, reraise_termination_request
from cornercase._common.process.signals import collect_interrupts, count_termination_requests
from cornercase._common.registry import check_option_names, parse_options
from cornercase._common.text.sanitize import format_exception
from cornercase._common.typing import FloatArray
from cornercase._common.validation import check_mapping, repr_short
from cornercase.drivers._base import Driver, Situation
from cornercase.drivers._driving_function import DrivingFunction
from cornercase.drivers._equipment import EquippedDriver, equip
from cornercase.drivers._prefix_hints import suggest_prefix
from cornercase.drivers._presets import Behaviour
from cornercase.drivers._registry import DRIVERS, is_registered_driver, split_spec
from cornercase.drivers._serialization import driver_command_option, record_driver_spec, serialize_driver
from cornercase.drivers._system_under_test import PerScenarioDriver, SystemUnderTest

DriverLike: TypeAlias = str | Driver | SystemUnderTest | Behaviour
"""Types that a user may give as a driver."""


@runtime_checkable
class _DriverProtocol(Protocol):
    """Members that make an object a driver, even if its class does not derive from `Driver`."""

    settings: dict[str, object]

    def start(self, scenarios: int, others: int) -> None: ...

    def acceleration(self, situation: Situation) -> FloatArray: ...


def is_driver(candidate: object) -> TypeGuard[Driver]:
    """Check whether an object is a driver, by its base class or its members; False for a class."""
    return (
        not isinstance(candidate, type)
        and isinstance(candidate, _DriverProtocol)
        and isinstance(candidate.settings, dict)
    )


def check_drivers(drivers: object) -> dict[str, str | Driver]:
    """Return drivers by entity, each as a name or an object; raises `InputError` for anything that is no driver.

    A `Behaviour` becomes the name of its preset with options. A driver object becomes a name, too, if a registered name
    creates an equal driver, so that a study can be continued without the object. The name of a user's own driver stays
    a name, and its module is not imported.
    """
    if drivers is not None and not isinstance(drivers, Mapping):
        raise InputError(
            f"`drivers` {repr_short(drivers)}: give the driver of each entity, as in drivers={{'Ego': 'normal'}}."
        )
    return {entity: _check_driver(entity, driver) for entity, driver in check_mapping("drivers", drivers or {}).items()}


def _check_driver(entity: str, driver: object) -> str | Driver:
    if isinstance(driver, SystemUnderTest | Behaviour):
        return resolve_driver(driver)
    if driver and isinstance(driver, str):
        if ":" not in split_spec(driver)[0] or is_registered_driver(driver):
            return resolve_driver(driver)
        return driver
    if is_driver(driver):
        return _name_of_equal_driver(driver) or driver
    if isinstance(driver, type):
        raise InputError(
            f"`drivers` {entity}: {driver.__name__} is a class; give an object of it, as in"
            f" drivers={{{entity!r}: {driver.__name__}()}}."
        )
    raise InputError(f"`drivers` {entity}={repr_short(driver)}: give the name of a driver, or a driver object.")


def create_driver_named_in_file(name: str) -> Driver:
    """Create a driver that a scenario file names, such as ``"normal:reaction_time=0.6,horizon=4"``.

    Scenario files are not trusted. So the name must be that of a registered driver, and all options must be numbers,
    since texts could name files or programs. Otherwise raises `InputError`.
    """
    if not is_registered_driver(name):
        hint = suggest_name(name.partition(":")[0], DRIVERS.names())
        raise InputError(f"asks for the driver '{name}', which does not exist; {hint}")
    if runs_program_or_file(name):
        raise InputError(
            f"asks for the driver '{name}', but a program named in a file is not run; give the driver with `drivers`."
        )
    if (other := find_non_numeric_option(name)) is not None:
        raise InputError(f"asks for the driver '{name}' with the option '{other}'; in a file, options are numbers.")
    return _create_registered(name)


def _create_registered(spec: str) -> Driver:
    """Create a registered driver with its equipment."""
    name, equipment = split_spec(spec)
    if not is_registered_driver(name) and (hint := suggest_prefix(name)) is not None:
        raise InputError(f"There is no driver '{name}'; {hint}.")
    driver: Driver | SystemUnderTest = DRIVERS.create(name)
    # Other packages may register systems under test, too.
    return equip(PerScenarioDriver(driver) if isinstance(driver, SystemUnderTest) else driver, equipment)


def runs_program_or_file(name: str) -> bool:
    """Return whether a registered driver runs the program or file that its name contains."""
    return is_registered_driver(name) and DRIVERS.takes_whole_text(split_spec(name)[0].partition(":")[0])


def refuse_program_driver(name: str) -> None:
    """Raise `InputError` for a driver that runs a program or file, which a condition of a study may not name."""
    if runs_program_or_file(name):
        raise InputError(f"the driver '{name}' runs a program or file, but a condition must not run one; give a class.")


def may_be_named_in_file(name: str) -> bool:
    """Return whether an untrusted file may name a driver, since creating the driver runs no code of a user."""
    try:
        create_driver_named_in_file(name)
    except InputError:
        return False
    return True


def find_non_numeric_option(name: str) -> str | None:
    """Return the first option of a driver with a text as value; None if all values are numbers, true or false.

    For a driver that runs a program or file, return all that follows the prefix.
    """
    driver, equipment = split_spec(name)
    if runs_program_or_file(driver):
        return driver.partition(":")[2]
    for part in (driver, *equipment):
        options = part.partition(":")[2]
        for option in options.split(",") if options else ():
            key, _, value = option.partition("=")
            try:
                float({"true": 1, "false": 0}.get(value.lower(), value))
            except ValueError:
                return key
            # The file of an FMU may be followed by another colon.
            if not key.strip().isidentifier():
                return key
    return None


def is_compiled_driver_name(name: str) -> bool:
    """Check whether a name creates a registered driver whose decisions and vehicle compiled code can compute."""
    from cornercase.drivers._attached_driver import AttachedDriver

    return is_registered_driver(name) and AttachedDriver(_create_registered(name), "").is_compiled


def load_user_driver(name: str) -> Driver:
    """Create a user's own driver from ``"package.module:Class"``, with options as in ``":reaction=0.3"`` or without.

    The module is imported, so the name must come from the user, never from a file. The module is searched among the
    installed packages, then in the current folder. Raises `InputError` if the driver cannot be created.
    """
    name, equipment = split_spec(name)
    module_name, _, class_and_options = name.partition(":")
    class_name, colon, text = class_and_options.partition(":")
    hint = suggest_prefix(name)
    is_dotted = all(identifier.isidentifier() for identifier in module_name.split("."))
    if hint is not None and not (is_dotted and class_name.isidentifier()):
        raise InputError(f"There is no driver '{name}'; {hint}.")
    if "=" in class_name:
        raise InputError(f"There is no driver '{module_name}'; {suggest_name(module_name, DRIVERS.names())}")
    if not is_dotted or not class_name.isidentifier():
        raise InputError(f"The driver '{name}' is not of the form package.module:Class.")
    class_path = f"{module_name}:{class_name}"
    if colon and not text:
        raise InputError(f"The driver '{name}' ends in a colon; give options as in '{class_path}:name=value'.")
    # Otherwise Python would treat a `KeyboardInterrupt` raised by the driver as Ctrl-C.
    with collect_interrupts():
        requests = count_termination_requests()
        try:
            module = import_from_current_folder(module_name)
        except ModuleNotFoundError as error:
            raise InputError(
                f"The driver '{name}' cannot be loaded since there is no module '{error.name}';"
                f" {hint or 'install it or run the command in its folder'}."
            ) from error
        except BaseException as error:
            reraise_termination_request(error, requests)
            raise InputError(
                f"The driver '{name}' cannot be loaded since its module fails: {format_exception(error)}."
            ) from error
        driver_class = getattr(module, class_name, None)
        if not isinstance(driver_class, type):
            hint = _describe_hidden_file(module_name) or suggest_name(class_name, _own_classes(module))
            raise InputError(
                f"The driver '{name}' cannot be loaded since '{module_name}' has no class '{class_name}'; {hint}"
            )
        options = parse_options("driver", class_path, driver_class, text) if text else {}
        check_option_names("driver", class_path, driver_class, options)
        try:
            driver = driver_class(**options)
        except InputError:
            raise
        except BaseException as error:
            reraise_termination_request(error, requests)
            raise InputError(f"The driver '{name}' cannot be created: {format_exception(error)}.") from error
    if isinstance(driver, SystemUnderTest):
        driver = PerScenarioDriver(driver)
    if not is_driver(driver):
        hidden = _describe_hidden_file(module_name)
        why = f" Its module is another one: {hidden}" if hidden else ""
        raise InputError(
            f"The class '{class_path}' is not a driver: derive it from cornercase.SystemUnderTest or"
            f" cornercase.Driver, or give it start(), acceleration() and a dict called settings.{why}"
        )
    record_driver_spec(driver, class_path, options)
    return equip(driver, equipment)


def _own_classes(module: ModuleType) -> list[str]:
    """Return the names of the classes that a module defines."""
    return [
        name for name, made in vars(module).items() if isinstance(made, type) and made.__module__ == module.__name__
    ]


def _describe_hidden_file(module_name: str) -> str:
    """Return a hint if Python loads another module instead of the user's file of this name; else an empty text."""
    top = module_name.partition(".")[0]
    loaded = getattr(sys.modules.get(top), "__file__", None)
    for file in (Path(f"{top}.py"), Path(top, "__init__.py")):
        if file.is_file() and not (loaded and Path(loaded).resolve() == file.resolve()):
            where = loaded or "part of Python itself"
            return f"the module '{top}' is {where}, which hides ./{file.as_posix()}, so rename yours."
    return ""


def driver_by_name(name: str) -> Driver:
    """Create a driver from the name of a registered driver or ``"package.module:Class"``, with or without options."""
    is_own = ":" in split_spec(name)[0] and not is_registered_driver(name)
    return load_user_driver(name) if is_own else _create_registered(name)


def resolve_driver(driver: DriverLike) -> str | Driver:
    """Convert what a user gave as a driver to the name of a registered driver, or else to a driver object.

    The result is a name, which a study can store, for a `Behaviour`, and for a registered driver given by name if all
    its options are numbers.
    """
    if isinstance(driver, SystemUnderTest):
        return PerScenarioDriver(driver)
    if isinstance(driver, Behaviour):
        # Its kernels take long to import.
        from cornercase.drivers._behaviour import BehaviourDriver

        return str(BehaviourDriver(driver))
    if not isinstance(driver, str):
        return driver
    created = driver_by_name(driver)
    if is_registered_driver(driver):
        if find_non_numeric_option(driver) is None:
            return driver
        record_driver_spec(created, driver, {})
    return created


def _name_of_equal_driver(driver: Driver) -> str:
    """Return the registered name, with options, that creates an equal driver; an empty text if there is none."""
    parts = (driver.driver, *driver.equipment) if isinstance(driver, EquippedDriver) else (driver,)
    if not all(map(is_built_in, parts)):
        return ""
    description = serialize_driver(driver)
    name = driver_command_option(description)
    if name is None or not is_registered_driver(name) or find_non_numeric_option(name) is not None:
        return ""
    with suppress(InputError):
        return name if serialize_driver(driver_by_name(name)) == description else ""
    return ""


def may_steer(driver: str | Driver) -> bool:
    """Return whether a driver may steer its vehicle, or has a vehicle model that steers along the path."""
    made = driver_by_name(driver) if isinstance(driver, str) else driver
    if isinstance(made, EquippedDriver):
        return isinstance(made.driver, DrivingFunction) or (made.vehicle is not None and made.vehicle.steers)
    return isinstance(made, DrivingFunction)
