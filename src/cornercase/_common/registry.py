"""Simulators, optimizers and metrics by name, also those of other packages."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from functools import partial
from importlib.metadata import EntryPoint, entry_points
from inspect import Parameter, signature
from typing import Any, Final, Generic, TypeVar, cast

from cornercase._common.errors import InputError, suggestion
from cornercase._common.interrupts import requests_heard
from cornercase._common.parts import guarded, maker_of, raise_if_request
from cornercase._common.texts import in_one_line

T = TypeVar("T")

# What is annotated so, or is so by default, takes nothing else; for the rest, a value is what it looks like.
_PLAIN: Final[dict[str, type[Any]]] = {one.__name__: one for one in (bool, int, float, str)}


class Registry(Generic[T]):
    """Factories by name, from this package and from an entry-point group.

    Parameters
    ----------
    kind : str
        What is registered, as it stands in messages: ``"metric"``.
    group : str
        Entry-point group in which other packages name theirs: ``"cornercase.metrics"``.
    base : type, optional
        Class of which each factory has to be a subclass, so that `class_of` finds what it declares.
    """

    def __init__(self, kind: str, group: str, base: type[Any] | None = None) -> None:
        self._kind = kind
        self._group = group
        self._base = base
        self._factories: dict[str, tuple[Callable[..., T] | str, dict[str, Any]]] = {}

    def register(self, name: str, factory: Callable[..., T] | str, /, **options: Any) -> None:
        """Make a factory known by a name.

        Parameters
        ----------
        name : str
        factory : callable or str
            As ``"package.module:name"`` it is imported when it is asked for, not before.
        **options
            What the factory always gets.

        Raises
        ------
        ValueError
            Something is registered by this name already.
        """
        if name in self._factories:
            raise ValueError(f"The {self._kind} '{name}' is registered twice.")
        self._factories[name] = (factory, options)

    def names(self) -> list[str]:
        """Return all names, also those of other packages.

        Returns
        -------
        list of str
            In alphabetical order.
        """
        return sorted({*self._factories, *(entry.name for entry in entry_points(group=self._group))})

    def __contains__(self, name: object) -> bool:
        return name in self._factories or any(entry.name == name for entry in entry_points(group=self._group))

    def create(self, name: str, **options: Any) -> T:
        """Build the one called `name`.

        Parameters
        ----------
        name : str
            May hold options after a colon: ``"ttc:accelerating=true"``; what is built then has the whole of it as its
            name. A factory whose first parameter is positional-only takes all that stands behind the colon as that, as
            a text: ``"stl:always(clearance > 0.5)"``.
        **options
            What its factory gets besides.

        Returns
        -------
        object

        Raises
        ------
        InputError
            No such name, no such option, or a value that it does not take.

        Examples
        --------
        >>> from cornercase import METRICS
        >>> METRICS.create("ttc:accelerating=true").unit
        's'
        """
        base, _, text = name.partition(":")
        factory = self.factory(base)
        if not text:
            if name != base:
                raise InputError(f"The {self._kind} '{name}' ends in a colon; give options as in '{base}:name=value'.")
            require_options(self._kind, base, factory, options)
            with guarded(f"The {self._kind} '{name}'", maker_of(factory), "as it was made"):
                return factory(**options)
        if any(one.kind is one.POSITIONAL_ONLY for one in signature(factory).parameters.values()):
            with guarded(f"The {self._kind} '{name}'", maker_of(factory), "as it was made"):
                whole: Any = factory(text, **options)
            whole.name = name
            return cast(T, whole)
        # What belongs to the name, as which preset it is, is no option.
        given = {*options, *(factory.keywords if isinstance(factory, partial) else ())}
        options |= read_options(self._kind, base, factory, text, given)
        require_options(self._kind, base, factory, options)
        with guarded(f"The {self._kind} '{name}'", maker_of(factory), "as it was made"):
            try:
                made: Any = factory(**options)
            except (TypeError, AttributeError) as error:
                raise InputError(f"The {self._kind} '{base}' does not take the options '{text}' ({error}).") from error
        made.name = name
        return cast(T, made)

    def factory(self, name: str) -> Callable[..., T]:
        """Return what builds the one called `name`, without options.

        Parameters
        ----------
        name : str

        Returns
        -------
        callable

        Raises
        ------
        InputError
            No such name, or what is registered is no subclass of the base class.
        """
        loaded, options = self._loaded(name)
        return partial(loaded, **options) if options else loaded

    def class_of(self, name: str) -> type[T]:
        """Return the class of the one called `name`, which tells what it declares.

        Parameters
        ----------
        name : str
            May hold options after a colon.

        Returns
        -------
        type

        Raises
        ------
        InputError
            No such name, or what is registered is no class.
        """
        loaded, _ = self._loaded(name.partition(":")[0])
        if not isinstance(loaded, type):
            raise InputError(f"The {self._kind} '{name}' is registered as a function; register its class.")
        return loaded

    def _loaded(self, name: str) -> tuple[Callable[..., T], dict[str, Any]]:
        if name in self._factories:
            known, options = self._factories[name]
            loaded = EntryPoint(name, known, self._group).load() if isinstance(known, str) else known
            return self._checked(name, loaded), options
        for entry in entry_points(group=self._group, name=name):
            heard = requests_heard()
            try:
                loaded = entry.load()
            except BaseException as error:
                raise_if_request(error, heard)
                raise InputError(
                    f"The {self._kind} '{name}' cannot be loaded since {entry.value} fails: {in_one_line(error)}."
                ) from error
            return self._checked(name, loaded), {}
        raise InputError(f"There is no {self._kind} '{name}'; {suggestion(name, self.names())}")

    def _checked(self, name: str, loaded: Callable[..., T]) -> Callable[..., T]:
        base = self._base
        if base is not None and not (isinstance(loaded, type) and issubclass(loaded, base)):
            place = f"{getattr(loaded, '__module__', '?')}.{getattr(loaded, '__qualname__', loaded)}"
            public = f"{base.__module__.rpartition('.')[0]}.{base.__qualname__}"
            raise InputError(
                f"The {self._kind} '{name}' is {place}, which is not a subclass of {public}; derive it from that."
            )
        return loaded


def declared_options(factory: Callable[..., Any]) -> dict[str, Parameter]:
    """Find the options that a factory declares, by name.

    A class that takes others too (``**options``) hands them on to the class that it derives from, so it has the options
    of that class as well. What no constructor names is no option, since nobody would notice that it is misspelt.

    Parameters
    ----------
    factory : callable

    Returns
    -------
    dict of str to Parameter
    """
    taken = dict(signature(factory).parameters)
    made = maker_of(factory)
    for above in made.__mro__ if isinstance(made, type) else ():
        if not any(one.kind is one.VAR_KEYWORD for one in taken.values()):
            break
        if "__init__" in vars(above):
            _, *own = signature(vars(above)["__init__"]).parameters.values()
            taken = {name: one for name, one in taken.items() if one.kind is not one.VAR_KEYWORD}
            taken = {one.name: one for one in own} | taken
    named = (Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)
    return {name: one for name, one in taken.items() if one.kind in named}


def read_options(
    kind: str, name: str, factory: Callable[..., Any], text: str, given: Container[str] = ()
) -> dict[str, Any]:
    """Read the options that stand behind the colon of a name.

    Parameters
    ----------
    kind : str
        What is made, for messages: ``"driver"``.
    name : str
        What stands before the colon.
    factory : callable
        Says which options there are, and what their values are.
    text : str
        ``"reaction=0.3,seed=1"``.
    given : container of str
        Names of what the factory gets besides.

    Returns
    -------
    dict of str to bool, float or str

    Raises
    ------
    InputError
        The factory declares no such option, or does not take its value.
    """
    known = {key: one for key, one in declared_options(factory).items() if key not in given}
    options: dict[str, Any] = {}
    for option in text.split(","):
        key, equals, value = (part.strip() for part in option.partition("="))
        if not (key.isidentifier() and equals):
            raise InputError(
                f"The {kind} '{name}:{text}' has the option '{option}'; give options as in '{name}:name=value'."
            )
        if key in options:
            raise InputError(f"The {kind} '{name}:{text}' has the option '{key}' twice; give it once.")
        if key not in known:
            advice = suggestion(key, known) if known else "its constructor declares none."
            raise InputError(f"The {kind} '{name}' has no option '{key}'; {advice}")
        try:
            options[key] = _value(value, _taken_by(known[key]))
        except ValueError as error:
            raise InputError(f"The {kind} '{name}' takes {error} for '{key}', not '{value}'.") from None
    return options


def require_options(kind: str, name: str, factory: Callable[..., Any], options: Mapping[str, Any]) -> None:
    """Refuse to make something without an option that it needs, or with one that its constructor does not take.

    Parameters
    ----------
    kind, name : str
        For messages.
    factory : callable
    options : mapping of str to object

    Raises
    ------
    InputError
        The first such option.
    """
    try:
        taken = signature(factory)
    except ValueError:
        # Compiled code need not say what it takes.
        return
    named = (Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)
    for key, one in taken.parameters.items():
        if one.kind in named and one.default is one.empty and key not in options:
            raise InputError(f"The {kind} '{name}' needs the option '{key}'; give it as in '{name}:{key}=value'.")
    if any(one.kind is one.VAR_KEYWORD for one in taken.parameters.values()):
        return
    for key in options:
        if key not in taken.parameters:
            raise InputError(f"The {kind} '{name}' does not take '{key}', which it gets; declare it in its class.")


def _taken_by(parameter: Parameter) -> type[Any] | None:
    """Find the plain type that a parameter takes; None where it says none, or another one."""
    if parameter.annotation is not parameter.empty:
        # Where annotations are not evaluated they are texts.
        return _PLAIN.get(getattr(parameter.annotation, "__name__", str(parameter.annotation)))
    # What is 100 by default may be 2.5.
    return float if type(parameter.default) is int else _PLAIN.get(type(parameter.default).__name__)


def _value(text: str, taken: type[Any] | None) -> bool | float | str:
    """Read the value of an option; a `ValueError` says what its type takes instead."""
    if taken is str:
        return text
    if text.lower() in ("true", "false") and taken in (bool, None):
        return text.lower() == "true"
    if taken is bool:
        raise ValueError("true or false")
    try:
        number = float(text)
    except ValueError:
        if taken is None:
            return text
        raise ValueError("a whole number" if taken is int else "a number") from None
    if taken is int and not number.is_integer():
        raise ValueError("a whole number")
    return int(number) if number.is_integer() and (taken is int or "." not in text) else number
