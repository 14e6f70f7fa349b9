"""Command `vary`: list the numbers of a scenario that could vary, or make parameters of them."""

from __future__ import annotations

import shlex
from contextlib import suppress
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from cornercase._common.errors import InputError
from cornercase._common.text.sanitize import shorten
from cornercase.cli.command_options import add_api_options
from cornercase.cli.options import Maps, ScenarioFile, app, out

if TYPE_CHECKING:
    from cornercase.scenario import Variable

_MAX_VALUE_LENGTH: Final = 11
_MAX_GROUP_LENGTH: Final = 60
_MAX_LINE_LENGTH: Final = 80


@app.command(name="vary")
@add_api_options("vary")
def vary_scenario(
    scenario: ScenarioFile,
    *,
    vary: tuple[str, ...] = (),
    vary_all: Annotated[bool, typer.Option("--all", help="Vary all numbers with a proposed range.")] = False,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="OUT.xosc", help="Scenario to write; the ranges go into OUT.space.xosc beside it."
        ),
    ] = None,
    maps: Maps = None,
) -> None:
    """List the numbers of a scenario that could vary, or make parameters of them.

    The list shows the name, value, unit, proposed range and line of each number. With --vary or --all, the command
    writes a scenario in which these numbers are parameters, and a file with their ranges. To explore at once, give
    --vary to explore.

    \b
    Example:
      cornercase vary examples/r157/cut_in.xosc
      cornercase vary examples/r157/cut_in.xosc --vary Ego.initial.x=90:110 \\
          -o varied/cut_in.xosc
    """
    from cornercase.scenario import list_variables
    from cornercase.scenario import vary as write_varied

    if not vary and not vary_all:
        if output is not None:
            raise InputError(f"-o {output}: only for a varied scenario; give --vary NAME or --all, too.")
        _print_variables(list_variables(scenario))
        return
    if output is None:
        raise InputError("--vary, --all: give the scenario to write, with -o OUT.xosc.")
    logical = write_varied(scenario, vary, output, proposed=vary_all)
    for parameter in logical.space.parameters:
        out.print(f"varied: {parameter}")
    space = output.with_suffix(".space.xosc")
    out.print(f"Written to {output}, and its ranges to {space}; search them with")
    command = shlex.join(["cornercase", "explore", str(output), "--space", str(space)])
    out.print(f"  {command} …", soft_wrap=True)


def _print_variables(variables: tuple[Variable, ...]) -> None:
    if not variables:
        out.print("no numbers that could vary")
        return
    rows = [("name", "value", "unit", "proposed", "line")]
    for group, members in groupby(variables, key=lambda variable: variable.group):
        rows.append((shorten(group, _MAX_GROUP_LENGTH), "", "", "", ""))
        for variable in members:
            proposal = "–" if variable.reason_fixed or not variable.proposed_range else variable.proposed_range
            rows.append(
                (f"  {variable.name}", _shorten_value(variable.value_text), variable.unit, proposal, str(variable.line))
            )
    name, value, unit, proposal_, line = (max(map(len, column)) for column in zip(*rows, strict=True))
    # Names are printed whole, as they are typed again; a long one only shifts its own line.
    left_width = min(name + 1 + value, _MAX_LINE_LENGTH - unit - proposal_ - line - 3)
    for row in rows:
        left = f"{row[0]} {row[1]:>{max(left_width - len(row[0]) - 1, 0)}}"
        text = f"{left} {row[2]:<{unit}} {row[3]:<{proposal_}} {row[4]:>{line}}"
        out.print(text.rstrip())
    if any(variable.reason_fixed and variable.value_text.startswith("$") for variable in variables):
        out.print("Values with $ refer to parameters: vary the parameter.")
    for variable in variables:
        if variable.reason_fixed and not variable.value_text.startswith("$"):
            out.print(f"{variable.name}: {variable.reason_fixed}.", soft_wrap=False)


def _shorten_value(text: str) -> str:
    with suppress(ValueError):
        return text if len(text) <= _MAX_VALUE_LENGTH else f"{float(text):.6g}"
    return shorten(text, _MAX_VALUE_LENGTH)
