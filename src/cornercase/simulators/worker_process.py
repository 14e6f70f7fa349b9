"""One worker process, in which a simulator runs."""

from __future__ import annotations

import pickle
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from cornercase._common.current_folder import kept_from_children, unpickle_here
from cornercase._common.errors import InputError, LostError, SimulationError, SimulatorError
from cornercase._common.guardian import Guardian
from cornercase._common.interrupts import held_interrupts
from cornercase._common.lifeline import end_with_parent, keep_temporary_files_in
from cornercase._common.parts import guarded
from cornercase._common.platform import (
    end_process_tree,
    ended_from_outside,
    ending_signals,
    interrupts_kept,
    leave_terminal,
    words_of_exit_code,
)
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.simulators.base import Simulator
from cornercase.simulators.outcomes import Outcome, outcomes_as_given
from cornercase.simulators.registry import SIMULATORS
from cornercase.simulators.sending import packed_options, with_drivers_made

# s that a simulator may take to start, for its exit code to arrive, and to end by itself.
_STARTED, _DIED, _ENDED = 60.0, 0.2, 10.0


@dataclass(frozen=True)
class Task:
    """Scenarios that a worker runs in one call of its simulator.

    Attributes
    ----------
    indices : tuple of int
        Which of all scenarios they are.
    tries : int
        How often they were tried before.
    """

    indices: tuple[int, ...]
    tries: int = 0


@dataclass(frozen=True)
class Noticed:
    """A sentence for whoever runs the scenarios.

    Attributes
    ----------
    sentence : str
    """

    sentence: str


Answer = Outcome | InputError | Noticed | None


class Worker:
    """One process with a simulator, started when it is first needed, and anew after it has ended.

    Parameters
    ----------
    name : str
        Registered simulator.
    options : dict
        What to make it with; has to be picklable.
    timeout : float or None
        s for each scenario.
    guardian : Guardian
        Ends the process where this one cannot, and keeps its folder for temporary files.

    Attributes
    ----------
    waiting : list of int
        Scenarios of its task that have no result yet; empty while it has nothing to do.
    task : Task
        The last one that it was given.
    connection : Connection
    deadline : float
        When its time is up, as in `time.monotonic`.
    """

    connection: Connection
    task: Task

    def __init__(self, name: str, options: dict[str, Any], timeout: float | None, guardian: Guardian) -> None:
        self._name, self._timeout, self._guardian = name, timeout, guardian
        # As bytes, so that the process looks for a driver of one's own where this one did.
        self._options = packed_options(options, pickle.dumps)
        self._process: Any = None
        self._folder: Path | None = None
        self._code: int | None = None
        self._started = False
        self.waiting: list[int] = []
        self.deadline = float("inf")

    def give(self, task: Task, concretes: Sequence[ConcreteScenario]) -> None:
        """Let it run the scenarios of a task.

        Parameters
        ----------
        task : Task
        concretes : sequence of ConcreteScenario
            All that there are; the task tells which it runs.
        """
        if self._process is None or not self._process.is_alive():
            self.stop()
            # Spawned, not forked: threads of numerical libraries do not survive a fork, and Windows has none.
            context = get_context("spawn")
            # What it leaves in it is removed after it, however it ends.
            self._folder = self._guardian.new_folder()
            self.connection, theirs = context.Pipe()
            given = theirs, self._name, self._options, self._folder
            process = context.Process(target=_serve, args=given, daemon=True)
            # One that came in the middle would leave a process that nobody knows.
            with held_interrupts(), interrupts_kept(*ending_signals()), kept_from_children():
                process.start()
                self._process = process
            self._guardian.watch(self._process.pid)
            theirs.close()
        self.task, self.waiting = task, list(task.indices)
        self._set_deadline()
        # If it has just ended, this is noticed when its answer is awaited.
        with suppress(OSError):
            self.connection.send([concretes[k] for k in task.indices])

    def _set_deadline(self) -> None:
        if not self._started:
            self.deadline = time.monotonic() + _STARTED
        elif self._timeout is None:
            self.deadline = float("inf")
        else:
            # A simulator may run its scenarios side by side, or one after the other.
            self.deadline = time.monotonic() + self._timeout * len(self.waiting)

    def answer(self) -> Answer:
        """Take the next message of the process.

        Returns
        -------
        Recording, SimulationError, InputError, Noticed or None
            What came of the next scenario, or why none follows; None says that the simulator has started.

        Raises
        ------
        TimeoutError
            Its time is up.
        EOFError, OSError
            The process has ended.
        """
        if not self.connection.poll():
            doing = f"end within {self._timeout:g} s" if self._started else f"start within {_STARTED:g} s"
            raise TimeoutError(f"the simulator did not {doing}")
        found: Answer = self.connection.recv()
        if isinstance(found, Noticed):
            return found
        if isinstance(found, Recording | SimulationError):
            self.waiting.pop(0)
        self._started = True
        self._set_deadline()
        return found

    def ending(self, process: str) -> SimulatorError:
        """Say how the process ended, which is called so in the sentence.

        Returns
        -------
        SimulatorError
            ``"the simulator's process ended with exit code 3"``; a `LostError` where somebody else has ended it.
        """
        words = f"{process} {words_of_exit_code(self._code)}"
        return LostError(f"{words} from outside") if ended_from_outside(self._code) else SimulatorError(words)

    def stop(self) -> None:
        """End the process at once, if there is one."""
        self.waiting, self._code, self._started = [], None, False
        if self._process is None:
            return
        # If the process has ended by itself, its exit code arrives within a moment.
        self._process.join(_DIED)
        self._code = self._process.exitcode
        # One that has been killed may have left what it has started.
        end_process_tree(self._process.pid)
        self._process.join(_ENDED)
        self._forget()

    def kill(self) -> None:
        """End the process from another thread, which finds that it has ended."""
        process = self._process
        if process is not None and process.exitcode is None:
            end_process_tree(process.pid)

    def hang_up(self) -> None:
        """Tell the process that nothing follows; it closes its simulator and ends. One at work is stopped."""
        if self.waiting:
            self.stop()
        elif self._process is not None:
            self.connection.close()

    def wait(self) -> None:
        """Wait until a process that was told so has ended, and end it if it does not."""
        if self._process is None:
            return
        self._process.join(_ENDED)
        if self._process.is_alive():
            end_process_tree(self._process.pid)
            self._process.join(_ENDED)
        self._started = False
        self._forget()

    def _forget(self) -> None:
        self.connection.close()
        self._guardian.release(self._process.pid)
        if self._folder is not None:
            self._guardian.remove(self._folder)
        self._process = self._folder = None


def _serve(connection: Connection, name: str, options: bytes, folder: Path) -> None:
    """Make a simulator, and run what comes until nothing follows."""
    # Ctrl-C is handled by the main process, which lets this one finish its scenario or stops it.
    leave_terminal()
    end_with_parent()
    keep_temporary_files_in(folder)
    try:
        with guarded("A worker process", None, "as it began"):
            simulator = SIMULATORS.create(name, **unpickled_options(options))
    except InputError as error:
        _send(connection, error)
        return
    simulator.on_notice = partial(_send_notice, connection)
    _send(connection, None)
    with simulator:
        while True:
            try:
                concretes = connection.recv()
            except (EOFError, OSError):
                return
            _answer(connection, simulator, concretes)


def unpickled_options(options: bytes) -> dict[str, Any]:
    """Read the options of a simulator, with drivers of one's own, whose modules may lie in the current folder.

    Parameters
    ----------
    options : bytes

    Returns
    -------
    dict
    """
    found: dict[str, Any] = unpickle_here(options)
    return with_drivers_made(found)


def _answer(connection: Connection, simulator: Simulator, concretes: list[ConcreteScenario]) -> None:
    try:
        for outcome in outcomes_as_given(simulator, concretes):
            _send(connection, outcome)
    except InputError as error:
        _send(connection, error)


def _send_notice(connection: Connection, sentence: str) -> None:
    if not _send(connection, Noticed(sentence)):
        print(f"{sentence}.", file=sys.stderr)


def _send(connection: Connection, found: Answer) -> bool:
    """Send an answer, and say whether anybody is there to receive it."""
    # Where nobody listens any more, this process is about to be ended.
    try:
        connection.send(found)
    except (BrokenPipeError, ConnectionResetError):
        return False
    return True
