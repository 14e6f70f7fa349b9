"""ScenarioRunner, as a process in an environment of its own."""

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
from cornercase._common.platform import end_process_tree, parent_watch
from cornercase.simulators.carla.tracker import Tracker

RUNNER: Final = "SCENARIO_RUNNER_ROOT"
PYTHON: Final = "CORNERCASE_CARLA_PYTHON"
ROOT: Final = "CARLA_ROOT"
_GET_IT: Final = "`git clone --branch v0.9.16 https://github.com/carla-simulator/scenario_runner`"
_UNKNOWN: Final = f"ScenarioRunner is not known; get it by {_GET_IT} and set SCENARIO_RUNNER_ROOT to its folder."
# What it has to have, by file, as it stands in its source: since 0.9.16. No constant of it names its version.
_NEEDED: Final = {
    "scenario_runner.py": (re.compile(r"""['"]--frameRate['"]"""), "the option --frameRate"),
    "srunner/scenariomanager/actorcontrols/basic_control.py": (
        re.compile(r"\bself\._times\b"),
        "the times of trajectories in controllers (_times)",
    ),
}
_CHANGES: Final = "Docs/CHANGELOG.md"
_VERSION: Final = re.compile(r"^## CARLA ScenarioRunner (\d[\w.]*)", re.MULTILINE)
_ENDING, _POLL = 2.0, 0.02
# ScenarioRunner prints one of these when a scenario has ended; its exit code does not tell.
_ENDED: Final = ("All scenario tests were passed", "Not all scenario tests were successful")
_ERROR: Final = re.compile(r"^\w*(Error|Exception)\b")


class ScenarioRunner:
    """Runs files of OpenSCENARIO 1.0, one process each.

    Parameters
    ----------
    folder, python, carla_root : str
        As in `cornercase.simulators.CarlaSimulator`; empty for those of the environment variables.

    Raises
    ------
    InputError
        Its folder is not known, or holds none that cornercase can use.
    """

    def __init__(self, folder: str, python: str, carla_root: str) -> None:
        self._folder = scenario_runner_folder(folder)
        self._python = python or os.environ.get(PYTHON, "") or sys.executable
        self._carla_root = carla_root or os.environ.get(ROOT, "")

    def run(
        self,
        file: Path,
        drivers: Path,
        options: Mapping[str, object],
        tracker: Tracker,
        *,
        duration: float,
        until_collision: bool,
        silence: float,
    ) -> None:
        """Run a scenario until it has ended, or has to.

        Parameters
        ----------
        file : Path
            What it says goes to ``scenario_runner.log`` beside it.
        drivers : Path
            Folder with the controllers that the scenario names; nothing else is on the path of Python's modules.
        options : mapping of str to object
            Further ones of its command line.
        tracker : Tracker
            Of the same run.
        duration : float
            s of simulated time after which it is ended.
        until_collision : bool
            Whether a collision of two entities ends it.
        silence : float
            s without a frame after which the server is taken for gone.

        Raises
        ------
        SimulationError
            It did not run the scenario to the end; as a `SimulatorError` where the server did not answer.
        """
        command = [self._python, str(self._folder / "scenario_runner.py"), "--sync", "--openscenario", str(file)]
        command += [str(part) for pair in options.items() for part in pair]
        log = file.with_name("scenario_runner.log")
        with log.open("wb") as output:
            process = subprocess.Popen(
                command, cwd=file.parent, env=self._environment(file.parent, drivers), stdin=subprocess.DEVNULL,
                stdout=output, stderr=subprocess.STDOUT,
            )  # fmt: skip
            try:
                stopped = _watch(process, tracker, duration, until_collision, silence)
            finally:
                _end(process)
        said = log.read_text(encoding="utf-8", errors="replace")
        if tracker.missing or not (stopped or any(words in said for words in _ENDED)):
            words = _last_words(said)
            # A request that timed out may be answered when it is tried again.
            kind = SimulatorError if "time-out of" in words else SimulationError
            raise kind(f"ScenarioRunner did not run it to the end: {words}")

    def _environment(self, folder: Path, drivers: Path) -> dict[str, str]:
        roots = [self._folder, drivers]
        if self._carla_root:
            roots.append(Path(self._carla_root) / "PythonAPI" / "carla")
        known = os.environ.get("PYTHONPATH", "")
        return os.environ | {
            "PYTHONPATH": os.pathsep.join([*map(str, roots), *filter(None, [known])]),
            # ScenarioRunner stores recordings relative to this folder.
            RUNNER: str(folder),
            "PYTHONUNBUFFERED": "1",
        }


def scenario_runner_folder(given: str) -> Path:
    """Find ScenarioRunner: in the folder that is given, or in that of the environment variable.

    Its files are read, and nothing of it is run.

    Parameters
    ----------
    given : str
        Empty for that of the variable ``SCENARIO_RUNNER_ROOT``.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        Neither is known, there is none in it, or it is older than what cornercase uses of it.
    """
    text = given or os.environ.get(RUNNER, "")
    if not text:
        raise InputError(_UNKNOWN)
    folder = Path(text)
    if not (folder / "scenario_runner.py").is_file():
        raise InputError(f"{folder}: holds no scenario_runner.py; {RUNNER} has to be the folder of ScenarioRunner.")
    lacks = [what for name, (sign, what) in _NEEDED.items() if not sign.search(_source(folder / name))]
    if lacks:
        version = _VERSION.search(_source(folder / _CHANGES))
        which = "ScenarioRunner" if version is None else f"ScenarioRunner {version[1]}"
        raise InputError(
            f"{folder}: {which} lacks {' and '.join(lacks)}; cornercase needs that of CARLA 0.9.16: get it by {_GET_IT}"
            f" and set {RUNNER} to its folder."
        )
    return folder.resolve()


def _source(path: Path) -> str:
    """Text of a file; empty where there is none."""
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _watch(
    process: subprocess.Popen[bytes], tracker: Tracker, duration: float, until_collision: bool, silence: float
) -> bool:
    """Wait until the run has ended or who asked for it is gone; True where it has to be ended."""
    has_parent, frames, heard = parent_watch(), 0, time.monotonic()
    while process.poll() is None and has_parent():
        tracker.look()
        elapsed, ended = tracker.progress()
        if ended:
            with suppress(subprocess.TimeoutExpired):
                process.wait(_ENDING)
            return False
        if tracker.frames > frames:
            frames, heard = tracker.frames, time.monotonic()
        elif time.monotonic() - heard > silence:
            # Without a server ScenarioRunner may wait for ever.
            raise SimulatorError(f"no frame came from CARLA for {silence:g} s")
        if (until_collision and tracker.collided) or elapsed > duration:
            return True
        # The sensors of collisions should be there before the first step.
        time.sleep(_POLL if not tracker.missing else _POLL / 10)
    return False


def _end(process: subprocess.Popen[bytes]) -> None:
    """Ask ScenarioRunner to clear up and end, where the platform can ask; end it by force if it does not."""
    if process.poll() is None:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(_ENDING)
    if process.poll() is None:
        end_process_tree(process.pid)
        process.wait()


def _last_words(said: str) -> str:
    """Last line that ScenarioRunner printed about an error, else its last line."""
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    errors = [line for line in lines if _ERROR.match(line)]
    return (errors or lines or ["it said nothing"])[-1][:300]
