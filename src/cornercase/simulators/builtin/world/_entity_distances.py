"""Distances between entities, along and across their headings, tracks or roads."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.tracks._lane import LaneTrack
from cornercase.simulators.builtin.tracks._track import Pose, Track
from cornercase.simulators.builtin.world._road_position import is_heading_along_road, road_pose
from cornercase.simulators.builtin.world._world import World

# m; a target that is farther from a track is not on the track.
_MAX_TRACK_DISTANCE: Final = 20.0


def locate_target_on_track(
    world: World, entity: int, target: Pose, number: FloatArray, distance: FloatArray, where: BoolArray
) -> None:
    """Store at which distance along the entity's track a fixed target is, in the scenarios of a mask.

    `number` (N,) receives the number of the track. `distance` (N,) receives the distance in m, which is infinite if the
    track does not lead to the target.
    """
    for k, track, rows in world.iter_followed_tracks(entity, where & np.isfinite(target.x + target.y)):
        new = rows[(number[rows] != k) | np.isnan(distance[rows])]
        if new.size:
            number[new] = k
            distance[new] = _distance_on_track(world, entity, track, target, new, allow_any_lateral=True)


def distance_along_roads(world: World, entity: int, target: Pose) -> FloatArray:
    """Return the distance in m from an entity to a target along its track, or along roads, shape (N,).

    The distance is negative if the target is behind, and infinite if neither track nor roads lead to the target.
    """
    result = np.full(world.scenarios, np.inf)
    for _, track, rows in world.iter_followed_tracks(entity, np.isfinite(target.x + target.y)):
        result[rows] = _distance_on_track(world, entity, track, target, rows) - world.distance[entity][rows]
    rows = np.flatnonzero(~np.isfinite(result) & np.isfinite(world.x[entity] + target.x))
    own_pose = road_pose(world, entity) if rows.size else None
    if world.network is not None and own_pose is not None and own_pose.road is not None and own_pose.s is not None:
        assert target.road is not None
        assert target.s is not None
        points_along = is_heading_along_road(world, own_pose)
        result[rows] = world.network.driving_distance(
            own_pose.road[rows], own_pose.s[rows], points_along[rows], target.road[rows], target.s[rows]
        )
    return result


def _distance_on_track(
    world: World, entity: int, track: Track, target: Pose, rows: IntArray, *, allow_any_lateral: bool = False
) -> FloatArray:
    """Return the distance from the start of a track to a target in m, shape (R,).

    The distance is infinite if the track does not lead to the target.
    """
    along = track.nearest_distance(target.x[rows], target.y[rows], rows, world.distance[entity][rows])
    x, y, _ = track.pose_at(along, np.zeros(len(rows)), rows)
    near = np.hypot(x - target.x[rows], y - target.y[rows]) < _MAX_TRACK_DISTANCE
    return np.where(near | (allow_any_lateral and not isinstance(track, LaneTrack)), along, np.inf)


def offset_of_entity(world: World, entity: int, other: int) -> FloatArray:
    """Return the lateral offset in m of another entity from the track of `entity`, shape (N,); positive to the left.

    Without a track, the offset is measured across the heading of `entity`.
    """
    is_present, (x, y) = world.present[other], _position_after_lateral_step(world, other)
    return offset_of_point(world, entity, np.where(is_present, x, np.nan), np.where(is_present, y, np.nan))


def offset_of_point(world: World, entity: int, x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the lateral offset in m of a point from the track of an entity, shape (N,); positive to the left.

    Without a track, the offset is measured across the heading of the entity.
    """
    cos, sin = np.cos(world.heading[entity]), np.sin(world.heading[entity])
    result = (y - world.y[entity]) * cos - (x - world.x[entity]) * sin + world.offset[entity]
    for _, track, rows in world.iter_followed_tracks(entity, np.isfinite(x)):
        along = track.nearest_distance(x[rows], y[rows], rows)
        at_x, at_y, heading = track.pose_at(along, np.zeros(len(rows)), rows)
        result[rows] = (y[rows] - at_y) * np.cos(heading) - (x[rows] - at_x) * np.sin(heading)
    return np.asarray(result)


def _position_after_lateral_step(world: World, entity: int) -> tuple[FloatArray, FloatArray]:
    """Return x and y in m of an entity if only the lateral motion of the coming step is made, shape (N,) each."""
    x, y = world.x[entity].copy(), world.y[entity].copy()
    for _, track, rows in world.iter_followed_tracks(entity, world.present[entity] & ~world.moved[entity]):
        x[rows], y[rows], _ = track.pose_at(world.distance[entity][rows], world.offset[entity][rows], rows)
    return x, y


def free_space_to_entity(world: World, entity: int, other: int, distance: FloatArray) -> FloatArray:
    """Return the free space in m between the bounding boxes of two entities, along the same line as `distance`.

    `distance` is that from the reference point of `entity` to the reference point of `other`, along a track or roads.
    Both values are negative if `other` is behind. The free space is 0 if the boxes touch or overlap.
    """
    own_box, other_box = world.entities[entity], world.entities[other]
    fronts = [0.5 * box.length + box.center_x for box in (own_box, other_box)]
    rears = [0.5 * box.length - box.center_x for box in (own_box, other_box)]
    return subtract_boxes_from_distance(distance, fronts[0] + rears[1], rears[0] + fronts[1])


def subtract_boxes_from_distance(distance: FloatArray, ahead: float, behind: float) -> FloatArray:
    """Return distances in m between reference points without the parts that lie inside bounding boxes.

    A positive distance (the other point is ahead) becomes shorter by `ahead` m, a negative one by `behind` m. The
    result is 0 if the boxes touch or overlap.
    """
    return np.where(distance > 0, np.maximum(distance - ahead, 0.0), np.minimum(distance + behind, 0.0))
