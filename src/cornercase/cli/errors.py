"""Conversion of any failure of a command into one sentence and an exit code; only ``--debug`` shows tracebacks."""

from __future__ import annotations

import errno
import io
import os
import signal
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from itertools import chain
from pathlib import Path
from types import FrameType
from typing import Any, Final, cast

import typer

from cornercase._common.errors import ExpressionError, InputError, StudyLostError
from cornercase._common.plugin_errors import describe_error
from cornercase._common.process.signals import pop_lost_interrupt
from cornercase._common.text.sanitize import check_no_surrogates, format_exception, shorten
from cornercase.cli.option_names import MAX_LINE_LENGTH, use_option_names
from cornercase.cli.options import err, show_tracebacks
from cornercase.cli.signals import interrupt_exit_code, print_interrupt

# typer may hold click's classes under other names.
_UsageError: Final = cast("type[Any]", typer.BadParameter.__mro__[1])
_PACKAGE_FOLDER: Final = Path(__file__).parents[1]


def run_command(command: Callable[[], Any]) -> int:
    """Run the command line application and return its exit code; a failure prints one sentence to stderr.

    Exit codes of failures: 2 if wrong input, a fault of the machine or a bug stopped the command; 130 after Ctrl-C and
    143 after SIGTERM; 1 if the study that the command was writing was lost, or if the reader of stdout closed the pipe.
    In the last case no sentence is printed.
    """
    try:
        code = command()
        # Flush here, where an error can still be reported.
        if sys.stdout is not None:
            sys.stdout.flush()
    except _UsageError as error:
        _reword_usage_error(error)
        # click prints several lines; err.print removes control characters from what they quote.
        message = io.StringIO()
        error.show(message)
        err.print("\n".join(shorten(line, MAX_LINE_LENGTH) for line in message.getvalue().rstrip().splitlines()))
        return int(error.exit_code)
    except (KeyboardInterrupt, typer.Abort):
        # Interrupted before or after the command itself, which prints its own message.
        print_interrupt()
        return interrupt_exit_code()
    except BaseException as error:
        lost_interrupt = pop_lost_interrupt()
        if show_tracebacks.get():
            err.print("".join(traceback.format_exception(error)).rstrip())
        if lost_interrupt:
            print_interrupt()
            return interrupt_exit_code()
        if _is_closed_pipe(error) or (isinstance(error, SystemExit) and _is_closed_pipe(error.__context__)):
            # typer turns a closed pipe into SystemExit.
            # As long as the process, so that writing what Python still buffers does not fail at exit.
            sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
            return 1
        if isinstance(error, SystemExit) and _is_raised_by_typer(error):
            return error.code if isinstance(error.code, int) else 0
        _print_error(_describe_error(error), _find_expression_excerpt(error))
        return 1 if isinstance(error, StudyLostError) else 2
    # Between commands, typer treats every interrupt as Ctrl-C.
    return interrupt_exit_code() if code == 128 + signal.SIGINT else code if isinstance(code, int) else 0


def _reword_usage_error(error: Any) -> None:
    """Reword click's error about options in place: list all missing options, or say what is wrong with a value."""
    if type(error).__name__ == "MissingParameter":
        error.message = _describe_missing_options(error.ctx)
        return
    cause = error.__cause__
    if type(cause).__module__.startswith("pydantic") and (problems := cause.errors()):
        problem = problems[0]
        bounds = problem.get("ctx", {})
        reasons = {
            "int_parsing": "is not a whole number",
            "int_from_float": "is not a whole number",
            "float_parsing": "is not a number",
            "greater_than_equal": f"is below {bounds.get('ge')}",
            "less_than_equal": f"is above {bounds.get('le')}",
        }
        error.message = f"{problem['input']!r} {reasons.get(problem['type'], 'cannot be used here')}."


def _describe_missing_options(context: Any) -> str:
    """Return sentences that list all missing options, if several are missing, and the entities of the scenario.

    Click itself names only the first missing option.
    """
    if context is None:
        return ""
    missing = [
        parameter
        for parameter in context.command.params
        # Those on the command line are read first; a study file gives defaults.
        if parameter.required and parameter.name not in context.params and not context.lookup_default(parameter.name)
    ]
    sentences = []
    if len(missing) > 1:
        names = [
            max(parameter.opts, key=len)
            if parameter.param_type_name == "option"
            else parameter.metavar or parameter.name
            for parameter in missing
        ]
        sentences.append(f"All that are missing: {', '.join(names)}.")
    scenario = context.params.get("scenario")
    if isinstance(scenario, Path) and {"ego", "other"} & {parameter.name for parameter in missing}:
        with suppress(InputError):
            from cornercase.scenario._file import ScenarioFile

            sentences.append(f"Entities of {scenario.name}: {', '.join(ScenarioFile.read(scenario).entities)}.")
    return " ".join(sentences)


def _is_raised_by_typer(error: BaseException) -> bool:
    """Return whether typer itself raised the exception, for example after shell completion."""
    *_, (frame, _) = traceback.walk_tb(error.__traceback__)
    return str(frame.f_globals.get("__name__")).partition(".")[0] in ("typer", "click")


def _is_closed_pipe(error: BaseException | None) -> bool:
    return isinstance(error, OSError) and error.errno == errno.EPIPE


def _print_error(sentence: str, excerpt: str = "") -> None:
    line = use_option_names(sentence.removesuffix(f"\n{excerpt}")).replace("\n", "\\n")
    err.print("\n".join([f"cornercase: {shorten(line, MAX_LINE_LENGTH)}", *excerpt.splitlines()]))


def _find_expression_excerpt(error: BaseException | None) -> str:
    """Return the lines that show where an expression is wrong; empty if the error is not about an expression."""
    # An error can be among its own causes if it was raised again from one of them.
    seen = list[BaseException]()
    while error is not None and error not in seen:
        if isinstance(error, ExpressionError):
            return error.excerpt
        seen.append(error)
        error = error.__cause__
    return ""


def _describe_error(error: BaseException) -> str:
    if isinstance(error, InputError | StudyLostError):
        return str(error)
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    file = _find_file_in_use(frames)
    prefix = f"{file}: " if file else ""
    if isinstance(error, MemoryError):
        return f"{prefix}needs more memory than available; use fewer or smaller files, or a machine with more memory."
    if isinstance(error, UnicodeEncodeError):
        try:
            check_no_surrogates(error.object)
        except ValueError as surrogate:
            return f"{prefix}{surrogate}, which cannot be encoded; rename it."
    if isinstance(error, OSError) and error.strerror:
        target = error.filename if isinstance(error.filename, str) else "the output, or a temporary file"
        return f"{target}: cannot be read or written ({error.strerror}); make room, or choose another path."
    fault = "is nested too deep" if isinstance(error, RecursionError) else "met a fault of cornercase itself"
    place = _describe_fault_location(error)
    if not isinstance(error, Exception):
        # Not raised by cornercase, but by user code, for example with sys.exit().
        return f"user code ended the command with {describe_error(error)}; fix that code."
    return (
        f"{prefix or 'the command '}{fault} ({shorten(format_exception(error), 200)}{place}); please report it, with"
        f" the output of 'cornercase --debug'{' and that file' if file else ''}."
    )


def _find_file_in_use(frames: list[FrameType]) -> Path | None:
    """Return a file in the variables of the innermost function that has one, or else on the command line; or None."""
    values = (value for frame in reversed(frames) for value in frame.f_locals.values() if isinstance(value, Path))
    return next(filter(_is_file, chain(values, map(Path, sys.argv[2:]))), None)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _describe_fault_location(error: BaseException) -> str:
    """Return the innermost module and line in cornercase of a traceback, so that reports of one bug look the same."""
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        path = Path(frame.filename)
        if path.is_relative_to(_PACKAGE_FOLDER):
            return f", {path.relative_to(_PACKAGE_FOLDER).as_posix()} line {frame.lineno}"
    return ""
