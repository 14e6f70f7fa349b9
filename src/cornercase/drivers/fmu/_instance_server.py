"""Child process that runs the instances of an FMU, one per scenario; values are exchanged through shared memory.

Only small modules are imported, so that the process starts quickly.
"""

from __future__ import annotations

import base64
import ctypes
import json
import mmap
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from ctypes import c_double, c_int64, c_size_t, c_uint8, c_uint32, c_void_p
from pathlib import Path
from typing import Any, BinaryIO, Final

from cornercase._common.platform import make_parent_check
from cornercase.drivers.fmu._instance import C_TYPES, FATAL, WARNING, Fmu, FmuError, FmuSource, Instance
from cornercase.drivers.fmu._osmp_buffers import MessageBuffers, pass_message, read_message

PROGRESS_BYTES: Final = 16
"""Size of the header of the shared memory: a counter, which grows with each start and step of an instance, and 1 once
all scenarios have been stepped."""
_MAX_LINES: Final = 20
# Time in s between two checks that the parent process is alive.
_LIFE_INTERVAL: Final = 1.0


class _Table:
    """Table of FMU variables of one type in the shared memory, with a row per scenario."""

    def __init__(self, fmu: Fmu, verb: str, kind: str, references: list[int], width: int, address: int) -> None:
        self.name, self._fmu = f"{verb}{kind}", fmu
        self._references = (c_uint32 * len(references))(*references)
        self._stride = width * ctypes.sizeof(C_TYPES[fmu.version][kind])
        self._address = address
        self._tail = (c_size_t(width),) if fmu.version == 3 else ()
        # Raises an error at the start of the batch if the library has no such function.
        self.bind(0, 0)

    def bind(self, component: int, row: int) -> Callable[[], int]:
        """Return a prepared C call that copies a scenario's row to an FMU instance (Set) or from it (Get)."""
        references, values = ctypes.addressof(self._references), self._address + row * self._stride
        pointers = c_void_p(component), c_void_p(references), c_size_t(len(self._references)), c_void_p(values)
        return self._fmu.bind(self.name, *pointers, *self._tail)

    def write_row(self, row: int, values: bytes) -> None:
        ctypes.memmove(self._address + row * self._stride, values, self._stride)

    def read_row(self, row: int) -> bytes:
        return ctypes.string_at(self._address + row * self._stride, self._stride)


class InstanceServer:
    """Runner of an FMU in its child process: one instance per scenario of a batch (scenarios that run together)."""

    def __init__(self, fmu: Fmu) -> None:
        self._fmu = fmu
        fmu.on_log = self._log
        self._lines: deque[str] = deque(maxlen=_MAX_LINES)
        self._idle: list[Instance] = []
        self._instances: list[Instance | None] = []
        # OSI messages that the FMU wrote in the last step, by scenario.
        self._written: list[list[bytes]] = []

    def _log(self, line: str) -> None:
        self._lines.append(line)
        # Also to stderr, which is read if this process crashes.
        print(line, file=sys.stderr, flush=True)

    def begin(self, message: dict[str, Any]) -> None:
        """Begin a batch; `message` holds the layout of the shared memory, parameters, and the size of steps."""
        with Path(message["memory"]).open("r+b") as file:
            self._memory = mmap.mmap(file.fileno(), 0)
        base = ctypes.addressof(ctypes.c_char.from_buffer(self._memory))
        n = message["scenarios"]
        self._progress = (c_int64 * 2).from_address(base)
        self._active = (c_uint8 * n).from_address(base + PROGRESS_BYTES)
        self._inputs, self._outputs = (
            [
                _Table(self._fmu, verb, kind, references, width, base + position)
                for kind, references, width, position in message[name]
            ]
            for verb, name in (("Set", "inputs"), ("Get", "outputs"))
        )
        self._parameters = message["parameters"]
        self._static = [(layout, base64.b64decode(text)) for layout, text in message["static"]]
        self._n_messages, self._message_outputs = len(message["message_inputs"]), message["message_outputs"]
        self._buffers = [MessageBuffers(message["message_inputs"]) for _ in range(n)]
        self._written = [[b""] * len(self._message_outputs) for _ in range(n)]
        self._size, self._n_steps = message["step"], message["steps"]
        self._instances, self._steps = [None] * n, [0] * n
        # By scenario: named calls that set inputs and get outputs, and the call that does a step from `_time`.
        self._setters, self._getters = ([list[tuple[str, Callable[[], int]]]() for _ in range(n)] for _ in range(2))
        self._steppers: list[Callable[[], None]] = [lambda: None] * n
        self._time = c_double()
        self._failed: set[int] = set()
        # Inputs, messages and outputs of one scenario, to check that an instance repeats the same bytes after a reset.
        self._is_reset_known = message["reset"] is not None
        self._recorded_row, self._recorded = -1, list[tuple[list[bytes], list[bytes], list[bytes]]]()

    def receive_messages(self, stream: BinaryIO) -> None:
        """Read the OSI messages for the next step: the sizes of all messages by scenario, then all bytes."""
        n, count = len(self._buffers), self._n_messages
        if not count:
            return
        sizes = iter((c_uint32 * (n * count)).from_buffer_copy(stream.read(4 * n * count)))
        for buffers, is_active in zip(self._buffers, self._active, strict=True):
            messages = [stream.read(next(sizes)) for _ in range(count)]
            # An inactive scenario keeps the messages of its last step.
            if is_active:
                buffers.replace(messages)

    def encode_written_messages(self) -> bytes:
        """Return the OSI messages that the FMU wrote in the last step: the sizes of all messages, then all bytes."""
        messages = [message for row in self._written for message in row]
        return bytes((c_uint32 * len(messages))(*map(len, messages))) + b"".join(messages)

    def step(self) -> dict[int, tuple[str, list[str], bool]]:
        """Step the active scenarios; return (error, log lines, whether the error is fatal) for each failed scenario."""
        failures: dict[int, tuple[str, list[str], bool]] = {}
        for row, is_active in enumerate(bytes(self._active)):
            if not is_active or row in self._failed:
                continue
            self._lines.clear()
            try:
                self._step_row(row)
            except FmuError as error:
                failures[row] = str(error), list(self._lines), error.status == FATAL
                self._failed.add(row)
                self._free_failed(row, error)
        self._progress[1] = 1
        return failures

    def _free_failed(self, row: int, error: FmuError) -> None:
        """Free the instance of a scenario, if there is one, after it has returned an error."""
        instance, self._instances[row] = self._instances[row], None
        if instance is not None and error.status != FATAL:
            instance.free(terminate=False)

    def _step_row(self, row: int) -> None:
        instance = self._instances[row] or self._set_up(row)
        self._set_inputs(instance, row)
        self._do_steps(row, self._steps[row])
        self._steps[row] += self._n_steps
        self._get_outputs(instance, row)
        if not self._is_reset_known and self._recorded_row in (-1, row):
            self._recorded_row = row
            inputs = [table.read_row(row) for table in self._inputs]
            self._recorded.append((inputs, self._buffers[row].newest, self._read_row(row)))

    def _read_row(self, row: int) -> list[bytes]:
        """Return all outputs and OSI messages of a scenario after the last step, as bytes."""
        return [*(table.read_row(row) for table in self._outputs), *self._written[row]]

    def _set_up(self, row: int) -> Instance:
        self._progress[0] += 1
        is_reused = bool(self._idle)
        instance = self._idle.pop() if is_reused else self._fmu.instantiate("cornercase")
        # Kept before any call can fail, since `step` frees the instance of a failed scenario.
        self._instances[row] = instance
        if is_reused:
            instance.reset()
        self._initialize(instance, row)
        return instance

    def _initialize(self, instance: Instance, row: int) -> None:
        self._progress[0] += 1
        self._setters[row], self._getters[row] = (
            [(table.name, table.bind(instance.component, row)) for table in tables]
            for tables in (self._inputs, self._outputs)
        )
        self._steppers[row] = instance.bind_step(self._time, self._size)
        for kind, reference, values in self._parameters:
            instance.set(kind, [reference], [values[row % len(values)]])
        for layout, static in self._static:
            pass_message(instance, layout, static)
        instance.enter_initialization()
        self._set_inputs(instance, row)
        instance.exit_initialization()

    def _set_inputs(self, instance: Instance, row: int) -> None:
        for name, call in self._setters[row]:
            if call() > WARNING:
                raise FmuError(f"fmi{self._fmu.version}{name} returned an error")
        if self._n_messages:
            self._buffers[row].pass_to(instance)

    def _get_outputs(self, instance: Instance, row: int) -> None:
        for name, call in self._getters[row]:
            if call() > WARNING:
                raise FmuError(f"fmi{self._fmu.version}{name} returned an error")
        if self._message_outputs:
            self._written[row] = [read_message(instance, layout) for layout in self._message_outputs]

    def _do_steps(self, row: int, first: int) -> None:
        step, time, progress = self._steppers[row], self._time, self._progress
        for k in range(first, first + self._n_steps):
            progress[0] += 1
            time.value = k * self._size
            step()

    def end(self, reset: bool | None) -> bool | None:
        """End a batch; return whether instances can be reused after a reset.

        `reset` is the answer so far: None if unknown. An unknown answer is found by repeating a recorded scenario after
        a reset; without a recorded scenario, the answer remains None.
        """
        running = [row for row, instance in enumerate(self._instances) if instance is not None]
        if reset is None and self._recorded and self._recorded_row in running:
            # The last instance has driven another scenario, which must not influence it after a reset.
            checked = dict.fromkeys((self._recorded_row, running[-1]))
            reset = all(self._is_repeated_after_reset(row) for row in checked)
        for instance in filter(None, self._instances):
            if reset:
                self._idle.append(instance)
            else:
                instance.free()
        self._instances = []
        return reset

    def _is_repeated_after_reset(self, row_of_instance: int) -> bool:
        instance, row = self._instances[row_of_instance], self._recorded_row
        assert instance is not None
        try:
            instance.reset()
            for k, (inputs, messages, outputs) in enumerate(self._recorded):
                for table, values in zip(self._inputs, inputs, strict=True):
                    table.write_row(row, values)
                self._buffers[row].replace(messages)
                if k == 0:
                    self._initialize(instance, row)
                self._set_inputs(instance, row)
                self._do_steps(row, k * self._n_steps)
                self._get_outputs(instance, row)
                if self._read_row(row) != outputs:
                    return False
        except FmuError as error:
            self._free_failed(row_of_instance, error)
            return False
        return True


def main() -> None:
    """Answer requests from the standard input, one per line: an empty line asks for a step, other lines are JSON.

    In a step, OSI messages in binary form follow the line of the request and the line of the answer.
    """
    # The FMU must neither print between the answers nor read the requests.
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    with open(os.devnull, "rb") as nothing:
        os.dup2(nothing.fileno(), 0)
    threading.Thread(target=_exit_with_parent, args=(make_parent_check(),), daemon=True).start()
    host: InstanceServer | None = None
    for line in requests:
        answer: Any = None
        messages = b""
        try:
            if line == b"\n":
                assert host is not None
                host.receive_messages(requests)
                answer = host.step() or None
                messages = host.encode_written_messages()
            else:
                message = json.loads(line)
                if message["do"] == "load":
                    source = FmuSource(**message["source"])
                    # Some libraries look for other libraries in the current folder.
                    os.chdir(Path(source.library).parent)
                    host = InstanceServer(Fmu(source))
                else:
                    assert host is not None
                    if message["do"] == "begin":
                        host.begin(message)
                    else:
                        answer = host.end(message["reset"])
        except FmuError as error:
            answer = {"error": str(error)}
        answers.write(json.dumps(answer).encode() + b"\n" + messages)
        answers.flush()


def _exit_with_parent(has_parent: Callable[[], bool]) -> None:
    """End this process when its parent has died, even while the FMU hangs."""
    while has_parent():
        time.sleep(_LIFE_INTERVAL)
    os._exit(1)
