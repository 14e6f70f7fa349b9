"""Compare two recordings."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase.recordings._recording import BOX_ARRAYS, MOTION_ARRAYS, Recording

NUMERIC_ARRAYS: Final = ("time", *MOTION_ARRAYS, *BOX_ARRAYS)
"""All numeric arrays of a recording."""


def are_bitwise_equal(first: Recording, second: Recording) -> bool:
    """Return whether entities, collisions and all bits of all numbers are equal; 0.0 differs from -0.0."""
    facts = [(recording.names, recording.object_types, recording.collisions) for recording in (first, second)]
    return facts[0] == facts[1] and all(
        np.asarray(getattr(first, name)).tobytes() == np.asarray(getattr(second, name)).tobytes()
        for name in NUMERIC_ARRAYS
    )


def max_position_difference(first: Recording, second: Recording) -> float | None:
    """Return the largest distance in m between the positions of an entity at the same instant in two recordings.

    If one recording ends earlier, only its instants are compared. None if the names of the entities or these instants
    differ, or if no entity exists in both recordings at the same instant.
    """
    count = min(len(first.time), len(second.time))
    if first.names != second.names or not np.array_equal(first.time[:count], second.time[:count]):
        return None
    distances = np.hypot(first.x[:, :count] - second.x[:, :count], first.y[:, :count] - second.y[:, :count])
    finite = distances[np.isfinite(distances)]
    return float(finite.max()) if len(finite) else None
