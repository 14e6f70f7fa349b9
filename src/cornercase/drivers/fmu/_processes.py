"""Processes that run the instances of an FMU, so that a crash of the FMU fails only the scenario at fault."""

from __future__ import annotations

import base64
import json
import mmap
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, NoReturn

import numpy as np
import numpy.typing as npt

from cornercase._common.platform import count_available_cpus, describe_exit_code, detached_process_options
from cornercase._common.process.reaper import Reaper
from cornercase._common.text.sanitize import escape_control_characters, remove_folders, shorten
from cornercase._common.typing import BoolArray
from cornercase.drivers.fmu._instance import FmuSource
from cornercase.drivers.fmu._instance_server import PROGRESS_BYTES
from cornercase.drivers.fmu._osmp_buffers import MessageLayout

MAX_PROCESSES: Final = 32
"""Maximum number of processes at the same time, for an FMU that allows only one instance per process."""
# Scenarios per process: a larger batch is divided between several processes.
_SCENARIOS_PER_PROCESS: Final = 100
# Least time limit in s for the start of a process, and for the start and the end of a batch.
_START_TIMEOUT: Final = 60.0
# Log lines that an error message shows, their total length in characters, and bytes of the log that are read.
_MAX_LINES, _MAX_LOG_LENGTH, _MAX_LOG_BYTES = 3, 300, 1_000_000
# The child process imports the package from the same folder as this process.
_HOST_CODE: Final = (
    "import sys; sys.path.insert(0, sys.argv[1]); from cornercase.drivers.fmu._instance_server import main; main()"
)


class FmuProcessError(Exception):
    """The process of an FMU crashed or hung, or its FMU cannot be used any more."""


@dataclass(frozen=True)
class TableLayout:
    """Layout of a table of FMU variables of one type, set or read in one call: `width` values per scenario.

    `kind` is the FMI type, and `references` are the value references of the variables.
    """

    kind: str
    references: tuple[int, ...]
    width: int
    dtype: str


@dataclass(frozen=True)
class MessageLayouts:
    """OSI messages that FMU instances read and write, each as (FMI type, value references of address and size).

    `static` messages are passed once, before the initialization, together with their bytes.
    """

    inputs: Sequence[MessageLayout] = ()
    outputs: Sequence[MessageLayout] = ()
    static: Sequence[tuple[MessageLayout, bytes]] = ()


@lru_cache(maxsize=1)
def process_reaper() -> Reaper:
    """Return the shared reaper, which ends FMU processes and removes unpacked FMUs once cornercase has ended."""
    reaper = Reaper()
    # At the end of the program, finalizers run in reverse order: those of processes come first.
    weakref.finalize(process_reaper, reaper.close)
    return reaper


class FmuProcesses:
    """Pool of processes that run the instances of an FMU, one instance per scenario of a batch.

    If `once_per_process`, each process runs one instance only. `timeout` is the longest time in s that a call of the
    FMU may take in a step.
    """

    def __init__(self, source: FmuSource, *, once_per_process: bool, timeout: float) -> None:
        self._source, self._once, self._timeout = source, once_per_process, timeout
        self._processes: list[_Process] = []
        # Processes of the current batch.
        self._used: list[_Process] = []
        self._reset: bool | None = None

    def begin_batch(
        self,
        scenarios: int,
        inputs: Sequence[TableLayout],
        outputs: Sequence[TableLayout],
        parameters: Sequence[tuple[str, int, Sequence[object]]],
        step: float,
        steps: int,
        messages: MessageLayouts,
    ) -> None:
        """Begin a batch; `FmuProcessError` if the FMU cannot be loaded, or if too many processes are needed.

        `parameters` are (type, value reference, values), with one value for all scenarios or one per scenario. `step`
        is the size of the FMU's steps in s, and `steps` their number in a time step of the simulator.
        """
        self._used = []
        if self._once and scenarios > MAX_PROCESSES:
            raise FmuProcessError(
                f"the FMU needs a process for each of {scenarios} scenarios, but at most {MAX_PROCESSES} are allowed"
            )
        n_processes = min(count_available_cpus(), -(-scenarios // _SCENARIOS_PER_PROCESS))
        bounds = np.linspace(0, scenarios, (scenarios if self._once else n_processes) + 1).astype(int).tolist()
        self._rows = [slice(*pair) for pair in pairwise(bounds)]
        self._processes = [process for process in self._processes if process.is_usable]
        while len(self._processes) < len(self._rows):
            self._processes.append(_Process(self._source, self._timeout))
        self._used = self._processes[: len(self._rows)]
        for process, rows in zip(self._used, self._rows, strict=True):
            own = [(kind, vr, values[rows] if len(values) > 1 else values) for kind, vr, values in parameters]
            process.begin_batch(rows.stop - rows.start, inputs, outputs, own, step, steps, messages, self._reset)

    def step(
        self, active: BoolArray, inputs: Sequence[npt.NDArray[Any]], messages: Sequence[Sequence[bytes]]
    ) -> dict[int, str]:
        """Step the active scenarios; return the errors of failed scenarios, by scenario.

        Raises `FmuProcessError` if a process crashed or hung, or if the FMU returned the status Fatal. `messages` are
        the OSI messages by scenario. `read_outputs` and `read_messages` return the results of the step.
        """
        failures: dict[int, str] = {}
        try:
            for process, rows in zip(self._used, self._rows, strict=True):
                process.start_step(active[rows], [table[rows] for table in inputs], messages[rows])
            for process, rows in zip(self._used, self._rows, strict=True):
                failures |= {rows.start + row: text for row, text in process.finish_step().items()}
        except BaseException:
            # Pending answers of other processes would be mistaken for answers to the next step.
            self.close()
            raise
        return failures

    def read_outputs(self, table: int) -> npt.NDArray[Any]:
        """Return the FMU's outputs in table number `table` after a step, with a row per scenario."""
        return np.concatenate([process.outputs[table] for process in self._used])

    def read_messages(self) -> list[list[bytes]]:
        """Return the OSI messages that the FMU wrote in the last step, by scenario."""
        return [row for process in self._used for row in process.messages]

    def end_batch(self) -> None:
        """End a batch; keep instances for the next batch if an instance gives the same outputs again after a reset."""
        for process in self._used:
            try:
                self._reset = process.end_batch(self._reset)
            except FmuProcessError:
                self._reset = False
            if self._once and not self._reset:
                process.close()

    def close(self) -> None:
        """End all processes."""
        for process in self._processes:
            process.close()
        self._processes, self._used = [], []


class _Process:
    """Child process with instances of an FMU; the constructor starts the process and loads the FMU."""

    def __init__(self, source: FmuSource, timeout: float) -> None:
        self._timeout = timeout
        self._folder = process_reaper().make_temporary_folder()
        self._n_batches = 0
        self._memory: mmap.mmap | None = None
        self._log = (self._folder / "log").open("ab+")
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", _HOST_CODE, str(Path(__file__).parents[3])],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            **detached_process_options(),
        )
        process_reaper().watch_process(self._process.pid)
        self._close = weakref.finalize(self, _end_process, self._process, self._log, self._folder)
        self._requests, self._is_busy, self._is_hung = 0, False, False
        # Time limit in s of the current request.
        self.limit = timeout
        threading.Thread(target=_kill_when_hung, args=(weakref.ref(self), timeout), daemon=True).start()
        self._request({"do": "load", "source": asdict(source)})

    @property
    def is_usable(self) -> bool:
        """True if the process still runs."""
        return self._close.alive and self._process.poll() is None

    def begin_batch(
        self,
        scenarios: int,
        inputs: Sequence[TableLayout],
        outputs: Sequence[TableLayout],
        parameters: Sequence[tuple[str, int, Sequence[object]]],
        step: float,
        steps: int,
        messages: MessageLayouts,
        reset: bool | None,
    ) -> None:
        """Begin a batch as in `FmuProcesses.begin_batch`.

        `reset` says whether instances can be reused after a reset; None if this is unknown.
        """
        size, layouts = PROGRESS_BYTES + scenarios, list[list[Any]]()
        positions = list[int]()
        for table in (*inputs, *outputs):
            # Numbers of 8 bytes begin at multiples of 8.
            size = -(-size // 8) * 8
            positions.append(size)
            layouts.append([table.kind, table.references, table.width, size])
            size += scenarios * table.width * np.dtype(table.dtype).itemsize
        # Each batch has its own memory, since the memory of the last batch may still be in use.
        path, last = (self._folder / f"values-{self._n_batches - k}" for k in (0, 1))
        self._n_batches += 1
        path.write_bytes(bytes(size))
        with path.open("r+b") as file:
            self._memory = mmap.mmap(file.fileno(), 0)
        # Windows cannot remove a file that is in use.
        with suppress(OSError):
            last.unlink()
        self._progress = np.frombuffer(self._memory, np.int64, 2)
        self._active = np.frombuffer(self._memory, np.bool_, scenarios, PROGRESS_BYTES)
        arrays = [
            np.frombuffer(self._memory, table.dtype, scenarios * table.width, position).reshape(scenarios, table.width)
            for table, position in zip((*inputs, *outputs), positions, strict=True)
        ]
        self._inputs, self.outputs = arrays[: len(inputs)], arrays[len(inputs) :]
        self._n_messages, self.messages = len(messages.outputs), [[b""] * len(messages.outputs)] * scenarios
        self._log.truncate(0)
        self._request(
            {
                "do": "begin",
                "memory": str(path),
                "scenarios": scenarios,
                "inputs": layouts[: len(inputs)],
                "outputs": layouts[len(inputs) :],
                "parameters": list(parameters),
                "step": step,
                "steps": steps,
                "message_inputs": messages.inputs,
                "message_outputs": messages.outputs,
                "static": [(layout, base64.b64encode(static).decode()) for layout, static in messages.static],
                "reset": reset,
            }
        )

    def start_step(
        self, active: BoolArray, inputs: Sequence[npt.NDArray[Any]], messages: Sequence[Sequence[bytes]]
    ) -> None:
        """Send inputs and OSI messages, and start a step of the active scenarios; `finish_step` waits for its end."""
        self._active[:] = active
        for own, table in zip(self._inputs, inputs, strict=True):
            own[:] = table
        flat = [message for row in messages for message in row]
        sizes = np.array([len(message) for message in flat], dtype=np.uint32)
        self._send(b"".join((b"\n", sizes.tobytes(), *flat)), self._timeout)

    def finish_step(self) -> dict[int, str]:
        """Wait for the end of the started step, and return the errors of failed scenarios, by scenario."""
        answer = self._receive()
        if self._n_messages:
            sizes = np.frombuffer(self._read(4 * self._n_messages * len(self.messages)), dtype=np.uint32)
            rows = sizes.reshape(len(self.messages), self._n_messages).tolist()
            self.messages = [[self._read(size) for size in row] for row in rows]
        for row, (text, lines, is_fatal) in (answer or {}).items():
            if is_fatal:
                raise FmuProcessError(f"failed: {text}{_format_log(lines)}")
            answer[row] = f"failed: {text}{_format_log(lines)}"
        return {int(row): text for row, text in (answer or {}).items()}

    def end_batch(self, reset: bool | None) -> bool | None:
        """End a batch; return whether instances can be reused after a reset, or None if this is unknown."""
        answer: bool | None = self._request({"do": "end", "reset": reset})
        return answer

    def close(self) -> None:
        """End the process."""
        self._close()

    def _request(self, message: dict[str, object]) -> Any:
        self._send(json.dumps(message).encode() + b"\n", max(self._timeout, _START_TIMEOUT))
        answer = self._receive()
        if isinstance(answer, dict) and "error" in answer:
            raise FmuProcessError(f"failed: {answer['error']}")
        return answer

    def _send(self, line: bytes, limit: float) -> None:
        assert self._process.stdin is not None
        if self._memory is not None:
            self._progress[1] = 0
        self.limit, self._requests, self._is_busy = limit, self._requests + 1, True
        # If the process has ended, there is no answer.
        with suppress(OSError, ValueError):
            self._process.stdin.write(line)
            self._process.stdin.flush()

    def _receive(self) -> Any:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        self._is_busy = False
        if not line.endswith(b"\n"):
            self._raise_ended()
        return json.loads(line)

    def _read(self, size: int) -> bytes:
        assert self._process.stdout is not None
        content = self._process.stdout.read(size) if size else b""
        if len(content) < size:
            self._raise_ended()
        return content

    def _raise_ended(self) -> NoReturn:
        code = self._process.wait()
        lines = self._read_log()
        self.close()
        if self._is_hung:
            raise FmuProcessError(f"hung: a call took more than {self.limit:g} s{_format_log(lines)}")
        raise FmuProcessError(f"crashed: its process {describe_exit_code(code)}{_format_log(lines)}")

    def _read_log(self) -> list[str]:
        size = self._log.seek(0, 2)
        self._log.seek(max(size - _MAX_LOG_BYTES, 0))
        return self._log.read().decode(errors="replace").splitlines()

    def read_progress(self) -> tuple[bool, tuple[int, int]]:
        """Return whether the process works on a request, and numbers that change while it makes progress."""
        progress, has_ended = (0, 0) if self._memory is None else self._progress.tolist()
        with suppress(OSError, ValueError):
            if self._log.seek(0, 2) > 10 * _MAX_LOG_BYTES:
                self._log.truncate(0)
        return self._is_busy and not has_ended, (self._requests, progress)

    def kill_as_hung(self) -> None:
        """Kill the process because it does not answer in time."""
        self._is_hung = True
        self._process.kill()


def _kill_when_hung(reference: weakref.ref[_Process], timeout: float) -> None:
    """Kill the process if a call exceeds the time limit; this function runs in a thread of its own.

    A shorter `timeout` in s makes the function check more often.
    """
    mark, since = (-1, -1), 0.0
    while True:
        process = reference()
        if process is None or not process.is_usable:
            return
        is_busy, current = process.read_progress()
        now = time.monotonic()
        if not is_busy or current != mark:
            mark, since = current, now
        elif now - since > process.limit:
            process.kill_as_hung()
            return
        del process
        time.sleep(min(0.1 * timeout, 0.5))


def _end_process(process: subprocess.Popen[bytes], log: Any, folder: Path) -> None:
    process.kill()
    process.wait()
    for stream in (process.stdin, process.stdout, log):
        with suppress(OSError):
            if stream is not None:
                stream.close()
    process_reaper().release_process(process.pid)
    process_reaper().remove_folder(folder)


def _format_log(lines: Sequence[str]) -> str:
    """Format the last lines of an FMU's log for an error message; an empty text if there are none."""
    plain = [" ".join(escape_control_characters(remove_folders(line)).split()) for line in lines[-_MAX_LINES:]]
    text = " | ".join(filter(None, plain))
    return f"; its log: {shorten(text, _MAX_LOG_LENGTH)}" if text else ""
