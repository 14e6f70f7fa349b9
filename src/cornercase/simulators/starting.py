"""Create a simulator by name, in this process or in processes of its own."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from multiprocessing import current_process
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from cornercase._common.arguments import number, text, whole_number
from cornercase.drivers import given_name
from cornercase.simulators.base import Simulator
from cornercase.simulators.cluster import ClusterSimulator
from cornercase.simulators.common_options import take_options
from cornercase.simulators.registry import SIMULATORS
from cornercase.simulators.workers import MOST_FAILURES, MOST_WORKERS, WorkerSimulator

if TYPE_CHECKING:
    from distributed import Client

_GUARD: Final = re.compile(r"""__name__\s*==\s*["']__main__["']|["']__main__["']\s*==\s*__name__""")


def start_simulator(
    name: str,
    options: Mapping[str, Any] | None = None,
    *,
    ego: str = "Ego",
    workers: int = 1,
    timeout: float | None = None,
    retries: int = 1,
    cluster: str | Client | None = None,
    max_failures: int = MOST_FAILURES,
) -> Simulator:
    """Create a simulator by name (options after a colon), in this process, in worker processes or on a Dask cluster.

    A simulator with `in_process` runs in this process unless there are several workers, a time-out or a user's driver
    given by name. Otherwise it runs in worker processes, where a crash or hang costs only the scenario at fault.
    Drivers given as objects need no worker process, since they may not be picklable. Nor do drivers by name in a script
    without ``__name__ == "__main__"``, which would start again in the worker process.

    Of `options` (``time_step``, ``duration``, ``on_collision``, ``drivers``; picklable) it gets those that its
    constructor declares; `timeout` is in s per scenario. Raises `InputError` for an unknown simulator, values out of
    range, or undeclared drivers or ``on_collision``; warns if a time step or duration has no effect.

    >>> from cornercase.simulators import start_simulator
    >>> with start_simulator("builtin", {"duration": 20.0}) as simulator:
    ...     simulator.settings["duration"]
    20.0
    """
    timeout = None if timeout is None else number("timeout", timeout, above=0.0)
    workers = whole_number("workers", workers, 1, MOST_WORKERS)
    retries, max_failures = whole_number("retries", retries), whole_number("max_failures", max_failures)
    simulator_class = SIMULATORS.class_of(text("simulator", name))
    accepted = take_options(name, simulator_class, options or {}) | (
        {"ego": ego} if "ego" in simulator_class.needs else {}
    )
    if cluster is not None:
        return ClusterSimulator(name, accepted, cluster, workers, timeout, retries, max_failures)
    if (
        simulator_class.in_process
        and workers == 1
        and timeout is None
        and not (_has_given_driver(accepted) and _may_start())
    ):
        return SIMULATORS.create(name, **accepted)
    return WorkerSimulator(name, accepted, workers, timeout, retries, max_failures)


def _has_given_driver(options: Mapping[str, Any]) -> bool:
    """Return whether a user named a driver that does not come with cornercase."""
    return any(given_name(driver) is not None for driver in (options.get("drivers") or {}).values())


def _may_start() -> bool:
    """Return whether this process can start others without running the user's script again."""
    if current_process().daemon:
        return False
    script = getattr(sys.modules.get("__main__"), "__file__", None)
    if script is None:
        return True
    try:
        return _GUARD.search(Path(script).read_text(encoding="utf-8", errors="replace")) is not None
    except OSError:
        return True
