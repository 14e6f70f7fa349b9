"""Let only one thread be in Python at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock


@contextmanager
def turn_given_up(turn: Lock | None) -> Iterator[None]:
    """Release a lock while compiled code runs in the block; None if there is no lock."""
    if turn is None:
        yield
        return
    turn.release()
    try:
        yield
    finally:
        turn.acquire()
