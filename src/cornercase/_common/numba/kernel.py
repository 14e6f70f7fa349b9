"""The decorator `kernel`: numba compilation with a cache on disk that concurrent processes share safely."""

# numba's caching internals have no type hints.
# mypy: disable-error-code="no-untyped-call, no-untyped-def, misc, attr-defined"

from __future__ import annotations

import logging
import multiprocessing
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import Any, cast
from weakref import WeakSet

from numba.core import event
from numba.core.caching import FunctionCache, NullCache
from numba.core.runtime.nrt import rtsys

from cornercase._common.io.locks import lock
from cornercase._common.numba.cache_key import kernel_digest
from cornercase._common.numba.dispatcher import KernelDispatcher
from cornercase._common.numba.interpret import compile_at_once
from cornercase._common.numba.shipped import ShippedCode, nested_field_names

_LOG = logging.getLogger(__name__)
_KERNELS: WeakSet[Any] = WeakSet()


class _SharedCache(FunctionCache):
    """numba's disk cache, used by one process at a time.

    numba reads the index of a function, adds an entry and writes the index back. If two processes do so at once,
    a key can point to the machine code that the other process wrote for another key. A truncated file (after a full
    disk or a crash) counts as missing.

    numba alone compiles again only if the file of the function changes. Here the key also covers functions and
    constants of other modules that the function uses.
    """

    def __init__(self, function, options):
        super().__init__(function)
        self._options = options
        self._shipped = ShippedCode(function)
        self._cache_file._source_stamp = None

    def load_overload(self, sig, target_context):
        # Loading machine code needs only this; numba would load its whole compiler (a third of a second).
        rtsys.initialize(target_context)
        self._set_source_stamp()
        shipped = self._shipped.load(self._cache_file._source_stamp, sig, target_context)
        if shipped is not None:
            return shipped
        with lock(self._lock_path()):
            try:
                with self._guard_against_spurious_io_errors():
                    return self._load_overload(sig, target_context)
            except Exception:  # what pickle raises for a part of a file is not one kind of error
                self.flush()
                return None

    def has_overload(self, sig, target_context):
        """Return whether machine code for a signature seems to be on disk."""
        self._set_source_stamp()
        if self._shipped.has(self._cache_file._source_stamp, sig):
            return True
        try:
            with lock(self._lock_path()):
                return self._index_key(sig, target_context.codegen()) in self._cache_file._load_index()
        except Exception:
            return False

    def save_overload(self, sig, data):
        self._set_source_stamp()
        self._shipped.save(self._cache_file._source_stamp, sig, data)
        try:
            with lock(self._lock_path()):
                super().save_overload(sig, data)
        except OSError as error:
            # A full disk only prevents caching; the compiled code is used all the same.
            _COMPILATION_LISTENER.report_not_cached(f"{self.cache_path}: {error.strerror}")

    def _index_key(self, sig, codegen):
        # Machine code accesses the fields of a named tuple by position.
        return (*super()._index_key(sig, codegen), tuple(nested_field_names(kind) for kind in sig))

    def _set_source_stamp(self):
        # Not at definition time: functions that it calls may be defined later.
        if self._cache_file._source_stamp is None:
            self._cache_file._source_stamp = kernel_digest(self._py_func, self._options)

    def _lock_path(self):
        return Path(self.cache_path) / "cornercase.lock"


class _ShippedCache(NullCache):
    """Read-only cache: the machine code that comes with the package."""

    def __init__(self, function, options):
        self._function, self._options, self._shipped = function, options, ShippedCode(function)

    @cached_property
    def _digest(self):
        return kernel_digest(self._function, self._options)

    def load_overload(self, sig, target_context):
        return self._shipped.load(self._digest, sig, target_context)

    def has_overload(self, sig, target_context):
        return self._shipped.has(self._digest, sig)


def kernel(
    *, interpreted_seconds: Callable[..., float] | None = None, **options: Any
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorator: compile a function like ``numba.njit(nogil=True, **options)`` and cache its machine code on disk.

    `interpreted_seconds` estimates from the arguments how many seconds Python would take. If it is given, short calls
    are interpreted as long as the kernel is not compiled.
    """

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        compiled = KernelDispatcher(function, options, interpreted_seconds)
        # Without a writable folder, each process compiles anew.
        try:
            compiled._cache = _SharedCache(function, options)
        except RuntimeError:
            compiled._cache = _ShippedCache(function, options)
        _KERNELS.add(compiled)
        return cast(Callable[..., Any], compiled)

    return decorate


class _CompilationListener(event.Listener):
    """Listener that logs when numba begins to compile kernels, and from time to time that compiling goes on.

    Nothing is logged if other listeners are registered. Worker processes log nothing, because their parent logs.
    """

    def __init__(self, seconds_between_messages: float = 10.0) -> None:
        self.seconds_between_messages = seconds_between_messages
        self.not_cached_reason = ""
        self.listeners: list[Callable[[str], None]] = []
        self.start_callbacks: list[Callable[[], None]] = []
        self.is_quiet = multiprocessing.parent_process() is not None
        # Kernels that this process has begun to compile; times in s of the first one and of the last message.
        self.n_compiled, self.start_time, self.message_time = 0, 0.0, 0.0

    def on_start(self, event: Any) -> None:
        kernel = event.data["dispatcher"]
        if kernel not in _KERNELS:
            return
        cached = isinstance(kernel._cache, _SharedCache)
        if not cached:
            self.not_cached_reason = _NO_CACHE_FOLDER_MESSAGE
        while cached and self.start_callbacks:
            self.start_callbacks.pop()()
        for listener in self.listeners:
            listener(f"{kernel.py_func.__module__.removeprefix('cornercase.')}.{kernel.py_func.__name__}")
        if self.listeners or self.is_quiet:
            return
        now = time.monotonic()
        if not self.n_compiled:
            self.start_time = self.message_time = now
            _LOG.warning(_CACHED_MESSAGE if cached else _NOT_CACHED_MESSAGE)
        elif now - self.message_time >= self.seconds_between_messages:
            self.message_time = now
            _LOG.warning("Still compiling: kernel %d, after %.0f s.", self.n_compiled + 1, now - self.start_time)
        self.n_compiled += 1

    def on_end(self, event: Any) -> None:
        pass

    def report_not_cached(self, reason: str) -> None:
        """Log once why machine code cannot be cached, unless other listeners are registered."""
        if not (self.not_cached_reason or self.listeners or multiprocessing.parent_process() is not None):
            _LOG.warning("Compiled kernels cannot be cached: %s.", reason)
        self.not_cached_reason = reason


_CACHED_MESSAGE = (
    "Compiling kernels for this machine, which takes about a minute in all (cached for later runs);"
    " 'cornercase warm-up' compiles all in advance."
)
_NO_CACHE_FOLDER_MESSAGE = "no cache folder is writable; set NUMBA_CACHE_DIR to one that is"
_NOT_CACHED_MESSAGE = "Compiling kernels in each process anew; set NUMBA_CACHE_DIR to a writable folder to cache them."
_COMPILATION_LISTENER = _CompilationListener()
event.register("numba:compile", _COMPILATION_LISTENER)


@contextmanager
def listen_to_compilation(listener: Callable[[str], None]) -> Iterator[None]:
    """Within the block, call `listener` with ``"module.name"`` of each kernel that numba compiles; log no warning."""
    _COMPILATION_LISTENER.listeners.append(listener)
    try:
        with compile_at_once():
            yield
    finally:
        _COMPILATION_LISTENER.listeners.remove(listener)


@contextmanager
def call_on_first_compilation(callback: Callable[[], None]) -> Iterator[None]:
    """Within the block, call `callback` once, when numba first compiles a kernel that will be cached."""
    _COMPILATION_LISTENER.start_callbacks.append(callback)
    try:
        yield
    finally:
        with suppress(ValueError):
            _COMPILATION_LISTENER.start_callbacks.remove(callback)


def count_ready_kernels() -> tuple[int, int]:
    """Return how many of the imported kernels are compiled or loaded, and how many are imported."""
    kernels = list(_KERNELS)
    return sum(function.is_compiled for function in kernels), len(kernels)


def reason_not_cached() -> str:
    """Return why machine code could not be cached; empty if it was cached, or if nothing was compiled."""
    return _COMPILATION_LISTENER.not_cached_reason
