"""Messages name options where the API names parameters."""

from __future__ import annotations

from typing import Any

import typer.main

from cornercase.cli import app
from cornercase.cli.messages import _COMMANDS, _PARAMETERS, _RENAMED, in_words_of_the_command_line


def test_parameters_become_options_and_functions_become_commands():
    message = "`stop_when` missed: write it so; give `weights` to `explore`, not `pareto`."
    assert in_words_of_the_command_line(message) == (
        "--stop-when missed: write it so; give --weight to 'cornercase explore', not --pareto."
    )


def test_what_is_neither_stays():
    assert in_words_of_the_command_line("The file `a.csv` has no column `speed`.") == (
        "The file `a.csv` has no column `speed`."
    )


def test_every_option_and_command_that_is_named_exists():
    group: Any = typer.main.get_command(app)
    commands = group.commands
    options = {text for command in commands.values() for one in command.params for text in one.opts}
    assert set(_COMMANDS) <= set(commands)
    assert set(_RENAMED.values()) <= options
    assert {in_words_of_the_command_line(f"`{name}`") for name in _PARAMETERS} <= options
