"""Create a driver from the name given on the command line."""

from __future__ import annotations

from typing import Protocol, TypeGuard, runtime_checkable

from cornercase._common.current_folder import import_here
from cornercase._common.errors import InputError, suggestion
from cornercase._common.interrupts import noted_interrupts, requests_heard
from cornercase._common.parts import raise_if_request
from cornercase._common.registry import read_options, require_options
from cornercase._common.texts import in_one_line
from cornercase._common.typing import FloatArray
from cornercase.drivers.base import Driver, Situation
from cornercase.drivers.description import note_name
from cornercase.drivers.registry import DRIVERS, is_registered


@runtime_checkable
class _Drives(Protocol):
    """What makes an object a driver, whether or not its class derives from `Driver`."""

    settings: dict[str, object]

    def start(self, scenarios: int, others: int) -> None: ...

    def acceleration(self, situation: Situation) -> FloatArray: ...


def is_driver(made: object) -> TypeGuard[Driver]:
    """Check whether an object is a driver, by base class or by its members; False for a class."""
    return not isinstance(made, type) and isinstance(made, _Drives) and isinstance(made.settings, dict)


def driver_of_file(name: str) -> Driver:
    """Create a driver named by a scenario file, such as ``"normal:reaction_time=0.6,horizon=4"``.

    A file may come from anywhere: it cannot name a class to load, and options must be numbers, since strings could name
    files or programs. Otherwise raises `InputError`.
    """
    if not is_registered(name):
        hint = suggestion(name.partition(":")[0], DRIVERS.names())
        raise InputError(f"asks for the driver '{name}', which does not exist; {hint}")
    if (other := _other_option(name)) is not None:
        raise InputError(f"asks for the driver '{name}' with the option '{other}'; in a file, options are numbers.")
    return DRIVERS.create(name)


def _other_option(name: str) -> str | None:
    """First option of a driver that is not a number; None if there is none."""
    options = name.partition(":")[2]
    for option in options.split(",") if options else ():
        key, _, value = option.partition("=")
        try:
            float(value)
        except ValueError:
            return key
    return None


def decides_compiled(name: str) -> bool:
    """Check whether a name, possibly with options, is a registered driver with compiled decisions."""
    from cornercase.drivers.fleet import CompiledDriver

    return is_registered(name) and isinstance(DRIVERS.create(name), CompiledDriver)


def load_driver(name: str) -> Driver:
    """Create a user's own driver from ``"package.module:Class"``, possibly with options ``":reaction=0.3"``.

    This runs the module, so the name must come from the person at the command line, never from a file. The module is
    searched among installed packages, then in the current folder. Raises `InputError` if anything of this fails.
    """
    module_name, _, class_and_options = name.partition(":")
    class_name, colon, text = class_and_options.partition(":")
    if "=" in class_name:
        raise InputError(f"There is no driver '{module_name}'; {suggestion(module_name, DRIVERS.names())}")
    if not all(identifier.isidentifier() for identifier in module_name.split(".")) or not class_name.isidentifier():
        raise InputError(f"The driver '{name}' is not of the form package.module:Class.")
    class_path = f"{module_name}:{class_name}"
    if colon and not text:
        raise InputError(f"The driver '{name}' ends in a colon; give options as in '{class_path}:name=value'.")
    # Otherwise Python would treat a `KeyboardInterrupt` raised by the driver as Ctrl-C.
    with noted_interrupts():
        requests = requests_heard()
        try:
            module = import_here(module_name)
        except ModuleNotFoundError as error:
            raise InputError(
                f"The driver '{name}' cannot be loaded since there is no module '{error.name}';"
                " install it or run the command in its folder."
            ) from error
        except BaseException as error:
            raise_if_request(error, requests)
            raise InputError(
                f"The driver '{name}' cannot be loaded since its module fails: {in_one_line(error)}."
            ) from error
        driver_class = getattr(module, class_name, None)
        if not isinstance(driver_class, type):
            raise InputError(f"The driver '{name}' cannot be loaded since '{module_name}' has no class '{class_name}'.")
        options = read_options("driver", class_path, driver_class, text) if text else {}
        require_options("driver", class_path, driver_class, options)
        try:
            driver = driver_class(**options)
        except InputError:
            raise
        except BaseException as error:
            raise_if_request(error, requests)
            raise InputError(f"The driver '{name}' cannot be created: {in_one_line(error)}.") from error
    if not is_driver(driver):
        raise InputError(
            f"The class '{class_path}' is not a driver: it neither derives from cornercase.drivers.Driver nor has"
            " start(), acceleration() and a dict called settings."
        )
    note_name(driver, class_path, options)
    return driver


def named_driver(name: str) -> Driver:
    """Create a driver from a registered name or ``"package.module:Class"``, either possibly with options."""
    return load_driver(name) if ":" in name and not is_registered(name) else DRIVERS.create(name)


def told_driver(driver: str | Driver) -> str | Driver:
    """Load a driver, but keep the name of a registered one, so that studies and files can store it."""
    if not isinstance(driver, str):
        return driver
    created = named_driver(driver)
    if is_registered(driver):
        if _other_option(driver) is None:
            return driver
        note_name(created, driver, {})
    return created
