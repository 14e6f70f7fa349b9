"""Whether two recordings are the same, and how far apart they are."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase.recordings.recording import BOX, MOTION, Recording

ARRAYS: Final = ("time", *MOTION, *BOX)
"""What of a recording is numbers."""


def same_bytes(before: Recording, now: Recording) -> bool:
    """Tell whether two recordings are the same, byte for byte.

    Parameters
    ----------
    before, now : Recording

    Returns
    -------
    bool
        Of entities, collisions, and all bits of all numbers: 0.0 is not -0.0.
    """
    facts = [(one.names, one.kinds, one.collisions) for one in (before, now)]
    return facts[0] == facts[1] and all(
        np.asarray(getattr(before, name)).tobytes() == np.asarray(getattr(now, name)).tobytes() for name in ARRAYS
    )


def farthest_apart(before: Recording, now: Recording) -> float | None:
    """Find how far an entity is from where it was at the same instant, at most.

    Parameters
    ----------
    before, now : Recording

    Returns
    -------
    float or None
        m, over the instants that both have; None where the entities or instants are others.
    """
    count = min(len(before.time), len(now.time))
    if before.names != now.names or not np.array_equal(before.time[:count], now.time[:count]):
        return None
    away = np.hypot(before.x[:, :count] - now.x[:, :count], before.y[:, :count] - now.y[:, :count])
    known = away[np.isfinite(away)]
    return float(known.max()) if len(known) else None
