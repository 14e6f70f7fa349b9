"""Scenarios that are given one after the other, and come back as soon as each has ended."""

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

# s between two looks at how many places there are, and for which one waits before a signal is looked for.
_LOOKS: Final = 5.0
_WAITS: Final = 0.5
# s that what is given up has to end; what waits for a cluster that is cut off never does.
_ENDS: Final = 10.0

Work = Callable[[Simulator], Any]
"""Has a simulator run something."""


@dataclass(eq=False)
class _Desk:
    """What one simulator has to do, and the threads that do it."""

    simulator: Simulator
    waiting: SimpleQueue[tuple[int, Work] | None] = field(default_factory=SimpleQueue)
    threads: list[tuple[Thread, Simulator]] = field(default_factory=list)


class SimulatorStream:
    """Keeps simulators at work: what is given is run by the next one that is free, each in a thread of its own.

    A simulator that runs in the thread that made it does so when its result is taken.

    Parameters
    ----------
    simulators : mapping of str to Simulator
        By name; the first says how many places there are.
    """

    def __init__(self, simulators: Mapping[str, Simulator]) -> None:
        self._desks = {name: _Desk(one) for name, one in simulators.items()}
        self._first = next(iter(self._desks))
        self._here: deque[tuple[int, Work, Simulator]] = deque()
        self._ended: SimpleQueue[tuple[int, Any, BaseException | None]] = SimpleQueue()
        self._looked, self._places, self._closed = -math.inf, 1, False

    def places(self) -> int:
        """Count the scenarios that can be run at a time, by now: on a cluster workers come and go.

        Returns
        -------
        int

        Raises
        ------
        InputError
            A cluster has no workers, or is lost.
        """
        if time.monotonic() - self._looked > _LOOKS:
            self._places = max(1, self._staffed(self._desks[self._first]))
            self._looked = time.monotonic()
        return self._places

    def _staffed(self, desk: _Desk) -> int:
        """Let simulators work that have come since; how many there are."""
        found = desk.simulator.beside()
        for one in found[len(desk.threads) :]:
            thread = Thread(target=self._work, args=(desk.waiting, one), daemon=True)
            desk.threads.append((thread, one))
            thread.start()
        return len(found)

    def _work(self, waiting: SimpleQueue[tuple[int, Work] | None], simulator: Simulator) -> None:
        while (given := waiting.get()) is not None and not self._closed:
            key, work = given
            try:
                self._ended.put((key, work(simulator), None))
            except BaseException as error:
                self._ended.put((key, None, error))

    def give(self, key: int, work: Work, name: str | None = None) -> None:
        """Have something run.

        Parameters
        ----------
        key : int
            By which its result is known.
        work : callable
            Takes a simulator that is free; called in another thread where that may be.
        name : str, optional
            Of the simulator; by default the first one.

        Raises
        ------
        InputError
            A cluster has no workers, or is lost.
        """
        desk = self._desks[self._first if name is None else name]
        if desk.threads or self._staffed(desk):
            desk.waiting.put((key, work))
        else:
            self._here.append((key, work, desk.simulator))

    @property
    def ready(self) -> bool:
        """Whether there is a result that need not be waited for."""
        return not self._ended.empty()

    def take(self, check: Callable[[], None]) -> tuple[int, Any]:
        """Wait for the next result, of whatever was given.

        Parameters
        ----------
        check : callable
            Called now and then while nothing comes; may raise.

        Returns
        -------
        tuple of (int, object)
            The key, and what came of the work.

        Raises
        ------
        BaseException
            What the work raised.
        """
        while True:
            check()
            if self._here and not self.ready:
                here, work, simulator = self._here.popleft()
                return here, work(simulator)
            try:
                key, found, error = self._ended.get(timeout=_WAITS)
            except Empty:
                continue
            if error is not None:
                raise error
            return key, found

    def close(self) -> None:
        """Give up what has not ended; the simulators stay open."""
        self._closed = True
        for desk in self._desks.values():
            for _ in desk.threads:
                desk.waiting.put(None)
        busy = [one for desk in self._desks.values() for one in desk.threads]
        deadline = time.monotonic() + _ENDS
        while busy := [(thread, simulator) for thread, simulator in busy if thread.is_alive()]:
            if time.monotonic() > deadline:
                return
            busy[0][0].join(0.1)
            for thread, simulator in busy:
                if thread.is_alive():
                    simulator.give_up()
