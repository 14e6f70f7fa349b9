"""Ctrl-C that is not lost in compiled code."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def noted_interrupts() -> Iterator[Callable[[], None]]:
    """Remember an interrupt whose exception falls into a callback of compiled code, where it would be lost.

    Yields
    ------
    callable
        Raises `KeyboardInterrupt` where there was one since it was last called; to be called now and then. Outside the
        main thread, and where the program handles the signal itself, it never does.
    """
    usual = signal.default_int_handler
    noted = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal noted
        noted = True
        usual(number, frame)

    def check() -> None:
        nonlocal noted
        if noted:
            noted = False
            raise KeyboardInterrupt

    alone = threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is usual
    if alone:
        signal.signal(signal.SIGINT, note)
    try:
        yield check
    except Exception as error:
        # Compiled code may put an error of its own in the place of the interrupt.
        if noted:
            raise KeyboardInterrupt from error
        raise
    finally:
        if alone:
            signal.signal(signal.SIGINT, usual)
