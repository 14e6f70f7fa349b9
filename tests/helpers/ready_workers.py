"""Worker processes that have imported everything when they start.

A worker process imports the package and loads kernels for two seconds, most of what a test with workers takes. Here
they are forked from a process that has done so. They get the environment, the folder and the module search path of the
moment, as spawned ones do.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import forkserver, get_all_start_methods, get_context
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import psutil
import pytest

from cornercase.simulators.pool import _process


@contextmanager
def fork_workers() -> Iterator[None]:
    """Within the block, fork worker processes where the platform can; else spawn them, as users do."""
    if "forkserver" not in get_all_start_methods() or os.uname().sysname != "Linux":
        yield
        return
    # What a test sets for itself does not hold for the process that is forked.
    environment = dict(os.environ)
    environment["PYTHONPATH"] = os.pathsep.join(
        filter(None, [str(Path(__file__).parents[1]), environment.get("PYTHONPATH")])
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_process, "get_context", lambda _: _Context(environment))
        yield


@contextmanager
def spawn_workers() -> Iterator[None]:
    """Within the block, spawn worker processes as users do."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_process, "get_context", get_context)
        yield


class _Context:
    """What the pool uses of a context of multiprocessing."""

    def __init__(self, environment: dict[str, str]) -> None:
        self._context, self._environment = get_context("forkserver"), environment
        self.Pipe = self._context.Pipe

    def Process(self, *, target: Callable[..., Any], args: tuple[Any, ...], daemon: bool) -> BaseProcess:  # noqa: N802
        self._context.set_forkserver_preload(["helpers.ready_worker"])
        own = dict(os.environ)
        _set_environment(self._environment)
        try:
            forkserver.ensure_running()
        finally:
            _set_environment(own)
        return self._context.Process(target=_work, args=(own, target, args), daemon=daemon)


def _work(environment: dict[str, str], target: Callable[..., Any], args: tuple[Any, ...]) -> None:
    _set_environment(environment)
    target(*args)


def _set_environment(environment: dict[str, str]) -> None:
    os.environ.clear()
    os.environ.update(environment)


def forked_seconds() -> float:
    """Seconds of the processor of the process that is forked, and of all workers that have ended."""
    number = getattr(getattr(forkserver, "_forkserver", None), "_forkserver_pid", None)
    try:
        return sum(psutil.Process(number).cpu_times()[:4]) if number else 0.0
    except psutil.NoSuchProcess:
        return 0.0
