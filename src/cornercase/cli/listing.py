"""Commands `metrics` and `simulators`: list what is available."""

from __future__ import annotations

import inspect
from typing import Annotated, Any

import typer
from rich.table import Column, Table

from cornercase._common.text.sanitize import docstring_summary
from cornercase.cli import options as opt
from cornercase.cli.options import app, out


@app.command()
def metrics(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME]…", help="Metrics whose definitions and options are printed; default: list all."),
    ] = None,
    *,
    as_json: opt.Json = False,
) -> None:
    """List the criticality metrics, with those of other packages, or print definitions.

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


def _format_definition(metric: Any) -> str:
    text = (inspect.getdoc(metric) or "").replace("``", "").replace("`", "").replace(" ::", ":")
    side = "low" if metric.lower_is_critical else "high"
    unit = f"in {metric.unit}" if metric.unit else "without unit"
    return f"{metric.name}, {unit}; {side} is critical\n\n{text}"
