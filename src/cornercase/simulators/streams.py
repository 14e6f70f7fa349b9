"""Submit scenarios one at a time, and receive results as they come."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any, Final

from cornercase.simulators.base import Simulator

# Time in s between two counts of parallel instances, and between two checks for signals while waiting.
_LOOKS: Final = 5.0
_WAITS: Final = 0.5
# Time limit in s for cancelled work to end; a wait for a cluster that is cut off never does.
_ENDS: Final = 10.0

# Runs something on a simulator.
Work = Callable[[Simulator], Any]


@dataclass(eq=False)
class _Desk:
    """Work queue of one simulator, and the threads that process it."""

    simulator: Simulator
    waiting: SimpleQueue[tuple[int, Work] | None] = field(default_factory=SimpleQueue)
    threads: list[tuple[Thread, Simulator]] = field(default_factory=list)


class SimulatorStream:
    """Runs submitted work on the next free simulator, each in its own thread.

    `simulators` are by name; the first determines the number of parallel scenarios. A simulator without parallel
    instances runs work in the calling thread when a result is taken.
    """

    def __init__(self, simulators: Mapping[str, Simulator]) -> None:
        self._desks = {name: _Desk(simulator) for name, simulator in simulators.items()}
        self._first = next(iter(self._desks))
        self._here: deque[tuple[int, Work, Simulator]] = deque()
        self._ended: SimpleQueue[tuple[int, Any, BaseException | None]] = SimpleQueue()
        self._looked, self._places, self._closed = -math.inf, 1, False

    def places(self) -> int:
        """Current number of parallel scenarios; it changes on a cluster."""
        if time.monotonic() - self._looked > _LOOKS:
            self._places = max(1, self._staffed(self._desks[self._first]))
            self._looked = time.monotonic()
        return self._places

    def _staffed(self, desk: _Desk) -> int:
        """Start threads for new parallel instances of a simulator; return their number."""
        instances = desk.simulator.beside()
        for instance in instances[len(desk.threads) :]:
            thread = Thread(target=self._work, args=(desk.waiting, instance), daemon=True)
            desk.threads.append((thread, instance))
            thread.start()
        return len(instances)

    def _work(self, waiting: SimpleQueue[tuple[int, Work] | None], simulator: Simulator) -> None:
        """Process work in a thread."""
        while (job := waiting.get()) is not None and not self._closed:
            key, work = job
            try:
                self._ended.put((key, work(simulator), None))
            except BaseException as error:
                self._ended.put((key, None, error))

    def give(self, key: int, work: Work, name: str | None = None) -> None:
        """Submit work under a key, for the simulator `name` or the first one; it may be called in another thread."""
        desk = self._desks[self._first if name is None else name]
        if desk.threads or self._staffed(desk):
            desk.waiting.put((key, work))
        else:
            self._here.append((key, work, desk.simulator))

    @property
    def ready(self) -> bool:
        """Whether a result is available now."""
        return not self._ended.empty()

    def take(self, check: Callable[[], None]) -> tuple[int, Any]:
        """Wait for the next result and return it with its key, or raise the error of the work.

        `check` is called now and then while waiting.
        """
        while True:
            check()
            if self._here and not self.ready:
                own_key, work, simulator = self._here.popleft()
                return own_key, work(simulator)
            try:
                key, result, error = self._ended.get(timeout=_WAITS)
            except Empty:
                continue
            if error is not None:
                raise error
            return key, result

    def close(self) -> None:
        """Cancel unfinished work; the simulators stay open."""
        self._closed = True
        for desk in self._desks.values():
            for _ in desk.threads:
                desk.waiting.put(None)
        busy = [entry for desk in self._desks.values() for entry in desk.threads]
        deadline = time.monotonic() + _ENDS
        while busy := [(thread, simulator) for thread, simulator in busy if thread.is_alive()]:
            if time.monotonic() > deadline:
                return
            busy[0][0].join(0.1)
            for thread, simulator in busy:
                if thread.is_alive():
                    simulator.give_up()
