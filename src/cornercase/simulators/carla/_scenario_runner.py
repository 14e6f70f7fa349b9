"""Run ScenarioRunner as a process in its own environment."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError, SimulationError, SimulatorError
from cornercase._common.platform import kill_process_tree, make_parent_check
from cornercase.simulators.carla._tracker import EntityTracker

RUNNER_VARIABLE: Final = "SCENARIO_RUNNER_ROOT"
PYTHON_VARIABLE: Final = "CORNERCASE_CARLA_PYTHON"
CARLA_ROOT_VARIABLE: Final = "CARLA_ROOT"
_DOWNLOAD_COMMAND: Final = "`git clone --branch v0.9.16 https://github.com/carla-simulator/scenario_runner`"
_NOT_FOUND_MESSAGE: Final = (
    f"ScenarioRunner is not found; get it by {_DOWNLOAD_COMMAND} and set SCENARIO_RUNNER_ROOT to its folder."
)
# Source code that must be present (since 0.9.16), by file. ScenarioRunner has no constant with its version.
_REQUIRED_SOURCE: Final = {
    "scenario_runner.py": (re.compile(r"""['"]--frameRate['"]"""), "the option --frameRate"),
    "srunner/scenariomanager/actorcontrols/basic_control.py": (
        re.compile(r"\bself\._times\b"),
        "the times of trajectories in controllers (_times)",
    ),
}
_CHANGELOG_FILE: Final = "Docs/CHANGELOG.md"
_VERSION_PATTERN: Final = re.compile(r"^## CARLA ScenarioRunner (\d[\w.]*)", re.MULTILINE)
_END_TIMEOUT, _POLL_INTERVAL = 2.0, 0.02
# ScenarioRunner prints one of these when a scenario has ended; its exit code does not show it.
_END_MESSAGES: Final = ("All scenario tests were passed", "Not all scenario tests were successful")
_ERROR_PATTERN: Final = re.compile(r"^\w*(Error|Exception)\b")


class ScenarioRunnerProcess:
    """Runs files with ScenarioRunner, one process per file; environment variables stand for empty arguments."""

    def __init__(self, folder: str, python: str, carla_root: str) -> None:
        self._folder = find_scenario_runner_folder(folder)
        self._python = python or os.environ.get(PYTHON_VARIABLE, "") or sys.executable
        self._carla_root = carla_root or os.environ.get(CARLA_ROOT_VARIABLE, "")

    def run_file(
        self,
        file: Path,
        drivers: Path,
        options: Mapping[str, object],
        tracker: EntityTracker,
        *,
        duration: float,
        until_collision: bool,
        silence: float,
    ) -> None:
        """Run a scenario until it ends or collides, or for `duration` s, or until no frame comes for `silence` s."""
        command = [self._python, str(self._folder / "scenario_runner.py"), "--sync", "--openscenario", str(file)]
        command += [str(part) for pair in options.items() for part in pair]
        log = file.with_name("scenario_runner.log")
        with log.open("wb") as output:
            process = subprocess.Popen(
                command,
                cwd=file.parent,
                env=self._environment_variables(file.parent, drivers),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
            )
            try:
                stopped = _wait_for_end(process, tracker, duration, until_collision, silence)
            finally:
                # A client aborts if an answer or a snapshot of the server is cut.
                is_aborted = (process.poll() or 0) < 0
                _end_process(process)
        output_text = log.read_text(encoding="utf-8", errors="replace")
        if tracker.missing or not (stopped or any(last_line in output_text for last_line in _END_MESSAGES)):
            last_line = _last_error_line(output_text)
            # A time-out may not happen again when the scenario is retried.
            error_class = SimulatorError if is_aborted or "time-out of" in last_line else SimulationError
            raise error_class(f"ScenarioRunner did not run it to the end: {last_line}")

    def _environment_variables(self, folder: Path, drivers: Path) -> dict[str, str]:
        roots = [self._folder, drivers]
        if self._carla_root:
            roots.append(Path(self._carla_root) / "PythonAPI" / "carla")
        python_path = os.environ.get("PYTHONPATH", "")
        return os.environ | {
            "PYTHONPATH": os.pathsep.join([*map(str, roots), *filter(None, [python_path])]),
            # ScenarioRunner stores recordings relative to this folder.
            RUNNER_VARIABLE: str(folder),
            "PYTHONUNBUFFERED": "1",
        }


def find_scenario_runner_folder(explicit_folder: str) -> Path:
    """Return ScenarioRunner's folder: the given one, else ``SCENARIO_RUNNER_ROOT``; `InputError` if it is too old."""
    text = explicit_folder or os.environ.get(RUNNER_VARIABLE, "")
    if not text:
        raise InputError(_NOT_FOUND_MESSAGE)
    folder = Path(text)
    if not (folder / "scenario_runner.py").is_file():
        raise InputError(
            f"{folder}: contains no scenario_runner.py; set {RUNNER_VARIABLE} to the folder of ScenarioRunner."
        )
    missing = [
        description
        for name, (pattern, description) in _REQUIRED_SOURCE.items()
        if not pattern.search(_read_source(folder / name))
    ]
    if missing:
        version = _VERSION_PATTERN.search(_read_source(folder / _CHANGELOG_FILE))
        runner_name = "ScenarioRunner" if version is None else f"ScenarioRunner {version[1]}"
        raise InputError(
            f"{folder}: {runner_name} lacks {' and '.join(missing)}; cornercase needs that of CARLA 0.9.16: get it by"
            f" {_DOWNLOAD_COMMAND} and set {RUNNER_VARIABLE} to its folder."
        )
    return folder.resolve()


def _read_source(path: Path) -> str:
    """Return the text of a file; empty if there is no such file."""
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _wait_for_end(
    process: subprocess.Popen[bytes], tracker: EntityTracker, duration: float, until_collision: bool, silence: float
) -> bool:
    """Wait until the run or the parent process has ended or must end; True if ScenarioRunner must be stopped."""
    has_parent, frames, last_frame_time = make_parent_check(), 0, time.monotonic()
    while process.poll() is None and has_parent():
        tracker.find_entities()
        elapsed, ended = tracker.progress()
        if ended:
            with suppress(subprocess.TimeoutExpired):
                process.wait(_END_TIMEOUT)
            return False
        if tracker.n_frames > frames:
            frames, last_frame_time = tracker.n_frames, time.monotonic()
        elif time.monotonic() - last_frame_time > silence:
            # Without a server, ScenarioRunner may wait forever.
            raise SimulatorError(f"CARLA sent no frame for {silence:g} s")
        if (until_collision and tracker.has_collision) or elapsed > duration:
            return True
        # Collision sensors should exist before the first step, so poll faster until then.
        time.sleep(_POLL_INTERVAL if not tracker.missing else _POLL_INTERVAL / 10)
    return False


def _end_process(process: subprocess.Popen[bytes]) -> None:
    """Terminate ScenarioRunner so that it can clean up; kill it if it does not end."""
    if process.poll() is None:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(_END_TIMEOUT)
    if process.poll() is None:
        kill_process_tree(process.pid)
        process.wait()


def _last_error_line(output: str) -> str:
    """Return the last line of ScenarioRunner's output with an error, else the last line."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    errors = [line for line in lines if _ERROR_PATTERN.match(line)]
    return (errors or lines or ["it printed nothing"])[-1][:300]
