"""Distances between entities along and across their headings, tracks and roads."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.tracks._lane import LaneTrack
from cornercase.simulators.builtin.tracks._track import Pose, Track
from cornercase.simulators.builtin.world._collisions import all_box_corners
from cornercase.simulators.builtin.world._road_position import is_heading_along_road, road_pose
from cornercase.simulators.builtin.world._world import World

# Largest distance in m of a target from its track.
_MAX_TRACK_DISTANCE: Final = 20.0


class TargetCache(NamedTuple):
    """Cache of a fixed target's position on the entity's track: track number, and distance in m, each (N,).

    The distance is infinite if the track does not lead to the target, and NaN if not computed yet.
    """

    track: FloatArray
    distance: FloatArray


def remaining_distance(world: World, entity: int, target: Pose, cache: TargetCache, where: BoolArray) -> FloatArray:
    """Distance along the entity's track to a target in m, shape (N,); negative once passed.

    A trajectory leads to its point nearest to the target. Without a track that leads there: the straight-line distance.
    Results are added to `cache`.
    """
    distance = np.full(world.scenarios, np.inf)
    for k, track, rows in world.iter_followed_tracks(entity, where & np.isfinite(target.x + target.y)):
        new = rows[(cache.track[rows] != k) | np.isnan(cache.distance[rows])]
        if new.size:
            cache.track[new], cache.distance[new] = (
                k,
                _distance_on_track(world, entity, track, target, new, allow_any_lateral=True),
            )
        distance[rows] = cache.distance[rows] - world.distance[entity][rows]
    straight_line = np.hypot(target.x - world.x[entity], target.y - world.y[entity])
    return np.where(np.isfinite(distance), distance, straight_line)


def distance_along_roads(world: World, entity: int, target: Pose) -> FloatArray:
    """Distance to a target along the track, else along roads, in m, (N,).

    Negative behind the entity, infinite if no road connects them.
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
    """Distance along a track to a target in m, shape (R,); infinite if the track does not lead there.

    With `allow_any_lateral`, a trajectory leads to targets at any lateral distance.
    """
    along = track.nearest_distance(target.x[rows], target.y[rows], rows, world.distance[entity][rows])
    x, y, _ = track.pose_at(along, np.zeros(len(rows)), rows)
    near = np.hypot(x - target.x[rows], y - target.y[rows]) < _MAX_TRACK_DISTANCE
    return np.where(near | (allow_any_lateral and not isinstance(track, LaneTrack)), along, np.inf)


def offset_of_entity(world: World, entity: int, other: int) -> FloatArray:
    """Offset of another entity from this one's track in m, shape (N,); positive to the left."""
    is_present, (x, y) = world.present[other], _position_after_lateral_step(world, other)
    return offset_of_point(world, entity, np.where(is_present, x, np.nan), np.where(is_present, y, np.nan))


def offset_of_point(world: World, entity: int, x: FloatArray, y: FloatArray) -> FloatArray:
    """Offset of a point (m, NaN if none) from an entity's track in m, shape (N,); positive to the left.

    It is measured across the entity's heading if it follows no track.
    """
    cos, sin = np.cos(world.heading[entity]), np.sin(world.heading[entity])
    result = (y - world.y[entity]) * cos - (x - world.x[entity]) * sin + world.offset[entity]
    for _, track, rows in world.iter_followed_tracks(entity, np.isfinite(x)):
        along = track.nearest_distance(x[rows], y[rows], rows)
        at_x, at_y, heading = track.pose_at(along, np.zeros(len(rows)), rows)
        result[rows] = (y[rows] - at_y) * np.cos(heading) - (x[rows] - at_x) * np.sin(heading)
    return np.asarray(result)


def _position_after_lateral_step(world: World, entity: int) -> tuple[FloatArray, FloatArray]:
    """Position of an entity after the lateral motion of the coming step, each (N,)."""
    x, y = world.x[entity].copy(), world.y[entity].copy()
    for _, track, rows in world.iter_followed_tracks(entity, world.present[entity] & ~world.moved[entity]):
        x[rows], y[rows], _ = track.pose_at(world.distance[entity][rows], world.offset[entity][rows], rows)
    return x, y


def distance_ahead(world: World, entity: int, other: int) -> FloatArray:
    """Distance in m to another reference point along the entity's heading, shape (N,); negative behind."""
    dx, dy = world.x[other] - world.x[entity], world.y[other] - world.y[entity]
    return np.asarray(dx * np.cos(world.heading[entity]) + dy * np.sin(world.heading[entity]))


def distance_left(world: World, entity: int, other: int) -> FloatArray:
    """Distance in m to another reference point across the entity's heading, shape (N,); positive to the left."""
    dx, dy = world.x[other] - world.x[entity], world.y[other] - world.y[entity]
    return np.asarray(dy * np.cos(world.heading[entity]) - dx * np.sin(world.heading[entity]))


def longitudinal_gap(world: World, entity: int, other: int) -> FloatArray:
    """Signed gap in m to another box along the entity's heading, shape (N,); 0 if side by side."""
    near, far, _, _ = relative_box_extent(world, entity, other)
    half = 0.5 * world.entities[entity].length
    return np.where(near > half, near - half, np.where(far < -half, far + half, 0.0))


def lateral_gap(world: World, entity: int, other: int) -> FloatArray:
    """Signed gap in m to another box across the entity's heading, (N,); positive to the left, 0 if overlapping."""
    _, _, near, far = relative_box_extent(world, entity, other)
    half = 0.5 * world.entities[entity].width
    return np.where(near > half, near - half, np.where(far < -half, far + half, 0.0))


def box_lengths_between_references(world: World, entity: int, other: int) -> tuple[float, float]:
    """Box lengths between two reference points in m: with the other ahead, and with it behind."""
    own_box, other_box = world.entities[entity], world.entities[other]
    fronts = [0.5 * box.length + box.center_x for box in (own_box, other_box)]
    rears = [0.5 * box.length - box.center_x for box in (own_box, other_box)]
    return fronts[0] + rears[1], rears[0] + fronts[1]


def relative_box_extent(world: World, entity: int, other: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Range of another box relative to an entity's centre in m: min and max ahead, min and max left, each (N,)."""
    corners = all_box_corners(world)[other]
    box = world.entities[entity]
    cos, sin = np.cos(world.heading[entity]), np.sin(world.heading[entity])
    x = corners[..., 0] - (world.x[entity] + box.center_x * cos)[:, None]
    y = corners[..., 1] - (world.y[entity] + box.center_x * sin)[:, None]
    longitudinal, lateral = x * cos[:, None] + y * sin[:, None], y * cos[:, None] - x * sin[:, None]
    return longitudinal.min(axis=1), longitudinal.max(axis=1), lateral.min(axis=1), lateral.max(axis=1)
