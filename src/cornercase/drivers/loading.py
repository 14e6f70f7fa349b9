"""A driver by the name that a person gives on the command line."""

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
    """What makes a driver of a class, whether it derives from `Driver` or not."""

    settings: dict[str, object]

    def start(self, scenarios: int, others: int) -> None: ...

    def acceleration(self, situation: Situation) -> FloatArray: ...


def is_driver(made: object) -> TypeGuard[Driver]:
    """Whether something can drive: it derives from `Driver`, or has all that one has.

    Parameters
    ----------
    made : object

    Returns
    -------
    bool
        False for a class, of which a driver is still to be made.
    """
    return not isinstance(made, type) and isinstance(made, _Drives) and isinstance(made.settings, dict)


def driver_of_file(name: str) -> Driver:
    """Build a driver that a file names.

    A file may come from anywhere: it can name no class to load, and its options can only be numbers, since others
    may name files or programs.

    Parameters
    ----------
    name : str
        As it is registered, possibly with options: ``"normal:reaction_time=0.6,horizon=4"``.

    Returns
    -------
    Driver

    Raises
    ------
    InputError
        There is none, or it cannot be named by a file.
    """
    if not is_registered(name):
        known = suggestion(name.partition(":")[0], DRIVERS.names())
        raise InputError(f"asks for the driver '{name}', which does not exist; {known}")
    if (other := _other_option(name)) is not None:
        raise InputError(f"asks for the driver '{name}' with the option '{other}'; in a file, options are numbers.")
    return DRIVERS.create(name)


def _other_option(name: str) -> str | None:
    """Return an option of a driver that is no number; None where there is none."""
    options = name.partition(":")[2]
    for option in options.split(",") if options else ():
        key, _, value = option.partition("=")
        try:
            float(value)
        except ValueError:
            return key
    return None


def decides_compiled(name: str) -> bool:
    """Whether the decisions of a registered driver are compiled.

    Parameters
    ----------
    name : str
        One of `DRIVERS`, possibly with options; there is none of another name.

    Returns
    -------
    bool
    """
    from cornercase.drivers.fleet import CompiledDriver

    return is_registered(name) and isinstance(DRIVERS.create(name), CompiledDriver)


def load_driver(name: str) -> Driver:
    """Build a user's own driver.

    This runs the module, so the name must come from the person at the command line, never from a file.

    Parameters
    ----------
    name : str
        ``"package.module:Class"``, possibly with options of its constructor: ``"package.module:Class:reaction=0.3"``.
        The module is looked for among what is installed, then in the current folder.

    Returns
    -------
    Driver

    Raises
    ------
    InputError
        The name has no such form, the module or the class is not there or fails, the class has no such option, or it
        makes no driver.
    """
    module_name, _, rest = name.partition(":")
    class_name, colon, text = rest.partition(":")
    if "=" in class_name:
        raise InputError(f"There is no driver '{module_name}'; {suggestion(module_name, DRIVERS.names())}")
    if not all(part.isidentifier() for part in module_name.split(".")) or not class_name.isidentifier():
        raise InputError(f"The driver '{name}' is not of the form package.module:Class.")
    place = f"{module_name}:{class_name}"
    if colon and not text:
        raise InputError(f"The driver '{name}' ends in a colon; give options as in '{place}:name=value'.")
    # Else Python itself would take a `KeyboardInterrupt` of the driver for one that somebody typed.
    with noted_interrupts():
        heard = requests_heard()
        try:
            module = import_here(module_name)
        except ModuleNotFoundError as error:
            raise InputError(
                f"The driver '{name}' cannot be loaded since there is no module '{error.name}';"
                " install it or start in its folder."
            ) from error
        except BaseException as error:
            raise_if_request(error, heard)
            raise InputError(
                f"The driver '{name}' cannot be loaded since its module fails: {in_one_line(error)}."
            ) from error
        made = getattr(module, class_name, None)
        if not isinstance(made, type):
            raise InputError(f"The driver '{name}' cannot be loaded since '{module_name}' has no class '{class_name}'.")
        options = read_options("driver", place, made, text) if text else {}
        require_options("driver", place, made, options)
        try:
            driver = made(**options)
        except InputError:
            raise
        except BaseException as error:
            raise_if_request(error, heard)
            raise InputError(f"The driver '{name}' cannot be made: {in_one_line(error)}.") from error
    if not is_driver(driver):
        raise InputError(
            f"The class '{place}' is not a driver: it neither derives from cornercase.drivers.Driver nor has start(),"
            " acceleration() and a dict called settings."
        )
    note_name(driver, place, options)
    return driver


def named_driver(name: str) -> Driver:
    """Build a driver by its name: a registered one, or a class of one's own.

    Parameters
    ----------
    name : str
        As it is registered or ``"package.module:Class"``, either possibly with options after a colon.

    Returns
    -------
    Driver

    Raises
    ------
    InputError
        There is none.
    """
    return load_driver(name) if ":" in name and not is_registered(name) else DRIVERS.create(name)


def told_driver(driver: str | Driver) -> str | Driver:
    """Load a driver as a simulator is told of it: a registered one stays a name, so that studies and files can hold it.

    Parameters
    ----------
    driver : str or Driver
        As of `named_driver`, or one that is made.

    Returns
    -------
    str or Driver

    Raises
    ------
    InputError
        There is no such driver.
    """
    if not isinstance(driver, str):
        return driver
    made = named_driver(driver)
    if is_registered(driver):
        if _other_option(driver) is None:
            return driver
        note_name(made, driver, {})
    return made
