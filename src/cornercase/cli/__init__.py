"""Command line of cornercase, which parses options, calls the API and prints results."""

from __future__ import annotations

import atexit
import gc
import sys
from typing import Final

from cornercase._common.platform import replace_unencodable_output
from cornercase._common.process.signals import install_signal_handlers
from cornercase.cli import (  # noqa: F401
    compare,
    contract_commands,
    demo,
    estimate,
    explore,
    listing,
    paper,
    recordings,
    report,
    scenario,
    simulate,
    study,
    test,
    vary,
    verify,
    warm_up,
)
from cornercase.cli.errors import run_command
from cornercase.cli.option_names import install_notice_printer
from cornercase.cli.options import app, show_tracebacks

# Instead of Python's 700: the many long-lived objects of packages would be scanned three times at import.
_OBJECTS_BETWEEN_COLLECTIONS: Final = 10_000

__all__ = ["app", "main"]


def main() -> None:
    """Run the command line and exit; a failure prints one sentence and sets the exit code."""
    gc.set_threshold(_OBJECTS_BETWEEN_COLLECTIONS)
    # No collection at exit, which would take half a second.
    atexit.register(gc.freeze)
    sys.exit(run_command(_run_app))


def _run_app() -> object:
    replace_unencodable_output()
    install_notice_printer()
    install_signal_handlers()
    show_tracebacks.set(False)
    return app(standalone_mode=False)
