"""The command line: parses, calls the API, prints."""

from __future__ import annotations

import sys
from typing import Final

from cornercase._common.errors import InputError
from cornercase._common.platform import forgive_narrow_output
from cornercase._common.texts import shorten

# Their order is that of the commands in the help.
# isort: off
from cornercase.cli import running, studies, testing, estimating, comparing, warming

# isort: on
from cornercase.cli.messages import in_words_of_the_command_line, show_notices
from cornercase.cli.options import app, err

__all__ = ["app", "comparing", "estimating", "main", "running", "studies", "testing", "warming"]


_LONGEST: Final = 1400


def main() -> None:
    """Run the command line; an `InputError` becomes one sentence and exit code 2."""
    forgive_narrow_output()
    show_notices()
    try:
        app(standalone_mode=True)
    except InputError as error:
        # One line of bounded length, whatever is called how in a file.
        sentence = in_words_of_the_command_line(str(error)).replace("\n", "\\n")
        err.print(f"cornercase: {shorten(sentence, _LONGEST)}")
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
