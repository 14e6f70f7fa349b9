"""How a recording differs from an earlier one of the same scenario."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording, same_bytes

NOTICED: Final = 1e-6
"""Distance in m from which a difference counts as one."""


@dataclass(frozen=True)
class Difference:
    """How a recording differs from an earlier one of the same scenario.

    Attributes
    ----------
    same : bool
        Whether all numbers of both are the same bits.
    distance : float or None
        Largest distance of the ego's reference point between both at the same instants, in m; None where there is no
        instant at which it is there in both.
    time : float or None
        First instant at which it is more than 1e-6 m, in s; None where it never is.
    duration : tuple of float
        How long the earlier one and this one are, in s.
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
    """Find how two recordings of one scenario differ.

    Parameters
    ----------
    before, now : Recording
    ego : str
        Name of the entity whose ways are compared. Where the instants of both are not the same, the way before is
        interpolated.
    scores : mapping of str to tuple of float, optional
        Scores of both, by metric.

    Returns
    -------
    Difference

    Raises
    ------
    InputError
        One has no such entity.
    """
    away = _distances(before, now, ego)
    known = np.isfinite(away)
    further = np.flatnonzero(known & (away > NOTICED))
    return Difference(
        same=same_bytes(before, now),
        distance=float(away[known].max()) if known.any() else None,
        time=float(now.time[further[0]]) if len(further) else None,
        duration=(float(before.time[-1] - before.time[0]), float(now.time[-1] - now.time[0])),
        scores=dict(scores or {}),
    )


def _distances(before: Recording, now: Recording, ego: str) -> FloatArray:
    """Distances in m at the instants of the second one, NaN where the ego is not there in both, shape (T,)."""
    i, j = before.index(ego), now.index(ego)
    # Beyond its ends nothing is known, and neither is it between an instant with the ego and one without.
    x, y = (
        np.interp(now.time, before.time, values, left=np.nan, right=np.nan) for values in (before.x[i], before.y[i])
    )
    return np.asarray(np.hypot(now.x[j] - x, now.y[j] - y))
