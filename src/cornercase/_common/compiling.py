"""Kernels that are compiled once on a machine, also when many processes start together."""

# The part of numba that is used here has no types.
# mypy: disable-error-code="no-untyped-call, no-untyped-def, misc"

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, cast

from numba import njit
from numba.core.caching import FunctionCache

from cornercase._common.locks import held_lock


class _SharedCache(FunctionCache):
    """numba's cache on disk, one process at a time.

    numba reads the index of a function, adds to it and writes it back: of two processes that compile different
    versions of the function at once, one can end up with the other's machine code under its own key. Files that were
    cut, when the disk was full or the machine died, count as missing.

    numba keeps machine code as long as the file of the function is the same. Here all modules beside it have to be,
    as a kernel holds what it calls and the constants that it uses.
    """

    def __init__(self, function):
        super().__init__(function)
        self._cache_file._source_stamp = _contents(Path(function.__code__.co_filename).parent)

    def load_overload(self, sig, target_context):
        with held_lock(self._lock_path()):
            try:
                return super().load_overload(sig, target_context)
            except Exception:  # what pickle raises for a part of a file is not one kind of error
                self.flush()
                return None

    def save_overload(self, sig, data):
        with held_lock(self._lock_path()):
            super().save_overload(sig, data)

    def _lock_path(self):
        return Path(self.cache_path) / "cornercase.lock"


@cache
def _contents(folder: Path) -> str:
    """Digest of all modules in a folder."""
    digest = hashlib.sha256()
    for path in sorted(folder.glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


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
        # Without a folder to write to, it is compiled in each process.
        with suppress(RuntimeError):
            compiled._cache = _SharedCache(function)
        return cast(Callable[..., Any], compiled)

    return decorate
