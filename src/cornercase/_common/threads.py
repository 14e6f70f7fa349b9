"""Linear algebra by one thread."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from threadpoolctl import ThreadpoolController


@contextmanager
def one_thread() -> Iterator[None]:
    """Let NumPy and SciPy use one thread, so that sums have one order and results do not depend on their number.

    The libraries are looked up once, which takes longer than many a result here; so whoever uses this has imported
    what of SciPy they call.
    """
    with _libraries().limit(limits=1):
        yield


@cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()
