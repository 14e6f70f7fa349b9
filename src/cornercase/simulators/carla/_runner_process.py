"""The process in which ScenarioRunner runs one scenario after another, in its own environment."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Final
from weakref import finalize

from cornercase._common.platform import kill_process_tree
from cornercase.simulators.carla._runner_environment import RunnerEnvironment

_LAUNCHER: Final = Path(__file__).with_name("cornercase_launcher.py")
_END_TIMEOUT, _POLL_INTERVAL = 2.0, 0.02


class RunnerProcess:
    """Process of the program `cornercase_launcher.py`, which runs scenarios by ScenarioRunner.

    The program is started when it is needed. Each scenario runs in a fork of the program, or in the program itself if
    it cannot fork.
    """

    def __init__(self, environment: RunnerEnvironment) -> None:
        self.environment = environment
        self._process: subprocess.Popen[bytes] | None = None
        # Number of the process of the scenario; 0 if there is none.
        self._number = 0
        self._exit_code: int | None = None
        self._finalizer: finalize[[subprocess.Popen[bytes]], RunnerProcess] | None = None

    def start(self, folder: Path, log: Path, drivers: Path, frame_rate: float, arguments: Sequence[object]) -> None:
        """Start a scenario in `folder`.

        `log`: file for the output of ScenarioRunner. `drivers`: folder of the controllers (Python modules) that the
        scenario needs. `frame_rate`: in Hz. `arguments`: command-line arguments of ScenarioRunner.
        """
        request = {
            "folder": str(folder.resolve()),
            "log": str(log.resolve()),
            "drivers": str(drivers.resolve()),
            "frame_rate": frame_rate,
            "arguments": [str(argument) for argument in arguments],
        }
        with log.open("ab") as output:
            if self._process is None or self._process.poll() is not None:
                self._start_program(output)
        assert self._process is not None
        self._number, self._exit_code = 0, None
        assert self._process.stdout is not None
        # If the program has ended, `poll` returns its exit code.
        with suppress(OSError):
            self._send(json.dumps(request))
            self._number = int(self._process.stdout.readline().decode().removeprefix("started ") or 0)

    def begin_storyboard(self) -> None:
        """Let the process of the scenario begin the storyboard, for which it waits."""
        with suppress(OSError):
            self._send("")

    def poll(self) -> int | None:
        """Return the exit code of the scenario's process, negative for a signal; None while it runs."""
        assert self._process is not None
        if self._exit_code is None and self._is_forked:
            assert self._process.stdout is not None
            if select.select([self._process.stdout], [], [], 0.0)[0]:
                line = self._process.stdout.readline().decode()
                self._exit_code = int(line.removeprefix("ended ")) if line else self._process.wait()
        elif self._exit_code is None:
            self._exit_code = self._process.poll()
        return self._exit_code

    def wait(self, timeout: float) -> bool:
        """Wait up to `timeout` s for the end of the scenario's process; return whether it has ended."""
        deadline = time.monotonic() + timeout
        while self.poll() is None:
            if time.monotonic() > deadline:
                return False
            time.sleep(_POLL_INTERVAL)
        return True

    def end_scenario(self) -> None:
        """Terminate the scenario's process so that it can clean up; kill it if it does not end."""
        if self.poll() is None and self._number:
            with suppress(OSError):
                os.kill(self._number, signal.SIGTERM)
            if not self.wait(_END_TIMEOUT):
                kill_process_tree(self._number)
        if not self.wait(_END_TIMEOUT):
            self.close()

    def close(self) -> None:
        """End the program and all processes that it has started; the next scenario starts it again."""
        if self._finalizer is not None:
            self._finalizer()
        self._process = None

    @property
    def _is_forked(self) -> bool:
        return self._process is not None and self._number not in (0, self._process.pid)

    def _start_program(self, output: IO[bytes]) -> None:
        self.close()
        self._process = subprocess.Popen(
            [self.environment.python, str(_LAUNCHER)],
            # Not the folder of a scenario, which is removed.
            cwd=self.environment.folder,
            env=self.environment.variables(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=output,
            # Unbuffered, so that `select` sees whether there is a line to read.
            bufsize=0,
        )
        # Ends the program even if `close` is never called.
        self._finalizer = finalize(self, _end_program, self._process)

    def _send(self, line: str) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        self._process.stdin.write(line.encode() + b"\n")


def _end_program(process: subprocess.Popen[bytes]) -> None:
    kill_process_tree(process.pid)
    process.wait()
    for pipe in (process.stdin, process.stdout):
        assert pipe is not None
        with suppress(OSError):
            pipe.close()
