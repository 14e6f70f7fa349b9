"""The command line: parses, calls the API, prints."""

from __future__ import annotations

import atexit
import gc
import sys
from typing import Final

from cornercase._common.interrupts import install_signal_handlers
from cornercase._common.platform import replace_unencodable_output

# Their order is that of the commands in the help.
# isort: off
from cornercase.cli import explore, scenario, recordings, listing, varying, simulating, study, report, demo, testing
from cornercase.cli import estimating, comparing, verifying, warming

# isort: on
from cornercase.cli.failures import run_command
from cornercase.cli.messages import print_notices
from cornercase.cli.options import app, show_tracebacks

# Instead of Python's 700: the many long-lived objects of packages would be scanned three times at import.
_OBJECTS_BETWEEN_COLLECTIONS: Final = 10_000

__all__ = [
    "app", "comparing", "demo", "estimating", "explore", "listing", "main", "recordings", "report", "scenario",
    "simulating", "study", "testing", "varying", "verifying", "warming",
]  # fmt: skip


def main() -> None:
    """Run the command line; any failure becomes one sentence and an exit code."""
    gc.set_threshold(_OBJECTS_BETWEEN_COLLECTIONS)
    # No collection at exit, which would take half a second.
    atexit.register(gc.freeze)
    sys.exit(run_command(_run_app))


def _run_app() -> object:
    replace_unencodable_output()
    print_notices()
    install_signal_handlers()
    show_tracebacks.set(False)
    return app(standalone_mode=False)
