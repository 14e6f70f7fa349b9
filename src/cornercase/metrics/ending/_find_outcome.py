"""Ending of a scenario for the ego: who is first, who collides, and whether the ego stops."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from cornercase._common.geometry.boxes import wrap_angle
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.metrics._outcome import Encounter, Impact, Manner, Outcome
from cornercase.metrics.ending._path_crossing import BoxPath, find_path_crossing
from cornercase.recordings import Collision, Recording

STANDING_SPEED: Final = 0.1
"""Speed in m/s below which an entity stands."""

# Largest heading difference of entities that move in the same direction, and largest lateral distance of centres, in m,
# of entities in one lane or in adjacent ones.
_SAME_DIRECTION_ANGLE: Final = math.pi / 4
_ADJACENT_LANE_DISTANCE: Final = 5.0
# Largest share of its speed that an entity keeps when it slows down for another.
_SLOWDOWN_SHARE: Final = 0.8


def find_outcome(recording: Recording, ego: str, other: str, *, others: bool = True) -> Outcome:
    """Determine how a recorded scenario ended for the ego.

    `others=False` skips encounters with further entities, each of which takes as long again.
    """
    return find_outcomes(recording, ego, (other,), others=others)[0]


def find_outcomes(
    recording: Recording, ego: str, main_others: Sequence[str], *, others: bool = True
) -> tuple[Outcome, ...]:
    """Determine how a recorded scenario ended for the ego, with each of some entities as the main other one."""
    exists = existence_mask(recording, ego)
    path = BoxPath.from_recording(recording, ego, exists)
    speed = np.nan_to_num(np.abs(recording.speed[recording.entity_index(ego)]))
    has_moved = np.maximum.accumulate(speed) >= STANDING_SPEED
    moving = [
        name
        for name in (recording.names if others else ())
        if name != ego and _highest_speed(recording, name) >= STANDING_SPEED and set(main_others) != {name}
    ]
    further_encounters = [_find_encounter(recording, path, ego, name) for name in moving]
    impacts = tuple(
        _impact_from_collision(recording, ego, collision)
        for collision in recording.collisions
        if ego in collision.entities
    )
    other_collisions = tuple(collision for collision in recording.collisions if ego not in collision.entities)
    outcomes = []
    for other in main_others:
        encounter = _find_encounter(recording, path, ego, other, extrapolate=True)
        waits, yields = _find_yielding(recording.time, speed, has_moved, ego, encounter)
        outcome = Outcome(
            ego=ego,
            encounter=encounter,
            others=tuple(further for further in further_encounters if further.entity != other),
            impacts=impacts,
            other_collisions=other_collisions,
            exists=bool(exists.any()),
            moves=bool(has_moved.any()),
            stops=bool((has_moved & exists & (speed < STANDING_SPEED)).any()),
            waits=waits,
            yields=yields,
        )
        outcomes.append(outcome)
    return tuple(outcomes)


def describe_outcome(recording: Recording, ego: str, other: str) -> str:
    """Return the ending as text: who collided, else who was first where the paths cross.

    ``"Ego and Pedestrian collide"``, ``"Ego first"``, ``"Pedestrian first"``, ``"only Pedestrian crosses"`` (the ego
    had not arrived at the end), ``"Pedestrian ahead"`` or ``"Ego overtakes Pedestrian"`` in a lane, ``"ways do not
    cross"``, or ``"Pedestrian is never there"``.
    """
    return find_outcome(recording, ego, other, others=False).text


def existence_mask(recording: Recording, entity: str) -> BoolArray:
    """Mask of the instants at which an entity exists, shape (T,)."""
    i = recording.entity_index(entity)
    # A sum is finite if all its terms are.
    exists: BoolArray = np.isfinite(recording.x[i] + recording.y[i] + recording.heading[i] + recording.speed[i])
    return exists


def _highest_speed(recording: Recording, entity: str) -> float:
    return float(np.nan_to_num(np.abs(recording.speed[recording.entity_index(entity)])).max(initial=0.0))


def _find_encounter(
    recording: Recording, ego_path: BoxPath, ego_name: str, other: str, extrapolate: bool = False
) -> Encounter:
    same_direction = _compare_directions(recording, ego_name, other)
    if same_direction is None:
        both_exist = existence_mask(recording, ego_name).any() and existence_mask(recording, other).any()
        return Encounter(other, "apart" if both_exist else "absent")
    is_same_direction, is_adjacent, lane_encounter = same_direction
    if is_same_direction and is_adjacent:
        return lane_encounter
    other_path = BoxPath.from_recording(recording, other, existence_mask(recording, other))
    crossing = find_path_crossing(ego_path, other_path)
    if is_same_direction:
        # On a bend, an entity far ahead is off to the side.
        return lane_encounter if crossing else Encounter(other, "apart")
    if crossing is None:
        return (
            _encounter_after_end(recording, ego_path, other_path, ego_name, other)
            if extrapolate
            else Encounter(other, "apart")
        )
    if crossing.enters < crossing.other_enters:
        first, gap = ego_name, crossing.other_enters - crossing.leaves
    else:
        first, gap = other, crossing.enters - crossing.other_leaves
    return Encounter(other, "crossing", first=first, enters=crossing.enters, leaves=crossing.other_leaves, gap=gap)


def _encounter_after_end(
    recording: Recording, ego_path: BoxPath, other_path: BoxPath, ego_name: str, other: str
) -> Encounter:
    """Who alone reached the point where both paths would cross if they went straight on after the end."""
    # An entity that never moves has no path to extrapolate.
    if min(_highest_speed(recording, ego_name), _highest_speed(recording, other)) < STANDING_SPEED:
        return Encounter(other, "apart")
    crossing = find_path_crossing(ego_path.extrapolate(), other_path.extrapolate())
    if crossing is None or min(crossing.enters, crossing.other_enters) > ego_path.end_time:
        return Encounter(other, "apart")
    if crossing.enters < crossing.other_enters:
        return Encounter(other, "crossing", first=ego_name, enters=crossing.enters)
    return Encounter(other, "crossing", first=other, leaves=min(crossing.other_leaves, ego_path.end_time))


def _compare_directions(recording: Recording, ego: str, other: str) -> tuple[bool, bool, Encounter] | None:
    """Whether both move in the same direction, whether in one lane or adjacent ones, and their encounter if so."""
    shared = np.flatnonzero(existence_mask(recording, ego) & existence_mask(recording, other))
    if not len(shared):
        return None
    ends_of_shared = shared[[0, -1]]
    headings = recording.heading[:, ends_of_shared]
    heading_difference = np.abs(
        wrap_angle(headings[recording.entity_index(other)] - headings[recording.entity_index(ego)])
    )
    along, across = _relative_position(recording, ego, other, ends_of_shared)
    first_ahead, last_ahead = (other if offset > 0.0 else ego for offset in along.tolist())
    encounter = Encounter(other, "lane", first=last_ahead, ahead=first_ahead)
    return (
        bool((heading_difference < _SAME_DIRECTION_ANGLE).all()),
        bool((np.abs(across) <= _ADJACENT_LANE_DISTANCE).all()),
        encounter,
    )


def _relative_position(recording: Recording, ego: str, other: str, instants: IntArray) -> tuple[FloatArray, FloatArray]:
    """Distance of the other's centre ahead of the ego's and to its left at some instants, in m, shape (k,) each."""
    i, j = recording.entity_index(ego), recording.entity_index(other)
    heading = recording.heading[:, instants]
    cos, sin, center_offset = np.cos(heading), np.sin(heading), recording.center_x[:, None]
    x, y = recording.x[:, instants] + center_offset * cos, recording.y[:, instants] + center_offset * sin
    x, y = x[j] - x[i], y[j] - y[i]
    return cos[i] * x + sin[i] * y, cos[i] * y - sin[i] * x


def _find_yielding(
    time: FloatArray, speed: FloatArray, has_moved: BoolArray, ego: str, encounter: Encounter
) -> tuple[bool, bool]:
    if encounter.relation != "crossing" or encounter.first == ego:
        return False, False
    deadline = time[-1] if math.isnan(encounter.enters) else encounter.enters
    before = np.flatnonzero(has_moved & (time <= min(deadline, encounter.leaves)))
    if not len(before):
        return False, False
    slowest = before[speed[before].argmin()]
    if speed[slowest] < STANDING_SPEED:
        return True, True
    slows_down = speed[slowest] <= _SLOWDOWN_SHARE * speed[: slowest + 1].max()
    speeds_up = math.isnan(encounter.enters) or speed[slowest] <= _SLOWDOWN_SHARE * np.interp(
        encounter.enters, time, speed
    )
    return False, bool(slows_down and speeds_up)


def _impact_from_collision(recording: Recording, ego: str, collision: Collision) -> Impact:
    (entity,) = (name for name in collision.entities if name != ego)
    instant = int(np.abs(recording.time - collision.time).argmin())
    i, j = recording.entity_index(ego), recording.entity_index(entity)
    velocities = [
        recording.speed[k, instant]
        * np.array([np.cos(recording.heading[k, instant]), np.sin(recording.heading[k, instant])])
        for k in (i, j)
    ]
    manner: Manner = "otherwise"
    if abs(recording.speed[i, instant]) < STANDING_SPEED:
        manner = "while it stands"
    elif abs(wrap_angle(recording.heading[j, instant] - recording.heading[i, instant])) < _SAME_DIRECTION_ANGLE:
        along, _ = _relative_position(recording, ego, entity, np.array([instant]))
        manner = "from behind" if along[0] > 0.0 else "its rear"
    return Impact(entity, collision.time, float(np.hypot(*(velocities[1] - velocities[0]))), manner)
