"""Compare two recordings."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase.recordings.recording import BOX, MOTION, Recording

ARRAYS: Final = ("time", *MOTION, *BOX)
"""All numeric arrays of a recording."""


def same_bytes(before: Recording, now: Recording) -> bool:
    """Whether entities, collisions and all bits of all numbers are equal; 0.0 differs from -0.0."""
    facts = [(recording.names, recording.kinds, recording.collisions) for recording in (before, now)]
    return facts[0] == facts[1] and all(
        np.asarray(getattr(before, name)).tobytes() == np.asarray(getattr(now, name)).tobytes() for name in ARRAYS
    )


def farthest_apart(before: Recording, now: Recording) -> float | None:
    """Return the largest distance in m of an entity's positions at the same instant; None if not comparable.

    Only instants that both recordings have are compared.
    """
    count = min(len(before.time), len(now.time))
    if before.names != now.names or not np.array_equal(before.time[:count], now.time[:count]):
        return None
    distances = np.hypot(before.x[:, :count] - now.x[:, :count], before.y[:, :count] - now.y[:, :count])
    finite = distances[np.isfinite(distances)]
    return float(finite.max()) if len(finite) else None
