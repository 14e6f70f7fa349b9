"""Free space between boxes along and across their common road."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.simulators.builtin.tracks.track import Pose
from cornercase.simulators.builtin.world.contacts import entity_corners, overlap
from cornercase.simulators.builtin.world.state import World
from cornercase.simulators.builtin.world.whereabouts import lane_of, looks_along

# Each iteration reduces the error in s by the factor curvature times lateral distance.
_PASSES: Final = 6


def free_space_on_road(world: World, entity: int, other: int, lateral: bool, otherwise: FloatArray) -> FloatArray:
    """Smallest difference in s (or t if `lateral`) between the corners of two boxes in m, shape (N,).

    It is 0 if side by side, and `default` on different roads. s is positive ahead, t to the left of the road.
    """
    own_pose, other_pose = lane_of(world, entity), lane_of(world, other)
    if own_pose.road is None or other_pose.road is None:
        return otherwise
    corners = entity_corners(world)
    same_road = (own_pose.road == other_pose.road) & world.present[entity] & world.present[other]
    first, second = (
        _on_road(world, pose, corners[k], same_road, lateral) for k, pose in ((entity, own_pose), (other, other_pose))
    )
    differences = second[:, None, :] - first[:, :, None]
    if not lateral:
        differences *= _direction(world, own_pose)[:, None, None]
    # Side by side: a corner of one box is between corners of the other.
    behind = differences < 0.0
    abreast = (behind.any(axis=2) & ~behind.all(axis=2)).any(axis=1)
    flat = differences.reshape(world.scenarios, -1)
    smallest = flat[np.arange(world.scenarios), np.abs(flat).argmin(axis=1)]
    return np.where(same_road, np.where(abreast | overlap(world, entity, other), 0.0, smallest), otherwise)


def free_space_to_place(world: World, entity: int, place: Pose, lateral: bool, otherwise: FloatArray) -> FloatArray:
    """Smallest difference in s (or t if `lateral`) between the corners of a box and a point in m, (N,).

    It is 0 if side by side, and `default` on different roads. s is positive ahead, t to the left of the road.
    """
    own_pose = lane_of(world, entity)
    if own_pose.road is None or place.road is None or place.s is None:
        return otherwise
    same_road = (own_pose.road == place.road) & world.present[entity] & np.isfinite(place.x)
    first = _on_road(world, own_pose, entity_corners(world)[entity], same_road, lateral)
    point = np.stack([place.x, place.y], axis=-1)[:, None, :]
    differences = _on_road(world, place, point, same_road, lateral) - first
    if not lateral:
        differences *= _direction(world, own_pose)[:, None]
    row, size = np.arange(world.scenarios), np.abs(differences)
    smallest, largest = differences[row, size.argmin(axis=1)], differences[row, size.argmax(axis=1)]
    return np.where(same_road, np.where((smallest < 0.0) != (largest < 0.0), 0.0, smallest), otherwise)


def beside_on_road(world: World, entity: int, place: Pose, otherwise: FloatArray) -> FloatArray:
    """Difference in t from an entity to a point on its road in m, (N,), positive left; `default` on other roads."""
    own_pose = lane_of(world, entity)
    if own_pose.road is None or place.road is None or place.s is None:
        return otherwise
    same_road = (own_pose.road == place.road) & world.present[entity] & np.isfinite(place.x)
    own_t, t = (
        _on_road(world, pose, np.stack([pose.x, pose.y], axis=-1)[:, None, :], same_road, True)[:, 0]
        for pose in (own_pose, place)
    )
    return np.where(same_road, t - own_t, otherwise)


def _direction(world: World, pose: Pose) -> FloatArray:
    """1 if the heading of a pose is along s, else -1, shape (N,)."""
    return np.where(looks_along(world, pose), 1.0, -1.0)


def _on_road(world: World, pose: Pose, points: FloatArray, where: BoolArray, lateral: bool) -> FloatArray:
    """s, or t, of P points near a pose on the pose's road, shape (N, P); 0 outside the mask."""
    assert world.network is not None
    assert pose.road is not None
    assert pose.s is not None
    result = np.zeros(points.shape[:2])
    for number in np.unique(pose.road[where]):
        rows = np.flatnonzero(where & (pose.road == number))
        road, flat = world.network.roads[int(number)], points[rows].reshape(-1, 2)
        s = np.repeat(pose.s[rows], points.shape[1])
        t = np.zeros_like(s)
        for _ in range(_PASSES):
            x, y, heading = road.reference(s)
            dx, dy = flat[:, 0] - x, flat[:, 1] - y
            s, t = s + dx * np.cos(heading) + dy * np.sin(heading), dy * np.cos(heading) - dx * np.sin(heading)
        result[rows] = (t if lateral else s).reshape(len(rows), -1)
    return result
