"""Kernels that are compiled once on a machine, also when many processes start together."""

# The part of numba that is used here has no types.
# mypy: disable-error-code="no-untyped-call, no-untyped-def, misc"

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

from numba import njit, types
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys

from cornercase._common.kernel_contents import contents
from cornercase._common.locks import held_lock


class _SharedCache(FunctionCache):
    """numba's cache on disk, one process at a time.

    numba reads the index of a function, adds to it and writes it back: of two processes that compile different
    versions of the function at once, one can end up with the other's machine code under its own key. Files that were
    cut, when the disk was full or the machine died, count as missing.

    numba keeps machine code as long as the file of the function is the same. Here everything that the machine code
    holds has to be: the function, what it calls and the constants that it uses, in whatever module they are.
    """

    def __init__(self, function, options):
        super().__init__(function)
        self._options = options
        self._cache_file._source_stamp = None

    def load_overload(self, sig, target_context):
        # numba would load all that it needs to compile, a third of a second; to load machine code, this is enough.
        rtsys.initialize(target_context)
        self._stamp()
        with held_lock(self._lock_path()):
            try:
                with self._guard_against_spurious_io_errors():
                    return self._load_overload(sig, target_context)
            except Exception:  # what pickle raises for a part of a file is not one kind of error
                self.flush()
                return None

    def save_overload(self, sig, data):
        self._stamp()
        with held_lock(self._lock_path()):
            super().save_overload(sig, data)

    def _index_key(self, sig, codegen):
        # Machine code takes the fields of a named tuple by their places.
        return (*super()._index_key(sig, codegen), tuple(_fields(kind) for kind in sig))

    def _stamp(self):
        # Not when the function is defined, as what it calls may be defined after it.
        if self._cache_file._source_stamp is None:
            self._cache_file._source_stamp = contents(self._py_func, self._options)

    def _lock_path(self):
        return Path(self.cache_path) / "cornercase.lock"


def _fields(kind: Any) -> tuple[Any, ...]:
    inner: Any = kind
    if not isinstance(kind, types.BaseTuple):
        return ()
    named = inner.fields if isinstance(kind, types.BaseNamedTuple) else ()
    return (named, *map(_fields, inner))


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
            compiled._cache = _SharedCache(function, options)
        return cast(Callable[..., Any], compiled)

    return decorate
