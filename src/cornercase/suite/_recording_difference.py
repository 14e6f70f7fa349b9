"""Differences between two recordings of the same scenario."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording
from cornercase.recordings._compare import are_bitwise_equal

DISTANCE_TOLERANCE: Final = 1e-6
"""Smallest distance in m that counts as a difference."""


@dataclass(frozen=True)
class RecordingDifference:
    """Difference between a recording and an earlier one of the same scenario.

    Attributes
    ----------
    same : bool
        Whether all numbers are equal bit by bit.
    distance : float or None
        Largest distance in m between the positions of the ego in both recordings at the same time. None if the ego is
        never present in both.
    time : float or None
        First time in s at which this distance exceeds 1e-6 m; None if it never does.
    duration : tuple of float
        Durations of the earlier and the later recording in s.
    scores : mapping of str to tuple of float
        Scores of the earlier and the later recording, by metric.

    Examples
    --------
    >>> import cornercase as cc
    >>> result = cc.run_suite("reduced", "new-run.db", against="run.db")  # doctest: +SKIP
    >>> print(result.scenarios[0].difference.text)  # doctest: +SKIP
    the same
    """

    same: bool
    distance: float | None
    time: float | None
    duration: tuple[float, float]
    scores: Mapping[str, tuple[float, float]]

    @property
    def text(self) -> str:
        """Describe the difference in a few words."""
        if self.same:
            return "the same"
        if self.distance is None:
            return "the ego is never there in both"
        if self.time is None:
            return "the ego moves the same way, other numbers differ"
        return f"the ego moves differently from {self.time:.4g} s on, by up to {self.distance:.3g} m"


def compare_recording_pair(
    earlier: Recording, later: Recording, ego: str, scores: Mapping[str, tuple[float, float]] | None = None
) -> RecordingDifference:
    """Compare two recordings of a scenario.

    The ego's positions in the earlier recording are interpolated at the times of the later recording.
    """
    distances = _ego_distances(earlier, later, ego)
    is_known = np.isfinite(distances)
    exceeding = np.flatnonzero(is_known & (distances > DISTANCE_TOLERANCE))
    return RecordingDifference(
        same=are_bitwise_equal(earlier, later),
        distance=float(distances[is_known].max()) if is_known.any() else None,
        time=float(later.time[exceeding[0]]) if len(exceeding) else None,
        duration=(float(earlier.time[-1] - earlier.time[0]), float(later.time[-1] - later.time[0])),
        scores=dict(scores or {}),
    )


def _ego_distances(earlier: Recording, later: Recording, ego: str) -> FloatArray:
    """Return the distances in m between the ego's positions in two recordings, at the T times of the later recording.

    NaN while the ego is absent in one of the recordings.
    """
    i, j = earlier.entity_index(ego), later.entity_index(ego)
    # NaN outside of the earlier recording, and between a time with the ego and a time without.
    x, y = (
        np.interp(later.time, earlier.time, values, left=np.nan, right=np.nan)
        for values in (earlier.x[i], earlier.y[i])
    )
    return np.asarray(np.hypot(later.x[j] - x, later.y[j] - y))
