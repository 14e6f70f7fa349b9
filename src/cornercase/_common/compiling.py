"""Kernels that are compiled once on a machine, also when many processes start together."""

# The part of numba that is used here has no types.
# mypy: disable-error-code="no-untyped-call, no-untyped-def, misc"

from __future__ import annotations

import fcntl
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, cast

from numba import njit
from numba.core.caching import FunctionCache


class _SharedCache(FunctionCache):
    """numba's cache on disk, one process at a time.

    numba reads the index of a function, adds to it and writes it back: of two processes that compile different
    versions of the function at once, one can end up with the other's machine code under its own key.
    """

    def load_overload(self, sig, target_context):
        with _locked(self.cache_path, fcntl.LOCK_SH):
            return super().load_overload(sig, target_context)

    def save_overload(self, sig, data):
        with _locked(self.cache_path, fcntl.LOCK_EX):
            super().save_overload(sig, data)


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Compile a function without Python objects and without the interpreter's lock, and keep its machine code.

    Parameters
    ----------
    **options
        For ``numba.njit``.

    Returns
    -------
    callable
        Decorator.
    """

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        compiled = njit(nogil=True, **options)(function)
        # Where there is no folder to write to, it is compiled anew each time.
        with suppress(RuntimeError):
            compiled._cache = _SharedCache(function)
        return cast(Callable[..., Any], compiled)

    return decorate


@contextmanager
def _locked(folder: str, how: int) -> Iterator[None]:
    with ExitStack() as opened:
        lock = None
        # Where nothing can be written, nothing is.
        with suppress(OSError):
            Path(folder).mkdir(parents=True, exist_ok=True)
            lock = opened.enter_context((Path(folder) / "cornercase.lock").open("ab"))
        if lock is not None:
            fcntl.flock(lock, how)
        yield
