"""Numeric features of how the ego drove in a scenario: times, speeds, gaps, braking, distances."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.metrics._outcome import Outcome
from cornercase.metrics.ending._box_gap import smallest_box_gap
from cornercase.metrics.ending._find_outcome import STANDING_SPEED
from cornercase.metrics.ending._poses import Poses
from cornercase.recordings import Recording
from cornercase.recordings._recording import MOTION_ARRAYS


def measure_features(recording: Recording, outcome: Outcome, poses: Poses | None = None) -> dict[str, float]:
    """Measure how the ego drove in a scenario: features by name, NaN for what did not happen.

    - ``"impact speed"``, ``"impact time"``: relative speed and time of the ego's first collision, in m/s and s
    - ``"entry"``, ``"gap"``: when the ego enters the crossing of the paths, and the time between one entity leaving the
      crossing and the other entering it (NaN if negative), in s, as in `PathRelation`
    - ``"nearest"``, ``"nearest time"``, ``"first distance"``: smallest gap between the boxes of ego and other, its
      first instant, and the gap at the beginning, in m and s
    - ``"lowest speed"``, ``"highest speed"``, ``"mean speed"``, ``"first speed"``, ``"last speed"``: speeds of the ego
      in m/s, without sign; the mean is over all instants
    - ``"mean speed of the other"``: mean speed of the other entity in m/s, without sign, over all instants
    - ``"standing"``: time that the ego stands, in s
    - ``"braking"``: hardest deceleration of the ego while it moves, in m/s²
    - ``"way"``, ``"duration"``: distance that the ego travels, and time from its first to its last instant, in m and s
    - ``"turn"``: change of heading of the ego, in rad, positive to the left
    - ``"shift"``: how far the ego is at the end to the left of its first line of travel, in m
    - ``"aside"``: how far the other entity is to the left of the ego at the beginning, in m

    `poses` are the poses in the recording, if they are already computed.
    """
    return measure_features_per_outcome(recording, (outcome,), poses)[0]


def measure_features_per_outcome(
    recording: Recording, outcomes: Sequence[Outcome], poses: Poses | None = None
) -> tuple[dict[str, float], ...]:
    """Measure the features of `measure_features` for each of several outcomes of one recording.

    The outcomes differ in the main other entity. `poses` are the poses in the recording, if they are already computed.
    """
    poses = Poses.from_recording(recording) if poses is None else poses
    ego_features: dict[str, float] = {}
    if outcomes:
        i = recording.entity_index(outcomes[0].ego)
        ego_features = _measure_ego_features(recording, i, poses.exists[i])
    return tuple(ego_features | _measure_encounter(recording, outcome, poses) for outcome in outcomes)


def _measure_encounter(recording: Recording, outcome: Outcome, poses: Poses) -> dict[str, float]:
    i, j = recording.entity_index(outcome.ego), recording.entity_index(outcome.encounter.entity)
    gap, nearest, nearest_time, first_distance, aside = outcome.encounter.gap, *[math.nan] * 4
    shared = poses.exists[i] & poses.exists[j]
    begin = int(shared.argmax())
    if shared[begin]:
        nearest, instant, first_distance = smallest_box_gap(
            shared, poses.x[i], poses.y[i], poses.cos[i], poses.sin[i], poses.size[i],
            poses.x[j], poses.y[j], poses.cos[j], poses.sin[j], poses.size[j],
        )  # fmt: skip
        nearest_time = float(recording.time[instant])
        x, y = (float(center[j, begin]) - float(center[i, begin]) for center in (poses.x, poses.y))
        aside = float(poses.cos[i, begin]) * y - float(poses.sin[i, begin]) * x
    return {
        "impact speed": outcome.impacts[0].speed if outcome.impacts else math.nan,
        "impact time": outcome.impacts[0].time if outcome.impacts else math.nan,
        "entry": outcome.encounter.enters,
        "gap": gap if gap >= 0.0 else math.nan,
        "mean speed of the other": _finite_mean(np.abs(recording.speed[j])),
        "nearest": nearest,
        "nearest time": nearest_time,
        "first distance": first_distance,
        "aside": aside,
    }


def _measure_ego_features(recording: Recording, ego_index: int, exists: BoolArray) -> dict[str, float]:
    names = (
        "lowest speed", "highest speed", "mean speed", "first speed", "last speed", "standing", "braking", "way",
        "duration", "turn", "shift",
    )  # fmt: skip
    if not exists.any():
        return dict.fromkeys(names, math.nan)
    arrays = (recording.time, *(getattr(recording, name)[ego_index] for name in MOTION_ARRAYS))
    if not exists.all():
        arrays = tuple(array[exists] for array in arrays)
    time, x, y, heading, signed_speed, acceleration = arrays
    speed, stands = np.abs(signed_speed), np.abs(signed_speed) < STANDING_SPEED
    slowing = np.where(stands, 0.0, -np.sign(signed_speed) * acceleration)
    values = (
        speed.min(), speed.max(), speed.mean(), speed[0], speed[-1],
        np.append(time[1:] - time[:-1], 0.0)[stands].sum(),
        max(float(np.nan_to_num(slowing).max()), 0.0),
        np.hypot(x[1:] - x[:-1], y[1:] - y[:-1]).sum(), time[-1] - time[0],
        _unwrapped_end(heading) - heading[0],
        np.cos(heading[0]) * (y[-1] - y[0]) - np.sin(heading[0]) * (x[-1] - x[0]),
    )  # fmt: skip
    return {name: float(value) for name, value in zip(names, values, strict=True)}


def _finite_mean(values: FloatArray) -> float:
    is_finite = np.isfinite(values)
    return float(values[is_finite].mean()) if is_finite.any() else math.nan


def _unwrapped_end(heading: FloatArray) -> float:
    steps = np.abs(heading[1:] - heading[:-1])
    return float((np.unwrap(heading) if (steps >= np.pi).any() else heading)[-1])
