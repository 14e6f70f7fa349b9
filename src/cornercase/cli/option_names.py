"""Translate messages of the API into terms of the command line."""

from __future__ import annotations

import re
import warnings
from typing import Any, Final

from cornercase._common.errors import NoticeWarning
from cornercase._common.text.sanitize import shorten
from cornercase.cli.options import err, show_tracebacks

MAX_LINE_LENGTH: Final = 1400
"""Longest line that is printed about an input, however long the names in it are."""
_PARAMETERS_WITH_OPTION: Final = (
    "against", "archetypes", "archetypes_by", "asynchronous", "audit", "batch", "beside", "budget", "by",
    "check_proposals", "cluster",
    "continuous", "cover", "critical", "critical_if", "duration",
    "ego", "encounter", "eps", "fps", "gamma", "host", "junit", "keep_clusters", "kill_mutants", "maps", "max_failures",
    "max_repeats",
    "max_seconds", "memory", "method", "min_samples", "on_collision", "optimizer", "other", "pareto",
    "patience", "port", "profile", "repair", "repeats", "require", "require_from_file", "requirements", "retries",
    "retry_failed", "scenario", "seed", "share", "simulator", "size",
    "space", "stop_when", "summary", "time_step", "timeout", "vary", "warm_start", "window", "within", "workers",
)  # fmt: skip
# Parameters whose option has a different name.
_OPTION_BY_PARAMETER: Final = {
    "client": "--cluster",
    "drivers": "--driver",
    "folder": "-o",
    "kill_matrix": "--kill-mutants",
    "metrics": "--metric",
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


def use_option_names(message: str) -> str:
    """Replace parameters and functions in backticks by options and commands: `` `stop_when` `` by ``--stop-when``."""

    def translate(match: re.Match[str]) -> str:
        name = match[1]
        if name in _OPTION_BY_PARAMETER:
            return _OPTION_BY_PARAMETER[name]
        if name in _PARAMETERS_WITH_OPTION:
            return f"--{name.replace('_', '-')}"
        return f"'cornercase {name}'" if name in _COMMANDS else match[0]

    return _QUOTED.sub(translate, message)


def print_notices() -> None:
    """Print each `NoticeWarning` as a line on stderr from now on; `RuntimeWarning` only with ``--debug``."""
    show = warnings.showwarning

    def show_warning(message: Any, category: Any, *location: Any, **kwargs: Any) -> None:
        if issubclass(category, NoticeWarning):
            sentence = use_option_names(str(message))
            err.print(shorten(f"{sentence[:1].upper()}{sentence[1:]}.", MAX_LINE_LENGTH))
        # NumPy's warnings about infinite numbers only help developers.
        elif not issubclass(category, RuntimeWarning) or show_tracebacks.get():
            show(message, category, *location, **kwargs)

    warnings.showwarning = show_warning
