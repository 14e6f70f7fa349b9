"""Messages and notices of the API, in the words of the command line."""

from __future__ import annotations

import re
import warnings
from typing import Any, Final

from cornercase._common.errors import NoticeWarning
from cornercase._common.texts import shorten
from cornercase.cli.options import debugging, err

LONGEST: Final = 1400
"""Characters of a line that is said of an input, whatever is called how in a file."""
_PARAMETERS: Final = (
    "against", "archetypes", "archetypes_by", "asynchronous", "audit", "batch", "beside", "budget", "by", "cluster",
    "continuous", "cover", "critical", "critical_if", "duration",
    "ego", "encounter", "eps", "fps", "gamma", "host", "junit", "keep_clusters", "maps", "max_failures",
    "max_repeats",
    "max_seconds", "memory", "method", "min_samples", "on_collision", "optimizer", "other", "pareto",
    "patience", "port", "profile", "repair", "repeats", "require", "require_from_file", "requirements", "retries",
    "retry_failed", "scenario", "seed", "share", "simulator", "size",
    "space", "stop_when", "summary", "time_step", "timeout", "vary", "warm_start", "window", "within", "workers",
)  # fmt: skip
# Those whose option has another name.
_RENAMED: Final = {
    "client": "--cluster",
    "drivers": "--driver",
    "folder": "-o",
    "from_study": "--warm-start",
    "keep": "--keep-clusters",
    "metrics": "--metric",
    "most_repeats": "--max-repeats",
    "output": "-o",
    "path": "-o",
    "ranges": "--range",
    "study": "-o",
    "table": "--parameters",
    "tolerances": "--tolerance",
    "values": "--set",
    "weights": "--weight",
}
_COMMANDS: Final = (
    "analyze", "check", "compare", "convert", "demo", "estimate", "explore", "export", "import", "measure", "reduce",
    "replay", "report", "show", "simulate", "test", "vary", "verify", "watch",
)  # fmt: skip
_QUOTED: Final = re.compile(r"`(\w+)`")


def in_words_of_the_command_line(message: str) -> str:
    """Name options and commands in a message that names parameters and functions between backticks.

    Parameters
    ----------
    message : str
        Of an `InputError`: ``"`stop_when` missing<1: …"``.

    Returns
    -------
    str
        ``"--stop-when missing<1: …"``.
    """

    def translated(match: re.Match[str]) -> str:
        name = match[1]
        if name in _RENAMED:
            return _RENAMED[name]
        if name in _PARAMETERS:
            return f"--{name.replace('_', '-')}"
        return f"'cornercase {name}'" if name in _COMMANDS else match[0]

    return _QUOTED.sub(translated, message)


def show_notices() -> None:
    """Print each `NoticeWarning` from now on as a line of its own on standard error.

    Others are printed as before, those of numbers (`RuntimeWarning`) only with ``--debug``.
    """
    show = warnings.showwarning

    def shown(message: Any, category: Any, *place: Any, **more: Any) -> None:
        if issubclass(category, NoticeWarning):
            said = in_words_of_the_command_line(str(message))
            err.print(shorten(f"{said[:1].upper()}{said[1:]}.", LONGEST))
        # What NumPy says of numbers without measure is for who mends cornercase.
        elif not issubclass(category, RuntimeWarning) or debugging.get():
            show(message, category, *place, **more)

    warnings.showwarning = shown
