"""Distances between entities in the coordinate systems of conditions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.geometry import box_corners
from cornercase._common.typing import FloatArray
from cornercase.scenario import Scope
from cornercase.simulators.builtin.tracks.track import Pose
from cornercase.simulators.builtin.world.contacts import overlap
from cornercase.simulators.builtin.world.free_space import beside_on_road, free_space_on_road, free_space_to_place
from cornercase.simulators.builtin.world.gaps import (
    along_roads,
    distance_ahead,
    distance_beside,
    lateral_gap,
    longitudinal_gap,
    longitudinal_reach,
    offset_from,
    offset_of,
)
from cornercase.simulators.builtin.world.state import World
from cornercase.simulators.builtin.world.whereabouts import ahead_on_road, lane_of


@dataclass(frozen=True)
class Gap:
    """How a condition measures a distance.

    `kind`: euclidean, longitudinal or lateral. `along_road`: in road coordinates instead of the entity's.
    `is_free_space`: between boxes instead of reference points.
    """

    kind: str
    along_road: bool
    free: bool

    def to_entity(self, world: World, e: int, other: int) -> FloatArray:
        """Signed distance in m to another entity, shape (N,); negative behind, and to the right if lateral."""
        if self.kind == "euclidean":
            if self.free:
                return np.where(longitudinal_gap(world, e, other) < 0.0, -1.0, 1.0) * _free_distance(world, e, other)
            sign = np.where(distance_ahead(world, e, other) > 0.0, 1.0, -1.0)
            return np.asarray(sign * _distance(world, e, world.x[other], world.y[other]))
        if self.kind == "lateral":
            if self.along_road:
                position = lane_of(world, other)
                is_linked = np.isfinite(along_roads(world, e, position))
                offset = np.where(is_linked, offset_from(world, e, other) - world.offset[e], np.inf)
                half = 0.5 * (world.entities[e].width + world.entities[other].width)
                if not self.free:
                    return beside_on_road(world, e, position, offset)
                narrowed = np.sign(offset) * np.maximum(np.abs(offset) - half, 0.0)
                return free_space_on_road(world, e, other, True, narrowed)
            return lateral_gap(world, e, other) if self.free else distance_beside(world, e, other)
        if self.along_road:
            position = lane_of(world, other)
            distance = ahead_on_road(world, e, position, along_roads(world, e, position))
            if not self.free:
                return distance
            ahead, behind = longitudinal_reach(world, e, other)
            shortened = np.where(distance > 0, np.maximum(distance - ahead, 0.0), np.minimum(distance + behind, 0.0))
            return free_space_on_road(world, e, other, False, shortened)
        return longitudinal_gap(world, e, other) if self.free else distance_ahead(world, e, other)

    def to_place(self, world: World, e: int, pose: Pose) -> FloatArray:
        """Signed distance in m to a point, shape (N,); negative behind, and to the right if lateral."""
        entity = world.entities[e]
        front, rear = 0.5 * entity.length + entity.center_x, 0.5 * entity.length - entity.center_x
        dx, dy = pose.x - world.x[e], pose.y - world.y[e]
        if self.kind == "euclidean":
            cos, sin = np.cos(world.heading[e]), np.sin(world.heading[e])
            along, across = dx * cos + dy * sin, dy * cos - dx * sin
            if not self.free:
                return np.where(along > 0.0, np.hypot(dx, dy), -np.hypot(dx, dy))
            along = along - entity.center_x
            beyond = np.maximum(np.abs(along) - 0.5 * entity.length, 0.0)
            sign = np.where(along < -0.5 * entity.length, -1.0, 1.0)
            return np.asarray(sign * np.hypot(beyond, np.maximum(np.abs(across) - 0.5 * entity.width, 0.0)))
        cos, sin = np.cos(world.heading[e]), np.sin(world.heading[e])
        if self.kind == "lateral":
            across = dy * cos - dx * sin
            if self.along_road:
                is_linked = np.isfinite(along_roads(world, e, pose))
                across = np.where(is_linked, offset_of(world, e, pose.x, pose.y) - world.offset[e], np.inf)
            result = np.asarray(np.sign(across) * np.maximum(np.abs(across) - 0.5 * entity.width * self.free, 0.0))
            if not self.along_road:
                return result
            return (
                free_space_to_place(world, e, pose, True, result)
                if self.free
                else beside_on_road(world, e, pose, result)
            )
        distance = dx * cos + dy * sin
        if self.along_road:
            distance = ahead_on_road(world, e, pose, along_roads(world, e, pose))
        if self.free:
            distance = np.where(distance > 0, np.maximum(distance - front, 0.0), np.minimum(distance + rear, 0.0))
            distance = free_space_to_place(world, e, pose, False, distance) if self.along_road else distance
        return np.asarray(distance)


def read_gap(element: etree._Element, scope: Scope) -> Gap:
    """Read how an element's distance is measured; `InputError` for an unknown system or type."""
    kind = scope.text(element, "relativeDistanceType", "euclidianDistance")
    system = scope.text(element, "coordinateSystem", "entity")
    kinds = {
        "euclidianDistance": "euclidean", "cartesianDistance": "euclidean",
        "longitudinal": "longitudinal", "lateral": "lateral",
    }  # fmt: skip
    if kind not in kinds or system not in ("entity", "lane", "road", "trajectory", "world"):
        raise InputError(
            f"{scope.source}, line {element.sourceline}: <{element.tag}>: a distance of type '{kind}' in the system"
            f" '{system}' does not exist; use euclidianDistance, longitudinal or lateral in entity, lane, road or"
            " trajectory."
        )
    if system in ("trajectory", "world") and kinds[kind] != "euclidean":
        raise InputError(
            f"{scope.source}, line {element.sourceline}: <{element.tag}>: a {kind} distance in the system '{system}'"
            " cannot be measured; use entity, lane or road."
        )
    return Gap(kinds[kind], system in ("lane", "road"), scope.flag(element, "freespace", False))


def _distance(world: World, e: int, x: FloatArray, y: FloatArray) -> FloatArray:
    return np.asarray(np.hypot(x - world.x[e], y - world.y[e]))


def _free_distance(world: World, e: int, other: int) -> FloatArray:
    corners_a, corners_b = (_corners(world, k) for k in (e, other))
    smallest = np.full(world.scenarios, np.inf)
    for points, box in ((corners_a, corners_b), (corners_b, corners_a)):
        for k in range(4):
            a, b = box[:, k], box[:, (k + 1) % 4]
            edge = b - a
            length = np.maximum((edge**2).sum(axis=1), 1e-12)
            for p in range(4):
                fraction = np.clip(((points[:, p] - a) * edge).sum(axis=1) / length, 0.0, 1.0)
                nearest = a + fraction[:, None] * edge
                smallest = np.minimum(smallest, np.hypot(*(points[:, p] - nearest).T))
    return np.where(overlap(world, e, other), 0.0, smallest)


def _corners(world: World, e: int) -> FloatArray:
    entity = world.entities[e]
    x = world.x[e] + entity.center_x * np.cos(world.heading[e])
    y = world.y[e] + entity.center_x * np.sin(world.heading[e])
    return box_corners(x, y, world.heading[e], np.array(entity.length), np.array(entity.width))
