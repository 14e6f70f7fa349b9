"""Deliver Ctrl-C and termination requests reliably, even from compiled code and callbacks that swallow exceptions."""

from __future__ import annotations

import _thread
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, Final

from cornercase._common.platform import termination_signals

_last_signal: int = signal.SIGINT
# Termination requests received by handlers of this module, and whether Ctrl-C is counted now.
_n_requests = 0
_is_counting = False
# Whether an interrupt was lost and has to be delivered again; seconds until then.
_is_lost_pending = False
_REDELIVERY_DELAY: Final = 0.005


def install_signal_handlers() -> None:
    """Make termination signals raise `KeyboardInterrupt`, like Ctrl-C. Call it in the main thread of a program.

    `KeyboardInterrupt` is raised again if it was lost: Python ignores it in a destructor, and compiled code can replace
    it by another error, as NumPy does while it is imported. Signals that were ignored before, as by ``nohup``, stay
    ignored.
    """
    for name in ("unraisablehook", "excepthook"):
        if not isinstance(usual := getattr(sys, name), _LostInterruptHook):
            setattr(sys, name, _LostInterruptHook(usual))
    for number in termination_signals():
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _handle_signal)


def last_signal() -> signal.Signals:
    """Return the signal that caused the last `KeyboardInterrupt`; SIGINT by default."""
    return signal.Signals(_last_signal)


def count_termination_requests() -> int:
    """Return the number of termination requests received so far; see `is_termination_request`."""
    return _n_requests


def is_termination_request(error: BaseException, n_requests_before: int) -> bool:
    """Return whether an exception of a plug-in was caused by a termination request, and not by the plug-in itself.

    `n_requests_before` is the result of `count_termination_requests` before the plug-in ran. The result is right even
    if the plug-in replaced the `KeyboardInterrupt` by another error. Ctrl-C is only counted within the block of
    `collect_interrupts`; outside of the block, every `KeyboardInterrupt` is taken for a request, unless Ctrl-C is
    ignored. Outside the main thread, the result is False.
    """
    if threading.current_thread() is not threading.main_thread():
        return False
    if _n_requests > n_requests_before:
        return True
    counted = _is_counting or signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    return isinstance(error, KeyboardInterrupt) and not counted


def _handle_signal(number: int, frame: FrameType | None) -> None:
    global _last_signal, _is_lost_pending, _n_requests
    _last_signal, _is_lost_pending, _n_requests = number, False, _n_requests + 1
    raise KeyboardInterrupt


class _LostInterruptHook:
    """Exception hook that raises an interrupt again if Python ignored it or only printed it."""

    def __init__(self, original_hook: Callable[..., object]) -> None:
        self._original_hook = original_hook

    def __call__(self, ignored: Any, *printed: Any) -> None:
        if issubclass(ignored if printed else ignored.exc_type, KeyboardInterrupt):
            _schedule_redelivery()
        else:
            self._original_hook(ignored, *printed)


def _schedule_redelivery() -> None:
    global _is_lost_pending
    _is_lost_pending = True
    # Raised here, it would be ignored again. `threading` is avoided, as the main thread may hold its locks here.
    with suppress(RuntimeError):
        _thread.start_new_thread(_redeliver_interrupt, ())


def _redeliver_interrupt() -> None:
    time.sleep(_REDELIVERY_DELAY)
    # It may have been handled meanwhile.
    if _is_lost_pending:
        _thread.interrupt_main(last_signal())


def pop_lost_interrupt() -> bool:
    """Return whether an interrupt was lost, and cancel its redelivery, because the caller handles the interrupt."""
    global _is_lost_pending
    lost, _is_lost_pending = _is_lost_pending, False
    return lost


@contextmanager
def collect_interrupts() -> Iterator[Callable[[], None]]:
    """Within the block, remember interrupts, because compiled code that calls Python callbacks may drop the exception.

    Yields a function to call from time to time. This function raises `KeyboardInterrupt` if an interrupt came since the
    last call. Nothing is remembered outside the main thread, or for signals with a handler of the user's program.
    """
    global _is_counting
    usual_handlers = {signal.SIGINT: signal.default_int_handler, **dict.fromkeys(termination_signals(), _handle_signal)}
    pending = False

    def handle_signal(number: int, frame: FrameType | None) -> None:
        global _n_requests
        nonlocal pending
        pending, _n_requests = True, _n_requests + 1
        usual_handlers[signal.Signals(number)](number, frame)

    def raise_if_interrupted() -> None:
        global _is_lost_pending
        nonlocal pending
        if pending:
            pending = _is_lost_pending = False
            raise KeyboardInterrupt

    in_main_thread = threading.current_thread() is threading.main_thread()
    replaced = [
        number for number, handler in usual_handlers.items() if in_main_thread and signal.getsignal(number) is handler
    ]
    counted_before = _is_counting
    _is_counting = _is_counting or signal.SIGINT in replaced
    for number in replaced:
        signal.signal(number, handle_signal)
    try:
        yield raise_if_interrupted
    except Exception as error:
        # Compiled code may replace the interrupt by its own error.
        if pending:
            raise KeyboardInterrupt from error
        raise
    finally:
        _is_counting = counted_before
        for number in replaced:
            signal.signal(number, usual_handlers[number])


@contextmanager
def defer_interrupts() -> Iterator[None]:
    """Defer interrupts to the end of the block.

    A signal mask alone is not enough: the system delivers the signal to any thread that accepts it, and Python raises
    the exception in the main thread.
    """
    deferred: list[int] = []
    in_main_thread = threading.current_thread() is threading.main_thread()
    handlers = {
        number: signal.getsignal(number) for number in (signal.SIGINT, *termination_signals()) if in_main_thread
    }
    replaced = {number: handler for number, handler in handlers.items() if callable(handler)}
    for number in replaced:
        signal.signal(number, lambda number, frame: deferred.append(number))
    try:
        yield
    finally:
        for number, handler in replaced.items():
            signal.signal(number, handler)
        for first in deferred[:1]:
            signal.raise_signal(first)
