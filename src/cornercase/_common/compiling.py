"""The decorator `kernel`: numba compilation with a cache on disk that concurrent processes share safely."""

# numba's caching internals have no type hints.
# mypy: disable-error-code="no-untyped-call, no-untyped-def, misc"

from __future__ import annotations

import logging
import multiprocessing
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, cast
from weakref import WeakSet

from numba import njit, types
from numba.core import event
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys

from cornercase._common.kernel_contents import contents
from cornercase._common.locks import held_lock

_LOG = logging.getLogger(__name__)
_KERNELS: WeakSet[Any] = WeakSet()


class _SharedCache(FunctionCache):
    """numba's disk cache, used by one process at a time.

    numba reads the index of a function, adds to it and writes it back. If two processes do so at once, one can end up
    with the other's machine code under its own key. Truncated files (full disk, crash) count as missing.

    numba keeps machine code while the function's file is unchanged. Here the key covers all that the code contains: the
    function, what it calls and its constants, in whatever module.
    """

    def __init__(self, function, options):
        super().__init__(function)
        self._options = options
        self._cache_file._source_stamp = None

    def load_overload(self, sig, target_context):
        # Loading machine code needs only this; numba would load its whole compiler (a third of a second).
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
        try:
            with held_lock(self._lock_path()):
                super().save_overload(sig, data)
        except OSError as error:
            # A full disk only prevents caching; the compiled code is used all the same.
            _WATCH.tell_unkept(f"{self.cache_path}: {error.strerror}")

    def _index_key(self, sig, codegen):
        # Machine code accesses the fields of a named tuple by position.
        return (*super()._index_key(sig, codegen), tuple(_fields(kind) for kind in sig))

    def _stamp(self):
        # Not at definition time: functions that it calls may be defined later.
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
    """Decorator: compile with ``numba.njit(nogil=True, **options)``, and cache the machine code on disk."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        compiled = njit(nogil=True, **options)(function)
        # Without a writable folder, each process compiles anew.
        with suppress(RuntimeError):
            compiled._cache = _SharedCache(function, options)
        _KERNELS.add(compiled)
        return cast(Callable[..., Any], compiled)

    return decorate


class _Watch(event.Listener):
    """Listens to numba's compilation. If nobody else listens, it logs one warning that kernels are being compiled.

    Worker processes leave that to their parent.
    """

    def __init__(self) -> None:
        self.unkept = ""
        self.listeners: list[Callable[[str], None]] = []
        self.companions: list[Callable[[], None]] = []
        self.said = multiprocessing.parent_process() is not None

    def on_start(self, event: Any) -> None:
        kernel = event.data["dispatcher"]
        if kernel not in _KERNELS:
            return
        cached = isinstance(kernel._cache, _SharedCache)
        if not cached:
            self.unkept = _NO_FOLDER
        while cached and self.companions:
            self.companions.pop()()
        for listener in self.listeners:
            listener(f"{kernel.py_func.__module__.removeprefix('cornercase.')}.{kernel.py_func.__name__}")
        if not (self.listeners or self.said):
            self.said = True
            _LOG.warning(_KEPT if cached else _NOT_KEPT)

    def on_end(self, event: Any) -> None:
        pass

    def tell_unkept(self, why: str) -> None:
        """Log once why machine code is not cached, unless somebody else listens."""
        if not (self.unkept or self.listeners or multiprocessing.parent_process() is not None):
            _LOG.warning("Compiled kernels cannot be cached: %s.", why)
        self.unkept = why


_KEPT = "Compiling kernels for this machine (cached for later runs); 'cornercase warm-up' compiles all in advance."
_NO_FOLDER = "no cache folder is writable; set NUMBA_CACHE_DIR to one that is"
_NOT_KEPT = "Compiling kernels in each process anew; set NUMBA_CACHE_DIR to a writable folder to cache them."
_WATCH = _Watch()
event.register("numba:compile", _WATCH)


@contextmanager
def heard_compilation(listener: Callable[[str], None]) -> Iterator[None]:
    """Within the block, call `listener` with module and name of each kernel that numba compiles; log nothing."""
    _WATCH.listeners.append(listener)
    try:
        yield
    finally:
        _WATCH.listeners.remove(listener)


@contextmanager
def companion(start: Callable[[], None]) -> Iterator[None]:
    """Within the block, call `callback` once, when numba first compiles a kernel that will be cached."""
    _WATCH.companions.append(start)
    try:
        yield
    finally:
        with suppress(ValueError):
            _WATCH.companions.remove(start)


def count_kernels() -> tuple[int, int]:
    """Return how many of the imported kernels are ready to run, and how many there are."""
    kernels = list(_KERNELS)
    return sum(bool(function.signatures) for function in kernels), len(kernels)


def why_not_kept() -> str:
    """Reason why compiled machine code could not be cached; empty if it was, or if nothing was compiled."""
    return _WATCH.unkept
