"""Run a simulator in worker processes, so that crashes and hangs cost only the scenario at fault."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from multiprocessing.connection import wait
from typing import Any, Final

from cornercase._common.errors import InputError, RunLostError, SimulationError, SimulatorError
from cornercase._common.process.reaper import Reaper
from cornercase._common.text.sanitize import quote_name
from cornercase.drivers._serialization import user_driver_spec
from cornercase.scenario import ConcreteScenario
from cornercase.simulators._base import Simulator
from cornercase.simulators._remote import RemoteSimulator
from cornercase.simulators._results import Outcome
from cornercase.simulators._run_options import DEFAULT_MAX_FAILURES
from cornercase.simulators.pool._process import NoticeMessage, WorkerProcess, WorkerTask

# In s.
_MAX_SINGLE_WAIT: Final = 3600.0


@dataclass
class _FailureCount:
    """Number of consecutive scenarios without a result, shared by all worker processes."""

    count: int = 0


class WorkerSimulator(RemoteSimulator):
    """Simulator in worker processes, each with its own instance; the number of processes does not change results.

    If the simulator is `batched`, each process gets an equal share of the scenarios as one batch, otherwise one
    scenario at a time. If the simulator crashes or hangs in a batch, the scenarios without a result are run again one
    by one. `timeout` is in s per scenario; the start of the simulator may take a minute. A scenario in which the
    simulator fails (crash, hang or `SimulatorError`) is run again up to `retries` times, and at least once if its
    process was killed from outside. `max_failures` consecutive failures of this kind end the run (0: no limit).
    """

    def __init__(
        self,
        name: str | type[Simulator],
        options: dict[str, Any],
        workers: int = 1,
        timeout: float | None = None,
        retries: int = 1,
        max_failures: int = DEFAULT_MAX_FAILURES,
    ) -> None:
        super().__init__(name, options)
        self._max_failures, self._process_description = max_failures, _describe_process(options)
        self._batched, self._retries = self.simulator_class.batched, retries
        numbered = "worker" in self.simulator_class.requires
        self._reaper = Reaper()
        self._workers = [
            WorkerProcess(name, options | ({"worker": k} if numbered else {}), timeout, self._reaper)
            for k in range(workers)
        ]
        self._consecutive_failures = _FailureCount()
        self._single_process_simulators: list[WorkerSimulator] = []

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Outcome]:
        """Run scenarios like `Simulator.run`; also raise `InputError` after `max_failures` consecutive failures."""
        size = -(-len(concretes) // len(self._workers)) if self._batched and concretes else 1
        indices = range(len(concretes))
        waiting = deque(WorkerTask(tuple(indices[k : k + size])) for k in indices[::size])
        done: dict[int, Outcome] = {}
        n_yielded = 0
        try:
            while n_yielded < len(concretes):
                for worker in self._workers:
                    if not worker.remaining and waiting:
                        worker.start_task(waiting.popleft(), concretes)
                for worker in self._wait_for_workers():
                    self._handle_message(worker, waiting, done)
                while n_yielded in done:
                    yield done.pop(n_yielded)
                    n_yielded += 1
        finally:
            for worker in self._workers:
                if worker.remaining:
                    worker.stop()

    def parallel_instances(self) -> Sequence[WorkerSimulator]:
        """Return one simulator per worker process; `close` of this simulator closes all."""
        if not self._single_process_simulators:
            self._single_process_simulators = [copy(self) for _ in self._workers]
            for single, worker in zip(self._single_process_simulators, self._workers, strict=True):
                single._workers, single._single_process_simulators = [worker], []
        return self._single_process_simulators

    def cancel(self) -> None:
        """Kill the processes at once, even while another thread waits for them; no scenario is retried."""
        self._retries = -1
        for worker in self._workers:
            worker.kill()

    def close(self) -> None:
        """End the processes; an idle process closes its simulator first."""
        for worker in self._workers:
            worker.close_connection()
        for worker in self._workers:
            worker.wait_until_ended()
        self._reaper.close()
        super().close()

    def _wait_for_workers(self) -> list[WorkerProcess]:
        """Wait until workers have sent a message or exceeded their deadline; return these workers."""
        busy = [worker for worker in self._workers if worker.remaining]
        deadline = min(worker.deadline for worker in busy)
        # Operating systems limit the time of a single wait.
        remaining = None if deadline == float("inf") else min(max(0.0, deadline - time.monotonic()), _MAX_SINGLE_WAIT)
        readable = wait([worker.connection for worker in busy], remaining)
        return [worker for worker in busy if worker.connection in readable or worker.deadline <= time.monotonic()]

    def _handle_message(self, worker: WorkerProcess, waiting: deque[WorkerTask], done: dict[int, Outcome]) -> None:
        task, remaining = worker.task, tuple(worker.remaining)
        try:
            answer = worker.receive()
        except (EOFError, OSError) as error:
            worker.stop()
            failure = (
                SimulatorError(str(error))
                if isinstance(error, TimeoutError)
                else worker.describe_exit(self._process_description)
            )
            self._retry_or_fail(task, remaining, failure, waiting, done)
            return
        if answer is None:
            return
        if isinstance(answer, NoticeMessage):
            self.notify([answer.sentence])
            return
        if isinstance(answer, InputError):
            worker.remaining = []
            raise answer
        if isinstance(answer, SimulatorError):
            self._retry_or_fail(task, remaining[:1], answer, waiting, done, is_own_result=True)
        else:
            self._consecutive_failures.count = 0
            done[remaining[0]] = answer

    def _retry_or_fail(
        self,
        task: WorkerTask,
        remaining: tuple[int, ...],
        failure: SimulationError,
        waiting: deque[WorkerTask],
        done: dict[int, Outcome],
        *,
        is_own_result: bool = False,
    ) -> None:
        """Run the remaining scenarios of a failed task again, or record the failure as their result.

        If a batch failed, the scenario at fault is unknown, so each scenario is run alone. With `is_own_result`, the
        failure is the result of the first remaining scenario.
        """
        if len(task.indices) > 1 and not is_own_result:
            waiting.extendleft(WorkerTask((k,)) for k in reversed(remaining))
            return
        (index,) = remaining
        # A process that was killed from outside is no reason to fail a scenario without a retry.
        retries = 1 if self._retries == 0 and isinstance(failure, RunLostError) else self._retries
        if not isinstance(failure, SimulatorError):
            self._consecutive_failures.count = 0
            done[index] = failure
        elif task.tries < retries:
            waiting.appendleft(WorkerTask((index,), task.tries + 1))
        else:
            self._consecutive_failures.count += 1
            if 0 < self._max_failures <= self._consecutive_failures.count:
                raise InputError(
                    f"The simulator '{self.name}' gave no result in"
                    f" {self._consecutive_failures.count} scenarios in a row"
                    f" (`max_failures`); in the last one {failure}. Fix the cause, and run the same command again to"
                    " resume."
                )
            times = "once" if task.tries == 0 else f"{task.tries + 1} times"
            error_class = RunLostError if isinstance(failure, RunLostError) else SimulationError
            done[index] = error_class(f"{failure}, tried {times}")


def _describe_process(options: Mapping[str, Any]) -> str:
    """Return a description of a simulator's process that names the user's own drivers, which may have ended it."""
    drivers = [
        f"the driver of {quote_name(entity)} ({name})"
        for entity, driver in (options.get("drivers") or {}).items()
        if (name := user_driver_spec(driver)) is not None
    ]
    return f"the process of the simulator and of {' and '.join(drivers)}" if drivers else "the simulator's process"
