"""Objects that are described by their class and the options of their constructor."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import wraps
from inspect import Parameter, signature
from typing import Any, ClassVar, Final, Self

from cornercase._common.errors import InputError
from cornercase._common.plugin_errors import unwrap_factory
from cornercase._common.unknown_names import refuse_unknown_arguments

# Name of the attribute in which an object keeps the options that it was given.
_GIVEN_OPTIONS: Final = "_given_options"


class Configurable:
    """Base class of objects that are described by the options of their constructor.

    The `repr` of an object is Python code that makes the object; the `str` is the text for the command line. Two
    objects are equal if their classes and options are equal. Constructors of subclasses are wrapped so that they store
    the options. `name` is the name under which the class is registered, followed by the options of the object, if any:
    ``"ttc:accelerating=true"``. `options_outside_name` lists options that are not part of `name`.
    """

    name: str = ""
    options_outside_name: ClassVar[frozenset[str]] = frozenset()

    def __init_subclass__(cls, **arguments: Any) -> None:
        super().__init_subclass__(**arguments)
        if "__init__" in vars(cls):
            cls.__init__ = _remember_options(cls.__init__)  # type: ignore[method-assign]

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(_format_options(self, given_options(self), repr))})"

    def __str__(self) -> str:
        return self.name or describe_as_text(self)

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and given_options(self) == given_options(other)

    def __hash__(self) -> int:
        return hash((type(self), frozenset(given_options(self))))

    def with_options(self, **changes: Any) -> Self:
        """Return a new object of the same class, with some options changed; the name follows the options.

        A name that was given to this object after its construction stays.

        Parameters
        ----------
        **changes
            Options that are changed.

        Returns
        -------
        Configurable
        """
        options = given_options(self) | changes
        positional = []
        if any(name in options for name in _positional_options(type(self))):
            # An argument before a positional argument that is given cannot be left out.
            parameters = signature(type(self)).parameters
            names = _positional_options(type(self))
            last = max(k for k, name in enumerate(names) if name in options)
            positional = [options.pop(name, parameters[name].default) for name in names[: last + 1]]
        made = type(self)(*positional, **options)
        has_own_name = self.name.partition(":")[0] != type(self).name
        if made.name != self.name and (has_own_name or changes.keys() <= self.options_outside_name):
            made.name = self.name
        return made


def given_options(configured: object) -> dict[str, Any]:
    """Return the options that an object was constructed with, except options with their default value.

    Fields of a dataclass that have a `default_factory` are always included.
    """
    # A subclass of a dataclass may have a constructor of its own.
    if is_dataclass(configured) and _GIVEN_OPTIONS not in getattr(configured, "__dict__", {}):
        # The constructor of a dataclass is made after the class, so it is not wrapped.
        values = {field.name: getattr(configured, field.name) for field in fields(configured) if field.init}
        return _leave_out_defaults(type(configured), values)
    return dict(vars(configured).get(_GIVEN_OPTIONS, {}))


def given_scalar_options(configured: object) -> dict[str, bool | int | float | str]:
    """Return those options given to an object that have a value of type bool, int, float or str."""
    return {
        name: value for name, value in given_options(configured).items() if isinstance(value, bool | int | float | str)
    }


def numeric_options(configured: Configurable) -> dict[str, float]:
    """Return names and values of an object's numeric options; options that were not given have their default value."""
    defaults = {name: parameter.default for name, parameter in declared_options(type(configured)).items()}
    values = {**defaults, **given_options(configured)}
    return {
        name: float(value)
        for name, value in values.items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    }


def describe_as_text(configured: Configurable) -> str:
    """Return the text that stands for an object on the command line, such as ``"level-set:filling=0.1"``.

    Only options of type bool, int, float or str are included. A class without a name is written as
    ``package.module:Class``.
    """
    cls = type(configured)
    options = {
        name: value for name, value in given_scalar_options(configured).items() if name not in cls.options_outside_name
    }
    base = cls.name if cls.name and isinstance(cls.name, str) else f"{cls.__module__}:{cls.__qualname__}"
    return f"{base}:{','.join(_format_options(configured, options, format_option_value))}" if options else base


def require_storable_options(
    configured: Configurable, described: Collection[str] = (), hint: str = "give numbers, texts, True or False"
) -> None:
    """Raise `InputError` if an option of an object has a value that a study file cannot store and compare.

    `described` names options that are not checked, because the study file stores them in another form. `hint` is the
    clause of the message that says what to do.
    """
    stored = {*given_scalar_options(configured), *configured.options_outside_name, *described}
    defaults = _factory_defaults(configured)
    for name, value in given_options(configured).items():
        if name not in stored and not (name in defaults and _is_equal(value, defaults[name])):
            if type(value).__module__ == "numpy" and "ndarray" not in type(value).__name__:
                hint = f"give numbers and texts of Python, as `{name}.item()` is"
            raise InputError(
                f"{type(configured).__qualname__}: its option `{name}` is of type {type(value).__name__}, which a study"
                f" cannot store and compare; {hint}."
            )


def _factory_defaults(configured: object) -> dict[str, Any]:
    """Return the defaults of those fields of a dataclass that have a `default_factory`, such as an empty list."""
    own_fields = fields(configured) if is_dataclass(configured) and not isinstance(configured, type) else ()
    return {field.name: field.default_factory() for field in own_fields if field.default_factory is not MISSING}


def format_option_value(value: object) -> str:
    """Return the value of an option as it is written on the command line."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def declared_options(factory: Callable[..., Any]) -> dict[str, Parameter]:
    """Return the parameters of a class or function that can be given as keyword arguments.

    If the constructor of a class takes ``**options``, the parameters of the base classes are included. Other keywords
    count as unknown, even though ``**options`` would accept them, so that misspelled names are noticed.
    """
    parameters = dict(signature(factory).parameters)
    callable_ = unwrap_factory(factory)
    for base in callable_.__mro__ if isinstance(callable_, type) else ():
        if not any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values()):
            break
        if "__init__" in vars(base):
            _, *own_parameters = signature(vars(base)["__init__"]).parameters.values()
            parameters = {
                name: parameter for name, parameter in parameters.items() if parameter.kind is not parameter.VAR_KEYWORD
            }
            parameters = {parameter.name: parameter for parameter in own_parameters} | parameters
    named = (Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)
    return {name: parameter for name, parameter in parameters.items() if parameter.kind in named}


def list_numeric_option_names(factory: Callable[..., Any]) -> list[str]:
    """Return the names of the options that take numbers, judged by annotation or, if missing, by default value."""

    def takes_numbers(parameter: Parameter) -> bool:
        if parameter.annotation is parameter.empty:
            default = parameter.default
            is_number = isinstance(default, int | float) and not isinstance(default, bool)
            return is_number or default is None or default is parameter.empty
        return bool({"int", "float"} & annotated_types(parameter.annotation))

    return [name for name, parameter in declared_options(factory).items() if takes_numbers(parameter)]


def list_whole_number_option_names(factory: Callable[..., Any]) -> list[str]:
    """Return the names of the options that are annotated as int."""
    return [
        name
        for name, parameter in declared_options(factory).items()
        if annotated_types(parameter.annotation) == {"int"}
    ]


def annotated_types(annotation: object) -> set[str]:
    """Return the names of the types that an annotation allows: ``{"int", "str"}`` for ``int | str | None``."""
    # Annotations are strings if they are not evaluated.
    text = annotation.__name__ if isinstance(annotation, type) else str(annotation)
    return {*re.findall(r"\w+", text)} - {"None", "Optional", "Union", "typing", "types"}


def copy_with_numeric_options(configured: Any, numbers: Mapping[str, float]) -> Any:
    """Return a copy of a configured object in which some options have new numbers.

    Options that the constructor declares as int get an int; `ValueError` if the new number is not a whole number.
    """
    whole = list_whole_number_option_names(type(configured))
    options: dict[str, float] = {}
    for name, number in numbers.items():
        options[name] = number
        if name in whole:
            if not float(number).is_integer():
                raise ValueError(f"'{name}' takes a whole number, not {number:g}; use a step of 1 in its range")
            options[name] = int(number)
    return configured.with_options(**options)


def _remember_options(constructor: Callable[..., None]) -> Callable[..., None]:
    """Wrap a constructor so that it also stores the given options, and the name with these options, in the object.

    The error for an unknown argument suggests the argument that is probably meant.
    """
    parameters = list(signature(constructor).parameters.values())
    takes_all = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters)
    names = [parameter.name for parameter in parameters[1:]]

    @wraps(constructor)
    def construct(self: Configurable, *positional: Any, **options: Any) -> None:
        cls = type(self)
        if not takes_all:
            refuse_unknown_arguments(cls.__name__, names, options)
        # A constructor may call the constructor of the base class, which is wrapped, too.
        if _GIVEN_OPTIONS in vars(self):
            constructor(self, *positional, **options)
            return
        given = dict(zip(signature(cls).parameters, positional, strict=False)) | options
        vars(self)[_GIVEN_OPTIONS] = _leave_out_defaults(cls, given)
        constructor(self, *positional, **options)
        # Set last, so that errors in the constructor show the short name. The constructor may also set a name.
        if given and "name" not in vars(self) and cls.name and isinstance(cls.name, str):
            self.name = describe_as_text(self)

    return construct


def _leave_out_defaults(cls: type[Any], options: dict[str, Any]) -> dict[str, Any]:
    """Return the options whose values differ from the defaults of the class."""
    declared = declared_options(cls) | dict(signature(cls).parameters) if options else {}
    return {
        name: value
        for name, value in options.items()
        if name not in declared or not _is_equal(value, declared[name].default)
    }


def _is_equal(value: object, default: object) -> bool:
    """Return whether a value of an option equals the default; False for arrays of several elements."""
    try:
        return bool(value == default)
    except ValueError:
        return False


def _positional_options(cls: type[Any]) -> list[str]:
    parameters = signature(cls).parameters.values()
    return [parameter.name for parameter in parameters if parameter.kind is parameter.POSITIONAL_ONLY]


def _format_options(configured: object, options: dict[str, Any], format_value: Callable[[object], str]) -> list[str]:
    positional = _positional_options(type(configured))
    return [
        format_value(value) if name in positional else f"{name}={format_value(value)}"
        for name, value in options.items()
    ]
