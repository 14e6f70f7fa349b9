"""Options for Python, the command line, files and documentation, each defined once as a field of a dataclass."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

from cornercase._common.unknown_names import Function, refuse_unknown_arguments
from cornercase._common.validation import (
    check_bool,
    check_float,
    check_int,
    check_mapping,
    check_path,
    check_str,
    check_str_sequence,
)

_LINE_LENGTH: Final = 110
# End of a clause.
_CLAUSE: Final = re.compile(r"[;.:]( |$)")


class _OptionType(NamedTuple):
    """Type of an option on the command line and in documentation."""

    command_type: Any
    documentation: str


# Types of options by the annotation of the field, without None.
_KINDS: Final = {
    "str": _OptionType(str, "str"),
    "Path | str": _OptionType(Path, "path"),
    "str | Client": _OptionType(str, "str or distributed.Client"),
    "str | Optimizer": _OptionType(str, "str or Optimizer"),
    "str | Simulator": _OptionType(str, "str or Simulator"),
    "StopRule | Sequence[StopRule | str]": _OptionType(list[str], "StopRule or sequence of StopRule or str"),
    "Metric | str | Sequence[Metric | str]": _OptionType(list[str], "Metric or str, or sequence of these"),
    "int": _OptionType(int, "int"),
    "float": _OptionType(float, "float"),
    "bool": _OptionType(bool, "bool"),
    "tuple[str, ...]": _OptionType(list[str], "sequence of str"),
    "str | Sequence[str]": _OptionType(list[str], "str or sequence of str"),
    "Mapping[str, float]": _OptionType(list[str], "mapping of str to float"),
    "Mapping[str, DriverLike]": _OptionType(list[str], "mapping of str to str, SystemUnderTest or Driver"),
}


@dataclass(frozen=True)
class Option:
    """Description of an option; `collect_options` adds the name, type and default of the dataclass field."""

    help: str
    """Help text on the command line; may use metavars."""
    docs: str = ""
    """Description for Python; by default the help text."""
    panel: str = ""
    """Heading of the group in help and documentation."""
    flag: str = ""
    """Name on the command line, such as ``--metric``; by default made from the name in Python."""
    metavar: str | None = None
    minimum: float | None = None
    above: float | None = None
    """Exclusive minimum."""
    maximum: int | None = None
    choices: tuple[str, ...] = ()
    in_file: bool = True
    """True if a study file may contain the option; False if the option can run code, start programs or name outputs."""
    stored: str | Callable[[Any], Any] | None = None
    """Source of the value in a stored study: the name of a field of `StudyMeta`; ``"settings"`` for an entry of the
    field `settings`; ``"simulator"`` if the simulator reports the value; a function that derives the value from
    `StudyMeta`; None if the study does not store the value."""
    name: str = ""
    annotation: str = ""
    """Type of the field, without None."""
    default: Any = ...
    """Default; Ellipsis if the option is required."""

    @property
    def key(self) -> str:
        """Name of the option in a study file."""
        return self.flag.removeprefix("--")

    @property
    def command_type(self) -> Any:
        """Type on the command line; a list if the option can be repeated."""
        return _KINDS[self.annotation].command_type

    @property
    def is_field_of_study(self) -> bool:
        """True if `StudyMeta` has a field that stores the option unchanged."""
        return isinstance(self.stored, str) and self.stored not in ("settings", "simulator")

    @property
    def is_list(self) -> bool:
        """True if the option can be repeated on the command line."""
        return bool(self.command_type == list[str])

    @property
    def is_mapping(self) -> bool:
        """True if the option maps names to values; the command line takes NAME=VALUE."""
        return self.annotation.startswith("Mapping")

    @property
    def has_numeric_values(self) -> bool:
        """True if the option is a mapping whose values are numbers."""
        return self.annotation.endswith("float]")

    @property
    def documented_type(self) -> str:
        """Type and default in the form of numpydoc: ``"int, default 10"``."""
        kind = _KINDS[self.annotation].documentation
        kind = f"{{{', '.join(map(_quote, self.choices))}}}" if self.choices else kind
        if self.default is ...:
            return kind
        return f"{kind}, optional" if self.is_empty_by_default else f"{kind}, default {_quote(self.default)}"

    @property
    def is_empty_by_default(self) -> bool:
        """True if the default is None, an empty tuple or an empty dict."""
        return self.default in (None, (), {})

    def with_default_of(self, source: str) -> Option:
        """Return a copy of the option for a function that takes the default from `source`, such as a manifest.

        The copy has the default None; its documentation says ``default: {source}``.
        """
        clause = _CLAUSE.split(self.help)[0]
        return replace(
            self,
            default=None,
            help=f"{clause}; default: {source}.",
            docs=f"{_CLAUSE.split(self.docs)[0]}. Default: {source}.",
        )

    def check(self, value: Any) -> Any:
        """Check a value and return it in the type of the option; raise `InputError` if the value is invalid.

        None stands for the default if the default is None or an empty dict.
        """
        if value is None and self.default in (None, {}):
            return self.default
        match self.annotation:
            case "int":
                return check_int(self.name, value, int(self.minimum or 0), self.maximum)
            case "float":
                return check_float(self.name, value, above=self.above, minimum=self.minimum)
            case "bool":
                return check_bool(self.name, value)
            case "Path | str":
                return check_path(self.name, value)
            case "str":
                return check_str(self.name, value, self.choices)
            case "str | Client":
                from cornercase._common.process.dask import check_cluster

                return check_cluster(value)
            case (
                "str | Optimizer"
                | "str | Simulator"
                | "StopRule | Sequence[StopRule | str]"
                | "Metric | str | Sequence[Metric | str]"
            ):
                # Packages that define these objects check them.
                return value
        if not self.is_mapping:
            return check_str_sequence(self.name, value)
        values = check_mapping(self.name, value)
        return (
            {name: check_float(self.name, item) for name, item in values.items()} if self.has_numeric_values else values
        )


def _quote(value: object) -> str:
    return f'"{value}"' if isinstance(value, str) else str(value)


def option(default: Any, text: str, **description: Any) -> Any:
    """Return a dataclass field that describes an option. `text` is the help text; `default` may be a factory."""
    values = {"default_factory": default} if callable(default) else {"default": default}
    return field(**values, metadata={"option": Option(text, **description)})


def collect_options(*groups: type[Any]) -> dict[str, Option]:
    """Return the options of dataclasses by name; only fields made with `option` are options."""
    return {
        item.name: replace(
            described := item.metadata["option"],
            name=item.name,
            annotation=str(item.type).removesuffix(" | None"),
            default=_read_default(item),
            flag=described.flag or f"--{item.name.replace('_', '-')}",
            docs=described.docs or described.help,
        )
        for group in groups
        for item in fields(group)
        if "option" in item.metadata
    }


def _read_default(item: Field[Any]) -> Any:
    if item.default_factory is not MISSING:
        return item.default_factory()
    return ... if item.default is MISSING else item.default


def check_options(function: str, options: Mapping[str, Option], given: Mapping[str, Any]) -> dict[str, Any]:
    """Check the keyword arguments of a function, and fill in defaults; `TypeError` for unknown names."""
    refuse_unknown_arguments(function, options, given)
    return {name: item.check(given.get(name, item.default)) for name, item in options.items()}


def document_options(options: Mapping[str, Option]) -> Callable[[Function], Function]:
    """Return a decorator that writes options into the numpydoc docstring of a function.

    The line ``REQUIRED`` is replaced by the options without a default, the line ``OPTIONS`` by the others.
    """

    def decorate(function: Function) -> Function:
        for mark, is_required in (("    REQUIRED", True), ("    OPTIONS", False)):
            text = "\n".join(
                _format_documentation(item) for item in options.values() if (item.default is ...) == is_required
            )
            function.__doc__ = (function.__doc__ or "").replace(mark, text)
        return function

    return decorate


def _format_documentation(item: Option) -> str:
    indent = " " * 8
    text = textwrap.fill(
        item.docs, _LINE_LENGTH, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False
    )
    return f"    {item.name} : {item.documented_type}\n{text}"
