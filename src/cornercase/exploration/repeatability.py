"""The first scenario of a study, run a second time to see whether runs repeat themselves."""

from __future__ import annotations

from collections.abc import Callable

from cornercase._common.errors import InputError, PartError, SimulationError
from cornercase._common.ledger import warn
from cornercase.recordings import Recording, farthest_apart, same_bytes
from cornercase.simulators import SIMULATORS
from cornercase.study import Row, Study


def try_repeatability(study: Study, again: Callable[[Row], Recording | SimulationError], advice: str) -> bool:
    """Run the first scenario of a study a second time, alone, and store whether its recording is the same.

    It is done once for a study. A simulator that does not claim to repeat itself is not tried. One try proves nothing,
    but finds what draws random numbers, or keeps something from one run to the next.

    Parameters
    ----------
    study : Study
        Open for writing.
    again : callable
        Runs a scenario.
    advice : str
        What to do where runs differ, for a warning; empty for none.

    Returns
    -------
    bool
        False as long as no scenario has been run.

    Warns
    -----
    NoticeWarning
        Runs differ, or the second run failed.
    """
    row = next((row for row in study.rows() if row.state == "done"), None)
    if row is None:
        return False
    if not study.meta.repeatability and _claims_to_repeat_itself(study.meta.simulator):
        outcome = again(row)
        if isinstance(outcome, PartError):
            study.writer.save_repeatability(row.id, False, None)
        elif isinstance(outcome, SimulationError):
            # It may have reasons outside, such as a time-out on a busy machine.
            warn(
                f"scenario {row.id} could not be run a second time ({outcome}), so it is not known whether runs repeat"
                " themselves; the same command tries it again"
            )
        else:
            first = study.recording(row.id)
            same = same_bytes(first, outcome)
            study.writer.save_repeatability(row.id, same, None if same else farthest_apart(first, outcome))
    if advice and study.meta.runs_differ:
        warn(f"runs differ: {study.meta.runs_differ}; {advice}")
    return True


def _claims_to_repeat_itself(simulator: str) -> bool:
    """Whether a simulator declares it; one that Python code hands to an explorer need not be registered."""
    try:
        return SIMULATORS.class_of(simulator).repeats_itself
    except InputError:
        return False
