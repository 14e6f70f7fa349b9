"""Free space between bounding boxes on the same road, along and across the road."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.simulators.builtin.tracks._track import Pose
from cornercase.simulators.builtin.world._road_position import is_heading_along_road, road_pose
from cornercase.simulators.builtin.world._world import World

# Each iteration reduces the error in s by the factor curvature times lateral distance.
_MAX_ITERATIONS: Final = 6


def free_space_to_entity_on_road(
    world: World, entity: int, other: int, lateral: bool, default: FloatArray
) -> FloatArray:
    """Return the smallest difference in s (or in t if `lateral`) between the corners of two boxes, in m, shape (N,).

    The difference is 0 if the boxes overlap, or if a corner of the own box is beside the other box (ahead of it or
    behind it if `lateral`), and `default` if they are on different roads. It is positive if the other entity is ahead,
    or to the left (seen along s) if `lateral`.
    """
    own_pose, other_pose = road_pose(world, entity), road_pose(world, other)
    if own_pose.road is None or other_pose.road is None:
        return default
    corners = world.box_corners()
    same_road = (own_pose.road == other_pose.road) & world.present[entity] & world.present[other]
    first, second = (
        _project_onto_road(world, pose, corners[k], same_road, lateral)
        for k, pose in ((entity, own_pose), (other, other_pose))
    )
    differences = second[:, None, :] - first[:, :, None]
    if not lateral:
        differences *= _sign_along_road(world, own_pose)[:, None, None]
    # As in esmini, corners of the other box between those of the own box do not count.
    behind = differences < 0.0
    abreast = (behind.any(axis=2) & ~behind.all(axis=2)).any(axis=1)
    flat = differences.reshape(world.scenarios, -1)
    smallest = flat[np.arange(world.scenarios), np.abs(flat).argmin(axis=1)]
    return np.where(same_road, np.where(abreast | world.compiled.find_overlaps(entity, other), 0.0, smallest), default)


def free_space_to_point_on_road(
    world: World, entity: int, target: Pose, lateral: bool, default: FloatArray
) -> FloatArray:
    """Return the smallest difference in s (or in t if `lateral`) between the corners of a box and a point, in m, (N,).

    The difference is 0 if the point is beside the box (ahead of it or behind it if `lateral`), and `default` if it is
    on another road. It is positive if the point is ahead, or to the left (seen along s) if `lateral`.
    """
    own_pose = road_pose(world, entity)
    if own_pose.road is None or target.road is None or target.s is None:
        return default
    same_road = (own_pose.road == target.road) & world.present[entity] & np.isfinite(target.x)
    first = _project_onto_road(world, own_pose, world.box_corners()[entity], same_road, lateral)
    point = np.stack([target.x, target.y], axis=-1)[:, None, :]
    differences = _project_onto_road(world, target, point, same_road, lateral) - first
    if not lateral:
        differences *= _sign_along_road(world, own_pose)[:, None]
    row, size = np.arange(world.scenarios), np.abs(differences)
    smallest, largest = differences[row, size.argmin(axis=1)], differences[row, size.argmax(axis=1)]
    return np.where(same_road, np.where((smallest < 0.0) != (largest < 0.0), 0.0, smallest), default)


def lateral_distance_on_road(world: World, entity: int, target: Pose, default: FloatArray) -> FloatArray:
    """Return the difference in t from an entity to a point in m, shape (N,); positive to the left, seen along s.

    The difference is `default` if the point is on another road.
    """
    own_pose = road_pose(world, entity)
    if own_pose.road is None or target.road is None or target.s is None:
        return default
    same_road = (own_pose.road == target.road) & world.present[entity] & np.isfinite(target.x)
    own_t, t = (
        _project_onto_road(world, pose, np.stack([pose.x, pose.y], axis=-1)[:, None, :], same_road, True)[:, 0]
        for pose in (own_pose, target)
    )
    return np.where(same_road, t - own_t, default)


def _sign_along_road(world: World, pose: Pose) -> FloatArray:
    """Return 1 if the heading of a pose is along s on its road, otherwise -1, shape (N,)."""
    return np.where(is_heading_along_road(world, pose), 1.0, -1.0)


def _project_onto_road(world: World, pose: Pose, points: FloatArray, where: BoolArray, lateral: bool) -> FloatArray:
    """Return the road coordinate s (or t if `lateral`) of P points in m, shape (N, P); 0 outside the mask.

    The coordinate is that on the road of the pose, near which the points must be.
    """
    assert world.network is not None
    roads, _, s_of_pose = pose.road_coordinates()
    result = np.zeros(points.shape[:2])
    for number in np.unique(roads[where]):
        rows = np.flatnonzero(where & (roads == number))
        road, flat = world.network.roads[int(number)], points[rows].reshape(-1, 2)
        s = np.repeat(s_of_pose[rows], points.shape[1])
        t = np.zeros_like(s)
        for _ in range(_MAX_ITERATIONS):
            x, y, heading = road.reference_pose(s)
            dx, dy = flat[:, 0] - x, flat[:, 1] - y
            s, t = s + dx * np.cos(heading) + dy * np.sin(heading), dy * np.cos(heading) - dx * np.sin(heading)
        result[rows] = (t if lateral else s).reshape(len(rows), -1)
    return result
