"""Kill a simulator on purpose while it runs scenarios, to check that later scenarios run."""

from __future__ import annotations

import math
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import psutil

from cornercase._common.configurable import declared_options
from cornercase._common.errors import SimulationError
from cornercase._common.platform import kill_process_tree
from cornercase.recordings import Recording
from cornercase.recordings._compare import max_position_difference
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import SIMULATORS
from cornercase.simulators._create import create_simulator
from cornercase.simulators._results import Outcome, run_scenarios
from cornercase.testing._contract_check import NotTriedError

# Total duration in s of the runs, which leaves time for a crash, and smallest and largest number of runs.
_RUN_TIME, _MIN_SCENARIOS, _MAX_SCENARIOS = 2.0, 3, 200
# The crash is in the middle of the second scenario.
_CRASH_AFTER: Final = 1.5
# s after which a killed process must have ended.
_DEATH_TIMEOUT: Final = 5.0


@dataclass(frozen=True)
class SimulatorCrashResult:
    """Results of several runs of the same scenario; during the runs, the simulator was killed once."""

    killed: str  # command line of the process that was killed
    is_server: bool  # True if a server was killed, False if the worker process that runs scenarios
    n_before: int  # number of runs that had ended before the crash
    seconds: tuple[float, ...]  # duration of each run
    first: Recording  # recording of the scenario before the crash
    outcomes: tuple[Outcome, ...]  # recording or error of each run

    @property
    def n_lost(self) -> int:
        """Number of runs that failed."""
        return sum(isinstance(outcome, SimulationError) for outcome in self.outcomes)

    @property
    def spread(self) -> float | None:
        """Largest distance in m between positions in any run and in `first`; None if a run cannot be compared."""
        largest = 0.0
        for outcome in self.outcomes:
            distance = None if isinstance(outcome, SimulationError) else max_position_difference(self.first, outcome)
            if distance is None:
                return None
            largest = max(largest, distance)
        return largest


def crash_during_runs(simulator: str, concrete: ConcreteScenario, ego: str) -> SimulatorCrashResult:
    """Run a scenario again and again, and kill the simulator once meanwhile.

    If the worker process has started a server of the simulator, the server is killed, otherwise the worker process
    itself. Raises `NotTriedError` if the server was started outside cornercase, or if all runs ended before the crash.
    """
    if "start" in declared_options(SIMULATORS.get_class(simulator)) and "start=" not in simulator:
        raise NotTriedError(
            "The simulator's server was not started by cornercase; set the simulator's option `start` to the command"
            " that starts the server."
        )
    own = psutil.Process()
    others = {process.pid for process in own.children(recursive=True)}
    with create_simulator(simulator, {}, ego=ego, workers=1) as started:
        (first,) = run_scenarios(started, [concrete])
        if isinstance(first, SimulationError):
            raise AssertionError(f"A scenario failed: {first}.")
        begin = time.perf_counter()
        list(run_scenarios(started, [concrete]))
        seconds = time.perf_counter() - begin
        count = min(max(_MIN_SCENARIOS, math.ceil(_RUN_TIME / max(seconds, 1e-3))), _MAX_SCENARIOS)
        victim, is_server = _find_process_to_kill(own, others)
        command = " ".join(victim.cmdline())
        outcomes, durations, n_before = list[Outcome](), list[float](), list[int]()

        def kill() -> None:
            n_before.append(len(outcomes))
            kill_process_tree(victim.pid)

        killer = threading.Timer(_CRASH_AFTER * seconds, kill)
        killer.start()
        try:
            begin = time.perf_counter()
            for outcome in run_scenarios(started, [concrete] * count):
                outcomes.append(outcome)
                durations.append(time.perf_counter() - begin)
                begin = time.perf_counter()
        finally:
            killer.cancel()
            killer.join()
        if not n_before or n_before[0] == count:
            raise NotTriedError("All scenarios had ended before the simulator could be killed; run the check again.")
        assert _is_gone(victim), "It goes on running after it was killed."
    return SimulatorCrashResult(command, is_server, n_before[0], tuple(durations), first, tuple(outcomes))


def _is_gone(process: psutil.Process) -> bool:
    """Return whether a process has ended, also if the process is still listed as a zombie."""
    with suppress(psutil.Error):
        try:
            process.wait(_DEATH_TIMEOUT)
        except psutil.TimeoutExpired:
            return process.status() == psutil.STATUS_ZOMBIE
    return True


def _find_process_to_kill(own: psutil.Process, others: set[int]) -> tuple[psutil.Process, bool]:
    """Return the process to kill, and whether it is a server.

    The server is the oldest process that a worker process has started. Without a server, the worker is returned.
    `others` are the ids of child processes that existed before the workers.
    """
    workers = [process for process in own.children() if process.pid not in others and _is_worker(process)]
    assert workers, "It runs in no process of its own."
    servers = [child for worker in workers for child in worker.children()]
    return min(servers or workers, key=lambda process: process.create_time()), bool(servers)


def _is_worker(process: psutil.Process) -> bool:
    """Return whether a process was started by `multiprocessing` to run scenarios."""
    with suppress(psutil.Error):
        return any("spawn_main" in word for word in process.cmdline())
    return False
