"""Runs of TestRuns through the Tcl command port of a running CarMaker."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError, SimulationError, SimulatorError
from cornercase.scenario import Value
from cornercase.simulators.carmaker._result_file_tracker import ResultFileTracker

_IDLE, _POSTPROCESSING, _FATAL, _LICENCE, _PAUSED = -2, -3, -6, -7, -8
# States of `SimStatus`; from 0 on the simulation is running.
_STATUS_NAMES: Final = {
    -1: "preprocessing",
    _IDLE: "idle",
    _POSTPROCESSING: "postprocessing",
    -4: "checking its models",
    -5: "adapting its driver",
    _FATAL: "stopped by a fatal error",
    _LICENCE: "waiting for a licence",
    _PAUSED: "paused",
    -10: "starting",
    -11: "initializing Simulink",
}
# In s: time limit for CarMaker to start or become idle, for a result file to appear, and interval of polling.
START_TIMEOUT: Final = 60.0
_RESULT_TIMEOUT: Final = 5.0
_POLL_INTERVAL: Final = 0.05

# Maximum size of an answer, and time limit in s to connect.
_MAX_REPLY_SIZE, _CONNECT_TIMEOUT = 1_000_000, 60.0


class TclClient:
    """Connection to a running CarMaker, which executes Tcl commands.

    CarMaker answers each command with ``O`` and a value, or with ``E`` and an error, followed by an empty line. Some
    answers are only an empty line. An answer may arrive in several pieces. Raises `InputError` if no CarMaker listens.
    """

    def __init__(self, host: str, port: int) -> None:
        try:
            self._socket = socket.create_connection((host, port), timeout=_CONNECT_TIMEOUT)
        except OSError as error:
            raise InputError(
                f"No CarMaker listens on {host}:{port} ({error.strerror or error}); start it with -cmdport {port}."
            ) from error
        self._received = b""

    def send(self, command: str, timeout: float) -> str:
        """Send a Tcl command, wait for the answer for up to `timeout` s, and return its value."""
        deadline = time.monotonic() + timeout
        # Discard the rest of an earlier answer.
        self._received = b""
        try:
            self._socket.sendall(command.encode() + b"\r")
            while True:
                answer = self._next_answer()
                if answer is not None:
                    break
                self._socket.settimeout(max(deadline - time.monotonic(), 1e-3))
                piece = self._socket.recv(65536)
                if not piece:
                    raise SimulatorError(f"CarMaker closed the connection while answering '{command}'")
                self._received += piece
                if len(self._received) > _MAX_REPLY_SIZE:
                    raise SimulatorError(f"CarMaker's answer to '{command}' has no end")
        except TimeoutError:
            raise SimulatorError(f"CarMaker did not answer '{command}' within {timeout:g} s") from None
        except OSError as error:
            raise SimulatorError(f"connection to CarMaker lost at '{command}' ({error.strerror or error})") from error
        if answer.startswith("E"):
            raise SimulationError(f"CarMaker refuses '{command}': {answer[1:].strip()}")
        return answer[1:].strip()

    def _next_answer(self) -> str | None:
        """Return the next answer if it has arrived completely, else None."""
        if self._received.startswith(b"\r\n"):
            self._received = self._received[2:]
            return ""
        whole, end, rest = self._received.partition(b"\r\n\r\n")
        if not end:
            return None
        self._received = rest
        return whole.decode("utf-8", "replace")

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


class TclTestRun:
    """Runs of TestRuns on a running CarMaker, from the idle state to the new result file.

    `quantities`: names of the quantities that CarMaker must store in addition to its usual quantities. `suffix`: text
    at the end of the names of result files, so that several CarMakers can write into one project. `run_timeout`: time
    limit of a run in s. `start_timeout`: time limit for starting or stopping in s.

    CarMaker's command `WaitForStatus` avoids frequent polling. The answer to this command may be late or an error, so
    the state of a run is always read with `SimStatus`.
    """

    def __init__(
        self,
        client: TclClient,
        project: Path,
        run_timeout: float,
        quantities: Sequence[str] = (),
        start_timeout: float = START_TIMEOUT,
        suffix: str = "",
    ) -> None:
        self._client, self._project, self._quantities = client, project, quantities
        self._run_timeout, self._start_timeout = run_timeout, start_timeout
        self._suffix = suffix

    def run_testrun(self, testrun: str, values: Mapping[str, Value]) -> Path:
        """Run a TestRun with named values, and return the new result file."""
        self._make_idle()
        before = ResultFileTracker(self._project)
        self._send(f'LoadTestRun "{testrun}"')
        if self._quantities:
            # A version without this command stores the project's own list; missing quantities are reported later.
            try:
                self._send(f"OutQuantsAdd {{{' '.join(self._quantities)}}}")
            except SimulationError as error:
                if isinstance(error, SimulatorError):
                    raise
        for name, value in values.items():
            self._send(f"NamedValue set {_format_tcl_word(name)} {_format_tcl_word(value)}")
        self._send("SaveMode save_all")
        if self._suffix:
            self._name_result_file()
        self._send("StartSim")
        self._wait_for_start(before)
        self._wait_for_end()
        return self._find_result_file(before)

    def _name_result_file(self) -> None:
        # Folder, user, date, TestRun and time, as CarMaker does; by the second, two CarMakers may get the same name.
        try:
            self._send(f'SetResultFName "%o/%r/%D/%f_%T{self._suffix}%?_s"')
        except SimulationError as error:
            if isinstance(error, SimulatorError):
                raise
            raise InputError(
                f"{self._project}: several workers use this project, and this CarMaker does not let each worker name"
                f" its result files ({error}); give each worker its own project, as project=A+B."
            ) from error

    def _send(self, command: str) -> str:
        return self._client.send(command, self._start_timeout)

    def _make_idle(self) -> None:
        """Stop a run that is active, and wait until CarMaker is idle, also after a fatal error (FailSafe)."""
        status = self._read_status(raises_if_fatal=False)
        if status == _IDLE:
            return
        status = self._stop_run()
        if status != _IDLE:
            raise SimulatorError(
                f"CarMaker is not idle but {_describe_status(status)}, even {self._start_timeout:g} s after StopSim"
            )

    def _stop_run(self) -> int:
        self._send("StopSim")
        return self._wait_for_state("idle", lambda now: now == _IDLE, self._start_timeout, raises_if_fatal=False)

    def _wait_for_start(self, earlier_files: ResultFileTracker) -> None:
        """Wait until the run has started; a short run may already have ended at the first poll."""
        status = self._wait_for_state(
            "running",
            lambda now: (
                now >= 0 or now in (_POSTPROCESSING, _PAUSED) or (now == _IDLE and bool(earlier_files.new_files()))
            ),
            self._start_timeout,
        )
        if status == _IDLE and not earlier_files.new_files():
            raise SimulationError(f"CarMaker did not start the TestRun within {self._start_timeout:g} s: it is idle")
        if status < 0 and status not in (_IDLE, _POSTPROCESSING):
            self._stop_run()
            raise SimulationError(
                f"CarMaker did not start the TestRun within {self._start_timeout:g} s: it is {_describe_status(status)}"
            )

    def _wait_for_end(self) -> None:
        status = self._wait_for_state("idle", lambda now: now in (_IDLE, _PAUSED), self._run_timeout)
        if status == _IDLE:
            return
        stopped = self._stop_run()
        if status == _PAUSED:
            raise SimulationError("CarMaker has paused the TestRun; let it run to its end by itself")
        if stopped != _IDLE:
            raise SimulatorError(
                f"CarMaker did not end the TestRun within {self._run_timeout:g} s, and StopSim did not stop it"
            )
        raise SimulationError(f"CarMaker did not end the TestRun within {self._run_timeout:g} s")

    def _find_result_file(self, earlier_files: ResultFileTracker) -> Path:
        """Return the result file of this run; a file that existed before is never returned."""
        deadline = time.monotonic() + min(_RESULT_TIMEOUT, self._start_timeout)
        while True:
            name = self._send("GetLastResultFName")
            path = self._project / name
            if name and path.is_file() and not earlier_files.is_old(path):
                return path
            if time.monotonic() > deadline:
                break
            time.sleep(_POLL_INTERVAL)
        if not name:
            raise SimulationError("CarMaker stored no result file; let the TestRun store its results")
        if not path.is_file():
            raise SimulationError(f"{path}: cannot be read; check that project is the folder of CarMaker's project")
        raise SimulationError(
            f"CarMaker names {path} as its last result, but it is older than this run; let the TestRun store its"
            " results"
        )

    def _wait_for_state(
        self, state: str, is_accepted: Callable[[int], bool], seconds: float, *, raises_if_fatal: bool = True
    ) -> int:
        """Wait until `is_accepted` accepts the status or the time in s is over; return the last status.

        CarMaker itself waits for `state` first.
        """
        deadline = time.monotonic() + seconds
        try:
            self._client.send(f"WaitForStatus {state} {round(1000 * seconds)}", seconds + self._start_timeout)
        except SimulationError as error:
            # The time limit is over, or CarMaker cannot wait.
            if isinstance(error, SimulatorError):
                raise
        while not is_accepted(status := self._read_status(raises_if_fatal)) and time.monotonic() < deadline:
            time.sleep(_POLL_INTERVAL)
        return status

    def _read_status(self, raises_if_fatal: bool = True) -> int:
        text = self._send("SimStatus")
        try:
            status = int(text)
        except ValueError:
            raise SimulationError(f"CarMaker reports the status '{text}', which is not a number") from None
        if status == _LICENCE:
            raise InputError(
                "CarMaker waits for a licence, or has lost its licence; restore the licence server and run the same"
                " command again to resume."
            )
        if status == _FATAL and raises_if_fatal:
            # Clear the error for the next run.
            with suppress(SimulationError):
                self._send("StopSim")
            raise SimulatorError("CarMaker ended the TestRun with a fatal error; see its log")
        return status


def _describe_status(status: int) -> str:
    return f"running ({status})" if status >= 0 else f"{_STATUS_NAMES.get(status, 'in an unknown state')} ({status})"


def _format_tcl_word(value: Value) -> str:
    text = f"{value:.9g}" if isinstance(value, float) else str(value)
    if any(sign in text for sign in "{}\\\r\n"):
        raise SimulationError(f"'{text}' contains a special character of Tcl")
    return text if text.replace(".", "").replace("-", "").replace("_", "").isalnum() else f"{{{text}}}"
