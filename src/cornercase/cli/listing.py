"""Commands `metrics`, `simulators` and `drivers`: list what is available."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import partial
from inspect import Parameter
from itertools import starmap
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Column, Table

from cornercase._common.configurable import declared_options, format_option_value
from cornercase._common.errors import InputError, suggest_name
from cornercase._common.plugin_errors import unwrap_factory
from cornercase._common.text.sanitize import docstring_summary
from cornercase.cli import options as opt
from cornercase.cli.options import app, out

if TYPE_CHECKING:
    from cornercase._common.registry import Registry


@app.command()
def metrics(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME]…", help="Metrics whose definitions and options are printed; default: list all."),
    ] = None,
    *,
    as_json: opt.Json = False,
) -> None:
    """List the criticality metrics, also metrics of other packages, or print definitions.

    Options of a metric follow a colon: --metric ttc:accelerating=true. The documentation of its class lists them.

    \b
    Example:
      cornercase metrics
      cornercase metrics wttc
    """
    from cornercase.metrics import METRICS

    if names and not as_json:
        out.print("\n\n".join(_format_definition(METRICS.create(name)) for name in dict.fromkeys(names)))
        return
    listed = [METRICS.create(name) for name in dict.fromkeys(names or METRICS.names())]
    if as_json:
        keys = ("name", "unit", "lower_is_critical", "cap", "source")
        rows = [
            {key: getattr(metric, key) for key in keys} | {"definition": docstring_summary(metric)} for metric in listed
        ]
        opt.print_json(rows)
        return
    # Names are printed whole even on a narrow terminal, as they are typed again.
    table = Table(Column("metric", no_wrap=True), "unit", "critical is", "what it is", "source", box=None)
    for metric in listed:
        side = "low" if metric.lower_is_critical else "high"
        table.add_row(metric.name, metric.unit, side, docstring_summary(metric), metric.source)
    out.print(table)


@app.command()
def simulators(*, as_json: opt.Json = False) -> None:
    """List the simulators, whether they can run here, and what they can do.

    \b
    Example:
      cornercase simulators
    """
    from dataclasses import asdict

    from cornercase.simulators import list_simulators

    available = list_simulators()
    if as_json:
        keys = {"problem": "missing", "features": "abilities"}
        rows = {
            name: {keys.get(field, field): value for field, value in asdict(simulator).items()}
            for name, simulator in available.items()
        }
        opt.print_json(rows)
        return
    # Addresses are printed whole even on a narrow terminal.
    missing = Column("what is missing", overflow="fold")
    table = Table("simulator", "here", "version", "what it can do", missing, box=None)
    for name, simulator in available.items():
        is_available, abilities = "no" if simulator.problem else "yes", ", ".join(simulator.features)
        table.add_row(name, is_available, simulator.version or "-", abilities, simulator.problem or "-")
    out.print(table)


@app.command()
def drivers(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME]…", help="Names of what is explained, with options; default: list all."),
    ] = None,
    *,
    as_json: opt.Json = False,
) -> None:
    """List the drivers, sensors and vehicle models, with their options, or explain some of them.

    A driver of your own needs no registration: --sut Ego=package.module:Class. Options follow a colon.

    \b
    Example:
      cornercase drivers
      cornercase drivers simple
    """
    from cornercase.drivers import DRIVERS, SENSORS, VEHICLES

    registries: dict[str, Registry[Any]] = {"driver": DRIVERS, "sensor": SENSORS, "vehicle": VEHICLES}
    listed = [(kind, name, registry) for kind, registry in registries.items() for name in registry.names()]
    registered = [name for _, name, _ in listed]
    for name in names or ():
        if name not in registered:
            raise InputError(f"There is no driver, sensor or vehicle '{name}'; {suggest_name(name, registered)}")
    rows = [
        _describe_factory(kind, name, registry.get_factory(name))
        for kind, name, registry in listed
        if not names or name in names
    ]
    if as_json:
        opt.print_json([{key: value for key, value in row.items() if key != "documentation"} for row in rows])
    elif names:
        out.print("\n\n".join(f"{row['kind']} {row['name']}\n\n{row['documentation']}" for row in rows))
    else:
        table = Table("kind", Column("name", no_wrap=True), "what it is", "options", box=None)
        for row in rows:
            options = ", ".join(starmap(_format_option, row["options"].items()))
            table.add_row(row["kind"], row["name"], row["what"], options or "-")
        out.print(table)


def _format_option(name: str, default: object) -> str:
    if default is None:
        return name
    return f"{name}={f'{default:g}' if isinstance(default, float) else format_option_value(default)}"


def _describe_factory(kind: str, name: str, factory: Callable[..., Any]) -> dict[str, Any]:
    """Return the kind, name, summary, options with defaults, and documentation of a driver, sensor or vehicle."""
    fixed = factory.keywords if isinstance(factory, partial) else ()
    options = {
        key: None if parameter.default is Parameter.empty else parameter.default
        for key, parameter in declared_options(factory).items()
        if key not in fixed
    }
    text = (inspect.getdoc(unwrap_factory(factory)) or "").replace("``", "").replace("`", "")
    return {"kind": kind, "name": name, "what": text.partition("\n")[0], "options": options, "documentation": text}


def _format_definition(metric: Any) -> str:
    text = (inspect.getdoc(metric) or "").replace("``", "").replace("`", "").replace(" ::", ":")
    side = "low" if metric.lower_is_critical else "high"
    unit = f"in {metric.unit}" if metric.unit else "without unit"
    return f"{metric.name}, {unit}; {side} is critical\n\n{text}"
