"""Translation of the API's messages into the terms of the command line."""

from __future__ import annotations

import re
import warnings
from functools import cache
from typing import Any, Final

from typer.main import get_command

from cornercase._common.errors import NoticeWarning
from cornercase._common.text.sanitize import shorten
from cornercase.cli.options import app, err, show_tracebacks

MAX_LINE_LENGTH: Final = 1400
"""Number of characters to which a printed line is shortened, since names in an input may be long."""
# Parameters and functions of the API for which the command line has another name.
_OPTION_BY_PARAMETER: Final = {
    "client": "--cluster",
    "folder": "-o",
    "kill_matrix": "--kill-mutants",
    "path": "-o",
    "study": "-o",
    "Study.create": "'cornercase explore'",
}
# Option of a command, but in messages the column of recordings.
_AMBIGUOUS: Final = "speed"
_QUOTED: Final = re.compile(r"`([\w.]+)`")
_DRIVER: Final = re.compile(r"as in \{'([^']*)': '([^']*)'\}")


def use_option_names(message: str) -> str:
    """Replace Python names in backticks by options and commands: `` `stop_when` `` becomes ``--stop-when``.

    A dictionary of drivers, such as ``{'Ego': 'normal'}``, becomes ``Ego=normal``.
    """
    message = _DRIVER.sub(r"as in \1=\2", message)
    names = _map_names_to_options()
    return _QUOTED.sub(lambda match: names.get(match[1], match[0]), message)


@cache
def _map_names_to_options() -> dict[str, str]:
    """Return the option of each Python parameter, and the command of each Python function, by the Python name."""
    commands: dict[str, Any] = vars(get_command(app))["commands"]
    options = {
        item.name: min(item.opts, key=len)
        for command in commands.values()
        for item in command.params
        if item.param_type_name == "option" and item.name != _AMBIGUOUS
    }
    return options | _OPTION_BY_PARAMETER | {name: f"'cornercase {name}'" for name in commands if name not in options}


def install_notice_printer() -> None:
    """From now on, print each `NoticeWarning` as a line on stderr; print a `RuntimeWarning` only with ``--debug``."""
    show = warnings.showwarning

    def show_warning(message: Any, category: Any, *location: Any, **kwargs: Any) -> None:
        if issubclass(category, NoticeWarning):
            sentence = use_option_names(str(message))
            err.print(shorten(f"{sentence[:1].upper()}{sentence[1:]}.", MAX_LINE_LENGTH))
        # NumPy's warnings about infinite numbers only help developers.
        elif not issubclass(category, RuntimeWarning) or show_tracebacks.get():
            show(message, category, *location, **kwargs)

    warnings.showwarning = show_warning
