"""Search for the ending of a scenario for the ego: who is first, who collides, whether the ego stops."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from cornercase._common.geometry.boxes import wrap_angle
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.metrics._outcome import Impact, Manner, Outcome, PathRelation
from cornercase.metrics.ending._path_crossing import BoxPath, find_path_crossing
from cornercase.metrics.ending._poses import Poses
from cornercase.metrics.fault._find_fault import find_fault
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

    `others=False` skips encounters with further entities. Each of these encounters takes as long to compute as the
    encounter with `other`.
    """
    return find_outcomes(recording, ego, (other,), others=others)[0]


def find_outcomes(
    recording: Recording, ego: str, main_others: Sequence[str], *, others: bool = True, poses: Poses | None = None
) -> tuple[Outcome, ...]:
    """Determine how a recorded scenario ended for the ego, once with each of `main_others` as main other entity.

    `others=False` skips encounters with further entities. `poses` are the poses in the recording, if they are already
    computed.
    """
    scene = _Scene(recording, ego, Poses.from_recording(recording) if poses is None else poses)
    exists, path = scene.poses.exists[scene.ego_index], scene.path(ego)
    speed = scene.speeds[scene.ego_index]
    has_moved = np.maximum.accumulate(speed) >= STANDING_SPEED
    moving = [
        name
        for name in (recording.names if others else ())
        if name != ego and scene.has_moved(name) and set(main_others) != {name}
    ]
    further_encounters = [_find_encounter(scene, path, name) for name in moving]
    impacts = tuple(
        _impact_from_collision(recording, ego, collision, scene.poses)
        for collision in recording.collisions
        if ego in collision.entities
    )
    other_collisions = tuple(collision for collision in recording.collisions if ego not in collision.entities)
    exists_ever, moves = bool(exists.any()), bool(has_moved[-1])
    stops = moves and bool((has_moved & exists & (speed < STANDING_SPEED)).any())
    outcomes = []
    for other in main_others:
        encounter = _find_encounter(scene, path, other, extrapolate=True)
        waits, yields = _find_waiting_and_yielding(recording.time, speed, has_moved, ego, encounter)
        outcome = Outcome(
            ego=ego,
            encounter=encounter,
            others=tuple(further for further in further_encounters if further.entity != other),
            impacts=impacts,
            other_collisions=other_collisions,
            exists=exists_ever,
            moves=moves,
            stops=stops,
            waits=waits,
            yields=yields,
        )
        outcomes.append(outcome)
    return tuple(outcomes)


class _Scene:
    """Recording, ego and poses, with quantities of the entities that are computed once.

    `speeds` are in m/s, without sign, and 0 instead of NaN.
    """

    def __init__(self, recording: Recording, ego: str, poses: Poses):
        self.recording, self.ego, self.poses = recording, ego, poses
        self.ego_index = recording.entity_index(ego)
        self.speeds: FloatArray = np.nan_to_num(np.abs(recording.speed))
        self._top_speeds = self.speeds.max(axis=1, initial=0.0).tolist()
        self._paths: dict[str, BoxPath] = {}

    def has_moved(self, entity: str) -> bool:
        return bool(self._top_speeds[self.recording.entity_index(entity)] >= STANDING_SPEED)

    def path(self, entity: str) -> BoxPath:
        if entity not in self._paths:
            self._paths[entity] = BoxPath.from_poses(self.poses, self.recording.entity_index(entity))
        return self._paths[entity]


def describe_outcome(recording: Recording, ego: str, other: str) -> str:
    """Return the ending as text: who collided, else who was first where the paths cross.

    Texts are ``"Ego and Pedestrian collide"``, ``"Ego first"``, ``"Pedestrian first"``, ``"only Pedestrian crosses"``
    (the ego had not arrived at the end), ``"Pedestrian ahead"`` or ``"Ego overtakes Pedestrian"`` in a lane, ``"ways do
    not cross"``, and ``"Pedestrian is never there"``.
    """
    return find_outcome(recording, ego, other, others=False).text


def _find_encounter(scene: _Scene, ego_path: BoxPath, other: str, extrapolate: bool = False) -> PathRelation:
    same_direction = _compare_directions(scene, other)
    if same_direction is None:
        both_exist = all(scene.poses.exists[scene.recording.entity_index(name)].any() for name in (scene.ego, other))
        return PathRelation(other, "apart" if both_exist else "absent")
    is_same_direction, is_adjacent, lane_encounter = same_direction
    if is_same_direction and is_adjacent:
        return lane_encounter
    other_path = scene.path(other)
    crossing = find_path_crossing(ego_path, other_path)
    if is_same_direction:
        # On a bend, an entity far ahead is off to the side.
        return lane_encounter if crossing else PathRelation(other, "apart")
    if crossing is None:
        return _encounter_after_end(scene, ego_path, other_path, other) if extrapolate else PathRelation(other, "apart")
    if crossing.enters < crossing.other_enters:
        first, gap = scene.ego, crossing.other_enters - crossing.leaves
    else:
        first, gap = other, crossing.enters - crossing.other_leaves
    return PathRelation(other, "crossing", first=first, enters=crossing.enters, leaves=crossing.other_leaves, gap=gap)


def _encounter_after_end(scene: _Scene, ego_path: BoxPath, other_path: BoxPath, other: str) -> PathRelation:
    """Return the relation of two paths that do not cross in the recording, but may if they are extrapolated.

    The paths cross if one entity reached the crossing of the extrapolated paths before the end; this entity is first.
    Otherwise the relation is ``"apart"``.
    """
    # An entity that never moves has no path to extrapolate.
    if not (scene.has_moved(scene.ego) and scene.has_moved(other)):
        return PathRelation(other, "apart")
    crossing = find_path_crossing(ego_path.extrapolate(), other_path.extrapolate())
    if crossing is None or min(crossing.enters, crossing.other_enters) > ego_path.end_time:
        return PathRelation(other, "apart")
    if crossing.enters < crossing.other_enters:
        return PathRelation(other, "crossing", first=scene.ego, enters=crossing.enters)
    return PathRelation(other, "crossing", first=other, leaves=min(crossing.other_leaves, ego_path.end_time))


def _compare_directions(scene: _Scene, other: str) -> tuple[bool, bool, PathRelation] | None:
    """Compare the directions and lanes in which the ego and another entity move.

    Return whether both move in the same direction, whether they are in one lane or in adjacent lanes, and the relation
    to use if both hold. None if they never exist at the same time.
    """
    i, j = scene.ego_index, scene.recording.entity_index(other)
    shared = scene.poses.exists[i] & scene.poses.exists[j]
    begin = int(shared.argmax())
    if not shared[begin]:
        return None
    is_same_direction = is_adjacent = True
    entities_ahead = []
    for instant in (begin, len(shared) - 1 - int(shared[::-1].argmax())):
        is_same_direction &= _heading_difference(scene.recording, i, j, instant) < _SAME_DIRECTION_ANGLE
        along, across = _relative_position(scene.poses, i, j, instant)
        is_adjacent &= abs(across) <= _ADJACENT_LANE_DISTANCE
        entities_ahead.append(other if along > 0.0 else scene.ego)
    first_ahead, last_ahead = entities_ahead
    return is_same_direction, is_adjacent, PathRelation(other, "lane", first=last_ahead, ahead=first_ahead)


def _heading_difference(recording: Recording, ego_index: int, other_index: int, instant: int) -> float:
    difference = float(recording.heading[other_index, instant]) - float(recording.heading[ego_index, instant])
    return abs(float(wrap_angle(difference)))


def _relative_position(poses: Poses, ego_index: int, other_index: int, instant: int) -> tuple[float, float]:
    """Return how far the other's centre is ahead of the ego's centre, and to its left, at an instant in m."""
    x = float(poses.x[other_index, instant]) - float(poses.x[ego_index, instant])
    y = float(poses.y[other_index, instant]) - float(poses.y[ego_index, instant])
    cos, sin = float(poses.cos[ego_index, instant]), float(poses.sin[ego_index, instant])
    return cos * x + sin * y, cos * y - sin * x


def _find_waiting_and_yielding(
    time: FloatArray, speed: FloatArray, has_moved: BoolArray, ego: str, encounter: PathRelation
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


def _impact_from_collision(recording: Recording, ego: str, collision: Collision, poses: Poses) -> Impact:
    (entity,) = (name for name in collision.entities if name != ego)
    instant = int(np.abs(recording.time - collision.time).argmin())
    i, j = recording.entity_index(ego), recording.entity_index(entity)
    velocities = [
        recording.speed[k, instant] * np.array([poses.cos[k, instant], poses.sin[k, instant]]) for k in (i, j)
    ]
    manner: Manner = "otherwise"
    if abs(recording.speed[i, instant]) < STANDING_SPEED:
        manner = "while it stands"
    elif _heading_difference(recording, i, j, instant) < _SAME_DIRECTION_ANGLE:
        along, _ = _relative_position(poses, i, j, instant)
        manner = "from behind" if along > 0.0 else "its rear"
    speed = float(np.hypot(*(velocities[1] - velocities[0])))
    return Impact(entity, collision.time, speed, manner, find_fault(recording, ego, collision))
