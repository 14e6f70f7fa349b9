"""Check if runs are deterministic: run the first scenario of a study twice."""

from __future__ import annotations

from collections.abc import Callable

from cornercase._common.errors import InputError, PartError, SimulationError
from cornercase._common.ledger import warn
from cornercase.recordings import Recording, farthest_apart, same_bytes
from cornercase.simulators import SIMULATORS
from cornercase.study import Row, Study


def try_repeatability(study: Study, again: Callable[[Row], Recording | SimulationError], advice: str) -> bool:
    """Run the first finished scenario again by `again`, and store whether the recording is identical.

    Done once per study, and only for simulators that claim to be deterministic. One check proves nothing, but finds
    random numbers and state that is kept between runs. `advice` is appended to the warning if runs differ; empty for no
    warning. Returns False as long as no scenario has finished.
    """
    row = next((row for row in study.rows() if row.state == "done"), None)
    if row is None:
        return False
    if not study.meta.repeatability and _claims_to_repeat_itself(study.meta.simulator):
        outcome = again(row)
        if isinstance(outcome, PartError):
            study.writer.save_repeatability(row.id, False, None)
        elif isinstance(outcome, SimulationError):
            # The cause may be external, such as a time-out on a busy machine.
            warn(
                f"scenario {row.id} could not be run a second time ({outcome}), so it is unknown whether runs are"
                " deterministic; run the same command again to retry"
            )
        else:
            first = study.recording(row.id)
            same = same_bytes(first, outcome)
            study.writer.save_repeatability(row.id, same, None if same else farthest_apart(first, outcome))
    if advice and study.meta.runs_differ:
        warn(f"runs differ: {study.meta.runs_differ}; {advice}")
    return True


def _claims_to_repeat_itself(simulator: str) -> bool:
    """Return whether the simulator declares that it is deterministic; False if it is not registered."""
    try:
        return SIMULATORS.class_of(simulator).repeats_itself
    except InputError:
        return False
