"""A simulator by name, ready to run: in this process or in processes of its own."""

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
    """Make a simulator that runs where it has to.

    One that declares that it may, and has neither company nor a time-out nor a driver that somebody else wrote, runs in
    this process. All others run in worker processes, where a crash or a hang costs the one scenario that is at fault,
    or on a cluster. A driver that is given as an object is no reason for a worker process, since it need not be
    possible to send it there; nor is one in a script that does not ask for ``__name__ == "__main__"``, which would
    begin anew in the worker process.

    Parameters
    ----------
    name : str
        Registered simulator, with options after a colon if need be: ``"esmini:seed=3"``.
    options : mapping, optional
        Keyword arguments that all simulators are offered: ``time_step``, ``duration``, ``on_collision``, ``drivers``;
        their values have to be picklable. A simulator gets those that its constructor declares.
    ego : str, default "Ego"
        Entity under test, for a simulator that needs to know it.
    workers : int, default 1
        Simulators side by side.
    timeout : float, optional
        s after which a scenario is given up.
    retries : int, default 1
        How often a scenario is run again after the simulator died or hung.
    cluster : str or distributed.Client, optional
        Dask cluster to run on: ``"local"``, the address of a scheduler, the file that a scheduler wrote, or a
        connection that stays open.
    max_failures : int, default 5
        Scenarios in a row in which the simulator dies or hangs, after which it is not tried any more; 0 for no limit.

    Returns
    -------
    Simulator
        To be closed, best as a context manager.

    Raises
    ------
    InputError
        There is no such simulator, it cannot run here, an option is out of range, or drivers or an end at collisions
        are asked for of one whose constructor does not declare them.

    Warns
    -----
    NoticeWarning
        A time step or duration has no effect, since the constructor does not declare it.

    Examples
    --------
    >>> from cornercase.simulators import start_simulator
    >>> with start_simulator("builtin", {"duration": 20.0}) as simulator:
    ...     simulator.settings["duration"]
    20.0
    """
    timeout = None if timeout is None else number("timeout", timeout, above=0.0)
    workers = whole_number("workers", workers, 1, MOST_WORKERS)
    retries, max_failures = whole_number("retries", retries), whole_number("max_failures", max_failures)
    declared = SIMULATORS.class_of(text("simulator", name))
    given = take_options(name, declared, options or {}) | ({"ego": ego} if "ego" in declared.needs else {})
    if cluster is not None:
        return ClusterSimulator(name, given, cluster, workers, timeout, retries, max_failures)
    if declared.in_process and workers == 1 and timeout is None and not (_has_given_driver(given) and _may_start()):
        return SIMULATORS.create(name, **given)
    return WorkerSimulator(name, given, workers, timeout, retries, max_failures)


def _has_given_driver(options: Mapping[str, Any]) -> bool:
    """Whether a user gave the name of a driver that does not come with cornercase."""
    return any(given_name(driver) is not None for driver in (options.get("drivers") or {}).values())


def _may_start() -> bool:
    """Whether this process can start others without beginning a script of the user anew."""
    if current_process().daemon:
        return False
    script = getattr(sys.modules.get("__main__"), "__file__", None)
    if script is None:
        return True
    try:
        return _GUARD.search(Path(script).read_text(encoding="utf-8", errors="replace")) is not None
    except OSError:
        return True
