"""Ctrl-C and other requests to end, of which none is lost in compiled code."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from cornercase._common.platform import ending_signals

_last: int = signal.SIGINT


def hear_requests() -> None:
    """Take what asks a program to end as it takes Ctrl-C: as `KeyboardInterrupt`, so that it clears up.

    What is ignored here, as by ``nohup``, stays so. To be called in the main thread of a program.
    """
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


def _interrupt(number: int, frame: FrameType | None) -> None:
    global _last
    _last = number
    raise KeyboardInterrupt


@contextmanager
def noted_interrupts() -> Iterator[Callable[[], None]]:
    """Remember an interrupt whose exception falls into a callback of compiled code, where it would be lost.

    Yields
    ------
    callable
        Raises `KeyboardInterrupt` where there was one since it was last called; to be called now and then. Outside the
        main thread, and where the program handles the signal itself, it never does.
    """
    usual = {signal.SIGINT: signal.default_int_handler, **dict.fromkeys(ending_signals(), _interrupt)}
    noted = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal noted
        noted = True
        usual[signal.Signals(number)](number, frame)

    def check() -> None:
        nonlocal noted
        if noted:
            noted = False
            raise KeyboardInterrupt

    alone = threading.current_thread() is threading.main_thread()
    ours = [number for number, handler in usual.items() if alone and signal.getsignal(number) is handler]
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
        for number in ours:
            signal.signal(number, usual[number])
