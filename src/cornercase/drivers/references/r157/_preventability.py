"""Preventability of a collision: whether a reference driver of UN Regulation No. 157 would have avoided it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers._base import DrivenPath, Situation
from cornercase.drivers.references.r157._models import REFERENCES, URGENT_TIME_TO_COLLISION, time_to_collision
from cornercase.drivers.references.r157._relative_motion_tracker import RelativeMotionTracker
from cornercase.recordings import Collision, Recording

# The regulation's models cover motorway traffic in about one direction: largest angle between directions in rad, and
# the time before contact for which it has to hold, in s.
_MAX_ANGLE: Final = np.pi / 4
_TIME_BEFORE: Final = 3.0
# Below this speed in m/s, the direction is ignored.
_MIN_MOVING_SPEED: Final = 0.5
_NON_MOTORWAY_TYPES: Final = frozenset({"pedestrian", "wheelchair", "animal", "bicycle", "tram", "train"})
# Straight extension of a driven path in m.
_PATH_EXTENSION: Final = 500.0
_TIME_TOLERANCE: Final = 1e-9


@dataclass(frozen=True)
class ReferenceOutcome:
    """Outcome of a scenario with a reference driver in control of the ego.

    `collides` is None if the regulation does not define the reference driver for this scenario. `time` is the time of
    the collision in s. After a collision that the regulation does not count, `collides` is False, but `time` is given.
    """

    collides: bool | None
    time: float | None = None

    def describe(self, driver: str) -> str:
        """Describe the outcome as part of a sentence; `driver` is the name of the reference driver."""
        if self.collides is None:
            return f"{driver} does not cover this scenario, only vehicles ahead that move in about its own direction"
        if not self.collides and self.time is not None:
            return (
                f"for {driver} it counts as prevented, though it collides at {self.time:.6g} s: the vehicle cut in with"
                " a time to collision above 2 s, in which the regulation sees no danger"
            )
        if not self.collides:
            return f"{driver} prevents it"
        when = "" if self.time is None else f", and collides at {self.time:.6g} s"
        return f"{driver} does not prevent it either{when}"


def assess_preventability(
    driver: str, run: Recording, original: Recording, ego: str, other: str | Sequence[str]
) -> ReferenceOutcome:
    """Assess whether a reference driver in control of the ego avoids the collision.

    `run` is the recording with the reference driver, and `original` the recording with the original driver. `other` is
    the entity that the ego meets. With several candidates and no collision, the nearest candidate counts.

    The reference drivers of UN Regulation No. 157 do not apply to every encounter; `collides` is None if they do not.
    The entity that the ego meets, and the entity that the reference driver collides with, must be motorway vehicles.
    Neither of these two entities may come from behind, with its whole box behind the ego just before contact. Within
    the last 3 s before the encounter, the direction of each of them may differ by at most 45° from the ego's while it
    is faster than 0.5 m/s.

    If the time to collision is above 2 s when a vehicle cuts in, the encounter ends without danger for ``cc-human``.
    Later collisions with that vehicle do not count (Annex 4, Appendix 3).
    """
    name = driver.partition(":")[0]
    collision = _first_collision(run, ego)
    if name in REFERENCES:
        original_collision = _first_collision(original, ego)
        others = (other,) if isinstance(other, str) else other
        partner, time = (
            _nearest_other(original, ego, others)
            if original_collision is None
            else (_collision_partner(original_collision, ego), original_collision.time)
        )
        if not _is_covered_by_regulation(original, ego, partner, time):
            return ReferenceOutcome(None)
        if collision is not None and not _is_covered_by_regulation(
            run, ego, _collision_partner(collision, ego), collision.time
        ):
            return ReferenceOutcome(None)
    if collision is None:
        return ReferenceOutcome(False)
    is_over = name == "cc-human" and _had_harmless_cut_in(run, ego, collision)
    return ReferenceOutcome(not is_over, float(collision.time))


def _first_collision(recording: Recording, ego: str) -> Collision | None:
    return next((collision for collision in recording.collisions if ego in collision.entities), None)


def _collision_partner(collision: Collision, ego: str) -> str:
    first, second = collision.entities
    return second if first == ego else first


def _nearest_other(recording: Recording, ego: str, others: Sequence[str]) -> tuple[str, float]:
    """Return the name of the nearest entity, and the time in s of the smallest distance.

    If no entity ever exists, return the first name and the first time.
    """
    distances = np.stack([np.hypot(*(recording.box_center(name) - recording.box_center(ego)).T) for name in others])
    row, column = np.unravel_index(np.where(np.isnan(distances), np.inf, distances).argmin(), distances.shape)
    return others[int(row)], float(recording.time[int(column)])


def _is_covered_by_regulation(recording: Recording, ego: str, other: str, time: float) -> bool:
    """Return whether UN Regulation No. 157 covers the encounter of ego and other at `time` in s."""
    i, j = recording.entity_index(ego), recording.entity_index(other)
    if recording.object_types[j] in _NON_MOTORWAY_TYPES:
        return False
    sample = max(int(np.abs(recording.time - time).argmin()) - 1, 0)
    heading = recording.heading[i, sample]
    x, y = recording.box_center(other)[sample] - recording.box_center(ego)[sample]
    if x * np.cos(heading) + y * np.sin(heading) < -0.5 * (recording.length[i] + recording.length[j]):
        return False
    moving = (
        (recording.time >= time - _TIME_BEFORE)
        & (recording.time <= time + _TIME_TOLERANCE)
        & (recording.speed[j] > _MIN_MOVING_SPEED)
    )
    angle = (recording.heading[j, moving] - recording.heading[i, moving] + np.pi) % (2.0 * np.pi) - np.pi
    return not (np.abs(angle) > _MAX_ANGLE).any()


def _had_harmless_cut_in(run: Recording, ego: str, hit_collision: Collision) -> bool:
    """Return whether the vehicle that the ego hits cut in earlier, with a time to collision above 2 s.

    The regulation does not count the collision after such a cut-in.
    """
    i, other_rows = run.entity_index(ego), [k for k, name in enumerate(run.names) if name != ego]
    valid = np.isfinite(run.x[i]) & (run.time <= hit_collision.time + _TIME_TOLERANCE)
    if np.count_nonzero(valid) < 2:
        return False
    situation = _stack_instants(run, i, other_rows, valid)
    tracker = RelativeMotionTracker(int(valid.sum()), len(other_rows))
    view = tracker.track_relative_motion(situation, run.acceleration[i, valid])
    k = other_rows.index(run.entity_index(_collision_partner(hit_collision, ego)))
    in_corridor, is_next_to = view.lateral_gap[:, k] < 0.0, view.lateral_gap[:, k] >= 0.0
    cuts_in = np.flatnonzero(in_corridor[1:] & is_next_to[:-1]) + 1
    if not len(cuts_in) or cuts_in[-1] == len(in_corridor) - 1:
        return False
    return bool(time_to_collision(view)[cuts_in[-1], k] > URGENT_TIME_TO_COLLISION)


def _stack_instants(run: Recording, ego_row: int, other_rows: list[int], is_present: BoolArray) -> Situation:
    """Return a situation in which each instant of a recording is a scenario; the path is the one that the ego drove."""
    x, y, heading = run.x[ego_row, is_present], run.y[ego_row, is_present], run.heading[ego_row, is_present]
    zeros = np.zeros(len(x))
    return Situation(
        time=0.0,
        time_step=float(run.time[1] - run.time[0]),
        path=_driven_path(x, y, heading),
        distance=zeros,
        x=x,
        y=y,
        heading=heading,
        speed=run.speed[ego_row, is_present],
        acceleration=run.acceleration[ego_row, is_present],
        length=float(run.length[ego_row]),
        width=float(run.width[ego_row]),
        center_x=float(run.center_x[ego_row]),
        target_speed=zeros,
        others_x=run.x[other_rows][:, is_present].T,
        others_y=run.y[other_rows][:, is_present].T,
        others_heading=run.heading[other_rows][:, is_present].T,
        others_speed=run.speed[other_rows][:, is_present].T,
        others_length=run.length[other_rows],
        others_width=run.width[other_rows],
        others_center_x=run.center_x[other_rows],
        others_object_type=tuple(run.object_types[k] for k in other_rows),
        active=np.ones(len(x), dtype=np.bool_),
    )


def _driven_path(x: FloatArray, y: FloatArray, heading: FloatArray) -> DrivenPath:
    step = np.hypot(np.diff(x), np.diff(y))
    moved = np.append(True, step > 1e-6)
    x, y, heading = x[moved], y[moved], np.unwrap(heading[moved])
    x = np.append(x, x[-1] + _PATH_EXTENSION * np.cos(heading[-1]))
    y = np.append(y, y[-1] + _PATH_EXTENSION * np.sin(heading[-1]))
    distance = np.append(0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y))))
    heading = np.append(heading, heading[-1])
    return DrivenPath(distance, x, y, heading, np.zeros(len(x)))
