"""Run of a scenario by ScenarioRunner, from its start to its end or failure."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cornercase._common.errors import SimulationError, SimulatorError
from cornercase._common.platform import describe_exit_code, make_parent_check
from cornercase.simulators.carla._runner_process import RunnerProcess
from cornercase.simulators.carla._tracker import EntityTracker

_FIRST_FRAME_FILE: Final = "first_frame"
_LAST_FRAME_FILE: Final = "last_frame"
_FAILURE_FILE: Final = "failure"
_END_TIMEOUT, _POLL_INTERVAL = 2.0, 0.02
# ScenarioRunner prints one of these when a scenario has ended; its exit code does not show it.
_END_MESSAGES: Final = ("All scenario tests were passed", "Not all scenario tests were successful")
# It prints this before the error, if the tree or an agent cannot be made.
_LOAD_MESSAGE: Final = "The scenario cannot be loaded"
# ScenarioRunner prints it before other errors, which 0.9.15 and 0.9.16 make themselves when it interrupts them.
_WATCHDOG_WORDS: Final = "Watchdog exception"
# Words in errors that are not due to the scenario: CARLA's client, the watchdog, the traffic manager's port.
_WORDS_OF_SERVER: Final = (
    "time-out of", _WATCHDOG_WORDS, "Timeout occurred during scenario execution", "because of bind error",
)  # fmt: skip
# ScenarioRunner's agents print this in each tick.
_TICK_WORDS: Final = "======[Agent] Wallclock_time"
_ERRORS_OF_SERVER: Final = ("RuntimeError", _WATCHDOG_WORDS)
_ERROR_PATTERN: Final = re.compile(r"^\w*(Error|Exception)\b")
# Limits in bytes, since an agent may print without end. The last bytes show how the run has ended.
_MAX_OUTPUT, _LAST_OUTPUT = 1 << 30, 1 << 20
_MAX_LINE: Final = 300


class SilenceError(SimulatorError):
    """Error if no frame has come for too long, due to the server or to ScenarioRunner."""


@dataclass(frozen=True)
class RunLimits:
    """Limits at which a run ends at the latest.

    `duration`: simulated time in s. `until_collision`: whether the first collision ends the run. `silence`: time in s
    without a frame. `ego_may_vanish`: whether the scenario removes the ego, which ends the run, too.
    `describe_server_end`: function that returns how the server has ended, and an empty text while the server runs.
    """

    duration: float
    until_collision: bool
    silence: float
    ego_may_vanish: bool = False
    describe_server_end: Callable[[], str] = lambda: ""


def run_scenario_runner(
    runner: RunnerProcess,
    file: Path,
    drivers: Path,
    options: Sequence[object],
    tracker: EntityTracker,
    limits: RunLimits,
    *,
    time_step: float,
    before_start: Callable[[], None] = lambda: None,
) -> None:
    """Run a scenario file by ScenarioRunner until the scenario ends; `tracker` records the entities.

    `drivers`: folder of controllers. `options`: further arguments of ScenarioRunner. `time_step`: in s. `before_start`
    is called when all entities exist. After a failure, `runner` is closed, so that the next scenario starts it again.
    """
    arguments = ["--sync", "--openscenario", file.resolve(), *options]
    if runner.environment.has_frame_rate:
        arguments += ["--frameRate", repr(1.0 / time_step)]
    log, failure = file.with_name("scenario_runner.log"), file.with_name(_FAILURE_FILE)
    runner.start(file.parent, log, drivers, 1.0 / time_step, arguments)
    try:
        try:
            stopped = _wait_for_end_or_limit(runner, tracker, log, limits, before_start)
        except SimulatorError:
            # CARLA's client may abort when the process ends that has failed.
            if limits.describe_server_end() or not _is_caused_by_scenario(_read_failure(failure)):
                raise
            stopped = False
        finally:
            # None if ScenarioRunner has to be ended.
            exit_code = runner.poll()
            runner.end_scenario()
        _check_size(log)
        last_frame_file = file.with_name(_LAST_FRAME_FILE)
        if last_frame_file.exists():
            tracker.last_frame = _read_frame(last_frame_file)
        output = _read_output(log)
        has_ended = tracker.first_frame is not None and (stopped or any(message in output for message in _END_MESSAGES))
        if not has_ended:
            raise _explain_failure(_read_failure(failure), output, exit_code, tracker)
        may_end_early = stopped or limits.ego_may_vanish
        if not may_end_early and (reason := tracker.describe_early_end()):
            raise SimulationError(f"the recording cannot be used: {reason}")
    except BaseException:
        runner.close()
        raise


def _wait_for_end_or_limit(
    runner: RunnerProcess,
    tracker: EntityTracker,
    log: Path,
    limits: RunLimits,
    before_start: Callable[[], None],
) -> bool:
    """Wait until the run has ended or reaches a limit; return whether ScenarioRunner must be stopped.

    Waiting also ends when the parent process, which started this process, has ended.
    """
    has_parent, frames, last_frame_time = make_parent_check(), 0, time.monotonic()
    frame_file = log.with_name(_FIRST_FRAME_FILE)
    while runner.poll() is None and has_parent():
        if end := limits.describe_server_end():
            raise SimulatorError(f"while the scenario ran, CARLA {end}")
        tracker.update()
        if tracker.first_frame is None and not tracker.missing and frame_file.exists():
            # The storyboard waits until all entities are recorded, so no collision is lost.
            tracker.first_frame = _read_frame(frame_file)
            before_start()
            runner.begin_storyboard()
        elapsed, ended = tracker.progress()
        if ended:
            has_to_be_stopped = not runner.wait(_END_TIMEOUT) and limits.ego_may_vanish
            tracker.update()
            return has_to_be_stopped
        if tracker.n_frames > frames:
            frames, last_frame_time = tracker.n_frames, time.monotonic()
        elif time.monotonic() - last_frame_time > limits.silence:
            # Without a server, ScenarioRunner may wait forever.
            raise SilenceError(f"CARLA sent no frame for {limits.silence:g} s")
        _check_size(log)
        if (limits.until_collision and tracker.has_collision) or elapsed > limits.duration:
            return True
        time.sleep(_POLL_INTERVAL)
    tracker.update()
    return False


def _check_size(log: Path) -> None:
    try:
        size = log.stat().st_size
    except OSError:
        # The error is raised when the run has ended.
        return
    if size > _MAX_OUTPUT:
        raise SimulationError(f"ScenarioRunner and the agent in it printed more than {_MAX_OUTPUT / 2**30:.2g} GiB")


def _read_output(log: Path) -> str:
    """Return the last MiB of what ScenarioRunner has printed."""
    try:
        with log.open("rb") as file:
            file.seek(max(log.stat().st_size - _LAST_OUTPUT, 0))
            return file.read().decode("utf-8", errors="replace")
    except OSError as error:
        raise _make_unreadable_file_error(log, error) from error


def _read_frame(file: Path) -> int:
    try:
        return int(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise _make_unreadable_file_error(file, error) from error


def _make_unreadable_file_error(file: Path, error: Exception) -> SimulationError:
    reason = error.strerror if isinstance(error, OSError) else error
    return SimulationError(
        f"{file.name}, which ScenarioRunner wrote into the folder of the run, cannot be read ({reason}); an agent must"
        " not change that folder"
    )


def _find_errors(output: str) -> list[str]:
    """Return the lines of an output that look like errors, and the last line of each traceback."""
    errors, is_in_traceback = [], False
    for line in output.splitlines():
        is_last = is_in_traceback and bool(line.strip()) and not line[0].isspace()
        if is_last or _ERROR_PATTERN.match(line.strip()):
            errors.append(line.strip()[:_MAX_LINE])
        is_in_traceback = not is_last and (is_in_traceback or line.startswith("Traceback (most recent call last)"))
    return errors


def _read_failure(file: Path) -> str:
    """Return the error with which the storyboard has failed, in one line; empty if there is none."""
    try:
        return " ".join(file.read_text(encoding="utf-8", errors="replace").split())[:_MAX_LINE]
    except OSError:
        return ""


def _is_caused_by_scenario(error: str) -> bool:
    """Return whether an error is due to the scenario, so that it would occur again; False for an empty text."""
    is_of_server = error.startswith(_ERRORS_OF_SERVER) and any(words in error for words in _WORDS_OF_SERVER)
    return bool(error) and not is_of_server


def _explain_failure(failure: str, output: str, exit_code: int | None, tracker: EntityTracker) -> SimulationError:
    """Return an error that says why ScenarioRunner did not run a scenario to the end.

    The error is a `SimulatorError` if a retry may help.
    """
    lines = [line.strip()[:_MAX_LINE] for line in output.splitlines() if line.strip() and _TICK_WORDS not in line]
    watchdog = [line for line in lines if line.startswith(_WATCHDOG_WORDS)]
    errors = [failure] if failure else _find_errors(output)
    reason = (watchdog or errors or [""])[-1]
    # CARLA's client aborts if an answer or a snapshot of the server is cut, but also while a process ends that has
    # failed for another reason. An error that was printed before need not be the reason, since an agent prints, too.
    is_aborted = exit_code is not None and exit_code < 0 and not failure and _LOAD_MESSAGE not in lines
    is_of_scenario = _is_caused_by_scenario(reason)
    if not reason or (is_of_scenario and is_aborted):
        ended = "it had to be ended" if exit_code is None else f"it {describe_exit_code(exit_code)}"
        reason, is_of_scenario = f"{ended}; its last words: {(lines or ['none'])[-1]}", not is_aborted
        if early_end := tracker.describe_early_end():
            reason, is_of_scenario = early_end, True
    error_class = SimulationError if is_of_scenario else SimulatorError
    return error_class(f"ScenarioRunner did not run the scenario to its end: {reason}")
