"""What happened when: the ego could see the other, could foresee a collision, slowed down, braked, and touched it."""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers._sight import find_visible_others
from cornercase.metrics.ending._box_gap import smallest_box_gap
from cornercase.metrics.ending._poses import Poses
from cornercase.metrics.fault._party import Party, iter_obstacles
from cornercase.metrics.fault._reaction import find_foreseeable, is_danger_foreseeable
from cornercase.recordings import Recording

SLOWING: Final = 0.4
"""Deceleration in m/s² from which the ego slows down.

It is that of UN Regulation No. 157's careful driver, who has left the accelerator and not braked yet (Annex 4,
Appendix 3).
"""

BRAKING: Final = 1.3
"""Deceleration in m/s² from which the ego brakes: from here on brake lights have to light (UN Regulation No. 13-H)."""

ANTICIPATION: Final = 0.5
"""Time in s by which a driver may slow down before a collision is foreseeable here.

It is foreseen from constant speeds; a driver may predict better than that.
"""

_MAX_GAP: Final = 0.3
"""Longest time in s for which sight or braking may seem to be over."""

_LOOK_AHEAD: Final = 5.0
"""Time in s after the closest point for which the ego's path is needed to foresee a collision."""

_LOOK_BACK: Final = 10.0

_STOPPED: Final = 0.5
"""Speed in m/s up to which braking has ended in standing: the last step before may not be recorded as braking."""

_ROUNDING: Final = 1e-6
"""Rounding error of an acceleration in m/s²."""


@dataclass(frozen=True)
class EncounterEvents:
    """What happened when between the ego and another entity: times in s, None for what did not happen.

    `sees`: since when the ego could see the other without interruption, before they touch or are closest; the eye and
    the rule are those of the drivers, without a field of view or a range. `foresees`: since when it could see a
    collision coming, as in `find_chance`; without a contact the last such danger before they are closest. `slows` and
    `brakes`: the first braking that begins at most 0.5 s before that, and the slowing down that it belongs to; else a
    braking that goes on or gets harder then, or the last one by which the ego had stopped. Without a foreseeable
    collision `slows` is None, and `brakes` the last braking that began in sight of the other. `closest` is the instant
    of the smallest gap between the boxes, `gap` in m.
    """

    other: str
    sees: float | None
    foresees: float | None
    slows: float | None
    brakes: float | None
    contact: float | None
    closest: float | None
    gap: float


def find_events(recording: Recording, ego: str, other: str, contact: float | None = None) -> EncounterEvents:
    """Find what happened when between the ego and another entity; `contact` is the time in s at which they collide."""
    entities = recording.with_absent_entities((ego, other))
    i, j = entities.entity_index(ego), entities.entity_index(other)
    time, poses = entities.time, Poses.from_recording(entities)
    shared = poses.exists[i] & poses.exists[j]
    if not shared.any():
        return EncounterEvents(other, None, None, None, None, contact, None, math.nan)
    gap, instant, _ = smallest_box_gap(
        shared, poses.x[i], poses.y[i], poses.cos[i], poses.sin[i], poses.size[i],
        poses.x[j], poses.y[j], poses.cos[j], poses.sin[j], poses.size[j],
    )  # fmt: skip
    closest = float(time[instant])
    anchor = closest if contact is None else contact
    before = time <= anchor + 1e-9
    seen = _find_sight(entities, i, j) & shared & before
    runs = _find_runs(seen, time)
    sees = None if not runs else float(time[runs[-1][0]])
    foresees = _find_danger(entities, ego, other, anchor, contact is not None)
    if sees is None:
        foresees = None
    elif foresees is not None:
        # Its eye is not at the centre of its box, from which a danger is foreseen.
        foresees = max(foresees, sees)
    slows, brakes = _find_braking(entities, i, before, sees, foresees)
    return EncounterEvents(other, sees, foresees, slows, brakes, contact, closest, float(gap))


def _find_sight(recording: Recording, ego_index: int, other_index: int) -> BoolArray:
    """Whether the ego can see the other at each instant, shape (T,)."""
    watched = [k for k in range(len(recording.names)) if k != ego_index]
    boxes = np.array([recording.length, recording.width, recording.center_x], dtype=np.float64)
    poses = np.array([recording.x, recording.y, recording.heading], dtype=np.float64).transpose(2, 0, 1)
    seen = find_visible_others(
        np.ascontiguousarray(poses[:, :, ego_index]),
        boxes[:, ego_index],
        np.ascontiguousarray(poses[:, :, watched]),
        np.ascontiguousarray(boxes[:, watched]),
    )
    column: BoolArray = seen[:, watched.index(other_index)]
    return column


def _find_runs(mask: BoolArray, time: FloatArray) -> list[tuple[int, int]]:
    """First and last instant of each run in which a mask holds; gaps up to 0.3 s do not end a run."""
    instants = np.flatnonzero(mask)
    if not len(instants):
        return []
    gaps = np.diff(time[instants])
    # The step is costly to find, and seldom matters.
    ends = np.flatnonzero(gaps > _MAX_GAP)
    if len(ends):
        ends = ends[gaps[ends] > _MAX_GAP + _usual_step(time)]
    starts = [0, *(ends + 1).tolist()]
    return [(int(instants[a]), int(instants[b])) for a, b in zip(starts, [*ends.tolist(), -1], strict=True)]


def _usual_step(time: FloatArray) -> float:
    return statistics.median((time[1:] - time[:-1]).tolist()) if len(time) > 1 else 0.0


def _find_danger(recording: Recording, ego: str, other: str, anchor: float, touches: bool) -> float | None:
    """Time in s since when a collision was foreseeable; None if it never was."""
    end, back = (anchor, _LOOK_BACK) if touches else (anchor + _LOOK_AHEAD, _LOOK_BACK + _LOOK_AHEAD)
    party, partner = (Party.from_recording(recording, name, end, back) for name in (ego, other))
    if min(len(party.time), len(partner.time)) < 2:
        return None
    obstacles = iter_obstacles(recording, (ego, other), end, back)
    if touches:
        foreseeable, _ = find_foreseeable(party, partner, anchor, obstacles)
        return anchor - foreseeable if foreseeable > 0.0 else None
    instants, is_danger = is_danger_foreseeable(party, partner, anchor, obstacles)
    runs = _find_runs(is_danger[::-1], instants[::-1])
    return float(instants[::-1][runs[-1][0]]) if runs else None


def _find_braking(
    recording: Recording, ego_index: int, before: BoolArray, sees: float | None, foresees: float | None
) -> tuple[float | None, float | None]:
    """When the ego slows down, and when it brakes."""
    time, speed = recording.time, recording.speed[ego_index]
    deceleration = np.nan_to_num(-recording.acceleration[ego_index] * np.where(speed < 0.0, -1.0, 1.0))
    if sees is None:
        return None, None
    begin = int(np.searchsorted(time, sees - 1e-9))

    def runs_after(threshold: float, earliest: float) -> list[tuple[int, int]]:
        """Runs that begin in sight of the other, from a time on."""
        runs = _find_runs((deceleration >= threshold - _ROUNDING) & before, time)
        return [run for run in runs if run[0] > begin and time[run[0]] >= earliest - 1e-9]

    if foresees is None:
        runs = runs_after(BRAKING, -math.inf)
        return None, float(time[runs[-1][0]]) if runs else None
    earliest = foresees - ANTICIPATION
    brakes = _first_begin(runs_after(BRAKING, earliest), time)
    if brakes is None:
        # It may brake already, for a bend, and harder from here on.
        now = int(np.searchsorted(time, foresees - 1e-9))
        harder = before & (time >= foresees - 1e-9) & (deceleration >= max(deceleration[now], 0.0) + BRAKING)
        brakes = _first_begin(_find_runs(harder, time), time)
    if brakes is None:
        active = [run for run in runs_after(BRAKING, -math.inf) if time[run[1]] >= foresees - 1e-9]
        brakes = _first_begin(active, time)
    slowing = runs_after(SLOWING, earliest)
    if brakes is None:
        stops = [run for run in runs_after(BRAKING, -math.inf) if abs(speed[run[1]]) < _STOPPED]
        return _first_begin(slowing, time), _first_begin(stops[-1:], time)
    whole = [run for run in slowing if time[run[0]] <= brakes + 1e-9 <= time[run[1]] + 2e-9]
    return _first_begin(whole, time) if whole else brakes, brakes


def _first_begin(runs: list[tuple[int, int]], time: FloatArray) -> float | None:
    return float(time[runs[0][0]]) if runs else None
