"""Single-threaded linear algebra."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Final

from threadpoolctl import ThreadpoolController

# Packages with thread pools of their own.
_PACKAGES_WITH_BLAS: Final = ("numpy", "scipy.linalg", "scipy.optimize", "scipy.special", "sklearn")


@contextmanager
def single_threaded_blas() -> Iterator[None]:
    """Limit NumPy and SciPy to one thread in the block, so that results do not depend on the number of threads.

    The libraries are looked up once, and again if a package with a library of its own was imported since. Import the
    packages that you call before you use it.
    """
    with _threadpool_controller(*(name in sys.modules for name in _PACKAGES_WITH_BLAS)).limit(limits=1):
        yield


@cache
def _threadpool_controller(*_: bool) -> ThreadpoolController:
    return ThreadpoolController()
