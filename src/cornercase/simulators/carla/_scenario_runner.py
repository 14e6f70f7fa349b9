"""Run a scenario by ScenarioRunner, and see when it ends."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cornercase._common.errors import SimulationError, SimulatorError
from cornercase._common.platform import make_parent_check
from cornercase.simulators.carla._runner_process import RunnerProcess
from cornercase.simulators.carla._tracker import EntityTracker

_FIRST_FRAME_FILE: Final = "first_frame"
_LAST_FRAME_FILE: Final = "last_frame"
_END_TIMEOUT, _POLL_INTERVAL = 2.0, 0.02
# ScenarioRunner prints one of these when a scenario has ended; its exit code does not show it.
_END_MESSAGES: Final = ("All scenario tests were passed", "Not all scenario tests were successful")
# ScenarioRunner prints it before other errors, which 0.9.15 and 0.9.16 make themselves when it interrupts them.
_WATCHDOG_WORDS: Final = "Watchdog exception"
# Of errors that are not the scenario's: CARLA's client, ScenarioRunner's watchdog, the traffic manager's port.
_WORDS_OF_SERVER: Final = (
    "time-out of", _WATCHDOG_WORDS, "Timeout occurred during scenario execution", "because of bind error",
)  # fmt: skip
_ERROR_PATTERN: Final = re.compile(r"^\w*(Error|Exception)\b")


@dataclass(frozen=True)
class RunLimits:
    """When a run ends at the latest: after `duration` s, at a collision, or if no frame comes for `silence` s.

    `describe_server_end` tells how the server has ended, empty while it runs: nobody has to wait for that one.
    """

    duration: float
    until_collision: bool
    silence: float
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
    """Run a file until the scenario ends; `before_start` is called when all entities exist.

    After a failure, `runner` is closed, so that the next scenario starts it again.
    """
    arguments = ["--sync", "--openscenario", file.resolve(), *options]
    if runner.environment.has_frame_rate:
        arguments += ["--frameRate", repr(1.0 / time_step)]
    log = file.with_name("scenario_runner.log")
    runner.start(file.parent, log, drivers, 1.0 / time_step, arguments)
    try:
        try:
            stopped = _wait_for_end(runner, tracker, file.with_name(_FIRST_FRAME_FILE), limits, before_start)
        finally:
            # A client aborts if an answer or a snapshot of the server is cut.
            is_aborted = (runner.poll() or 0) < 0
            runner.end_scenario()
        last_frame = file.with_name(_LAST_FRAME_FILE)
        if last_frame.exists():
            tracker.last_frame = int(last_frame.read_text(encoding="utf-8"))
        output = log.read_text(encoding="utf-8", errors="replace")
        if tracker.first_frame is None or not (stopped or any(message in output for message in _END_MESSAGES)):
            last_line = _last_error_line(output)
            # It may not happen again when the scenario is retried.
            is_of_server = is_aborted or any(words in last_line for words in _WORDS_OF_SERVER)
            error_class = SimulatorError if is_of_server else SimulationError
            raise error_class(f"ScenarioRunner did not run it to the end: {last_line}")
    except BaseException:
        runner.close()
        raise


def _wait_for_end(
    runner: RunnerProcess,
    tracker: EntityTracker,
    frame_file: Path,
    limits: RunLimits,
    before_start: Callable[[], None],
) -> bool:
    """Wait until the run or the parent process has ended or must end; True if ScenarioRunner must be stopped."""
    has_parent, frames, last_frame_time = make_parent_check(), 0, time.monotonic()
    while runner.poll() is None and has_parent():
        if end := limits.describe_server_end():
            raise SimulatorError(f"while the scenario ran, CARLA {end}")
        tracker.update()
        if tracker.first_frame is None and not tracker.missing and frame_file.exists():
            # The storyboard waits until all entities are recorded, so no collision is lost.
            tracker.first_frame = int(frame_file.read_text(encoding="utf-8"))
            before_start()
            runner.begin_storyboard()
        elapsed, ended = tracker.progress()
        if ended:
            runner.wait(_END_TIMEOUT)
            return False
        if tracker.n_frames > frames:
            frames, last_frame_time = tracker.n_frames, time.monotonic()
        elif time.monotonic() - last_frame_time > limits.silence:
            # Without a server, ScenarioRunner may wait forever.
            raise SimulatorError(f"CARLA sent no frame for {limits.silence:g} s")
        if (limits.until_collision and tracker.has_collision) or elapsed > limits.duration:
            return True
        time.sleep(_POLL_INTERVAL)
    tracker.update()
    return False


def _last_error_line(output: str) -> str:
    """Return the line of ScenarioRunner's output with its watchdog, else the last one with an error, else the last."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    errors = [line for line in lines if _ERROR_PATTERN.match(line)]
    watchdog = [line for line in lines if line.startswith(_WATCHDOG_WORDS)]
    return (watchdog or errors or lines or ["it printed nothing"])[-1][:300]
