"""Several simulators side by side, each in a process of its own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

from cornercase._common.errors import SimulationError
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.simulators.registry import SIMULATORS


class ParallelSimulator:
    """Spreads concrete scenarios over processes; the results are those of one simulator.

    Parameters
    ----------
    name : str
        Registered simulator.
    options : dict
        What to make it with; has to be picklable.
    workers : int
    """

    def __init__(self, name: str, options: dict[str, Any], workers: int) -> None:
        self.name = name
        self.settings = SIMULATORS.create(name, **options).settings
        self._name, self._options, self._workers = name, options, workers
        # Started anew rather than forked: threads of numerical libraries do not survive a fork.
        self._pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording | SimulationError]:
        """Give one recording or one error per concrete scenario, in order."""
        size = max(1, -(-len(concretes) // self._workers))
        parts = [list(concretes[i : i + size]) for i in range(0, len(concretes), size)]
        futures = [self._pool.submit(_run, self._name, self._options, part) for part in parts]
        for future in futures:
            yield from future.result()

    def close(self) -> None:
        """End the processes."""
        self._pool.shutdown(cancel_futures=True)


def _run(name: str, options: dict[str, Any], concretes: list[ConcreteScenario]) -> list[Recording | SimulationError]:
    return list(SIMULATORS.create(name, **options).run(concretes))
