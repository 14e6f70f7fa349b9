"""What ends a command, in a sentence: nobody who types one sees a traceback unless asked for."""

from __future__ import annotations

import errno
import io
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any, Final, cast

import typer

from cornercase._common.errors import InputError, StudyLostError
from cornercase._common.interrupts import take_lost_interrupt
from cornercase._common.parts import describe_error
from cornercase._common.texts import in_one_line, require_whole, shorten
from cornercase.cli.interrupting import exit_code, tell_of_interrupt
from cornercase.cli.messages import LONGEST, in_words_of_the_command_line
from cornercase.cli.options import debugging, err

# typer may hold click's classes under other names.
_Usage: Final = cast("type[Any]", typer.BadParameter.__mro__[1])
_PACKAGE: Final = Path(__file__).parents[1]


def exit_code_of(command: Callable[[], Any]) -> int:
    """Run a command to its end, and say on standard error what else than success ended it.

    Parameters
    ----------
    command : callable
        The application of typer, which neither prints what went wrong nor leaves.

    Returns
    -------
    int
        2 where the input, the machine or cornercase itself did not let it be done; 130 for Ctrl-C, 143 for SIGTERM. 1
        where the study was lost that it wrote to, and, in silence, where nobody reads the output any more.
    """
    try:
        code = command()
        # What is still held back is written here, where an error of it can be told.
        if sys.stdout is not None:
            sys.stdout.flush()
    except _Usage as error:
        # click says it in several lines; this is where what it quotes loses its orders to the terminal.
        said = io.StringIO()
        error.show(said)
        err.print("\n".join(shorten(line, LONGEST) for line in said.getvalue().rstrip().splitlines()))
        return int(error.exit_code)
    except (KeyboardInterrupt, typer.Abort):
        # Before or after the command itself, which says so.
        tell_of_interrupt()
        return exit_code()
    except BaseException as error:
        lost = take_lost_interrupt()
        if debugging.get():
            err.print("".join(traceback.format_exception(error)).rstrip())
        if lost:
            tell_of_interrupt()
            return exit_code()
        if _is_closed_pipe(error) or (isinstance(error, SystemExit) and _is_closed_pipe(error.__context__)):
            # typer makes the latter of the former.
            _write_to_nobody()
            return 1
        if isinstance(error, SystemExit) and _is_of_typer(error):
            return error.code if isinstance(error.code, int) else 0
        _tell(_sentence(error))
        return 1 if isinstance(error, StudyLostError) else 2
    # Between its parts typer takes each interrupt for Ctrl-C.
    return exit_code() if code == 128 + signal.SIGINT else code if isinstance(code, int) else 0


def _is_of_typer(error: BaseException) -> bool:
    """Whether typer has raised an exception, as when it has completed a command for a shell."""
    *_, (frame, _) = traceback.walk_tb(error.__traceback__)
    return str(frame.f_globals.get("__name__")).partition(".")[0] in ("typer", "click")


def _is_closed_pipe(error: BaseException | None) -> bool:
    return isinstance(error, OSError) and error.errno == errno.EPIPE


def _tell(sentence: str) -> None:
    line = in_words_of_the_command_line(sentence).replace("\n", "\\n")
    err.print(f"cornercase: {shorten(line, LONGEST)}")


def _write_to_nobody() -> None:
    """Let Python write what it still holds for a closed pipe where it makes no error of it."""
    sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - as long as the process


def _sentence(error: BaseException) -> str:
    if isinstance(error, InputError | StudyLostError):
        return str(error)
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    file = _file_in_use(frames)
    whose = f"{file}: " if file else ""
    if isinstance(error, MemoryError):
        return f"{whose}needs more memory than there is; give fewer or smaller files, or a machine with more memory."
    if isinstance(error, UnicodeEncodeError):
        try:
            require_whole(error.object)
        except ValueError as half:
            return f"{whose}{half}, which no file can hold; rename it."
    if isinstance(error, OSError) and error.strerror:
        named = error.filename if isinstance(error.filename, str) else "the output, or a temporary file"
        return f"{named}: cannot be read or written ({error.strerror}); make room, or choose another place."
    what = "is nested too deep" if isinstance(error, RecursionError) else "met a fault of cornercase itself"
    place = _place(error)
    if not isinstance(error, Exception):
        # cornercase raises none of these: somebody else's code did, as by sys.exit().
        return f"the command was ended by {describe_error(error)}, in code that it was given; fix that."
    return (
        f"{whose or 'the command '}{what} ({shorten(in_one_line(error), 200)}{place}); please report it, with what"
        f" 'cornercase --debug' says{' and that file' if file else ''}."
    )


def _file_in_use(frames: list[FrameType]) -> Path | None:
    """The file that the innermost function at work had a name for."""
    for frame in reversed(frames):
        for value in frame.f_locals.values():
            if isinstance(value, Path) and _is_file(value):
                return value
    return next(_given_files(), None)


def _given_files() -> Iterator[Path]:
    yield from (path for one in sys.argv[2:] if _is_file(path := Path(one)))


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _place(error: BaseException) -> str:
    """Where in the package it was: the same words for the same fault."""
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        path = Path(frame.filename)
        if path.is_relative_to(_PACKAGE):
            return f", {path.relative_to(_PACKAGE).as_posix()} line {frame.lineno}"
    return ""
