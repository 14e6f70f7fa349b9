"""Linear algebra by one thread."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Final

from threadpoolctl import ThreadpoolController

# Packages with libraries of their own that run threads.
_BRINGING: Final = ("numpy", "scipy.linalg", "scipy.optimize", "scipy.special", "sklearn")


@contextmanager
def one_thread() -> Iterator[None]:
    """Let NumPy and SciPy use one thread, so that sums have one order and results do not depend on their number.

    The libraries are looked up once, which takes longer than many a result here, and again when a package that brings
    one was imported since; so whoever uses this has imported what of these packages they call.
    """
    with _libraries(*(name in sys.modules for name in _BRINGING)).limit(limits=1):
        yield


@cache
def _libraries(*_: bool) -> ThreadpoolController:
    return ThreadpoolController()
