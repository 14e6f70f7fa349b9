"""Numeric features of a scenario for the ego: when, how fast, how near, how hard it brakes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from cornercase._common.geometry.boxes import box_corners, box_distance
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.metrics._outcome import Outcome
from cornercase.metrics.ending._find_outcome import STANDING_SPEED, existence_mask
from cornercase.recordings import Recording

# Largest rounding error of a distance, in m.
_ROUNDING: Final = 1e-6


def measure_features(recording: Recording, outcome: Outcome) -> dict[str, float]:
    """Measure how a scenario went for the ego: features by name, NaN for what did not happen.

    - ``"impact speed"``, ``"impact time"``: of the ego's first collision, in m/s and s
    - ``"entry"``, ``"gap"``: when the ego enters the crossing, and the time gap there, in s, as in `Encounter`
    - ``"nearest"``, ``"nearest time"``, ``"first distance"``: smallest gap between the boxes of ego and other, its
      first instant, and the gap at the beginning, in m and s
    - ``"lowest speed"``, ``"highest speed"``, ``"mean speed"``, ``"first speed"``, ``"last speed"``: of the ego in m/s,
      without sign; the mean is over all instants, as is ``"mean speed of the other"``
    - ``"standing"``: time that the ego stands, in s; ``"braking"``: its hardest deceleration while it moves, in m/s²
    - ``"way"``, ``"duration"``: distance and time that it travels, in m and s
    - ``"turn"``, ``"shift"``: change of heading to the left in rad, and lateral offset to the left at the end, in m;
      ``"aside"``: lateral offset of the other to the left at the beginning, in m
    """
    i, j = recording.entity_index(outcome.ego), recording.entity_index(outcome.encounter.entity)
    gap, exists = outcome.encounter.gap, existence_mask(recording, outcome.ego)
    traits = _measure_ego_features(recording, i, exists)
    traits |= {
        "impact speed": outcome.impacts[0].speed if outcome.impacts else math.nan,
        "impact time": outcome.impacts[0].time if outcome.impacts else math.nan,
        "entry": outcome.encounter.enters,
        "gap": gap if gap >= 0.0 else math.nan,
        "mean speed of the other": _finite_mean(np.abs(recording.speed[j])),
    } | dict.fromkeys(("nearest", "nearest time", "first distance", "aside"), math.nan)
    if (shared := np.flatnonzero(exists & existence_mask(recording, outcome.encounter.entity))).size:
        centers = [recording.box_center(recording.names[k])[shared] for k in (i, j)]
        nearest, instant, first_gap = _smallest_box_gap(recording, (i, j), shared, centers)
        offset = centers[1][0] - centers[0][0]
        heading = recording.heading[i, shared[0]]
        aside = float(np.cos(heading) * offset[1] - np.sin(heading) * offset[0])
        traits |= {
            "nearest": nearest,
            "nearest time": float(recording.time[instant]),
            "first distance": first_gap,
            "aside": aside,
        }
    return traits


def _smallest_box_gap(
    recording: Recording, entity_indices: tuple[int, int], instants: IntArray, centers_of_both: Sequence[FloatArray]
) -> tuple[float, int, float]:
    """Smallest gap between two boxes in m, the first instant of it, and the gap at the first instant."""
    center_distances = np.hypot(*(centers_of_both[1] - centers_of_both[0]).T)
    length, width = recording.length[list(entity_indices)], recording.width[list(entity_indices)]
    # The gap is at least the centre distance less both circumscribed radii, and at most that less both inscribed radii.
    reach, inner = 0.5 * float(np.hypot(length, width).sum()), 0.5 * float(np.minimum(length, width).sum())
    is_candidate = center_distances - reach <= max(float(center_distances.min()) - inner, 0.0) + _ROUNDING
    is_candidate[0] = True
    x, y = np.stack([center[is_candidate] for center in centers_of_both]).transpose(2, 0, 1)
    headings = recording.heading[list(entity_indices)][:, instants[is_candidate]]
    gaps = box_distance(*box_corners(x, y, headings, length[:, None], width[:, None]))
    return float(gaps.min()), int(instants[is_candidate][gaps.argmin()]), float(gaps[0])


def _measure_ego_features(recording: Recording, ego_index: int, exists: BoolArray) -> dict[str, float]:
    names = (
        "lowest speed", "highest speed", "mean speed", "first speed", "last speed", "standing", "braking", "way",
        "duration", "turn", "shift",
    )  # fmt: skip
    if not exists.any():
        return dict.fromkeys(names, math.nan)
    time, signed_speed, heading = (
        recording.time[exists],
        recording.speed[ego_index, exists],
        recording.heading[ego_index, exists],
    )
    x, y, speed = (
        recording.x[ego_index, exists],
        recording.y[ego_index, exists],
        np.abs(recording.speed[ego_index, exists]),
    )
    slowing = np.where(speed >= STANDING_SPEED, -np.sign(signed_speed) * recording.acceleration[ego_index, exists], 0.0)
    values = (
        np.nanmin(speed), np.nanmax(speed), _finite_mean(speed), speed[0], speed[-1],
        np.append(np.diff(time), 0.0)[speed < STANDING_SPEED].sum(),
        max(float(np.nan_to_num(slowing).max()), 0.0),
        np.hypot(np.diff(x), np.diff(y)).sum(), time[-1] - time[0],
        np.unwrap(heading)[-1] - heading[0],
        np.cos(heading[0]) * (y[-1] - y[0]) - np.sin(heading[0]) * (x[-1] - x[0]),
    )  # fmt: skip
    return {name: float(value) for name, value in zip(names, values, strict=True)}


def _finite_mean(values: FloatArray) -> float:
    is_finite = np.isfinite(values)
    return float(values[is_finite].mean()) if is_finite.any() else math.nan
