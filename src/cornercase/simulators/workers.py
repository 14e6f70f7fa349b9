"""Run a simulator in worker processes, so that crashes and hangs cost only the scenario at fault."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from multiprocessing.connection import wait
from typing import Any, Final

from cornercase._common.errors import InputError, LostError, SimulationError, SimulatorError
from cornercase._common.guardian import Guardian
from cornercase._common.texts import quoted_name
from cornercase.drivers import given_name
from cornercase.scenario import ConcreteScenario
from cornercase.simulators.elsewhere import SimulatorElsewhere
from cornercase.simulators.outcomes import Outcome
from cornercase.simulators.worker_process import Noticed, Task, Worker

MOST_FAILURES: Final = 5
"""Default number of consecutive failures after which the simulator, not the scenarios, is considered at fault."""
# In s.
_LONGEST_WAIT: Final = 3600.0
MOST_WORKERS: Final = 1024
"""Maximum number of worker processes: more than any machine has cores, and few enough to be started."""


@dataclass
class _Lost:
    """Number of consecutive scenarios without a result, over all processes."""

    count: int = 0


class WorkerSimulator(SimulatorElsewhere):
    """Runs concrete scenarios in worker processes, each with its own simulator.

    A simulator with `batched` gets an equal share of the scenarios per process, any other gets one at a time. If a
    batch crashes or hangs, its scenarios without a result are run again one by one, so that only the one at fault
    fails. Results do not depend on the number of workers.

    `options` must be picklable. `timeout` is in s per scenario; the simulator has another minute to start. `retries`
    counts further runs after the simulator failed (its process ended, hung, or lost its program); if the process was
    killed from outside, there is at least one. `max_failures` consecutive failures end the run (0: no limit).

    >>> from cornercase.simulators import WorkerSimulator
    >>> with WorkerSimulator("builtin", {"duration": 20.0}, workers=4, timeout=30.0) as simulator:
    ...     recordings = list(simulator.run([]))
    >>> recordings
    []
    """

    def __init__(
        self,
        name: str,
        options: dict[str, Any],
        workers: int = 1,
        timeout: float | None = None,
        retries: int = 1,
        max_failures: int = MOST_FAILURES,
    ) -> None:
        super().__init__(name, options)
        self._max_failures, self._process = max_failures, _name_process(options)
        self._batches, self._retries = self.declared.takes_batches, retries
        numbered = "worker" in self.declared.needs
        self._guardian = Guardian()
        self._workers = [
            Worker(name, options | ({"worker": k} if numbered else {}), timeout, self._guardian) for k in range(workers)
        ]
        self._lost = _Lost()
        self._each: list[WorkerSimulator] = []

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Outcome]:
        """Run scenarios, as `Simulator.run`; `InputError` also after `max_failures` consecutive failures."""
        size = -(-len(concretes) // len(self._workers)) if self._batches and concretes else 1
        indices = range(len(concretes))
        waiting = deque(Task(tuple(indices[k : k + size])) for k in indices[::size])
        done: dict[int, Outcome] = {}
        n_yielded = 0
        try:
            while n_yielded < len(concretes):
                for worker in self._workers:
                    if not worker.waiting and waiting:
                        worker.give(waiting.popleft(), concretes)
                for worker in self._ready():
                    self._take(worker, waiting, done)
                while n_yielded in done:
                    yield done.pop(n_yielded)
                    n_yielded += 1
        finally:
            for worker in self._workers:
                if worker.waiting:
                    worker.stop()

    def beside(self) -> Sequence[WorkerSimulator]:
        """Return one simulator per process; they are closed with this one."""
        if not self._each:
            self._each = [copy(self) for _ in self._workers]
            for single, worker in zip(self._each, self._workers, strict=True):
                single._workers, single._each = [worker], []
        return self._each

    def give_up(self) -> None:
        """Kill the processes at once, even if another thread waits for them; nothing is retried."""
        self._retries = -1
        for worker in self._workers:
            worker.kill()

    def close(self) -> None:
        """End the processes; idle ones close their simulator first."""
        for worker in self._workers:
            worker.hang_up()
        for worker in self._workers:
            worker.wait()
        self._guardian.close()
        super().close()

    def _ready(self) -> list[Worker]:
        """Wait for workers that have an answer or exceeded their deadline."""
        busy = [worker for worker in self._workers if worker.waiting]
        deadline = min(worker.deadline for worker in busy)
        # Operating systems limit the time of a single wait.
        remaining = None if deadline == float("inf") else min(max(0.0, deadline - time.monotonic()), _LONGEST_WAIT)
        readable = wait([worker.connection for worker in busy], remaining)
        return [worker for worker in busy if worker.connection in readable or worker.deadline <= time.monotonic()]

    def _take(self, worker: Worker, waiting: deque[Task], done: dict[int, Outcome]) -> None:
        task, remaining = worker.task, tuple(worker.waiting)
        try:
            answer = worker.answer()
        except (EOFError, OSError) as error:
            worker.stop()
            failure = SimulatorError(str(error)) if isinstance(error, TimeoutError) else worker.ending(self._process)
            self._lose(task, remaining, failure, waiting, done)
            return
        if answer is None:
            return
        if isinstance(answer, Noticed):
            self.notice([answer.sentence])
            return
        if isinstance(answer, InputError):
            worker.waiting = []
            raise answer
        if isinstance(answer, SimulatorError):
            self._lose(task, remaining[:1], answer, waiting, done, own=True)
        else:
            self._lost.count = 0
            done[remaining[0]] = answer

    def _lose(
        self,
        task: Task,
        left: tuple[int, ...],
        why: SimulationError,
        waiting: deque[Task],
        done: dict[int, Outcome],
        *,
        own: bool = False,
    ) -> None:
        """Run scenarios without a result again, or fail them.

        If a batch failed, it is unknown which scenario is at fault, unless `own`: the failure is the result of the
        first.
        """
        if len(task.indices) > 1 and not own:
            waiting.extendleft(Task((k,)) for k in reversed(left))
            return
        (index,) = left
        # A process that was killed from outside is no reason to fail a scenario without a retry.
        retries = 1 if self._retries == 0 and isinstance(why, LostError) else self._retries
        if not isinstance(why, SimulatorError):
            self._lost.count = 0
            done[index] = why
        elif task.tries < retries:
            waiting.appendleft(Task((index,), task.tries + 1))
        else:
            self._lost.count += 1
            if 0 < self._max_failures <= self._lost.count:
                raise InputError(
                    f"The simulator '{self.name}' gave no result in {self._lost.count} scenarios in a row"
                    f" (`max_failures`); in the last one {why}. Fix it, and run the same command again to resume."
                )
            times = "once" if task.tries == 0 else f"{task.tries + 1} times"
            error_class = LostError if isinstance(why, LostError) else SimulationError
            done[index] = error_class(f"{why}, tried {times}")


def _name_process(options: Mapping[str, Any]) -> str:
    """Describe a simulator's process in messages, with the user's drivers, which may have ended it."""
    drivers = [
        f"the driver of {quoted_name(entity)} ({name})"
        for entity, driver in (options.get("drivers") or {}).items()
        if (name := given_name(driver)) is not None
    ]
    return f"the process of the simulator and of {' and '.join(drivers)}" if drivers else "the simulator's process"
