"""Release of a lock that lets only one thread run Python code at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock


@contextmanager
def release_gil_lock(gil_lock: Lock | None) -> Iterator[None]:
    """Release a lock while a block runs compiled code, and acquire the lock again; does nothing for None."""
    if gil_lock is None:
        yield
        return
    gil_lock.release()
    try:
        yield
    finally:
        gil_lock.acquire()
