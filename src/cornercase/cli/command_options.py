"""Decorator that gives commands the options that the API defines, and commands whose help has sections."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from inspect import Parameter, signature
from typing import Annotated, Any, TypeVar

import typer
from typer.core import TyperCommand

from cornercase._common.option import Option
from cornercase.cli.driver_options import DRIVER_OPTIONS, combine_drivers
from cornercase.cli.parsing import parse_numbers, parse_pairs
from cornercase.exploration._explore_options import OPTIONS

Function = TypeVar("Function", bound=Callable[..., Any])


def add_api_options(*names: str, **defaults: str) -> Callable[[Function], Function]:
    """Return a decorator that adds options of the API to a command.

    The command gets the values of the options as keyword arguments, parsed as the API takes them. `names` are options
    that have the default of the API. `defaults` maps further options, whose default the API chooses later, to the text
    that the help shows as the default.
    """
    options: dict[str, Option] = {}
    for name in (*names, *defaults):
        source = defaults.get(name)
        options[name] = OPTIONS[name] if source is None else OPTIONS[name].with_default_of(source)
        if name == "drivers":
            options |= DRIVER_OPTIONS

    def decorate(function: Function) -> Function:
        own = signature(function, eval_str=True)
        taken = {name: _make_parameter(option) for name, option in options.items()}
        parameters = [
            taken.pop(name, item) for name, item in own.parameters.items() if item.kind is not Parameter.VAR_KEYWORD
        ]
        parameters += taken.values()

        @wraps(function)
        def command(**arguments: Any) -> Any:
            if "drivers" in options:
                texts = [arguments.pop(name) or () for name in ("drivers", *DRIVER_OPTIONS)]
                arguments["drivers"] = combine_drivers(*texts)
            parsed = {
                name: _convert_option_value(option, arguments[name])
                for name, option in options.items()
                if name in arguments
            }
            return function(**arguments | parsed)

        command.__signature__ = own.replace(parameters=parameters)  # type: ignore[attr-defined]
        command.__annotations__ = {item.name: item.annotation for item in parameters}
        return command  # type: ignore[return-value]

    return decorate


def _make_parameter(option: Option) -> Parameter:
    """Return an option as a parameter of a command's signature, from which Typer reads options."""
    declared = typer.Option(
        option.flag,
        metavar=option.metavar,
        help=option.help,
        min=option.minimum if option.annotation == "int" else None,
        rich_help_panel=option.panel,
    )
    kind = option.command_type
    return Parameter(
        option.name,
        Parameter.KEYWORD_ONLY,
        default=Parameter.empty
        if option.default is ...
        else option.default or None
        if option.is_list
        else option.default,
        annotation=Annotated[
            kind if option.default is ... or not option.is_empty_by_default else kind | None, declared
        ],
    )


def _convert_option_value(option: Option, value: Any) -> Any:
    """Convert the value of an option from the command line or a study file to what the API takes."""
    if not value and option.is_list:
        return option.default
    if not option.is_mapping or isinstance(value, dict):
        return value
    return (parse_numbers if option.has_numeric_values else parse_pairs)(value, option.flag)


class SectionedCommand(TyperCommand):
    """Command whose help has a section for each group of options."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write a section of the help for each group of options; click calls this method."""
        sections: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            heading = "Arguments" if parameter.param_type_name == "argument" else "Options"
            record = parameter.get_help_record(ctx)
            if record is not None:
                sections.setdefault(vars(parameter).get("rich_help_panel") or heading, []).append(record)
        for heading, records in sections.items():
            with formatter.section(heading):
                formatter.write_dl(records)
