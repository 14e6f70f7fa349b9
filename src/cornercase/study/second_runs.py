"""What came of scenarios that were run again with references, beside the courses of metrics."""

from __future__ import annotations

from collections.abc import Mapping
from sqlite3 import Connection
from typing import Final

import numpy as np

from cornercase.drivers import ReferenceOutcome
from cornercase.study.codec import pack_arrays, unpack_arrays
from cornercase.study.damage import require
from cornercase.study.seals import put

# What the column of scores holds.
_CODES: Final = {0.0: False, 1.0: True, -1.0: None}
_NUMBERS: Final = {collides: code for code, collides in _CODES.items()}


def row_name(driver: str) -> str:
    """Name under which the outcomes of a reference stand where else the name of a metric does.

    Parameters
    ----------
    driver : str

    Returns
    -------
    str
    """
    return f"reference:{driver}"


def write_references(connection: Connection, scenario: int, outcomes: Mapping[str, ReferenceOutcome]) -> None:
    """Store what came of a scenario with references.

    Parameters
    ----------
    connection : Connection
        In a transaction.
    scenario : int
        Its id.
    outcomes : mapping of str to ReferenceOutcome
        By the name of the reference.
    """
    put(
        connection,
        "courses",
        [
            (
                scenario,
                row_name(name),
                _NUMBERS[one.collides],
                pack_arrays({"course": np.array([] if one.time is None else [one.time], dtype=np.float64)}),
            )
            for name, one in outcomes.items()
        ],
    )


def read_reference(score: float, packed: bytes) -> ReferenceOutcome:
    """Read what `write_references` wrote of one.

    Parameters
    ----------
    score : float
    packed : bytes

    Returns
    -------
    ReferenceOutcome

    Raises
    ------
    ValueError
        It is of something else.
    """
    instants = np.asarray(unpack_arrays(packed)["course"])
    require(score in _CODES and instants.ndim == 1 and len(instants) <= 1, "the outcome of a reference")
    return ReferenceOutcome(_CODES[score], float(instants[0]) if len(instants) else None)
