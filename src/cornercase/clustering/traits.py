"""Numbers that tell how a scenario goes for the ego: when, how fast, how near, how hard it brakes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final

import numpy as np

from cornercase._common.geometry import box_corners, box_distance
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.clustering.outcomes import STANDING, Outcome, there
from cornercase.recordings import Recording

TRAITS: Final[Mapping[str, tuple[str, str]]] = MappingProxyType(
    {
        "impact speed": ("hits slower than {} m/s", "hits faster than {} m/s"),
        "impact time": ("hits before {} s", "hits after {} s"),
        "entry": ("enters before {} s", "enters after {} s"),
        "gap": ("gap below {} s", "gap above {} s"),
        "nearest": ("comes within {} m of {other}", "stays more than {} m from {other}"),
        "nearest time": ("nearest before {} s", "nearest after {} s"),
        "lowest speed": ("slows below {} m/s", "stays above {} m/s"),
        "highest speed": ("never above {} m/s", "reaches more than {} m/s"),
        "mean speed": ("slower than {} m/s on average", "faster than {} m/s on average"),
        "first speed": ("begins slower than {} m/s", "begins faster than {} m/s"),
        "last speed": ("ends slower than {} m/s", "ends faster than {} m/s"),
        "standing": ("stands less than {} s", "stands more than {} s"),
        "braking": ("brakes less than {} m/s²", "brakes more than {} m/s²"),
        "way": ("goes less than {} m", "goes more than {} m"),
        "duration": ("over before {} s", "over after {} s"),
        "first distance": ("begins within {} m of {other}", "begins more than {} m from {other}"),
        "mean speed of the other": ("{other} slower than {} m/s on average", "{other} faster than {} m/s on average"),
    }
)
"""By name what is said of a scenario with less than a number, and with more; `measure_traits` says what each is."""

# m that rounding may make of a distance, at most.
_ROUNDING: Final = 1e-6


def measure_traits(recording: Recording, outcome: Outcome) -> dict[str, float]:
    """Measure how a scenario went for the ego.

    Parameters
    ----------
    recording : Recording
        What came out of the scenario.
    outcome : Outcome
        How it ended.

    Returns
    -------
    dict of str to float
        The traits, NaN for what did not happen:

        - ``"impact speed"``, ``"impact time"``: of the ego's first collision, in m/s and s;
        - ``"entry"``, ``"gap"``: when the ego enters the crossing, and the gap there, in s, as in
          `cornercase.clustering.outcomes.Encounter` where it is not negative;
        - ``"nearest"``, ``"nearest time"``, ``"first distance"``: the smallest gap between the boxes of ego and other,
          when it is first reached, and the gap at the beginning, in m and s;
        - ``"lowest speed"``, ``"highest speed"``, ``"mean speed"``, ``"first speed"``, ``"last speed"``: of the ego, in
          m/s, without sign; the mean is of all instants, as is ``"mean speed of the other"``;
        - ``"standing"``: how long the ego stands, in s; ``"braking"``: its hardest deceleration while it moves, in
          m/s²;
        - ``"way"``, ``"duration"``: how far and how long it goes, in m and s;
        - ``"turn"``, ``"shift"``: by how much its heading turns to the left, in rad, and how far to the left of a
          straight way it ends, in m; ``"aside"``: how far to the left of it the other is at the beginning, in m.
    """
    i, j = recording.index(outcome.ego), recording.index(outcome.encounter.entity)
    gap, here = outcome.encounter.gap, there(recording, outcome.ego)
    traits = _of_ego(recording, i, here)
    traits |= {
        "impact speed": outcome.impacts[0].speed if outcome.impacts else math.nan,
        "impact time": outcome.impacts[0].time if outcome.impacts else math.nan,
        "entry": outcome.encounter.enters,
        "gap": gap if gap >= 0.0 else math.nan,
        "mean speed of the other": _mean(np.abs(recording.speed[j])),
    } | dict.fromkeys(("nearest", "nearest time", "first distance", "aside"), math.nan)
    if (both := np.flatnonzero(here & there(recording, outcome.encounter.entity))).size:
        centers = [recording.center(recording.names[k])[both] for k in (i, j)]
        nearest, at, begins = _nearest(recording, (i, j), both, centers)
        away = centers[1][0] - centers[0][0]
        heading = recording.heading[i, both[0]]
        aside = float(np.cos(heading) * away[1] - np.sin(heading) * away[0])
        traits |= {
            "nearest": nearest,
            "nearest time": float(recording.time[at]),
            "first distance": begins,
            "aside": aside,
        }
    return traits


def _nearest(
    recording: Recording, which: tuple[int, int], at: IntArray, centers: Sequence[FloatArray]
) -> tuple[float, int, float]:
    """Smallest gap between two boxes at some instants in m, the first instant of it, and the gap at the first one."""
    apart = np.hypot(*(centers[1] - centers[0]).T)
    length, width = recording.length[list(which)], recording.width[list(which)]
    # No box is nearer than its centre is, less both reaches, and none farther than the circles within both are.
    reach, within = 0.5 * float(np.hypot(length, width).sum()), 0.5 * float(np.minimum(length, width).sum())
    near = apart - reach <= max(float(apart.min()) - within, 0.0) + _ROUNDING
    near[0] = True
    x, y = np.stack([center[near] for center in centers]).transpose(2, 0, 1)
    headings = recording.heading[list(which)][:, at[near]]
    gaps = box_distance(*box_corners(x, y, headings, length[:, None], width[:, None]))
    return float(gaps.min()), int(at[near][gaps.argmin()]), float(gaps[0])


def _of_ego(recording: Recording, i: int, here: BoolArray) -> dict[str, float]:
    names = (
        "lowest speed", "highest speed", "mean speed", "first speed", "last speed", "standing", "braking", "way",
        "duration", "turn", "shift",
    )  # fmt: skip
    if not here.any():
        return dict.fromkeys(names, math.nan)
    time, signed, heading = recording.time[here], recording.speed[i, here], recording.heading[i, here]
    x, y, speed = recording.x[i, here], recording.y[i, here], np.abs(recording.speed[i, here])
    slowing = np.where(speed >= STANDING, -np.sign(signed) * recording.acceleration[i, here], 0.0)
    found = (
        np.nanmin(speed), np.nanmax(speed), _mean(speed), speed[0], speed[-1],
        np.append(np.diff(time), 0.0)[speed < STANDING].sum(),
        max(float(np.nan_to_num(slowing).max()), 0.0),
        np.hypot(np.diff(x), np.diff(y)).sum(), time[-1] - time[0],
        np.unwrap(heading)[-1] - heading[0],
        np.cos(heading[0]) * (y[-1] - y[0]) - np.sin(heading[0]) * (x[-1] - x[0]),
    )  # fmt: skip
    return {name: float(value) for name, value in zip(names, found, strict=True)}


def _mean(values: FloatArray) -> float:
    known = np.isfinite(values)
    return float(values[known].mean()) if known.any() else math.nan
