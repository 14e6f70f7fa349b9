"""A worker process that runs a simulator."""

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

# Time limits in s: to start the simulator, to get its exit code, and to let it end by itself.
_STARTED, _DIED, _ENDED = 60.0, 0.2, 10.0


@dataclass(frozen=True)
class Task:
    """Scenarios (indices) that a worker runs in one call of its simulator, and how often they were tried before."""

    indices: tuple[int, ...]
    tries: int = 0


@dataclass(frozen=True)
class Noticed:
    """A sentence for the user."""

    sentence: str


Answer = Outcome | InputError | Noticed | None


class Worker:
    """A process with a simulator; started when first needed, and again after it has ended.

    `timeout` is in s per scenario. `guardian` ends the process if this one cannot, and owns its folder for temporary
    files.

    Attributes: `waiting`, the scenarios of the task without a result, empty if idle; `task`, the last one;
    `connection`; `deadline`, in `time.monotonic` time.
    """

    connection: Connection
    task: Task

    def __init__(self, name: str, options: dict[str, Any], timeout: float | None, guardian: Guardian) -> None:
        self._name, self._timeout, self._guardian = name, timeout, guardian
        # As bytes, so that the process imports the user's drivers from where this one did.
        self._options = packed_options(options, pickle.dumps)
        self._process: Any = None
        self._folder: Path | None = None
        self._code: int | None = None
        self._started = False
        self.waiting: list[int] = []
        self.deadline = float("inf")

    def give(self, task: Task, concretes: Sequence[ConcreteScenario]) -> None:
        """Start a task; `concretes` are all scenarios; the task has the indices of its own."""
        if self._process is None or not self._process.is_alive():
            self.stop()
            # Spawned, not forked: threads of numerical libraries do not survive a fork, and Windows has none.
            context = get_context("spawn")
            # Removed after the process, however it ends.
            self._folder = self._guardian.new_folder()
            self.connection, child_connection = context.Pipe()
            arguments = child_connection, self._name, self._options, self._folder
            process = context.Process(target=_serve, args=arguments, daemon=True)
            # An interrupt in the middle would leave an orphaned process.
            with held_interrupts(), interrupts_kept(*ending_signals()), kept_from_children():
                process.start()
                self._process = process
            self._guardian.watch(self._process.pid)
            child_connection.close()
        self.task, self.waiting = task, list(task.indices)
        self._set_deadline()
        # If the process has just ended, `receive` notices.
        with suppress(OSError):
            self.connection.send([concretes[k] for k in task.indices])

    def _set_deadline(self) -> None:
        if not self._started:
            self.deadline = time.monotonic() + _STARTED
        elif self._timeout is None:
            self.deadline = float("inf")
        else:
            # Scenarios may run in parallel or one after another.
            self.deadline = time.monotonic() + self._timeout * len(self.waiting)

    def answer(self) -> Answer:
        """Receive the next message: a result, an error for the rest, a notice, or None once the simulator has started.

        Raises TimeoutError after the deadline, EOFError or OSError if the process has ended.
        """
        if not self.connection.poll():
            action = f"end within {self._timeout:g} s" if self._started else f"start within {_STARTED:g} s"
            raise TimeoutError(f"the simulator did not {action}")
        answer: Answer = self.connection.recv()
        if isinstance(answer, Noticed):
            return answer
        if isinstance(answer, Recording | SimulationError):
            self.waiting.pop(0)
        self._started = True
        self._set_deadline()
        return answer

    def ending(self, process: str) -> SimulatorError:
        """Return the error that describes how the process ended; `LostError` if it was killed from outside."""
        text = f"{process} {words_of_exit_code(self._code)}"
        return LostError(f"{text} from outside") if ended_from_outside(self._code) else SimulatorError(text)

    def stop(self) -> None:
        """End the process at once, if there is one."""
        self.waiting, self._code, self._started = [], None, False
        if self._process is None:
            return
        # If the process has ended by itself, its exit code arrives within a moment.
        self._process.join(_DIED)
        self._code = self._process.exitcode
        # A killed process may have left children.
        end_process_tree(self._process.pid)
        self._process.join(_ENDED)
        self._forget()

    def kill(self) -> None:
        """Kill the process from another thread than the one that waits for it."""
        process = self._process
        if process is not None and process.exitcode is None:
            end_process_tree(process.pid)

    def hang_up(self) -> None:
        """Close the connection, so that an idle process closes its simulator and ends; a busy one is stopped."""
        if self.waiting:
            self.stop()
        elif self._process is not None:
            self.connection.close()

    def wait(self) -> None:
        """Wait until a process that was told to end has ended; kill it if it does not."""
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
    """Create a simulator in the worker process, and run tasks until the connection closes."""
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
    """Unpickle the options of a simulator; modules of the user's drivers may be in the current folder."""
    options_with_names: dict[str, Any] = unpickle_here(options)
    return with_drivers_made(options_with_names)


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
    """Send an answer; return whether there is a receiver."""
    # Without a receiver, this process is about to be ended.
    try:
        connection.send(found)
    except (BrokenPipeError, ConnectionResetError):
        return False
    return True
