"""A run of a TestRun through CarMaker's command port, from idle to the new result file."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError, SimulationError, SimulatorError
from cornercase.scenario import Value
from cornercase.simulators.carmaker.port import CommandPort
from cornercase.simulators.carmaker.results import ResultFiles

_IDLE, _POSTPROCESSING, _FATAL, _LICENCE, _PAUSED = -2, -3, -6, -7, -8
# States of `SimStatus`; from 0 on the simulation is running.
_STATES: Final = {
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
WAITING: Final = 60.0
_SETTLING: Final = 5.0
_BETWEEN: Final = 0.05


class PortRun:
    """Runs a TestRun; `patience` is the time limit in s of the run, `waiting` that to start or stop.

    `WaitForStatus` saves polling, but its answer may be late or an error, so `SimStatus` decides.
    """

    def __init__(self, line: CommandPort, project: Path, patience: float, waiting: float = WAITING) -> None:
        self._line, self._project, self._patience, self._waiting = line, project, patience, waiting

    def run(self, testrun: str, values: Mapping[str, Value]) -> Path:
        """Run the TestRun with named values, and return the result file that it wrote.

        Raises `SimulationError` if CarMaker refuses, does not start or end in time, is paused or writes no result file,
        `SimulatorError` if it fails or does not stop, and `InputError` if it waits for a licence.
        """
        self._come_to_rest()
        before = ResultFiles(self._project)
        self._ask(f'LoadTestRun "{testrun}"')
        for name, value in values.items():
            self._ask(f"NamedValue set {_word(name)} {_word(value)}")
        self._ask("SaveMode save_all")
        self._ask("StartSim")
        self._await_begin(before)
        self._await_end()
        return self._result(before)

    def _ask(self, command: str) -> str:
        return self._line.ask(command, self._waiting)

    def _come_to_rest(self) -> None:
        """Stop whatever is running, and wait until CarMaker is idle."""
        status = self._status()
        if status == _IDLE:
            return
        status = self._stopped()
        if status != _IDLE:
            raise SimulatorError(f"CarMaker is not idle but {_name(status)}, also {self._waiting:g} s after StopSim")

    def _stopped(self) -> int:
        self._ask("StopSim")
        self._wait_for("idle", self._waiting)
        return self._polled(lambda status: status == _IDLE, self._waiting)

    def _await_begin(self, before: ResultFiles) -> None:
        """Wait until the run has started; a short run may be over before the first poll."""
        self._wait_for("running", self._waiting)
        status = self._polled(
            lambda now: now >= 0 or now in (_POSTPROCESSING, _PAUSED) or (now == _IDLE and bool(before.written())),
            self._waiting,
        )
        if status == _IDLE and not before.written():
            raise SimulationError(f"CarMaker did not start the TestRun within {self._waiting:g} s: it is idle")
        if status < 0 and status not in (_IDLE, _POSTPROCESSING):
            self._stopped()
            raise SimulationError(
                f"CarMaker did not start the TestRun within {self._waiting:g} s: it is {_name(status)}"
            )

    def _await_end(self) -> None:
        self._wait_for("idle", self._patience)
        status = self._polled(lambda now: now in (_IDLE, _PAUSED), self._patience)
        if status == _IDLE:
            return
        stopped = self._stopped()
        if status == _PAUSED:
            raise SimulationError("CarMaker has paused the TestRun; let it run to its end by itself")
        if stopped != _IDLE:
            raise SimulatorError(f"CarMaker did not end the TestRun within {self._patience:g} s, nor after StopSim")
        raise SimulationError(f"CarMaker did not end the TestRun within {self._patience:g} s")

    def _result(self, before: ResultFiles) -> Path:
        """Return the result file of this run, never one that existed before."""
        deadline = time.monotonic() + min(_SETTLING, self._waiting)
        while True:
            name = self._ask("GetLastResultFName")
            path = self._project / name
            if name and path.is_file() and not before.is_old(path):
                return path
            if time.monotonic() > deadline:
                break
            time.sleep(_BETWEEN)
        if not name:
            raise SimulationError("CarMaker stored no result file; let the TestRun store its results")
        if not path.is_file():
            raise SimulationError(f"{path}: cannot be read; check that project is the folder of CarMaker's project")
        raise SimulationError(
            f"CarMaker names {path} as its last result, but it is older than this run; let the TestRun store its"
            " results"
        )

    def _wait_for(self, state: str, seconds: float) -> None:
        """Let CarMaker wait for a state; the status is polled afterwards in any case."""
        try:
            self._line.ask(f"WaitForStatus {state} {round(1000 * seconds)}", seconds + self._waiting)
        except SimulatorError:
            raise
        except SimulationError:
            # The time limit is over, or CarMaker cannot wait.
            pass

    def _polled(self, enough: Callable[[int], bool], seconds: float) -> int:
        """Poll the status until `enough` accepts it; return the last one."""
        deadline = time.monotonic() + seconds
        while not enough(status := self._status()) and time.monotonic() < deadline:
            time.sleep(_BETWEEN)
        return status

    def _status(self) -> int:
        text = self._ask("SimStatus")
        try:
            status = int(text)
        except ValueError:
            raise SimulationError(f"CarMaker reports the status '{text}', which is not a number") from None
        if status == _LICENCE:
            raise InputError(
                "CarMaker waits for a licence, or has lost its licence; restore the licence server and run the same"
                " command again to resume."
            )
        if status == _FATAL:
            # Clear the error for the next run.
            with suppress(SimulationError):
                self._ask("StopSim")
            raise SimulatorError("CarMaker ended the TestRun with a fatal error; see its log")
        return status


def _name(status: int) -> str:
    return f"running ({status})" if status >= 0 else f"{_STATES.get(status, 'in an unknown state')} ({status})"


def _word(value: Value) -> str:
    """Format a value as one Tcl word."""
    text = f"{value:.9g}" if isinstance(value, float) else str(value)
    if any(sign in text for sign in "{}\\\r\n"):
        raise SimulationError(f"'{text}' contains a special character of Tcl")
    return text if text.replace(".", "").replace("-", "").replace("_", "").isalnum() else f"{{{text}}}"
