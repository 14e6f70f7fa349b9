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
    """Run the first finished scenario again, and store whether a new recording equals the stored recording.

    `run_again` repeats all runs of a scenario with the seeds of these runs; the study holds the recording of one of
    them. `is_random` returns whether sensors are random, so that runs with other seeds differ.

    The check is done once per study, and only for simulators that claim to be deterministic. After a failure such as a
    time-out, it is done again when the exploration is continued. Equal recordings prove nothing, but the check finds
    random numbers without a seed and state that persists between runs. If runs differ, there is a warning that ends
    with `advice`, unless `advice` is empty. Returns False if no scenario has finished yet.
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
