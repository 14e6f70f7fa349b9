"""Server of a simulator, which a worker process starts on its own machine and restarts if needed."""

from __future__ import annotations

import subprocess
import tempfile
import time
from collections.abc import Callable
from typing import IO, Final

from cornercase._common.errors import InputError, SimulatorError
from cornercase._common.platform import describe_exit_code, kill_process_tree, split_command

_LOCAL_HOSTS: Final = ("localhost", "127.0.0.1", "::1")
_POLL_INTERVAL, _END_TIMEOUT = 0.1, 10.0
_START_ATTEMPTS: Final = 2


class ServerProcess:
    """A server that is started by a command, in which ``{port}`` stands for its port.

    `is_ready` is a function that returns whether the server answers. The server must answer within `start_timeout` s,
    and is started again after `restart_after` scenarios (0: never). Messages call the simulator `name`.
    """

    def __init__(
        self,
        name: str,
        command: str,
        host: str,
        port: int,
        is_ready: Callable[[], bool],
        *,
        start_timeout: float,
        restart_after: int = 0,
    ) -> None:
        if host not in _LOCAL_HOSTS:
            raise InputError(f"start={command}: starts {name} on this machine, not on {host}; leave out `hosts`.")
        if "{port}" not in command:
            raise InputError(f"start={command}: names no port; write {{port}} where the port belongs.")
        self._name, self._command, self._port = name, command.replace("{port}", str(port)), port
        self._is_ready, self._start_timeout, self._restart_after = is_ready, start_timeout, restart_after
        self._process: subprocess.Popen[bytes] | None = None
        self._log: IO[bytes] | None = None
        self._n_scenarios, self._n_starts = 0, 0

    @property
    def n_starts(self) -> int:
        """Number of times that the server was started."""
        return self._n_starts

    @property
    def is_running(self) -> bool:
        """Whether the server was started and has not ended."""
        return self._process is not None and self._process.poll() is None

    def start_if_needed(self) -> bool:
        """Start the server before a scenario if it does not run or has to be restarted; return whether it was started.

        If the server does not start, raises `InputError` the first time, and `SimulatorError` later.
        """
        is_worn = 0 < self._restart_after <= self._n_scenarios
        if self._process is not None and (is_worn or self._process.poll() is not None):
            self.stop()
        is_new = self._process is None
        if is_new:
            self._start()
        self._n_scenarios += 1
        return is_new

    @property
    def _start_error(self) -> type[InputError | SimulatorError]:
        return SimulatorError if self._n_starts else InputError

    def _start(self) -> None:
        """Start the server; if this fails, try once more, since the first failure may have been accidental."""
        if self._is_ready():
            raise self._start_error(
                f"Another server answers on port {self._port} already; end that server, choose another port, or leave"
                " out 'start' to use that server."
            )
        for attempt in range(1, _START_ATTEMPTS + 1):
            problem = self._try_to_start()
            if not problem:
                break
            if attempt == _START_ATTEMPTS:
                raise self._start_error(f"{self._name}, started by '{self._command}', {problem}.")
        self._n_starts, self._n_scenarios = self._n_starts + 1, 0

    def _try_to_start(self) -> str:
        """Start the server and wait until it answers; return what went wrong, as a clause; empty if nothing."""
        self._log = tempfile.TemporaryFile()  # noqa: SIM115
        try:
            self._process = subprocess.Popen(
                split_command(self._command), stdin=subprocess.DEVNULL, stdout=self._log, stderr=subprocess.STDOUT
            )
        except (OSError, ValueError) as error:
            raise self._start_error(f"{self._name} cannot be started by '{self._command}' ({error}).") from error
        deadline = time.monotonic() + self._start_timeout
        while not self._is_ready():
            code = self._process.poll()
            if code is not None or time.monotonic() > deadline:
                late = f"did not answer within {self._start_timeout:g} s"
                problem = (late if code is None else describe_exit_code(code)) + self._last_line()
                self.stop()
                return problem
            time.sleep(_POLL_INTERVAL)
        return ""

    def _last_line(self) -> str:
        """Return the last line that the server has printed, as a clause; empty if it has printed nothing."""
        if self._log is None:
            return ""
        self._log.seek(0)
        lines = self._log.read()[-2000:].decode("utf-8", "replace").split("\n")
        printed = [line.strip() for line in lines if line.strip()]
        return f"; its last words: {printed[-1][:200]}" if printed else ""

    def describe_end(self) -> str:
        """Return how the server has ended, as a clause; empty if it runs or was never started."""
        code = None if self._process is None else self._process.poll()
        return "" if code is None else f"{describe_exit_code(code)}{self._last_line()}"

    def stop(self) -> None:
        """End the server with all processes that it has started; the next scenario starts it again."""
        if self._process is not None:
            kill_process_tree(self._process.pid)
            try:
                self._process.wait(_END_TIMEOUT)
            except subprocess.TimeoutExpired as error:
                raise SimulatorError(
                    f"{self._name} (process {self._process.pid}) was killed, but still runs after {_END_TIMEOUT:g} s"
                ) from error
            self._process = None
        if self._log is not None:
            self._log.close()
            self._log = None
