"""A simulator in processes of its own, which may crash or hang without taking anything with it."""

from __future__ import annotations

import os
import signal
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from typing import Any, Final

from cornercase._common.errors import InputError, SimulationError, SimulatorError
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario, Scenario
from cornercase.simulators.registry import SIMULATORS, told

# So many scenarios in a row that end without a result say that the simulator is at fault, not they.
_MOST_LOST: Final = 5
_STARTED: Final = 60.0
_STOPPED: Final = 5.0

Outcome = Recording | SimulationError


class WorkerSimulator:
    """Runs concrete scenarios one by one in worker processes, each of which starts the simulator once.

    Parameters
    ----------
    name : str
        Registered simulator.
    options : dict
        What to make it with; has to be picklable.
    workers : int, default 1
    timeout : float, optional
        s after which a scenario is given up; the start of the simulator has a minute of its own.
    retries : int, default 1
        How often a scenario is run again after the simulator failed: its process died, was stopped, or its line broke.

    Raises
    ------
    InputError
        The simulator cannot be made so.
    """

    def __init__(
        self,
        name: str,
        options: dict[str, Any],
        workers: int = 1,
        timeout: float | None = None,
        retries: int = 1,
    ) -> None:
        self.name = name
        self._first = SIMULATORS.create(name, **options)
        self.settings = self._first.settings
        self._retries = retries
        # A simulator that has something of its own for each worker, as a port, is told which one it is.
        numbered = "worker" in told(name)
        self._workers = [_Worker(name, options | ({"worker": k} if numbered else {}), timeout) for k in range(workers)]
        self._lost = 0

    def require_means(self, scenario: Scenario) -> None:
        """Let the simulator refuse a scenario for which it has not the means, before anything is run."""
        getattr(self._first, "require_means", lambda _: None)(scenario)

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Outcome]:
        """Give one recording or one error per concrete scenario, in order.

        Raises
        ------
        InputError
            The scenario file cannot be used, or the simulator dies or hangs in five scenarios in a row.
        """
        waiting = deque((k, 0) for k in range(len(concretes)))
        done: dict[int, Outcome] = {}
        given = 0
        try:
            while given < len(concretes):
                for worker in self._workers:
                    if worker.task is None and waiting:
                        task = waiting.popleft()
                        worker.give(task, concretes[task[0]])
                for worker in self._ready():
                    self._take(worker, waiting, done)
                while given in done:
                    yield done.pop(given)
                    given += 1
        finally:
            for worker in self._workers:
                if worker.task is not None:
                    worker.stop()

    def close(self) -> None:
        """End the processes."""
        for worker in self._workers:
            worker.stop()

    def _ready(self) -> list[_Worker]:
        """Workers with something to say, and those whose time is up."""
        busy = [worker for worker in self._workers if worker.task is not None]
        deadline = min(worker.deadline for worker in busy)
        remaining = None if deadline == float("inf") else max(0.0, deadline - time.monotonic())
        heard = wait([worker.connection for worker in busy], remaining)
        return [worker for worker in busy if worker.connection in heard or worker.deadline <= time.monotonic()]

    def _take(self, worker: _Worker, waiting: deque[tuple[int, int]], done: dict[int, Outcome]) -> None:
        assert worker.task is not None
        index, tries = worker.task
        try:
            found = worker.answer()
        except (EOFError, OSError, TimeoutError) as error:
            worker.stop()
            found = SimulatorError(str(error) if isinstance(error, TimeoutError) else worker.ending())
        if found is None:
            worker.begin()
            return
        worker.task = None
        if isinstance(found, InputError):
            raise found
        if not isinstance(found, SimulatorError):
            self._lost = 0
            done[index] = found
        elif tries < self._retries:
            waiting.appendleft((index, tries + 1))
        else:
            self._lost += 1
            if self._lost >= _MOST_LOST:
                raise InputError(
                    f"The simulator '{self.name}' gave no result in {self._lost} scenarios in a row; in the last one"
                    f" {found}. The same command goes on when it is well again."
                )
            times = "once" if tries == 0 else f"{tries + 1} times"
            done[index] = SimulationError(f"{found}, tried {times}")


class _Worker:
    """One process, started when it is first needed and anew after it died."""

    def __init__(self, name: str, options: dict[str, Any], timeout: float | None) -> None:
        self._name, self._options, self._timeout = name, options, timeout
        self._process: Any = None
        self._code: int | None = None
        self._started = False
        self.connection: Connection
        self.task: tuple[int, int] | None = None
        self.deadline = float("inf")

    def give(self, task: tuple[int, int], concrete: ConcreteScenario) -> None:
        """Let it run a scenario; the task says which it is, and how often it was tried before."""
        if self._process is None or not self._process.is_alive():
            self.stop()
            # Started anew rather than forked: threads of numerical libraries do not survive a fork.
            context = get_context("spawn")
            self.connection, theirs = context.Pipe()
            self._process = context.Process(target=_serve, args=(theirs, self._name, self._options), daemon=True)
            self._process.start()
            theirs.close()
        self.task = task
        if self._started:
            self.begin()
        else:
            self.deadline = time.monotonic() + _STARTED
        # Where it has died just now, its end is noticed by who waits for the answer.
        with suppress(OSError):
            self.connection.send(concrete)

    def begin(self) -> None:
        """Note that it is at its scenario from now on."""
        self._started = True
        self.deadline = float("inf") if self._timeout is None else time.monotonic() + self._timeout

    def answer(self) -> Outcome | InputError | None:
        """What came out; None says that the simulator has started."""
        if not self.connection.poll():
            doing = f"end within {self._timeout:g} s" if self._started else f"start within {_STARTED:g} s"
            raise TimeoutError(f"the simulator did not {doing}")
        found: Outcome | InputError | None = self.connection.recv()
        return found

    def ending(self) -> str:
        """How the process ended, in words."""
        code = self._code
        if code is None or code == 0:
            return "the simulator's process ended"
        if code < 0:
            return f"the simulator's process was ended by {signal.Signals(-code).name}"
        return f"the simulator's process ended with exit code {code}"

    def stop(self) -> None:
        """End the process, if there is one."""
        self.task, self._code, self._started = None, None, False
        if self._process is None:
            return
        # Who has died says how; who has not is made to.
        self._process.join(0.2)
        self._code = self._process.exitcode
        if self._process.is_alive():
            # With all that it has started, as the simulator itself.
            with suppress(OSError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.kill()
            self._process.join(_STOPPED)
        self.connection.close()
        self._process = None


def _serve(connection: Connection, name: str, options: dict[str, Any]) -> None:
    # Ctrl-C is for the process that the user sees, which lets this one finish its scenario or stops it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Of a group of its own, so that it is stopped with all that it starts.
    os.setsid()
    try:
        simulator = SIMULATORS.create(name, **options)
    except InputError as error:
        connection.send(error)
        return
    connection.send(None)
    found: Outcome | InputError
    while True:
        try:
            concrete = connection.recv()
        except EOFError:
            return
        try:
            (found,) = simulator.run([concrete])
        except InputError as error:
            found = error
        except Exception as error:
            found = SimulationError(f"the simulator failed ({type(error).__name__}: {error})")
        connection.send(found)
