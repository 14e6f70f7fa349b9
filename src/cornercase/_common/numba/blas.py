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
    """Limit NumPy's and SciPy's linear algebra to one thread, so that results do not depend on the number of threads.

    The limit holds within the block, and only for packages that were imported before the block.
    """
    with _threadpool_controller(*(name in sys.modules for name in _PACKAGES_WITH_BLAS)).limit(limits=1):
        yield


@cache
def _threadpool_controller(*_: bool) -> ThreadpoolController:
    return ThreadpoolController()
