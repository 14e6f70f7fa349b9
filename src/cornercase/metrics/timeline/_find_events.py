"""Search for the times of events between the ego and another entity.

The events are that the ego could see the other entity, could foresee a collision, slowed down, braked, and collided.
"""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers._visible_entities import find_visible_others
from cornercase.metrics.ending._box_gap import smallest_box_gap
from cornercase.metrics.ending._poses import Poses
from cornercase.metrics.fault._avoidability import find_foreseeable_dangers, find_foreseeable_time
from cornercase.metrics.fault._party import Party, iter_obstacles
from cornercase.recordings import Recording

SLOWING: Final = 0.4
"""Deceleration in m/s² from which the ego slows down.

It is the deceleration of the careful driver of UN Regulation No. 157 who has released the accelerator and does not
brake yet (Annex 4, Appendix 3).
"""

BRAKING: Final = 1.3
"""Deceleration in m/s² from which the ego brakes: from here on brake lights have to light (UN Regulation No. 13-H)."""

ANTICIPATION: Final = 0.5
"""Time in s before a collision is foreseeable from which slowing down counts as a reaction to it.

A collision is foreseen from constant speeds here; a driver may predict better.
"""

_MAX_GAP: Final = 0.3
"""Longest interruption in s of sight or braking that is ignored."""

_LOOK_AHEAD: Final = 5.0
"""Time in s after the closest point for which the ego's path is needed to foresee a collision."""

_LOOK_BACK: Final = 10.0

_STOPPED: Final = 0.5
"""Speed in m/s up to which braking has ended in standing: the last step before may not be recorded as braking."""

_ROUNDING: Final = 1e-6
"""Rounding error of an acceleration in m/s²."""


@dataclass(frozen=True)
class EncounterEvents:
    """Times in s of events between the ego and another entity, `other`; None for events that did not happen.

    `sees` is the begin of the last time span in which the ego could see the other entity, before they touch or are
    closest. Sight is computed as for the drivers, without limits of angle or distance. `foresees` is when the ego could
    first see the collision coming, as in `find_chance`. Without a contact, it is the begin of the last time span in
    which a collision was foreseeable, before they are closest. `contact` is when they touch. `closest` is the instant
    of the smallest gap between the boxes, and `gap` is this gap in m.

    `brakes` is the begin of the first braking that starts in sight of the other entity, and at most 0.5 s before
    `foresees` or later. If there is none, `brakes` is the begin of the first of these that exists: harder braking after
    `foresees`, braking that started in sight earlier and goes on at `foresees`, the last braking that started in sight
    and ended in standing. `slows` is the begin of the slowing down that leads to this braking, or `brakes` if the
    slowing down started more than 0.5 s before `foresees`. If the ego does not brake, or only before `foresees` to
    stand, `slows` is the begin of the first slowing down that starts in sight, and at most 0.5 s before `foresees` or
    later. Without a foreseeable collision, `slows` is None, and `brakes` is the begin of the last braking that started
    in sight.
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
    """Find the times of events between the ego and another entity.

    `contact` is the time in s at which they collide; None if they do not collide.
    """
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
    seen = _is_other_visible(entities, i, j) & shared & before
    runs = _find_runs(seen, time)
    sees = None if not runs else float(time[runs[-1][0]])
    foresees = _find_danger(entities, ego, other, anchor, contact is not None)
    if sees is None:
        foresees = None
    elif foresees is not None:
        # Sight starts at the driver's eye, danger at the centre of the box, so the times can differ.
        foresees = max(foresees, sees)
    slows, brakes = _find_braking(entities, i, before, sees, foresees)
    return EncounterEvents(other, sees, foresees, slows, brakes, contact, closest, float(gap))


def _is_other_visible(recording: Recording, ego_index: int, other_index: int) -> BoolArray:
    """Return whether the ego can see the other entity at each instant, shape (T,)."""
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
    """Return the indices of the first and last instant of each time span in which a mask is True.

    Instants with False end a time span only if they interrupt it for more than 0.3 s and one usual time step.
    """
    instants = np.flatnonzero(mask)
    if not len(instants):
        return []
    gaps = np.diff(time[instants])
    # The usual time step takes long to find, and seldom matters.
    ends = np.flatnonzero(gaps > _MAX_GAP)
    if len(ends):
        ends = ends[gaps[ends] > _MAX_GAP + _usual_step(time)]
    starts = [0, *(ends + 1).tolist()]
    return [(int(instants[a]), int(instants[b])) for a, b in zip(starts, [*ends.tolist(), -1], strict=True)]


def _usual_step(time: FloatArray) -> float:
    return statistics.median((time[1:] - time[:-1]).tolist()) if len(time) > 1 else 0.0


def _find_danger(recording: Recording, ego: str, other: str, anchor: float, touches: bool) -> float | None:
    """Return the time in s from which on a collision was foreseeable; None if it never was.

    `anchor` is the time in s at which the ego and the other entity touch or are closest.
    """
    end, back = (anchor, _LOOK_BACK) if touches else (anchor + _LOOK_AHEAD, _LOOK_BACK + _LOOK_AHEAD)
    party, partner = (Party.from_recording(recording, name, end, back) for name in (ego, other))
    if min(len(party.time), len(partner.time)) < 2:
        return None
    obstacles = iter_obstacles(recording, (ego, other), end, back)
    if touches:
        foreseeable, _ = find_foreseeable_time(party, partner, anchor, obstacles)
        return anchor - foreseeable if foreseeable > 0.0 else None
    instants, is_danger = find_foreseeable_dangers(party, partner, anchor, obstacles)
    runs = _find_runs(is_danger[::-1], instants[::-1])
    return float(instants[::-1][runs[-1][0]]) if runs else None


def _find_braking(
    recording: Recording, ego_index: int, before: BoolArray, sees: float | None, foresees: float | None
) -> tuple[float | None, float | None]:
    """Return the times in s at which the ego begins to slow down and begins to brake; None for what it does not do."""
    time, speed = recording.time, recording.speed[ego_index]
    deceleration = np.nan_to_num(-recording.acceleration[ego_index] * np.where(speed < 0.0, -1.0, 1.0))
    if sees is None:
        return None, None
    begin = int(np.searchsorted(time, sees - 1e-9))

    def runs_after(threshold: float, earliest: float) -> list[tuple[int, int]]:
        """Return runs of deceleration that begin in sight of the other, at `earliest` in s or later."""
        runs = _find_runs((deceleration >= threshold - _ROUNDING) & before, time)
        return [run for run in runs if run[0] > begin and time[run[0]] >= earliest - 1e-9]

    if foresees is None:
        runs = runs_after(BRAKING, -math.inf)
        return None, float(time[runs[-1][0]]) if runs else None
    earliest = foresees - ANTICIPATION
    brakes = _first_begin(runs_after(BRAKING, earliest), time)
    if brakes is None:
        # The ego may brake already, for example before a bend, and brake harder from here on.
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
