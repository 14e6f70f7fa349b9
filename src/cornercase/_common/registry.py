"""Registries of simulators, optimizers and metrics by name, including those in other packages."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from functools import lru_cache, partial
from importlib import metadata
from importlib.metadata import EntryPoint, EntryPoints
from inspect import Parameter, signature
from typing import Any, Final, Generic, NoReturn, TypeVar, cast

from cornercase._common.configurable import Configurable, annotated_types, declared_options
from cornercase._common.errors import InputError, suggest_name
from cornercase._common.plugin_errors import (
    convert_plugin_errors,
    is_built_in,
    reraise_termination_request,
    unwrap_factory,
)
from cornercase._common.process.signals import count_termination_requests
from cornercase._common.text.sanitize import format_exception
from cornercase._common.validation import not_an_object_error

T = TypeVar("T")

# Types to which the text of an option is converted. If an option declares no such type, the text determines the type.
_PLAIN_TYPES: Final[dict[str, type[Any]]] = {kind.__name__: kind for kind in (bool, int, float, str)}


def entry_points(*, group: str, name: str | None = None) -> EntryPoints:
    """Return the entry points of installed packages in a group, like `importlib.metadata.entry_points`, but cached."""
    of_group = _read_entry_points(group, tuple((folder, _modification_time(folder)) for folder in sys.path))
    return of_group if name is None else of_group.select(name=name)


@lru_cache(maxsize=16)
def _read_entry_points(group: str, folders: tuple[tuple[str, int | None], ...]) -> EntryPoints:
    """Read the entry points of a group; the result is cached until import folders or their times change."""
    # Reading the files of some hundred packages takes as long as a short command.
    return metadata.entry_points(group=group)


def _modification_time(folder: str) -> int | None:
    try:
        return os.stat(folder or os.curdir).st_mtime_ns
    except OSError:
        return None


class Registry(Generic[T]):
    """Mapping of names to factories, both from this package and from an entry-point group of other packages.

    Parameters
    ----------
    kind : str
        What is registered, for messages: ``"metric"``.
    group : str
        Entry-point group in which other packages register their factories: ``"cornercase.metrics"``.
    base : type, optional
        Class from which each factory must be derived. Every factory is then a class, which `get_class` returns.
    """

    def __init__(self, kind: str, group: str, base: type[Any] | None = None) -> None:
        self._kind = kind
        self._group = group
        self._base = base
        self._factories: dict[str, tuple[Callable[..., T] | str, dict[str, Any]]] = {}

    def register(self, name: str, factory: Callable[..., T] | str, /, **options: Any) -> None:
        """Register a factory under a name.

        Parameters
        ----------
        name : str
        factory : callable or str
            A text ``"package.module:name"`` is imported when the factory is needed.
        **options
            Fixed options of the factory.

        Raises
        ------
        ValueError
            The name is registered already.
        InputError
            The factory is not a subclass of the base class.
        """
        if name in self._factories:
            raise ValueError(f"The {self._kind} '{name}' is registered twice.")
        if not isinstance(factory, str):
            self._check_subclass(name, factory)
        self._factories[name] = (factory, options)

    def export(self, values: Iterable[object]) -> dict[str, Any]:
        """Return registrations by the user's program, so that another process can `restore` them.

        Parameters
        ----------
        values : iterable of object
            Names, with or without options; other objects are skipped.

        Returns
        -------
        dict of str to object
        """
        names = [value.partition(":")[0] for value in values if isinstance(value, str)]
        return {
            name: self._factories[name]
            for name in names
            if name in self._factories and not self._is_built_in_name(name)
        }

    def restore(self, registrations: Mapping[str, Any]) -> None:
        """Register the names that another process has exported.

        Parameters
        ----------
        registrations : mapping of str to object
            Result of `export`.
        """
        self._factories = {**registrations, **self._factories}

    def check_name_not_taken(self, instance: Any) -> None:
        """Raise `InputError` if the name of an object belongs to another registered class.

        Otherwise, results of the object would be taken for results of that class.

        Parameters
        ----------
        instance : object
            The attribute ``name`` of the object may contain options after a colon.

        Raises
        ------
        InputError
            The name belongs to another class.
        """
        name, cls = instance.name.partition(":")[0], type(instance)
        if name not in self:
            return
        registered = self.get_class(name)
        # A cell of a notebook that runs again defines the same class again.
        if (registered.__module__, registered.__qualname__) != (cls.__module__, cls.__qualname__):
            raise InputError(
                f"The {self._kind} {cls.__qualname__} has the name '{name}' of another {self._kind}; change the"
                " `name` of the class."
            )

    def _is_built_in_name(self, name: str) -> bool:
        """Return whether a registered name belongs to a factory of cornercase, not of the user's program."""
        factory, _ = self._factories[name]
        return factory.startswith("cornercase.") if isinstance(factory, str) else is_built_in(unwrap_factory(factory))

    def names(self) -> list[str]:
        """Return all registered names, including those from other packages.

        Returns
        -------
        list of str
            In alphabetical order.
        """
        return sorted({*self._factories, *(entry.name for entry in entry_points(group=self._group))})

    def __contains__(self, name: object) -> bool:
        return name in self._factories or any(entry.name == name for entry in entry_points(group=self._group))

    def __iter__(self) -> Iterator[str]:
        return iter(self.names())

    def __len__(self) -> int:
        return len(self.names())

    def __getitem__(self, name: object) -> NoReturn:
        raise TypeError(
            f"A registry cannot be indexed; create({name!r}) makes the {self._kind}, and get_class({name!r}) returns"
            " its class."
        )

    def __repr__(self) -> str:
        return f"<Registry ({self._kind}): {', '.join(self)}>"

    def create(self, name: str | type[T], **options: Any) -> T:
        """Create the object registered as `name`.

        Parameters
        ----------
        name : str or type
            A name may contain options after a colon: ``"ttc:accelerating=true"``; the object then has the whole text as
            its name. If the first parameter of the factory is positional-only, the parameter gets the whole text after
            the colon: ``"stl:always(clearance > 0.5)"``. A class need not be registered.
        **options
            Further options of the factory.

        Returns
        -------
        object

        Raises
        ------
        InputError
            Unknown name, unknown option, or a value that the option does not take.

        Examples
        --------
        >>> from cornercase.metrics import METRICS
        >>> METRICS.create("ttc:accelerating=true").unit
        's'
        """
        base, colon, text = (name if isinstance(name, str) else name.__qualname__).partition(":")
        if isinstance(name, str):
            self._refuse_class_path(name)
        factory = self.get_factory(name if isinstance(name, type) else base)
        if colon and self.takes_whole_text(base):
            with convert_plugin_errors(f"The {self._kind} '{name}'", unwrap_factory(factory), "when it was created"):
                instance: Any = factory(text, **options)
            instance.name = name
            return cast(T, instance)
        if not text:
            if colon:
                raise InputError(f"The {self._kind} '{name}' ends in a colon; give options as in '{base}:name=value'.")
            check_option_names(self._kind, base, factory, options)
            with convert_plugin_errors(f"The {self._kind} '{base}'", unwrap_factory(factory), "when it was created"):
                return factory(**options)
        # Options fixed by the name, such as a preset, cannot be given.
        given = {*options, *(factory.keywords if isinstance(factory, partial) else ())}
        options |= parse_options(self._kind, base, factory, text, given)
        check_option_names(self._kind, base, factory, options)
        with convert_plugin_errors(f"The {self._kind} '{name}'", unwrap_factory(factory), "when it was created"):
            try:
                configured: Any = factory(**options)
            except (TypeError, AttributeError) as error:
                raise InputError(f"The {self._kind} '{base}' does not take the options '{text}' ({error}).") from error
        configured.name = name
        return cast(T, configured)

    def takes_whole_text(self, name: str | type[T]) -> bool:
        """Return whether a factory gets the whole text after the colon of a name as one argument.

        Such a text may name a file or a program.

        Parameters
        ----------
        name : str or type
            Without options.

        Returns
        -------
        bool
        """
        parameters = signature(self.get_factory(name)).parameters.values()
        return any(parameter.kind is parameter.POSITIONAL_ONLY for parameter in parameters)

    def resolve(self, value: str | T, parameter: str) -> T:
        """Create the object that a text describes; return an object as it is.

        Parameters
        ----------
        value : str or object
        parameter : str
            Name of the parameter in error messages.

        Returns
        -------
        object

        Raises
        ------
        InputError
            Unknown name, or an object of another kind.
        """
        if isinstance(value, str) and value:
            return self.create(value)
        if isinstance(value, str) or self._base is None or not isinstance(value, self._base):
            raise not_an_object_error(parameter, value)
        return value

    def get_factory(self, name: str | type[T]) -> Callable[..., T]:
        """Return the factory registered as `name`, without options.

        Parameters
        ----------
        name : str or type
            A class is its own factory.

        Returns
        -------
        callable

        Raises
        ------
        InputError
            Unknown name, or a factory that is not a subclass of the base class.
        """
        loaded, options = self._load(name)
        return partial(loaded, **options) if options else loaded

    def get_class(self, name: str | type[T] | T) -> type[T]:
        """Return the class registered as `name`, or the class of an object.

        Parameters
        ----------
        name : str, type or object
            A name may contain options after a colon. A class is returned as it is.

        Returns
        -------
        type

        Raises
        ------
        InputError
            Unknown name, or a factory that is not a class.
        """
        if not isinstance(name, str):
            return name if isinstance(name, type) else type(name)
        self._refuse_class_path(name)
        loaded, _ = self._load(name.partition(":")[0])
        if not isinstance(loaded, type):
            raise InputError(
                f"The {self._kind} '{name}' is registered as a function; register the class that the function creates."
            )
        return loaded

    def _refuse_class_path(self, name: str) -> None:
        """Raise `InputError` for ``"module:Class"`` in place of a name; the message says how to register a class."""
        base, _, text = name.partition(":")
        if base not in self and text.isidentifier():
            raise InputError(
                f"There is no {self._kind} '{base}'; to use your own class {text}, register the class as an entry point"
                f" of an installed package, in the group {self._group}."
            )

    def _load(self, name: str | type[T]) -> tuple[Callable[..., T], dict[str, Any]]:
        if isinstance(name, type):
            return self._check_subclass(name.__qualname__, name), {}
        if name in self._factories:
            registered, options = self._factories[name]
            loaded = EntryPoint(name, registered, self._group).load() if isinstance(registered, str) else registered
            return self._check_subclass(name, loaded), options
        for entry in entry_points(group=self._group, name=name):
            n_requests = count_termination_requests()
            try:
                loaded = entry.load()
            except BaseException as error:
                reraise_termination_request(error, n_requests)
                raise InputError(
                    f"The {self._kind} '{name}' cannot be loaded since {entry.value} fails: {format_exception(error)}."
                ) from error
            return self._check_subclass(name, loaded), {}
        raise InputError(f"There is no {self._kind} '{name}'; {suggest_name(name, self.names())}")

    def _check_subclass(self, name: str, loaded: Callable[..., T]) -> Callable[..., T]:
        base = self._base
        if base is not None and not (isinstance(loaded, type) and issubclass(loaded, base)):
            actual = f"{getattr(loaded, '__module__', '?')}.{getattr(loaded, '__qualname__', loaded)}"
            public = f"{base.__module__.rpartition('.')[0]}.{base.__qualname__}"
            raise InputError(
                f"The {self._kind} '{name}' is {actual}, which is not a subclass of {public}; register a subclass."
            )
        return loaded


def parse_options(
    kind: str, name: str, factory: Callable[..., Any], text: str, reserved: Container[str] = ()
) -> dict[str, Any]:
    """Parse the options after the colon of a name, such as ``"reaction=0.3,seed=1"``.

    `kind` and `name` are used in messages. `reserved` are options that the text may not set. `InputError` for unknown
    options and wrong values.
    """
    all_declared = declared_options(factory)
    declared = {key: parameter for key, parameter in all_declared.items() if key not in reserved}
    options: dict[str, Any] = {}
    for option in text.split(","):
        key, equals, value = (part.strip() for part in option.partition("="))
        if not (key.isidentifier() and equals):
            # A text without a name may be the value of the first option.
            is_value = bool(declared and key and not equals) and key not in declared
            example = f"{next(iter(declared))}={key}" if is_value else "name=value"
            raise InputError(
                f"The {kind} '{name}:{text}' has the option '{option}' without a name or value; give options as in"
                f" '{name}:{example}'."
            )
        if key in options:
            raise InputError(f"The {kind} '{name}:{text}' has the option '{key}' twice; give it once.")
        if key not in declared:
            if declared:
                advice = suggest_name(key, declared)
            elif all_declared:
                advice = f"its options ({', '.join(sorted(all_declared))}) are given on their own, not after the colon."
            else:
                advice = "its constructor declares none."
            raise InputError(f"The {kind} '{name}' has no option '{key}'; {advice}")
        try:
            options[key] = _parse_option_value(value, _plain_type(declared[key]))
        except ValueError as error:
            raise InputError(f"The {kind} '{name}' takes {error} for '{key}', not '{value}'.") from None
    return options


def check_option_names(kind: str, name: str, factory: Callable[..., Any], options: Mapping[str, Any]) -> None:
    """Raise `InputError` if `options` lack a required option, or contain one that the constructor does not take."""
    try:
        declared = signature(factory)
    except ValueError:
        # Compiled code may have no signature.
        return
    named = (Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)
    for key, parameter in declared.parameters.items():
        if parameter.kind in named and parameter.default is parameter.empty and key not in options:
            raise InputError(f"The {kind} '{name}' needs the option '{key}'; give it as in '{name}:{key}=value'.")
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in declared.parameters.values()):
        return
    cls = unwrap_factory(factory)
    always_given = cls.options_outside_name if isinstance(cls, type) and issubclass(cls, Configurable) else ()
    for key in options:
        if key in declared.parameters:
            continue
        if key in always_given:
            raise InputError(
                f"The {kind} '{name}' does not accept the argument '{key}', which cornercase always gives; add it to"
                " the constructor."
            )
        valid_options = declared_options(factory)
        advice = suggest_name(key, valid_options) if valid_options else "its constructor declares none."
        raise InputError(f"The {kind} '{name}' has no option '{key}'; {advice}")


def _plain_type(parameter: Parameter) -> type[Any] | None:
    """Return the type of a parameter (bool, int, float or str) from its annotation or default; None for other types."""
    if parameter.annotation is not parameter.empty:
        allowed = annotated_types(parameter.annotation)
        return _PLAIN_TYPES.get(allowed.pop()) if len(allowed) == 1 else None
    # A default of 100 also allows 2.5.
    return float if type(parameter.default) is int else _PLAIN_TYPES.get(type(parameter.default).__name__)


def _parse_option_value(text: str, plain_type: type[Any] | None) -> bool | float | str:
    """Parse the value of an option; on failure, raise ValueError with what was expected, such as ``"a number"``."""
    if plain_type is str:
        return text
    if text.lower() in ("true", "false") and plain_type in (bool, None):
        return text.lower() == "true"
    if plain_type is bool:
        raise ValueError("true or false")
    try:
        number = float(text)
    except ValueError:
        if plain_type is None:
            return text
        raise ValueError("a whole number" if plain_type is int else "a number") from None
    if math.isnan(number):
        raise ValueError("a number")
    if plain_type is int and not number.is_integer():
        raise ValueError("a whole number")
    return int(number) if number.is_integer() and (plain_type is int or "." not in text) else number
