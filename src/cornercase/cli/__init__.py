"""The command line: parses, calls the API, prints."""

from __future__ import annotations

import atexit
import gc
import sys
from typing import Final

from cornercase._common.interrupts import hear_requests
from cornercase._common.platform import forgive_narrow_output

# Their order is that of the commands in the help.
# isort: off
from cornercase.cli import running, varying, simulating, studies, testing, estimating, comparing, verifying, warming

# isort: on
from cornercase.cli.failures import exit_code_of
from cornercase.cli.messages import show_notices
from cornercase.cli.options import app, debugging

# Python begins with 700: what packages bring with them stays, and would be looked through three times as it is loaded.
_OBJECTS_BETWEEN_COLLECTIONS: Final = 10_000

__all__ = [
    "app", "comparing", "estimating", "main", "running", "simulating", "studies", "testing", "varying", "verifying",
    "warming",
]  # fmt: skip


def main() -> None:
    """Run the command line; whatever goes wrong becomes one sentence and an exit code."""
    gc.set_threshold(_OBJECTS_BETWEEN_COLLECTIONS)
    # Nor is it looked through at the end of the process, which would take half a second.
    atexit.register(gc.freeze)
    sys.exit(exit_code_of(_command))


def _command() -> object:
    forgive_narrow_output()
    show_notices()
    hear_requests()
    debugging.set(False)
    return app(standalone_mode=False)
