"""Let a simulator crash on purpose while it runs scenarios."""

from __future__ import annotations

import math
import threading
import time
from contextlib import suppress

import psutil

from cornercase._common.configurable import declared_options
from cornercase._common.errors import SimulationError
from cornercase._common.platform import kill_process_tree
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import SIMULATORS
from cornercase.simulators._create import create_simulator
from cornercase.simulators._results import Outcome, run_scenarios
from cornercase.testing._contract_check import NotTriedError

# s that scenarios should run, so that there is time for a crash, and how many there are at most.
_RUN_TIME, _MAX_SCENARIOS = 2.0, 200


def crash_during_runs(simulator: str, concrete: ConcreteScenario, ego: str) -> tuple[Recording, list[Outcome]]:
    """Run a scenario, then again while the simulator is killed; return the first and the later outcomes.

    If the simulator is a server that its worker process has started, the server is killed, else the worker process.
    Raises `NotTriedError` if the server was started by somebody else.
    """
    if "start" in declared_options(SIMULATORS.get_class(simulator)) and "start=" not in simulator:
        raise NotTriedError("cornercase has not started its server; let it do so by the option start.")
    own = psutil.Process()
    others = {process.pid for process in own.children(recursive=True)}
    with create_simulator(simulator, {}, ego=ego, workers=1) as started:
        (first,) = run_scenarios(started, [concrete])
        if isinstance(first, SimulationError):
            raise AssertionError(f"A scenario failed: {first}.")
        begin = time.perf_counter()
        list(run_scenarios(started, [concrete]))
        seconds = time.perf_counter() - begin
        count = min(max(2, math.ceil(_RUN_TIME / max(seconds, 1e-3))), _MAX_SCENARIOS)
        victim = _find_server(own, others)
        killer = threading.Timer(0.5 * seconds * min(count, 3), _kill, [victim])
        killer.start()
        try:
            outcomes = list(run_scenarios(started, [concrete] * count))
        finally:
            killer.cancel()
            killer.join()
    return first, outcomes


def _find_server(own: psutil.Process, others: set[int]) -> psutil.Process:
    """Return the oldest process that a worker process of this one has started, else the worker process."""
    workers = [process for process in own.children() if process.pid not in others and _is_worker(process)]
    assert workers, "It runs in no process of its own."
    servers = [child for worker in workers for child in worker.children()]
    return min(servers or workers, key=lambda process: process.create_time())


def _is_worker(process: psutil.Process) -> bool:
    """Return whether it is a process of `multiprocessing` that runs scenarios."""
    with suppress(psutil.Error):
        return any("spawn_main" in word for word in process.cmdline())
    return False


def _kill(process: psutil.Process) -> None:
    kill_process_tree(process.pid)
