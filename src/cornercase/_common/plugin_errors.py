"""Turn exceptions of users' drivers, simulators and metrics into one-sentence errors."""

from __future__ import annotations

import re
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Final

from cornercase._common.errors import (
    InputError,
    PluginError,
    RunLostError,
    SimulationError,
    UserCodeError,
    is_machine_error,
)
from cornercase._common.process.signals import collect_interrupts, count_termination_requests, is_termination_request
from cornercase._common.text.sanitize import remove_folders, shorten

_PACKAGE_FOLDER: Final = str(Path(__file__).parents[1])
# Limits of a description: lines of the traceback; characters of a line, of the message and of the whole text.
_MAX_LINES: Final = 3
_MAX_LINE_LENGTH: Final = 90
_MAX_MESSAGE_LENGTH: Final = 200
_MAX_LENGTH: Final = 700
_TIME_PATTERN: Final = re.compile(r" at t = (\d[\d.e+-]*) s\b")


@contextmanager
def convert_plugin_errors(name: str, plugin: object, activity: str = "") -> Iterator[None]:
    """Within the block, turn exceptions of a user's plug-in into `UserCodeError`.

    The message begins with `name`, such as ``"The simulator 'braking'"``. `activity` says when the plug-in failed, such
    as ``"when it was created"``. An `InputError` and a request to end the program pass unchanged. Exceptions of
    built-in plug-ins pass unchanged, too, because they are bugs of cornercase.
    """
    with collect_interrupts():
        n_requests = count_termination_requests()
        try:
            yield
        except InputError:
            raise
        except BaseException as error:
            reraise_termination_request(error, n_requests)
            if is_built_in(plugin):
                raise
            when = f" {activity}" if activity else ""
            raise UserCodeError(f"{name} failed{when}: {describe_error(error)}; fix its code.") from error


def unwrap_factory(factory: Callable[..., object]) -> Callable[..., object]:
    """Return the class or function behind a factory, which may be a `functools.partial`."""
    return factory.func if isinstance(factory, partial) else factory


def is_built_in(plugin: object) -> bool:
    """Return whether an object or its class comes with cornercase."""
    return str(getattr(plugin, "__module__", "")).partition(".")[0] == "cornercase"


def make_scenario_failure(
    plugin_name: str, error: BaseException, n_requests_before: int, time: float | None = None
) -> SimulationError:
    """Return the error of a scenario in which a plug-in raised an exception.

    The error is a `PluginError`, or a `RunLostError` (the scenario may be run again) if the machine is at fault, for
    example because the disk is full. If the user asked the program to end, `KeyboardInterrupt` is raised instead.
    `n_requests_before` is the value of `count_termination_requests` before the plug-in ran.
    """
    reraise_termination_request(error, n_requests_before)
    message = f"{plugin_name} failed{format_time_of_failure(time)}: {describe_error(error)}"
    return RunLostError(message) if is_machine_error(error) else PluginError(message)


def user_code_error(failure: PluginError) -> UserCodeError:
    """Return the `UserCodeError` of a call that fails because a plug-in failed in a scenario."""
    return UserCodeError(f"{str(failure)[0].upper()}{str(failure)[1:]}.")


def reraise_termination_request(error: BaseException, n_requests_before: int) -> None:
    """Raise `KeyboardInterrupt` if an exception was caused by a request to end the program.

    `n_requests_before` is the result of `count_termination_requests` before the call that raised the exception.
    """
    if is_termination_request(error, n_requests_before):
        if isinstance(error, KeyboardInterrupt):
            raise error
        raise KeyboardInterrupt from error


def format_time_of_failure(time: float | None) -> str:
    """Return the time of a failure in a scenario as ``" at t = 1.25 s"``; an empty text for None."""
    return "" if time is None else f" at t = {time:.6g} s"


def describe_error(error: BaseException) -> str:
    """Describe an exception in one line without a full stop, with the last lines of its traceback.

    Example: ``"RuntimeError: no gap (aeb.py line 12 in acceleration: raise RuntimeError('no gap'))"``. Folders are left
    out, as they are private.
    """
    try:
        message = str(error)
    except BaseException:
        message = ""
    message = shorten(" ".join(remove_folders(message).split()).rstrip(".: "), _MAX_MESSAGE_LENGTH)
    name = type(error).__name__
    lines = "; ".join(_traceback_lines(error))
    return shorten((f"{name}: {message}" if message else name) + (f" ({lines})" if lines else ""), _MAX_LENGTH)


def group_failure_messages(errors: Iterable[str]) -> dict[str, list[int]]:
    """Group failure messages that differ only in the time of the failure, the most frequent group first.

    The result maps the message of each group to the indices of its members in `errors`. If times differ, the message
    states the earliest and the latest time.
    """
    texts = list(errors)
    groups: dict[str, list[int]] = {}
    for k, text in enumerate(texts):
        groups.setdefault(_TIME_PATTERN.sub("", text, count=1), []).append(k)
    ranked = sorted(groups.values(), key=lambda members: (-len(members), members[0]))
    return {_merge_times([texts[k] for k in members]): members for members in ranked}


def _merge_times(texts: list[str]) -> str:
    """Return the first of several messages that differ only in time, with the earliest and latest time."""
    instants = [float(match[1]) for text in texts if (match := _TIME_PATTERN.search(text)) is not None]
    if not instants or min(instants) == max(instants):
        return texts[0]
    return _TIME_PATTERN.sub(f" at t = {min(instants):.6g} to {max(instants):.6g} s", texts[0], count=1)


def _traceback_lines(error: BaseException) -> list[str]:
    """Return the last lines of a traceback, without the lines before cornercase called code outside of cornercase."""
    frames = list(traceback.walk_tb(error.__traceback__))
    foreign = [k for k, (frame, _) in enumerate(frames) if not frame.f_code.co_filename.startswith(_PACKAGE_FOLDER)]
    frames = frames[foreign[0] :] if foreign else []
    summaries = traceback.StackSummary.extract(iter(frames[-_MAX_LINES:]))
    return [_format_frame(summary) for summary in summaries]


def _format_frame(frame: traceback.FrameSummary) -> str:
    location = f"{Path(frame.filename).name} line {frame.lineno} in {frame.name}"
    text = " ".join((frame.line or "").split())
    return f"{location}: {shorten(text, _MAX_LINE_LENGTH)}" if text else location
