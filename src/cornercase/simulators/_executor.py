"""Execution of scenarios that are submitted one at a time; results are returned as soon as they are ready."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any, Final

from cornercase.simulators._base import Simulator

# Time in s between two counts of parallel instances, and between two checks for signals while waiting.
_COUNT_INTERVAL: Final = 5.0
_WAIT_INTERVAL: Final = 0.5
# Time limit in s for cancelled work to end; a wait for a cluster that is cut off never does.
_CANCEL_TIMEOUT: Final = 10.0

# Runs something on a simulator.
SimulatorWork = Callable[[Simulator], Any]


@dataclass(eq=False)
class _WorkQueue:
    """Queue of the work for one simulator, and the threads that process it."""

    simulator: Simulator
    queue: SimpleQueue[tuple[int, SimulatorWork] | None] = field(default_factory=SimpleQueue)
    threads: list[tuple[Thread, Simulator]] = field(default_factory=list)


class SimulatorExecutor:
    """Executor that runs submitted work on the next free instance of a simulator, each instance in its own thread.

    `simulators` has simulators by name; the first simulator determines how many scenarios run in parallel. If a
    simulator has no parallel instances, its work runs in the calling thread when a result is requested.
    """

    def __init__(self, simulators: Mapping[str, Simulator]) -> None:
        self._queues = {name: _WorkQueue(simulator) for name, simulator in simulators.items()}
        self._first_name = next(iter(self._queues))
        self._local_work: deque[tuple[int, SimulatorWork, Simulator]] = deque()
        self._results: SimpleQueue[tuple[int, Any, BaseException | None]] = SimpleQueue()
        self._last_counted, self._n_parallel, self._closed = -math.inf, 1, False

    def count_parallel(self) -> int:
        """Return how many scenarios can run in parallel now; on a cluster this number changes."""
        if time.monotonic() - self._last_counted > _COUNT_INTERVAL:
            self._n_parallel = max(1, self._start_threads(self._queues[self._first_name]))
            self._last_counted = time.monotonic()
        return self._n_parallel

    def _start_threads(self, queue: _WorkQueue) -> int:
        """Start the missing threads, one per parallel instance of a simulator; return the number of instances."""
        instances = queue.simulator.parallel_instances()
        for instance in instances[len(queue.threads) :]:
            thread = Thread(target=self._process_work, args=(queue.queue, instance), daemon=True)
            queue.threads.append((thread, instance))
            thread.start()
        return len(instances)

    def _process_work(self, queue: SimpleQueue[tuple[int, SimulatorWork] | None], simulator: Simulator) -> None:
        """Process the work in a queue; runs in its own thread."""
        while (job := queue.get()) is not None and not self._closed:
            key, work = job
            try:
                self._results.put((key, work(simulator), None))
            except BaseException as error:
                self._results.put((key, None, error))

    def submit(self, key: int, work: SimulatorWork, name: str | None = None) -> None:
        """Submit work under a key for the simulator called `name`, by default the first simulator.

        The work may run in another thread.
        """
        queue = self._queues[self._first_name if name is None else name]
        if queue.threads or self._start_threads(queue):
            queue.queue.put((key, work))
        else:
            self._local_work.append((key, work, queue.simulator))

    @property
    def has_result(self) -> bool:
        """Whether the result of submitted work is ready."""
        return not self._results.empty()

    def wait_for_result(self, check: Callable[[], None]) -> tuple[int, Any]:
        """Return the next result with its key, or raise the error of its work; `check` is called during the wait."""
        while True:
            check()
            if self._local_work and not self.has_result:
                own_key, work, simulator = self._local_work.popleft()
                return own_key, work(simulator)
            try:
                key, result, error = self._results.get(timeout=_WAIT_INTERVAL)
            except Empty:
                continue
            if error is not None:
                raise error
            return key, result

    def close(self, cancel_timeout: float = _CANCEL_TIMEOUT) -> None:
        """Cancel unfinished work and end the threads within `cancel_timeout` s; the simulators stay open."""
        self._closed = True
        for queue in self._queues.values():
            for _ in queue.threads:
                queue.queue.put(None)
        busy = [entry for queue in self._queues.values() for entry in queue.threads]
        deadline = time.monotonic() + cancel_timeout
        while busy := [(thread, simulator) for thread, simulator in busy if thread.is_alive()]:
            if time.monotonic() > deadline:
                return
            busy[0][0].join(0.1)
            for thread, simulator in busy:
                if thread.is_alive():
                    simulator.cancel()
