"""Options of a simulator on their way to another process, with drivers of users among them."""

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
    """A driver on its way to another process.

    Attributes
    ----------
    name : str
        ``"package.module:Class"``, with options after a colon if it has some.
    description : str or dict
        Of the driver that this process made by that name.
    """

    name: str
    description: str | dict[str, Any]

    @classmethod
    def from_driver(cls, driver: str | Driver) -> str | Driver | GivenDriver:
        """Return what is sent in place of a driver: the driver itself if it was given as an object, or is a name."""
        name = given_name(driver)
        return driver if isinstance(driver, str) or name is None else cls(name, describe_driver(driver))

    def make(self) -> Driver:
        """Make the driver in this process.

        Raises
        ------
        InputError
            It cannot be made here, or is another one than in the process that has sent it.
        """
        driver = named_driver(self.name)
        if describe_driver(driver) != self.description:
            raise InputError(
                f"The driver '{self.name}' is another one than it was when the command began: its file or settings have"
                " changed; give the command again."
            )
        return driver


def packed_options(options: Mapping[str, Any], dumps: Callable[[Any], bytes]) -> bytes:
    """Pickle the options of a simulator.

    Parameters
    ----------
    options : mapping of str to object
    dumps : callable
        Of `pickle`, or of another package that does more.

    Returns
    -------
    bytes
        Drivers that were given by the name of their class are only named; the other process makes them.

    Raises
    ------
    InputError
        A driver, or something else, cannot be pickled.
    """
    drivers = {entity: GivenDriver.from_driver(one) for entity, one in (options.get(_DRIVERS) or {}).items()}
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
        held = next((f"its attribute '{name}'" for name, value in _attributes(driver) if not _can(dumps, value)), "it")
        why = in_one_line(error)
        raise InputError(
            f"`drivers` {entity}: the driver {cls.__module__}:{cls.__qualname__} cannot be sent to another process, as"
            f" `workers`, `timeout` and `cluster` need, since {held} cannot be pickled ({why}); make that in start(),"
            f" give the name of the class, as in {entity}=package.module:Class, or define __getstate__."
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
    """Make the drivers that options only name.

    Parameters
    ----------
    options : dict
        As another process has packed them.

    Returns
    -------
    dict

    Raises
    ------
    InputError
        A driver cannot be made here.
    """
    drivers = options.get(_DRIVERS)
    if not drivers:
        return options
    made = {entity: one.make() if isinstance(one, GivenDriver) else one for entity, one in drivers.items()}
    return {**options, _DRIVERS: made}
