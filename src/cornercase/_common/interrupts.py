"""Ctrl-C and other requests to end, of which none is lost in compiled code or where Python ignores exceptions."""

from __future__ import annotations

import _thread
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, Final

from cornercase._common.platform import ending_signals

_last: int = signal.SIGINT
# Requests that handlers of this module have heard so far, and whether Ctrl-C is among them by now.
_heard = 0
_counting = False
# Whether an interrupt was lost, and is to come again; s after which it does.
_owed = False
_AGAIN: Final = 0.005


def hear_requests() -> None:
    """Take what asks a program to end as it takes Ctrl-C: as `KeyboardInterrupt`, so that it clears up.

    One that falls where Python ignores exceptions, as into the clearing up of an object, comes again, and so does one
    that compiled code prints and puts another error in the place of, as NumPy does while it is loaded. What is ignored
    here, as by ``nohup``, stays so. To be called in the main thread of a program.
    """
    for name in ("unraisablehook", "excepthook"):
        if not isinstance(usual := getattr(sys, name), _HookForLostInterrupts):
            setattr(sys, name, _HookForLostInterrupts(usual))
    for number in ending_signals():
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _interrupt)


def last_request() -> signal.Signals:
    """Tell which signal the last `KeyboardInterrupt` was of.

    Returns
    -------
    signal.Signals
        That of Ctrl-C where there was no other.
    """
    return signal.Signals(_last)


def requests_heard() -> int:
    """Count the requests to end that this process has heard so far, as far as it counts them: see `is_request`."""
    return _heard


def is_request(error: BaseException, heard: int) -> bool:
    """Tell whether somebody asked the program to end, or the code itself raised the exception.

    Parameters
    ----------
    error : BaseException
        Raised by code of somebody else, which may have caught a `KeyboardInterrupt` and raised another error.
    heard : int
        `requests_heard` before that code ran.

    Returns
    -------
    bool
        True too for a `KeyboardInterrupt` if nobody counts requests here, as outside `noted_interrupts`.
    """
    if threading.current_thread() is not threading.main_thread():
        return False
    if _heard > heard:
        return True
    counted = _counting or signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    return isinstance(error, KeyboardInterrupt) and not counted


def _interrupt(number: int, frame: FrameType | None) -> None:
    global _last, _owed, _heard
    _last, _owed, _heard = number, False, _heard + 1
    raise KeyboardInterrupt


class _HookForLostInterrupts:
    """Has an interrupt come again that Python ignored or only printed, and tells of other exceptions as before."""

    def __init__(self, usual: Callable[..., object]) -> None:
        self._usual = usual

    def __call__(self, ignored: Any, *printed: Any) -> None:
        if issubclass(ignored if printed else ignored.exc_type, KeyboardInterrupt):
            _lose()
        else:
            self._usual(ignored, *printed)


def _lose() -> None:
    global _owed
    _owed = True
    # Raised here, it would be ignored again. `threading` is not used, as the main thread may hold its locks here.
    with suppress(RuntimeError):
        _thread.start_new_thread(_come_again, ())


def _come_again() -> None:
    time.sleep(_AGAIN)
    # Meanwhile it may have been heard.
    if _owed:
        _thread.interrupt_main(last_request())


def take_lost_interrupt() -> bool:
    """Tell whether an interrupt was lost and is to come again; who asks handles it.

    Returns
    -------
    bool
        Whether what has gone wrong may come of it.
    """
    global _owed
    lost, _owed = _owed, False
    return lost


@contextmanager
def noted_interrupts() -> Iterator[Callable[[], None]]:
    """Remember an interrupt whose exception falls into a callback of compiled code, where it would be lost.

    Yields
    ------
    callable
        Raises `KeyboardInterrupt` where there was one since it was last called; to be called now and then. Outside the
        main thread, and where the program handles the signal itself, it never does.
    """
    global _counting
    usual = {signal.SIGINT: signal.default_int_handler, **dict.fromkeys(ending_signals(), _interrupt)}
    noted = False

    def note(number: int, frame: FrameType | None) -> None:
        global _heard
        nonlocal noted
        noted, _heard = True, _heard + 1
        usual[signal.Signals(number)](number, frame)

    def check() -> None:
        global _owed
        nonlocal noted
        if noted:
            noted = _owed = False
            raise KeyboardInterrupt

    alone = threading.current_thread() is threading.main_thread()
    ours = [number for number, handler in usual.items() if alone and signal.getsignal(number) is handler]
    counted_before = _counting
    _counting = _counting or signal.SIGINT in ours
    for number in ours:
        signal.signal(number, note)
    try:
        yield check
    except Exception as error:
        # Compiled code may put an error of its own in the place of the interrupt.
        if noted:
            raise KeyboardInterrupt from error
        raise
    finally:
        _counting = counted_before
        for number in ours:
            signal.signal(number, usual[number])


@contextmanager
def held_interrupts() -> Iterator[None]:
    """Let interrupts come at the end of the block.

    A mask of signals alone does not do that: the system gives a signal to any thread that lets it through, and Python
    raises it in the main thread.

    Yields
    ------
    None
    """
    held: list[int] = []
    alone = threading.current_thread() is threading.main_thread()
    usual = {number: signal.getsignal(number) for number in (signal.SIGINT, *ending_signals()) if alone}
    ours = {number: handler for number, handler in usual.items() if callable(handler)}
    for number in ours:
        signal.signal(number, lambda number, frame: held.append(number))
    try:
        yield
    finally:
        for number, handler in ours.items():
            signal.signal(number, handler)
        for one in held[:1]:
            signal.raise_signal(one)
