"""Kernels whose machine code is kept on a machine, also when many processes start together."""

# The part of numba that is used here has no types.
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
        try:
            with held_lock(self._lock_path()):
                super().save_overload(sig, data)
        except OSError as error:
            # A disk that is full keeps nobody from what has been compiled.
            _WATCH.tell_unkept(f"{self.cache_path}: {error.strerror}")

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
        _KERNELS.add(compiled)
        return cast(Callable[..., Any], compiled)

    return decorate


class _Watch(event.Listener):
    """Hears of each kernel that numba begins to compile; without anybody else who listens, it says so once.

    The message is a warning of the logger ``cornercase._common.compiling``, which Python shows on standard error where
    no logging is set up. Worker processes leave the saying to the one that started them.
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
        kept = isinstance(kernel._cache, _SharedCache)
        if not kept:
            self.unkept = _NO_FOLDER
        while kept and self.companions:
            self.companions.pop()()
        for listener in self.listeners:
            listener(f"{kernel.py_func.__module__.removeprefix('cornercase.')}.{kernel.py_func.__name__}")
        if not (self.listeners or self.said):
            self.said = True
            _LOG.warning(_KEPT if kept else _NOT_KEPT)

    def on_end(self, event: Any) -> None:
        pass

    def tell_unkept(self, why: str) -> None:
        """Say once why machine code is not kept, where nobody else listens."""
        if not (self.unkept or self.listeners or multiprocessing.parent_process() is not None):
            _LOG.warning("What is compiled cannot be kept: %s.", why)
        self.unkept = why


_KEPT = "Compiling for this machine, kept for the next time; 'cornercase warm-up' does all of it ahead."
_NO_FOLDER = "there is no folder that can be written; NUMBA_CACHE_DIR can name one"
_NOT_KEPT = "Compiling, in each process anew: NUMBA_CACHE_DIR can name a folder to keep it in."
_WATCH = _Watch()
event.register("numba:compile", _WATCH)


@contextmanager
def heard_compilation(listener: Callable[[str], None]) -> Iterator[None]:
    """Tell a listener which kernels are compiled within the block, instead of the user.

    Parameters
    ----------
    listener : callable
        Called with a kernel's module and name whenever numba begins to compile it.

    Yields
    ------
    None
    """
    _WATCH.listeners.append(listener)
    try:
        yield
    finally:
        _WATCH.listeners.remove(listener)


@contextmanager
def companion(start: Callable[[], None]) -> Iterator[None]:
    """Call something once when numba begins to compile within the block, and keeps what it compiles.

    Parameters
    ----------
    start : callable
        Such as what has another process compile what this one needs later.

    Yields
    ------
    None
    """
    _WATCH.companions.append(start)
    try:
        yield
    finally:
        with suppress(ValueError):
            _WATCH.companions.remove(start)


def count_kernels() -> tuple[int, int]:
    """Count the kernels of the modules that have been imported.

    Returns
    -------
    tuple of (int, int)
        Those that are ready to run, compiled or read from the disk, and all.
    """
    known = list(_KERNELS)
    return sum(bool(one.signatures) for one in known), len(known)


def why_not_kept() -> str:
    """Say why machine code that this process has compiled could not be kept.

    Returns
    -------
    str
        Empty where it was, or where nothing was compiled.
    """
    return _WATCH.unkept
