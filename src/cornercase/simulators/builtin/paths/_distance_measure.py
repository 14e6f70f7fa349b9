"""Distances between entities in the coordinate systems of conditions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.geometry.boxes import box_corners
from cornercase._common.typing import FloatArray
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.tracks._track import Pose
from cornercase.simulators.builtin.world._collisions import do_boxes_overlap
from cornercase.simulators.builtin.world._entity_distances import (
    box_lengths_between_references,
    distance_ahead,
    distance_along_roads,
    distance_left,
    lateral_gap,
    longitudinal_gap,
    offset_of_entity,
    offset_of_point,
)
from cornercase.simulators.builtin.world._free_space import (
    free_space_to_entity_on_road,
    free_space_to_point_on_road,
    lateral_distance_on_road,
)
from cornercase.simulators.builtin.world._road_position import distance_ahead_on_road, road_pose
from cornercase.simulators.builtin.world._world import World


@dataclass(frozen=True)
class DistanceMeasure:
    """How a condition measures a distance.

    `kind`: euclidean, longitudinal or lateral. `along_road`: in road coordinates instead of the entity's.
    `is_free_space`: between boxes instead of reference points.
    """

    kind: str
    along_road: bool
    is_free_space: bool

    def measure_to_entity(self, world: World, e: int, other: int) -> FloatArray:
        """Signed distance in m to another entity, shape (N,); negative behind, and to the right if lateral."""
        if self.kind == "euclidean":
            if self.is_free_space:
                return np.where(longitudinal_gap(world, e, other) < 0.0, -1.0, 1.0) * _box_distance(world, e, other)
            sign = np.where(distance_ahead(world, e, other) > 0.0, 1.0, -1.0)
            return np.asarray(sign * _distance_to_point(world, e, world.x[other], world.y[other]))
        if self.kind == "lateral":
            if self.along_road:
                position = road_pose(world, other)
                is_linked = np.isfinite(distance_along_roads(world, e, position))
                offset = np.where(is_linked, offset_of_entity(world, e, other) - world.offset[e], np.inf)
                half = 0.5 * (world.entities[e].width + world.entities[other].width)
                if not self.is_free_space:
                    return lateral_distance_on_road(world, e, position, offset)
                narrowed = np.sign(offset) * np.maximum(np.abs(offset) - half, 0.0)
                return free_space_to_entity_on_road(world, e, other, True, narrowed)
            return lateral_gap(world, e, other) if self.is_free_space else distance_left(world, e, other)
        if self.along_road:
            position = road_pose(world, other)
            distance = distance_ahead_on_road(world, e, position, distance_along_roads(world, e, position))
            if not self.is_free_space:
                return distance
            ahead, behind = box_lengths_between_references(world, e, other)
            shortened = np.where(distance > 0, np.maximum(distance - ahead, 0.0), np.minimum(distance + behind, 0.0))
            return free_space_to_entity_on_road(world, e, other, False, shortened)
        return longitudinal_gap(world, e, other) if self.is_free_space else distance_ahead(world, e, other)

    def measure_to_point(self, world: World, e: int, pose: Pose) -> FloatArray:
        """Signed distance in m to a point, shape (N,); negative behind, and to the right if lateral."""
        entity = world.entities[e]
        front, rear = 0.5 * entity.length + entity.center_x, 0.5 * entity.length - entity.center_x
        dx, dy = pose.x - world.x[e], pose.y - world.y[e]
        if self.kind == "euclidean":
            cos, sin = np.cos(world.heading[e]), np.sin(world.heading[e])
            along, across = dx * cos + dy * sin, dy * cos - dx * sin
            if not self.is_free_space:
                return np.where(along > 0.0, np.hypot(dx, dy), -np.hypot(dx, dy))
            along = along - entity.center_x
            beyond = np.maximum(np.abs(along) - 0.5 * entity.length, 0.0)
            sign = np.where(along < -0.5 * entity.length, -1.0, 1.0)
            return np.asarray(sign * np.hypot(beyond, np.maximum(np.abs(across) - 0.5 * entity.width, 0.0)))
        cos, sin = np.cos(world.heading[e]), np.sin(world.heading[e])
        if self.kind == "lateral":
            across = dy * cos - dx * sin
            if self.along_road:
                is_linked = np.isfinite(distance_along_roads(world, e, pose))
                across = np.where(is_linked, offset_of_point(world, e, pose.x, pose.y) - world.offset[e], np.inf)
            result = np.asarray(
                np.sign(across) * np.maximum(np.abs(across) - 0.5 * entity.width * self.is_free_space, 0.0)
            )
            if not self.along_road:
                return result
            return (
                free_space_to_point_on_road(world, e, pose, True, result)
                if self.is_free_space
                else lateral_distance_on_road(world, e, pose, result)
            )
        distance = dx * cos + dy * sin
        if self.along_road:
            distance = distance_ahead_on_road(world, e, pose, distance_along_roads(world, e, pose))
        if self.is_free_space:
            distance = np.where(distance > 0, np.maximum(distance - front, 0.0), np.minimum(distance + rear, 0.0))
            distance = free_space_to_point_on_road(world, e, pose, False, distance) if self.along_road else distance
        return np.asarray(distance)


def read_distance_measure(element: etree._Element, scope: Scope) -> DistanceMeasure:
    """Read how an element's distance is measured; `InputError` for an unknown system or type."""
    kind = scope.read_text(element, "relativeDistanceType", "euclidianDistance")
    system = scope.read_text(element, "coordinateSystem", "entity")
    kinds = {
        "euclidianDistance": "euclidean", "cartesianDistance": "euclidean",
        "longitudinal": "longitudinal", "lateral": "lateral",
    }  # fmt: skip
    if kind not in kinds or system not in ("entity", "lane", "road", "trajectory", "world"):
        raise InputError(
            f"{scope.file_name}, line {element.sourceline}: <{element.tag}>: a distance of type '{kind}' in the system"
            f" '{system}' does not exist; use euclidianDistance, longitudinal or lateral in entity, lane, road or"
            " trajectory."
        )
    if system in ("trajectory", "world") and kinds[kind] != "euclidean":
        raise InputError(
            f"{scope.file_name}, line {element.sourceline}: <{element.tag}>: a {kind} distance in the system '{system}'"
            " cannot be measured; use entity, lane or road."
        )
    return DistanceMeasure(kinds[kind], system in ("lane", "road"), scope.read_boolean(element, "freespace", False))


def _distance_to_point(world: World, e: int, x: FloatArray, y: FloatArray) -> FloatArray:
    return np.asarray(np.hypot(x - world.x[e], y - world.y[e]))


def _box_distance(world: World, e: int, other: int) -> FloatArray:
    corners_a, corners_b = (_entity_corners(world, k) for k in (e, other))
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
    return np.where(do_boxes_overlap(world, e, other), 0.0, smallest)


def _entity_corners(world: World, e: int) -> FloatArray:
    entity = world.entities[e]
    x = world.x[e] + entity.center_x * np.cos(world.heading[e])
    y = world.y[e] + entity.center_x * np.sin(world.heading[e])
    return box_corners(x, y, world.heading[e], np.array(entity.length), np.array(entity.width))
