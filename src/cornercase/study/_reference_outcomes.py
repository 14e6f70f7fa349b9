"""Store outcomes of runs with a reference driver in the table ``courses``, between the courses of metrics."""

from __future__ import annotations

from collections.abc import Mapping
from sqlite3 import Connection
from typing import Final

import numpy as np

from cornercase.drivers.references.r157._preventability import ReferenceOutcome
from cornercase.study._checksums import insert_rows
from cornercase.study._codec import pack_arrays, unpack_arrays
from cornercase.study._damage import require_condition

# Outcome (whether it collides, if known) by stored score.
_OUTCOME_BY_SCORE: Final = {0.0: False, 1.0: True, -1.0: None}
_SCORE_BY_OUTCOME: Final = {collides: code for code, collides in _OUTCOME_BY_SCORE.items()}


def reference_metric_name(driver: str) -> str:
    """Return the value of the column ``metric`` for outcomes with this driver, in the table ``courses``."""
    return f"reference:{driver}"


def write_reference_outcomes(connection: Connection, scenario: int, outcomes: Mapping[str, ReferenceOutcome]) -> None:
    """Store the outcomes of a scenario by reference driver; call it within a transaction."""
    insert_rows(
        connection,
        "courses",
        [
            (
                scenario,
                reference_metric_name(name),
                _SCORE_BY_OUTCOME[outcome.collides],
                pack_arrays({"course": np.array([] if outcome.time is None else [outcome.time], dtype=np.float64)}),
            )
            for name, outcome in outcomes.items()
        ],
    )


def decode_reference_outcome(score: float, packed: bytes) -> ReferenceOutcome:
    """Decode the stored outcome of a run with a reference driver."""
    times = np.asarray(unpack_arrays(packed)["course"])
    require_condition(
        score in _OUTCOME_BY_SCORE and times.ndim == 1 and len(times) <= 1,
        "the outcome with a reference driver is not valid",
    )
    return ReferenceOutcome(_OUTCOME_BY_SCORE[score], float(times[0]) if len(times) else None)
