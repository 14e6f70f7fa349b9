"""Connections to external driving programs, which cornercase starts, or which already listen on a port."""

from __future__ import annotations

import math
import os
import shutil
import socket
import subprocess
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import suppress
from io import BufferedReader
from pathlib import Path
from threading import Event, Thread
from typing import Any, BinaryIO, Final, cast

from cornercase._common.errors import InputError
from cornercase._common.platform import (
    describe_exit_code,
    detached_process_options,
    find_program,
    is_killed_externally,
    kill_process_tree,
)
from cornercase._common.process.reaper import Reaper
from cornercase._common.text.sanitize import escape_control_characters, remove_folders, shorten
from cornercase.drivers.process._messages import ProtocolError, read_message, write_message

# Seconds: interval between checks of time limits; time that a program has to end after the last message.
_POLL_INTERVAL, _GRACE_PERIOD = 0.05, 2.0
# Of what a program writes to stderr: bytes that are stored, lines and characters that a failure shows.
_STDERR_BYTES, _SHOWN_LINES, _SHOWN_CHARACTERS = 4096, 3, 400
# Bytes, so that a message is written by one call.
_BUFFER_SIZE: Final = 2**20
TCP_PREFIX: Final = "tcp://"


class Peer(ABC):
    """External driving program that answers one message at a time.

    `was_killed`: True if a user or the system has killed the program, so that another attempt may succeed.
    """

    was_killed = False

    def __init__(self, output: BinaryIO, answers: BufferedReader) -> None:
        self._output, self._answers = output, answers
        self._deadline, self._timed_out, self._closed = math.inf, False, Event()
        self._watchdog = Thread(target=self._enforce_deadline, daemon=True, name="time limit of a driver")
        self._watchdog.start()

    def request_answer(self, message: Mapping[str, Any], timeout: float) -> dict[str, Any]:
        """Send a message and return the answer; `ProtocolError` if no answer comes within `timeout` s."""
        self._deadline = time.monotonic() + timeout
        try:
            # If the program has ended, its stderr says why.
            with suppress(BrokenPipeError, ConnectionError):
                write_message(self._output, message)
            answer = read_message(self._answers)
        except (OSError, ValueError):
            # The program has ended, or its pipe was closed.
            answer = None
        finally:
            self._deadline = math.inf
        if self._timed_out:
            raise ProtocolError(f"it did not answer within {timeout:g} s{self._describe_stderr()}")
        if answer is None:
            raise ProtocolError(f"{self._describe_end()}{self._describe_stderr()}")
        return answer

    def send(self, message: Mapping[str, Any]) -> None:
        """Send a message without waiting for an answer."""
        with suppress(OSError, ValueError):
            write_message(self._output, message)

    def _enforce_deadline(self) -> None:
        # Blocking reads have no time limit of their own.
        while not self._closed.wait(_POLL_INTERVAL):
            if time.monotonic() > self._deadline:
                self._timed_out = True
                self._break_off()
                return

    def close(self) -> None:
        """End the program, or the connection to it."""
        self._closed.set()
        for stream in (self._output, self._answers):
            with suppress(OSError):
                stream.close()

    @abstractmethod
    def _break_off(self) -> None:
        """Break the connection, so that pending reads and writes fail."""

    @abstractmethod
    def _describe_end(self) -> str: ...

    def _describe_stderr(self) -> str:
        return ""


class Program(Peer):
    """Driving program that cornercase starts; messages go by stdin and stdout, and stderr is appended to `log`."""

    def __init__(self, words: Sequence[str], log: Path | None) -> None:
        # In its own process group, so that Ctrl-C does not reach the program, which ends when its stdin is closed.
        self._process = subprocess.Popen(
            words,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            bufsize=_BUFFER_SIZE,
            **detached_process_options(),
        )
        self._reaper = Reaper()
        self._reaper.watch_process(self._process.pid)
        self._stderr = b""
        self._stderr_reader = Thread(target=self._read_stderr, args=(log,), daemon=True, name="stderr of a driver")
        self._stderr_reader.start()
        super().__init__(cast("BinaryIO", self._process.stdin), cast("BufferedReader", self._process.stdout))

    def _read_stderr(self, log: Path | None) -> None:
        pipe = self._process.stderr
        assert pipe is not None
        with pipe, open(log or os.devnull, "ab") as copy:
            while piece := os.read(pipe.fileno(), _STDERR_BYTES):
                self._stderr = (self._stderr + piece)[-_STDERR_BYTES:]
                copy.write(piece)
                copy.flush()

    def _break_off(self) -> None:
        kill_process_tree(self._process.pid)

    def _describe_end(self) -> str:
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_GRACE_PERIOD)
        code = self._process.poll()
        if code is None:
            return "it has closed its output"
        self.was_killed = is_killed_externally(code)
        return f"it {describe_exit_code(code)}" if code else "it ended with exit code 0 before it answered"

    def _describe_stderr(self) -> str:
        if self._process.poll() is not None:
            self._stderr_reader.join(_GRACE_PERIOD)
        text = remove_folders(escape_control_characters(self._stderr.decode(errors="replace")))
        lines = [line for line in map(str.strip, text.splitlines()) if line][-_SHOWN_LINES:]
        return f"; its last lines: {shorten(' | '.join(lines), _SHOWN_CHARACTERS)}" if lines else ""

    def close(self) -> None:
        """Close the program's stdin, and kill the program if it does not end soon."""
        if self._process.poll() is None:
            with suppress(OSError):
                self._process.stdin.close()  # type: ignore[union-attr]
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_GRACE_PERIOD)
        # Processes that the program has started may still run.
        kill_process_tree(self._process.pid)
        self._process.wait()
        self._stderr_reader.join(_GRACE_PERIOD)
        super().close()
        self._reaper.close()


class Connection(Peer):
    """TCP connection to a driving program that listens on a port."""

    def __init__(self, host: str, port: int, timeout: float) -> None:
        self._socket = socket.create_connection((host, port), timeout)
        self._socket.settimeout(None)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        output = cast("BinaryIO", self._socket.makefile("wb", _BUFFER_SIZE))
        super().__init__(output, self._socket.makefile("rb"))

    def _break_off(self) -> None:
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def _describe_end(self) -> str:
        return "it has closed the connection"

    def close(self) -> None:
        """Close the connection."""
        self._break_off()
        super().close()
        self._socket.close()


def parse_address(command: str) -> tuple[str, int]:
    """Return host and port of an address ``tcp://HOST:PORT``; `InputError` if one of the two is missing or wrong."""
    host, _, port = command.removeprefix(TCP_PREFIX).rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise InputError(
            f"The driver 'exec:{command}' has no host and port; give both, as in exec:tcp://localhost:5000."
        )
    return host.strip("[]"), int(port)


def resolve_command_words(command: str, words: Sequence[str]) -> list[str]:
    """Return a command's words, the first replaced by the path of the program; `InputError` if there is no program."""
    program = words[0]
    is_path = os.path.dirname(program) != ""
    path = shutil.which(program) if is_path else find_program(program)
    if path is None:
        if Path(program).is_file():
            advice = f"on PATH; give it by its folder, exec:./{program}" if not is_path else "executable; make it so"
            raise InputError(
                f"The driver 'exec:{command}' cannot be started since '{program}' is not {advice}, or name"
                f" its interpreter, as in exec:python {program}."
            )
        raise InputError(f"The driver 'exec:{command}' cannot be started since there is no program '{program}'.")
    return [path, *words[1:]]
