"""A worker process that runs a simulator."""

from __future__ import annotations

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

from cornercase._common.current_folder import isolate_children
from cornercase._common.errors import InputError, RunLostError, SimulationError, SimulatorError
from cornercase._common.platform import (
    block_interrupts,
    describe_exit_code,
    detach_from_terminal,
    is_killed_externally,
    kill_process_tree,
    termination_signals,
)
from cornercase._common.plugin_errors import convert_plugin_errors
from cornercase._common.process.parent_death import exit_with_parent, set_temporary_folder
from cornercase._common.process.reaper import Reaper
from cornercase._common.process.signals import defer_interrupts
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.simulators._base import Simulator
from cornercase.simulators._option_pickling import pickle_simulator, unpickle_simulator
from cornercase.simulators._registry import SIMULATORS
from cornercase.simulators._results import Outcome, run_scenarios_as_given

# Time limits in s: to start the simulator, to get its exit code, and to let it end by itself.
_START_TIMEOUT, _EXIT_CODE_TIMEOUT, _END_TIMEOUT = 60.0, 0.2, 10.0


@dataclass(frozen=True)
class WorkerTask:
    """Indices of the scenarios that a worker process runs in one call, and the number of earlier attempts."""

    indices: tuple[int, ...]
    tries: int = 0


@dataclass(frozen=True)
class NoticeMessage:
    """Message of a worker process: a sentence for the user."""

    sentence: str


WorkerMessage = Outcome | InputError | NoticeMessage | None


class WorkerProcess:
    """A process with a simulator; it is started when it is needed, and again after it has ended.

    `timeout` is in s per scenario. `reaper` ends the worker process if the main process dies, and owns the worker's
    temporary folder.

    Attributes: `task` is the last task. `remaining` has the indices of those scenarios of this task that have no result
    yet (empty if the process is idle). `connection` is the pipe to the process. `deadline` is the time of
    `time.monotonic` at which the next message is late.
    """

    connection: Connection
    task: WorkerTask

    def __init__(
        self, name: str | type[Simulator], options: dict[str, Any], timeout: float | None, reaper: Reaper
    ) -> None:
        self._timeout, self._reaper = timeout, reaper
        # As bytes, so that the process imports the user's classes from where this one did.
        self._simulator = pickle_simulator(name, options)
        self._process: Any = None
        self._folder: Path | None = None
        self._exit_code: int | None = None
        self._is_started = False
        self.remaining: list[int] = []
        self.deadline = float("inf")

    def start_task(self, task: WorkerTask, concretes: Sequence[ConcreteScenario]) -> None:
        """Start a task; the indices in the task refer to `concretes`."""
        if self._process is None or not self._process.is_alive():
            self.stop()
            # Spawned, not forked: threads of numerical libraries do not survive a fork, and Windows has none.
            context = get_context("spawn")
            # Removed after the process, however it ends.
            self._folder = self._reaper.make_temporary_folder()
            self.connection, child_connection = context.Pipe()
            arguments = child_connection, self._simulator, self._folder
            process = context.Process(target=_worker_main, args=arguments, daemon=True)
            # An interrupt in the middle would leave an orphaned process.
            with defer_interrupts(), block_interrupts(*termination_signals()), isolate_children():
                process.start()
                self._process = process
            self._reaper.watch_process(self._process.pid)
            child_connection.close()
        self.task, self.remaining = task, list(task.indices)
        self._set_deadline()
        # If the process has just ended, `receive` notices.
        with suppress(OSError):
            self.connection.send([concretes[k] for k in task.indices])

    def _set_deadline(self) -> None:
        if not self._is_started:
            self.deadline = time.monotonic() + _START_TIMEOUT
        elif self._timeout is None:
            self.deadline = float("inf")
        else:
            # Scenarios may run in parallel or one after another.
            self.deadline = time.monotonic() + self._timeout * len(self.remaining)

    def receive(self) -> WorkerMessage:
        """Return the next message; the first message, None, means that the simulator has started.

        Raises TimeoutError if the deadline has passed, and EOFError or OSError if the process has ended.
        """
        if not self.connection.poll():
            action = f"end within {self._timeout:g} s" if self._is_started else f"start within {_START_TIMEOUT:g} s"
            raise TimeoutError(f"the simulator did not {action}")
        answer: WorkerMessage = self.connection.recv()
        if isinstance(answer, NoticeMessage):
            return answer
        if isinstance(answer, Recording | SimulationError):
            self.remaining.pop(0)
        self._is_started = True
        self._set_deadline()
        return answer

    def describe_exit(self, process_name: str) -> SimulatorError:
        """Return an error that describes how the process ended; `RunLostError` if it was killed from outside."""
        text = f"{process_name} {describe_exit_code(self._exit_code)}"
        return RunLostError(f"{text} from outside") if is_killed_externally(self._exit_code) else SimulatorError(text)

    def stop(self) -> None:
        """End the process at once; do nothing if no process was started."""
        self.remaining, self._exit_code, self._is_started = [], None, False
        if self._process is None:
            return
        # If the process has ended by itself, its exit code arrives within a moment.
        self._process.join(_EXIT_CODE_TIMEOUT)
        self._exit_code = self._process.exitcode
        # A killed process may have left children.
        kill_process_tree(self._process.pid)
        self._process.join(_END_TIMEOUT)
        self._release_process()

    def kill(self) -> None:
        """Kill the process; may be called in another thread than the one that waits for it."""
        process = self._process
        if process is not None and process.exitcode is None:
            kill_process_tree(process.pid)

    def close_connection(self) -> None:
        """Close the connection: an idle process closes its simulator and ends; a busy process is stopped."""
        if self.remaining:
            self.stop()
        elif self._process is not None:
            self.connection.close()

    def wait_until_ended(self) -> None:
        """Wait for the end of a process whose connection was closed; kill it if it does not end."""
        if self._process is None:
            return
        self._process.join(_END_TIMEOUT)
        if self._process.is_alive():
            kill_process_tree(self._process.pid)
            self._process.join(_END_TIMEOUT)
        self._is_started = False
        self._release_process()

    def _release_process(self) -> None:
        self.connection.close()
        self._reaper.release_process(self._process.pid)
        if self._folder is not None:
            self._reaper.remove_folder(self._folder)
        self._process = self._folder = None


def _worker_main(connection: Connection, simulator_description: bytes, folder: Path) -> None:
    """Run in the worker process: create a simulator, and run tasks until the connection closes."""
    # Ctrl-C is handled by the main process, which lets this one finish its scenario or stops it.
    detach_from_terminal()
    exit_with_parent()
    set_temporary_folder(folder)
    try:
        with convert_plugin_errors("A worker process", None, "as it began"):
            name, options = unpickle_simulator(simulator_description)
            _require_simulator_registered(name)
            simulator = SIMULATORS.create(name, **options)
    except InputError as error:
        _send_message(connection, error)
        return
    simulator.on_notice = partial(_forward_notice, connection)
    _send_message(connection, None)
    with simulator:
        while True:
            try:
                concretes = connection.recv()
            except (EOFError, OSError):
                return
            _run_and_send(connection, simulator, concretes)


def _require_simulator_registered(name: str | type[Simulator]) -> None:
    """Raise `InputError` if no simulator of this name is registered in this worker process."""
    if isinstance(name, str) and (base := name.partition(":")[0]) not in SIMULATORS:
        raise InputError(
            f"Worker processes find no simulator '{base}', as they do not search the current folder for packages;"
            " install the package of this simulator, or name its folder in PYTHONPATH."
        )


def _run_and_send(connection: Connection, simulator: Simulator, concretes: list[ConcreteScenario]) -> None:
    try:
        for outcome in run_scenarios_as_given(simulator, concretes):
            _send_message(connection, outcome)
    except InputError as error:
        _send_message(connection, error)


def _forward_notice(connection: Connection, sentence: str) -> None:
    if not _send_message(connection, NoticeMessage(sentence)):
        print(f"{sentence}.", file=sys.stderr)


def _send_message(connection: Connection, message: WorkerMessage) -> bool:
    """Send a message; return whether it could be delivered."""
    # Without a receiver, this process is about to be ended.
    try:
        connection.send(message)
    except (BrokenPipeError, ConnectionResetError):
        return False
    return True
