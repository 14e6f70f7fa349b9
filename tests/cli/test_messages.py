"""Messages name options where the API names parameters."""

from __future__ import annotations

from typing import Any

import typer.main

from conftest import car, scenario_file, speed_action, teleport
from cornercase.cli import app
from cornercase.cli.option_names import use_option_names
from cornercase.exploration._explore_options import OPTIONS
from helpers.command_line import cornercase


def test_parameters_become_options_and_functions_become_commands():
    message = "`stop_when` missed: write it so; give `weights` to `explore`, not `pareto`."
    assert use_option_names(message) == (
        "--stop-when missed: write it so; give --weight to 'cornercase explore', not --pareto."
    )


def test_the_connection_with_a_cluster_is_what_was_given_for_it():
    assert use_option_names("`client`: a worker has cornercase 0.0.1.") == ("--cluster: a worker has cornercase 0.0.1.")


def test_what_is_neither_stays():
    assert use_option_names("The file `a.csv` has no column `speed`.") == ("The file `a.csv` has no column `speed`.")


def test_each_parameter_of_an_exploration_becomes_its_option():
    command: Any = typer.main.get_command(app)
    options = {text for item in command.commands["explore"].params for text in item.opts}
    for name, option in OPTIONS.items():
        assert option.flag in options | {""}
        assert use_option_names(f"`{name}`") == (option.flag or f"`{name}`")


def test_options_of_other_commands_are_named_too():
    message = "`tolerances`, `kill_mutants` of `reduce`, `values`, `output`"
    assert use_option_names(message) == "--tolerance, --kill-mutants of 'cornercase reduce', --set, -o"


def test_an_exploration_tells_how_many_failed(tmp_path):
    """A start beyond the end of the road, at 500 m, cannot be run."""
    start = '<ParameterDeclaration name="start" parameterType="double" value="10"/>'
    init = "".join(
        f'<Private entityRef="{name}">{teleport(s)}{speed_action("5")}</Private>'
        for name, s in (("Ego", "$start"), ("B", "60"))
    )
    path = scenario_file(tmp_path, init=init, parameters=start, entities=car("Ego") + car("B"))
    asked = ("--ego", "Ego", "--other", "B", "--metric", "distance", "--optimizer", "grid", "--budget", "4")
    done = cornercase(
        "explore", path, "--range", "start=-200:400:200", *asked, "--duration", "1", "-o", tmp_path / "s.db"
    )
    assert done.returncode == 0, done.stderr
    assert "4 scenarios in" in done.stdout
    assert ", 1 of which failed; ended because" in " ".join(done.stdout.split())
