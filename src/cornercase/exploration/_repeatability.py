"""Check if runs are deterministic, by running the first finished scenario of a study again."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from cornercase._common.errors import InputError, PluginError, SimulationError
from cornercase._common.io.support_table import issue_notice_warning
from cornercase.recordings import Recording
from cornercase.recordings._compare import are_bitwise_equal, max_position_difference
from cornercase.simulators import SIMULATORS
from cornercase.study import ScenarioRecord, StudyFile


def check_repeatability(
    study: StudyFile,
    run_again: Callable[[ScenarioRecord], Iterable[Recording | SimulationError]],
    advice: str,
    is_random: Callable[[], bool],
) -> bool:
    """Run the first finished scenario again by `run_again`, and store whether a recording is identical.

    `run_again` repeats the runs of a scenario, each with its seed; the study holds the recording of one of these runs.
    `is_random` returns whether sensors are random, so that runs with other seeds differ.

    The check is done once per study, and only for simulators that claim to be deterministic. One check proves nothing,
    but finds random numbers without a seed and state that persists between runs. If runs differ, a warning ends with
    `advice`; if `advice` is empty, there is no warning. Returns False as long as no scenario has finished.
    """
    row = next((row for row in study.rows() if row.state == "done"), None)
    if row is None:
        return False
    if not study.meta.repeatability and _is_declared_deterministic(study.meta.simulator):
        random, first, outcomes = is_random(), study.recording(row.id), list[Recording | SimulationError]()
        for outcome in run_again(row):
            outcomes.append(outcome)
            if isinstance(outcome, Recording) and are_bitwise_equal(first, outcome):
                study.writer.save_repeatability(row.id, True, None, random)
                return True
        outcome = outcomes[0]
        if isinstance(outcome, PluginError):
            study.writer.save_repeatability(row.id, False, None, random)
        elif isinstance(outcome, SimulationError):
            # The cause may be external, such as a time-out on a busy machine.
            issue_notice_warning(
                f"scenario {row.id} could not be run a second time ({outcome}), so it is unknown whether runs are"
                " deterministic; run the same command again to retry"
            )
        else:
            study.writer.save_repeatability(row.id, False, max_position_difference(first, outcome), random)
    if advice and study.meta.nondeterminism_text:
        issue_notice_warning(f"runs differ: {study.meta.nondeterminism_text}; {advice}")
    return True


def _is_declared_deterministic(simulator: str) -> bool:
    """Return whether the simulator declares that it is deterministic; False if it is not registered."""
    try:
        return SIMULATORS.get_class(simulator).deterministic
    except InputError:
        return False
