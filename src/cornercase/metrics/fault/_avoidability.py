"""Analysis of who could still have avoided a collision.

It finds when the collision became foreseeable, and until when braking would have avoided the collision.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers._competent_driver import DELAY, FULL_BRAKING, JERK, RISK_PERCEPTION
from cornercase.metrics.fault._party import STANDING_SPEED, Party, boxes_touch

REACTION_TIME: Final = RISK_PERCEPTION + DELAY
"""Time in s from a foreseeable danger to braking."""

_HORIZON: Final = 5.0
"""Time in s by which a driver looks ahead."""

_LOOK_BACK: Final = 8.0
"""Length in s of the time before the contact that is considered."""

_STEP: Final = 0.1
"""Time step in s of predictions, and of the instants at which they are made."""

_BRAKING_STEP: Final = 0.05

_MAX_GAP: Final = 0.3
"""Longest interruption in s of a foreseeable danger after which it counts as the same danger."""


@dataclass(frozen=True)
class AvoidanceChance:
    """Chance that a party (one of the two entities of a collision) had to avoid the collision.

    `foreseeable` is for how long in s before the contact the party could see the collision coming. `could_avoid` says
    whether a careful and competent driver would have avoided the collision by braking when it became foreseeable.
    `is_whole` is False if the collision may have been foreseeable even earlier: it was already foreseeable at the
    beginning of the recording, or 8 s before the contact, where the search ends. It is also False if the recording
    begins less than 0.1 s before the contact.
    """

    foreseeable: float
    could_avoid: bool
    is_whole: bool


def find_chance(party: Party, partner: Party, contact: float, obstacles: Iterable[Party]) -> AvoidanceChance:
    """Find the chance that a party had to avoid the collision with its partner by braking on its path.

    The partner is the other entity of the collision. At an instant, the collision is foreseeable if the party can see
    the partner and a prediction shows a collision within 5 s. The prediction is that the party stays on its path at its
    speed, and that the partner goes straight on. The collision counts as foreseeable from the first such instant after
    which this holds until the contact; interruptions of up to 0.3 s are ignored. `obstacles` may hide the partner.

    The driver is the careful and competent driver of UN Regulation No. 157 (Annex 4, Appendix 3). This driver
    recognises the danger within 0.4 s, begins to brake 0.75 s later, and reaches a deceleration of 0.774 g after
    another 0.6 s. Meanwhile the partner moves as recorded, and straight on after the recorded contact. The party avoids
    the collision if it stands before the boxes of both touch.
    """
    foreseeable, is_whole = find_foreseeable_time(party, partner, contact, obstacles)
    could_avoid = foreseeable > 0.0 and can_brake(party, partner, contact - foreseeable)
    return AvoidanceChance(foreseeable, could_avoid, is_whole)


def find_foreseeable_time(
    party: Party, partner: Party, contact: float, obstacles: Iterable[Party]
) -> tuple[float, bool]:
    """Return for how long in s a collision was foreseeable before the contact, and whether this time is complete.

    The time is 0 if the collision never was foreseeable, as defined in `find_chance`. It is incomplete if the collision
    was already foreseeable at the beginning of the recording, or 8 s before the contact, where the search ends, or if
    the recording begins less than 0.1 s before the contact.
    """
    instants, is_danger = find_foreseeable_dangers(party, partner, contact, obstacles)
    if not len(instants):
        return 0.0, False
    foreseeable, unnoticed = 0.0, 0.0
    for instant, danger in zip(instants.tolist(), is_danger.tolist(), strict=True):
        unnoticed = 0.0 if danger else unnoticed + _STEP
        if unnoticed > _MAX_GAP + 1e-9:
            break
        if danger:
            foreseeable = contact - instant
    return foreseeable, foreseeable < contact - float(instants[-1])


def find_foreseeable_dangers(
    party: Party, partner: Party, end: float, obstacles: Iterable[Party]
) -> tuple[FloatArray, BoolArray]:
    """Find at which instants of the 8 s before the time `end` a party could see a collision with its partner coming.

    Return the n instants, the latest first, and whether the collision was foreseeable at each; both have shape (n,).
    Times are in s.
    """
    instants = _instants_before(party, partner, end)
    if not len(instants):
        return instants, np.zeros(0, dtype=np.bool_)
    is_danger = _predicts_collision(party, partner, instants)
    # Obstacles matter only if a collision is predicted.
    if is_danger.any():
        is_danger[is_danger] = _can_see(party, partner, instants[is_danger], obstacles)
    return instants, is_danger


def can_brake(party: Party, partner: Party, noticed: float) -> bool:
    """Return whether a careful and competent driver of `party` avoids a collision with `partner` by braking.

    `noticed` is the time in s at which the driver notices the danger. Braking begins after a reaction time.
    """
    return _avoids(party, partner, noticed, REACTION_TIME)


def can_stop(party: Party, partner: Party, start: float) -> bool:
    """Return whether the party stands before it touches the partner, if it brakes fully from the time `start` in s."""
    return _avoids(party, partner, start, 0.0)


def find_latest_braking(party: Party, partner: Party, contact: float) -> float | None:
    """Return how long in s before the contact full braking must begin at the latest to avoid the collision.

    None if full braking avoids the collision at no time. If full braking at some time avoids the collision, earlier
    braking is assumed to avoid it, too.
    """
    instants = _instants_before(party, partner, contact)
    if not len(instants):
        return None
    if not _avoids(party, partner, float(instants[-1]), 0.0):
        return None
    late, early = 0, len(instants) - 1
    while late < early:
        middle = (late + early) // 2
        if _avoids(party, partner, float(instants[middle]), 0.0):
            early = middle
        else:
            late = middle + 1
    return contact - float(instants[early])


def _instants_before(party: Party, partner: Party, contact: float) -> FloatArray:
    """Return the instants in s, in steps of 0.1 s, of the 8 s before the contact, the latest first.

    Instants before the recorded motion of either party begins are left out.
    """
    begin = max(float(party.time[0]), float(partner.time[0]), contact - _LOOK_BACK)
    return contact - _STEP * np.arange(1, max(int((contact - begin) / _STEP + 1e-6), 0) + 1)


def _predicts_collision(party: Party, partner: Party, instants: FloatArray) -> BoolArray:
    """Return for each of n instants whether party and partner are predicted to collide within 5 s, shape (n,).

    The prediction is that the party goes on along its path, and the partner straight on, both at constant speed.
    """
    ahead = np.arange(_STEP, _HORIZON + _STEP / 2.0, _STEP)
    speeds = np.abs(np.interp(instants, party.time, party.speed))
    driven = np.interp(instants, party.time, party.distance)
    poses = party.poses_along(driven[:, None] + speeds[:, None] * ahead)
    x, y, heading, speed = (
        np.interp(instants, partner.time, values)[:, None]
        for values in (partner.x, partner.y, partner.heading, partner.speed)
    )
    other_poses = (x + speed * np.cos(heading) * ahead, y + speed * np.sin(heading) * ahead, heading)
    return np.asarray(boxes_touch(party, poses, partner, other_poses).any(axis=1))


def _can_see(party: Party, partner: Party, instants: FloatArray, obstacles: Iterable[Party]) -> BoolArray:
    """Return whether any corner of the partner's box can be seen from the party's centre at each of n instants."""
    sees = np.ones((len(instants), 4), dtype=np.bool_)
    eye = np.stack([np.interp(instants, party.time, values) for values in (party.x, party.y)], -1)[:, None]
    ray = partner.corners(partner.poses_at(instants)) - eye
    for obstacle in obstacles:
        x, y, heading = (
            np.interp(instants, obstacle.time, v)[:, None] for v in (obstacle.x, obstacle.y, obstacle.heading)
        )
        is_there = (instants >= obstacle.time[0] - 1e-9) & (instants <= obstacle.time[-1] + 1e-9)
        cos, sin = np.cos(heading), np.sin(heading)
        enters, leaves = np.zeros(sees.shape), np.ones(sees.shape)
        for c, s, half in ((cos, sin, 0.5 * obstacle.size[0]), (-sin, cos, 0.5 * obstacle.size[1])):
            start = c * (eye[..., 0] - x) + s * (eye[..., 1] - y)
            along = c * ray[..., 0] + s * ray[..., 1]
            along = np.where(np.abs(along) > 1e-12, along, 1e-12)
            first, last = (-half - start) / along, (half - start) / along
            enters = np.maximum(enters, np.minimum(first, last))
            leaves = np.minimum(leaves, np.maximum(first, last))
        sees &= ~(is_there[:, None] & (enters < leaves))
    return np.asarray(sees.any(axis=1))


def _avoids(party: Party, partner: Party, start: float, delay: float) -> bool:
    """Return whether the party stands before it touches the partner, if it brakes fully from `start` + `delay` on.

    `start` is a time in s, `delay` a duration in s.
    """
    elapsed, speeds = full_braking_speeds(abs(party.speed_at(start)), delay)
    driven = np.append(0.0, np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * _BRAKING_STEP))
    poses = party.poses_along(float(np.interp(start, party.time, party.distance)) + driven)
    touches = boxes_touch(party, poses, partner, partner.poses_at(start + elapsed))
    return not bool((touches & (speeds > STANDING_SPEED)).any())


def full_braking_speeds(speed: float, delay: float) -> tuple[FloatArray, FloatArray]:
    """Return times in s and speeds in m/s while a careful and competent driver brakes to standing.

    `speed` is the initial speed in m/s; full braking begins after `delay` in s.
    """
    rise = FULL_BRAKING / JERK
    elapsed = np.arange(0.0, delay + speed / FULL_BRAKING + rise + 2.0, _BRAKING_STEP)
    braking = np.maximum(elapsed - delay, 0.0)
    lost = np.where(braking < rise, 0.5 * JERK * braking**2, FULL_BRAKING * (braking - 0.5 * rise))
    return elapsed, np.maximum(speed - lost, 0.0)
