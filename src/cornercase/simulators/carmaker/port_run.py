"""One run of a TestRun by CarMaker's command port, from rest to its new result file."""

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
# What `SimStatus` says; from 0 on the simulation runs.
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
# s that CarMaker may take to begin or to come to rest, beyond those of a run; s that a result file may take to appear;
# and s between two questions.
WAITING: Final = 60.0
_SETTLING: Final = 5.0
_BETWEEN: Final = 0.05


class PortRun:
    """A run of a TestRun.

    `WaitForStatus` saves questions but is not relied on: its answer may be late, or an error. `SimStatus` decides.

    Parameters
    ----------
    line : CommandPort
    project : Path
        Folder of the CarMaker project.
    patience : float
        s that the run may take.
    waiting : float, default 60
        s that it may take to begin, or to stop.
    """

    def __init__(self, line: CommandPort, project: Path, patience: float, waiting: float = WAITING) -> None:
        self._line, self._project, self._patience, self._waiting = line, project, patience, waiting

    def run(self, testrun: str, values: Mapping[str, Value]) -> Path:
        """Run it with named values.

        Parameters
        ----------
        testrun : str
        values : mapping of str to float or str

        Returns
        -------
        Path
            The result file that this run has written.

        Raises
        ------
        SimulationError
            CarMaker refuses, does not begin or end in time, is paused, or writes no new result file; as a
            `SimulatorError`, it fails or does not stop.
        InputError
            It waits for a licence.
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
        """Stop what is still running, or somebody else has started, and wait until nothing does."""
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
        """Wait until it runs, or has run already: a short run may be over before anyone asks."""
        self._wait_for("running", self._waiting)
        status = self._polled(
            lambda now: now >= 0 or now in (_POSTPROCESSING, _PAUSED) or (now == _IDLE and bool(before.written())),
            self._waiting,
        )
        if status == _IDLE and not before.written():
            raise SimulationError(f"CarMaker did not begin the TestRun within {self._waiting:g} s: it is idle")
        if status < 0 and status not in (_IDLE, _POSTPROCESSING):
            self._stopped()
            raise SimulationError(
                f"CarMaker did not begin the TestRun within {self._waiting:g} s: it is {_name(status)}"
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
        """Find the file of this run; one that was there before is never taken for it."""
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
            f"CarMaker names {path} as its last result, which was there before this run; let the TestRun store its"
            " results"
        )

    def _wait_for(self, state: str, seconds: float) -> None:
        """Let CarMaker wait; whatever it answers, its status is asked for afterwards."""
        try:
            self._line.ask(f"WaitForStatus {state} {round(1000 * seconds)}", seconds + self._waiting)
        except SimulatorError:
            raise
        except SimulationError:
            # It has waited long enough, or cannot wait.
            pass

    def _polled(self, enough: Callable[[int], bool], seconds: float) -> int:
        """Ask for the status until it is one that is enough, and give the last one."""
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
                " command again to go on."
            )
        if status == _FATAL:
            # So that the next run does not find the same error.
            with suppress(SimulationError):
                self._ask("StopSim")
            raise SimulatorError("CarMaker ended the TestRun with a fatal error; its log tells which")
        return status


def _name(status: int) -> str:
    return f"running ({status})" if status >= 0 else f"{_STATES.get(status, 'in an unknown state')} ({status})"


def _word(value: Value) -> str:
    """A value as one Tcl word."""
    text = f"{value:.9g}" if isinstance(value, float) else str(value)
    if any(sign in text for sign in "{}\\\r\n"):
        raise SimulationError(f"'{text}' has a character with a meaning in Tcl")
    return text if text.replace(".", "").replace("-", "").replace("_", "").isalnum() else f"{{{text}}}"
