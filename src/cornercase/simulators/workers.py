"""A simulator in worker processes, which may crash or hang without taking anything with them."""

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
"""Scenarios in a row without a result after which the simulator is at fault, not they, unless a user says otherwise."""
# s.
_LONGEST_WAIT: Final = 3600.0

MOST_WORKERS: Final = 1024
"""Worker processes side by side: more than there are cores anywhere, and few enough to be started."""


@dataclass
class _Lost:
    """Scenarios in a row that ended without a result, of all processes."""

    count: int = 0


class WorkerSimulator(SimulatorElsewhere):
    """Runs concrete scenarios in worker processes, each of which starts the simulator once.

    A simulator that takes batches gets an equal share of the scenarios in each process, any other gets them one by
    one. If a batch crashes or hangs, those of its scenarios that have no result yet are run again one by one, so that
    only the one at fault is lost. Results are the same for any number of workers.

    Parameters
    ----------
    name : str
        Registered simulator.
    options : dict
        What to make it with; has to be picklable.
    workers : int, default 1
    timeout : float, optional
        s after which a scenario is given up; a batch has as much for each of its scenarios. The start of the simulator
        has a minute of its own.
    retries : int, default 1
        How often a scenario is run again after the simulator failed: its process ended, had to be ended, or the
        connection to its program broke. Where somebody else has ended its process, it is run again at least once.
    max_failures : int, default 5
        Scenarios in a row without a result, since the simulator failed in each, after which it is not tried any more; 0
        for no limit.

    Raises
    ------
    InputError
        The simulator cannot be made so.

    Examples
    --------
    Four processes, each of which runs a quarter of the scenarios at once:

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
        """Run scenarios.

        Parameters
        ----------
        concretes : sequence of ConcreteScenario

        Yields
        ------
        Recording or SimulationError
            One for each scenario, in order.

        Raises
        ------
        InputError
            The scenario file cannot be used, or the simulator crashes or hangs in `max_failures` scenarios in a row.
        """
        size = -(-len(concretes) // len(self._workers)) if self._batches and concretes else 1
        every = range(len(concretes))
        waiting = deque(Task(tuple(every[k : k + size])) for k in every[::size])
        done: dict[int, Outcome] = {}
        given = 0
        try:
            while given < len(concretes):
                for worker in self._workers:
                    if not worker.waiting and waiting:
                        worker.give(waiting.popleft(), concretes)
                for worker in self._ready():
                    self._take(worker, waiting, done)
                while given in done:
                    yield done.pop(given)
                    given += 1
        finally:
            for worker in self._workers:
                if worker.waiting:
                    worker.stop()

    def beside(self) -> Sequence[WorkerSimulator]:
        """Give a simulator for each of the processes.

        Returns
        -------
        sequence of WorkerSimulator
            Of one process each; they are closed with this one.
        """
        if not self._each:
            self._each = [copy(self) for _ in self._workers]
            for one, worker in zip(self._each, self._workers, strict=True):
                one._workers, one._each = [worker], []
        return self._each

    def give_up(self) -> None:
        """End the processes at once, though another thread waits for them; nothing is tried again."""
        self._retries = -1
        for worker in self._workers:
            worker.kill()

    def close(self) -> None:
        """End the processes; those without work close their simulator first."""
        for worker in self._workers:
            worker.hang_up()
        for worker in self._workers:
            worker.wait()
        self._guardian.close()
        super().close()

    def _ready(self) -> list[Worker]:
        """Wait for the workers that have an answer, and those whose time is up."""
        busy = [worker for worker in self._workers if worker.waiting]
        deadline = min(worker.deadline for worker in busy)
        # No system waits for any length of time in one go.
        remaining = None if deadline == float("inf") else min(max(0.0, deadline - time.monotonic()), _LONGEST_WAIT)
        heard = wait([worker.connection for worker in busy], remaining)
        return [worker for worker in busy if worker.connection in heard or worker.deadline <= time.monotonic()]

    def _take(self, worker: Worker, waiting: deque[Task], done: dict[int, Outcome]) -> None:
        task, left = worker.task, tuple(worker.waiting)
        try:
            found = worker.answer()
        except (EOFError, OSError) as error:
            worker.stop()
            why = SimulatorError(str(error)) if isinstance(error, TimeoutError) else worker.ending(self._process)
            self._lose(task, left, why, waiting, done)
            return
        if found is None:
            return
        if isinstance(found, Noticed):
            self.notice([found.sentence])
            return
        if isinstance(found, InputError):
            worker.waiting = []
            raise found
        if isinstance(found, SimulatorError):
            self._lose(task, left[:1], found, waiting, done, own=True)
        else:
            self._lost.count = 0
            done[left[0]] = found

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
        """Have scenarios without a result run again, or give them up.

        What has happened to a batch says nothing of any one of its scenarios, unless it is the result of its `own`.
        """
        if len(task.indices) > 1 and not own:
            waiting.extendleft(Task((k,)) for k in reversed(left))
            return
        (index,) = left
        # Who has ended it does not ask how often a scenario may be tried.
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
                    f" (`max_failures`); in the last one {why}. Fix it, and run the same command again to go on."
                )
            times = "once" if task.tries == 0 else f"{task.tries + 1} times"
            kind = LostError if isinstance(why, LostError) else SimulationError
            done[index] = kind(f"{why}, tried {times}")


def _name_process(options: Mapping[str, Any]) -> str:
    """Name the process of a simulator, which may have ended because of a driver of a user."""
    drivers = [
        f"the driver of {quoted_name(entity)} ({name})"
        for entity, driver in (options.get("drivers") or {}).items()
        if (name := given_name(driver)) is not None
    ]
    return f"the process of the simulator and of {' and '.join(drivers)}" if drivers else "the simulator's process"
