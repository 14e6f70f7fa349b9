"""Turns of threads, of which only one is in Python at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock


@contextmanager
def turn_given_up(turn: Lock | None) -> Iterator[None]:
    """Let another thread have its turn in Python while compiled code runs within the block.

    Parameters
    ----------
    turn : Lock or None
        Held before and after; None where nobody else waits for it.

    Yields
    ------
    None
    """
    if turn is None:
        yield
        return
    turn.release()
    try:
        yield
    finally:
        turn.acquire()
