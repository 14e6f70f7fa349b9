"""Parts that users bring along, such as drivers and simulators: whatever they raise becomes a sentence."""

from __future__ import annotations

import re
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Final

from cornercase._common.errors import InputError, LostError, PartError, SimulationError, is_of_the_machine
from cornercase._common.interrupts import is_request, noted_interrupts, requests_heard
from cornercase._common.texts import shorten, without_folders

_PACKAGE: Final = str(Path(__file__).parents[1])
# Last lines of a traceback that are kept, and characters of one, of a message and of all of it.
_MOST_LINES: Final = 3
_LONGEST_LINE: Final = 90
_LONGEST_MESSAGE: Final = 200
_LONGEST: Final = 700
_INSTANT: Final = re.compile(r" at t = (\d[\d.e+-]*) s\b")


@contextmanager
def guarded(name: str, part: object, doing: str = "") -> Iterator[None]:
    """Turn whatever a part raises in the block into an `InputError`, except `InputError` itself and requests to end.

    Parameters
    ----------
    name : str
        Whose code runs in the block, for the message: ``"The simulator 'braking'"``.
    part : object
        The part, or its class. If it comes with cornercase, its exceptions are faults of cornercase, and stay.
    doing : str, optional
        What it is asked for: ``"in ask"``.

    Raises
    ------
    InputError
        ``"The simulator 'braking' failed in close: …; fix it."``
    """
    with noted_interrupts():
        heard = requests_heard()
        try:
            yield
        except InputError:
            raise
        except BaseException as error:
            raise_if_request(error, heard)
            if is_built_in(part):
                raise
            where = f" {doing}" if doing else ""
            raise InputError(f"{name} failed{where}: {describe_error(error)}; fix it.") from error


def maker_of(factory: Callable[..., object]) -> Callable[..., object]:
    """Class or function of a factory that may have some of its options already."""
    return factory.func if isinstance(factory, partial) else factory


def is_built_in(part: object) -> bool:
    """Whether a part, or its class, comes with cornercase."""
    return str(getattr(part, "__module__", "")).partition(".")[0] == "cornercase"


def failure_of(part: str, error: BaseException, heard: int, time: float | None = None) -> SimulationError:
    """Make the failure of a scenario of what a part raised in it.

    Parameters
    ----------
    part : str
        Whose code raised it: ``"the driver of Ego"``.
    error : BaseException
    heard : int
        `requests_heard` before that code ran.
    time : float, optional
        s; instant of the scenario at which it was raised.

    Returns
    -------
    PartError or LostError
        The latter if the machine is at fault, as a full disk is; then the scenario may be run again.

    Raises
    ------
    KeyboardInterrupt
        Somebody asked the program to end.
    """
    raise_if_request(error, heard)
    words = f"{part} failed{format_instant(time)}: {describe_error(error)}"
    return LostError(words) if is_of_the_machine(error) else PartError(words)


def raise_if_request(error: BaseException, heard: int) -> None:
    """Raise `KeyboardInterrupt` if an exception came because somebody asked the program to end."""
    if is_request(error, heard):
        if isinstance(error, KeyboardInterrupt):
            raise error
        raise KeyboardInterrupt from error


def format_instant(time: float | None) -> str:
    """Instant of a scenario as all failures name it: ``" at t = 1.25 s"``; nothing for None."""
    return "" if time is None else f" at t = {time:.6g} s"


def describe_error(error: BaseException) -> str:
    """Describe an exception of somebody's code in one line, with the last lines of its traceback.

    Parameters
    ----------
    error : BaseException

    Returns
    -------
    str
        ``"RuntimeError: no gap (aeb.py line 12 in acceleration: raise RuntimeError('no gap'))"``, without a full stop.
        Files are named without their folders, which are nobody else's concern.
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
    """Group why scenarios failed; the same failure at different instants is one.

    Parameters
    ----------
    errors : iterable of str

    Returns
    -------
    dict of str to list of int
        Positions of the errors by reason, the most frequent first. It names the first and the last instant.
    """
    texts = list(errors)
    groups: dict[str, list[int]] = {}
    for k, text in enumerate(texts):
        groups.setdefault(_INSTANT.sub("", text, count=1), []).append(k)
    ranked = sorted(groups.values(), key=lambda members: (-len(members), members[0]))
    return {_over_instants([texts[k] for k in members]): members for members in ranked}


def _over_instants(texts: list[str]) -> str:
    """The first of texts that differ in an instant alone, with the first and the last instant."""
    instants = [float(found[1]) for text in texts if (found := _INSTANT.search(text)) is not None]
    if not instants or min(instants) == max(instants):
        return texts[0]
    return _INSTANT.sub(f" at t = {min(instants):.6g} to {max(instants):.6g} s", texts[0], count=1)


def _last_lines(error: BaseException) -> list[str]:
    """Last lines of a traceback, from where it leaves this package."""
    frames = list(traceback.walk_tb(error.__traceback__))
    own = [k for k, (frame, _) in enumerate(frames) if not _is_ours(frame)]
    frames = frames[own[0] :] if own else []
    found = traceback.StackSummary.extract(iter(frames[-_MOST_LINES:]))
    return [_line(one) for one in found]


def _line(one: traceback.FrameSummary) -> str:
    place = f"{Path(one.filename).name} line {one.lineno} in {one.name}"
    text = " ".join((one.line or "").split())
    return f"{place}: {shorten(text, _LONGEST_LINE)}" if text else place


def _is_ours(frame: FrameType) -> bool:
    return frame.f_code.co_filename.startswith(_PACKAGE)
