"""Differences between two recordings of the same scenario."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording, same_bytes

NOTICED: Final = 1e-6
"""Smallest distance in m that counts as a difference."""


@dataclass(frozen=True)
class Difference:
    """Difference between a recording and an earlier one of the same scenario.

    Attributes
    ----------
    same : bool
        Whether all numbers are equal bit by bit.
    distance : float or None
        Largest distance of the ego's reference point between both at the same time, in m; None if it is never present
        in both.
    time : float or None
        First time at which the distance is more than 1e-6 m, in s; None if it never is.
    duration : tuple of float
        Duration of the earlier one and of this one, in s.
    scores : mapping of str to tuple of float
        Score of the earlier one and of this one, by metric that both have.
    """

    same: bool
    distance: float | None
    time: float | None
    duration: tuple[float, float]
    scores: Mapping[str, tuple[float, float]]

    @property
    def text(self) -> str:
        """The difference in a few words."""
        if self.same:
            return "the same"
        if self.distance is None:
            return "another"
        since = "" if self.time is None else f" from {self.time:.4g} s"
        return f"up to {self.distance:.3g} m elsewhere{since}"


def find_difference(
    before: Recording, now: Recording, ego: str, scores: Mapping[str, tuple[float, float]] | None = None
) -> Difference:
    """Compare two recordings of one scenario; the earlier path of the ego is interpolated if the times differ."""
    distances = _distances(before, now, ego)
    is_known = np.isfinite(distances)
    exceeding = np.flatnonzero(is_known & (distances > NOTICED))
    return Difference(
        same=same_bytes(before, now),
        distance=float(distances[is_known].max()) if is_known.any() else None,
        time=float(now.time[exceeding[0]]) if len(exceeding) else None,
        duration=(float(before.time[-1] - before.time[0]), float(now.time[-1] - now.time[0])),
        scores=dict(scores or {}),
    )


def _distances(before: Recording, now: Recording, ego: str) -> FloatArray:
    """Distances of the ego in m at the times of the second recording, NaN if it is absent in one, shape (T,)."""
    i, j = before.index(ego), now.index(ego)
    # NaN beyond its ends, and between a time with the ego and one without.
    x, y = (
        np.interp(now.time, before.time, values, left=np.nan, right=np.nan) for values in (before.x[i], before.y[i])
    )
    return np.asarray(np.hypot(now.x[j] - x, now.y[j] - y))
