"""Turn exceptions of users' drivers, simulators and metrics into one-sentence errors."""

from __future__ import annotations

import re
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError, LostError, PartError, SimulationError, is_of_the_machine
from cornercase._common.interrupts import is_request, noted_interrupts, requests_heard
from cornercase._common.texts import shorten, without_folders

_PACKAGE: Final = str(Path(__file__).parents[1])
# Limits of a description: lines of the traceback, and characters of a line, of the message and of all.
_MOST_LINES: Final = 3
_LONGEST_LINE: Final = 90
_LONGEST_MESSAGE: Final = 200
_LONGEST: Final = 700
_INSTANT: Final = re.compile(r" at t = (\d[\d.e+-]*) s\b")


@contextmanager
def guarded(name: str, part: object, doing: str = "") -> Iterator[None]:
    """Turn exceptions of a plug-in in the block into `InputError`; keep `InputError` and termination requests.

    `name` starts the sentence: ``"The simulator 'braking'"``; `activity` says when: ``"in ask"``. Exceptions of
    built-in parts are bugs of cornercase, and stay as they are.
    """
    with noted_interrupts():
        n_requests = requests_heard()
        try:
            yield
        except InputError:
            raise
        except BaseException as error:
            raise_if_request(error, n_requests)
            if is_built_in(part):
                raise
            when = f" {doing}" if doing else ""
            raise InputError(f"{name} failed{when}: {describe_error(error)}; fix it.") from error


def maker_of(factory: Callable[..., object]) -> Callable[..., object]:
    """Class or function behind a factory, which may be a `partial`."""
    return factory.func if isinstance(factory, partial) else factory


def is_built_in(part: object) -> bool:
    """Whether an object, or its class, comes with cornercase."""
    return str(getattr(part, "__module__", "")).partition(".")[0] == "cornercase"


def failure_of(part: str, error: BaseException, heard: int, time: float | None = None) -> SimulationError:
    """Make the failure of a scenario from an exception of a plug-in.

    It is a `RunLostError` (the scenario may be run again) if the machine is at fault, such as a full disk.
    KeyboardInterrupt is raised if somebody asked the program to end. `n_requests_before` is `count_requests` before the
    code ran.
    """
    raise_if_request(error, heard)
    message = f"{part} failed{format_instant(time)}: {describe_error(error)}"
    return LostError(message) if is_of_the_machine(error) else PartError(message)


def raise_if_request(error: BaseException, heard: int) -> None:
    """Raise `KeyboardInterrupt` if an exception came from a termination request."""
    if is_request(error, heard):
        if isinstance(error, KeyboardInterrupt):
            raise error
        raise KeyboardInterrupt from error


def format_instant(time: float | None) -> str:
    """Format the time of a failure in a scenario: ``" at t = 1.25 s"``; empty for None."""
    return "" if time is None else f" at t = {time:.6g} s"


def describe_error(error: BaseException) -> str:
    """Describe an exception in one line, with the last lines of its traceback and without a full stop.

    ``"RuntimeError: no gap (aeb.py line 12 in acceleration: raise RuntimeError('no gap'))"``. Folders are left out, as
    they are private.
    """
    try:
        message = str(error)
    except BaseException:
        message = ""
    message = shorten(" ".join(without_folders(message).split()).rstrip(".: "), _LONGEST_MESSAGE)
    name = type(error).__name__
    lines = "; ".join(_last_lines(error))
    return shorten((f"{name}: {message}" if message else name) + (f" ({lines})" if lines else ""), _LONGEST)


def group_reasons(errors: Iterable[str]) -> dict[str, list[int]]:
    """Group failure messages that differ only in time: message (first and last time) → indices, most frequent first."""
    texts = list(errors)
    groups: dict[str, list[int]] = {}
    for k, text in enumerate(texts):
        groups.setdefault(_INSTANT.sub("", text, count=1), []).append(k)
    ranked = sorted(groups.values(), key=lambda members: (-len(members), members[0]))
    return {_over_instants([texts[k] for k in members]): members for members in ranked}


def _over_instants(texts: list[str]) -> str:
    """First of several messages that differ only in time, with the earliest and latest time."""
    instants = [float(match[1]) for text in texts if (match := _INSTANT.search(text)) is not None]
    if not instants or min(instants) == max(instants):
        return texts[0]
    return _INSTANT.sub(f" at t = {min(instants):.6g} to {max(instants):.6g} s", texts[0], count=1)


def _last_lines(error: BaseException) -> list[str]:
    """Last lines of a traceback, starting where it leaves this package."""
    frames = list(traceback.walk_tb(error.__traceback__))
    foreign = [k for k, (frame, _) in enumerate(frames) if not frame.f_code.co_filename.startswith(_PACKAGE)]
    frames = frames[foreign[0] :] if foreign else []
    summaries = traceback.StackSummary.extract(iter(frames[-_MOST_LINES:]))
    return [_line(summary) for summary in summaries]


def _line(one: traceback.FrameSummary) -> str:
    location = f"{Path(one.filename).name} line {one.lineno} in {one.name}"
    text = " ".join((one.line or "").split())
    return f"{location}: {shorten(text, _LONGEST_LINE)}" if text else location
