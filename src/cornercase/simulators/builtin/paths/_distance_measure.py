"""Distances between entities, in the coordinate systems that conditions can name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.typing import FloatArray
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.kernels._distances import (
    EUCLIDEAN_DISTANCE,
    FREE_SPACE,
    LATERAL_DISTANCE,
    LONGITUDINAL_DISTANCE,
)
from cornercase.simulators.builtin.tracks._track import Pose
from cornercase.simulators.builtin.world._entity_distances import (
    distance_along_roads,
    free_space_to_entity,
    offset_of_entity,
    offset_of_point,
    subtract_boxes_from_distance,
)
from cornercase.simulators.builtin.world._free_space import (
    free_space_to_entity_on_road,
    free_space_to_point_on_road,
    lateral_distance_on_road,
)
from cornercase.simulators.builtin.world._road_position import distance_ahead_on_road, road_pose
from cornercase.simulators.builtin.world._world import World

_KERNEL_KINDS: Final = {
    "euclidean": EUCLIDEAN_DISTANCE, "longitudinal": LONGITUDINAL_DISTANCE, "lateral": LATERAL_DISTANCE,
}  # fmt: skip


@dataclass(frozen=True)
class DistanceMeasure:
    """Method by which a condition measures a distance.

    `kind` is euclidean, longitudinal or lateral. `along_road`: True for road coordinates, False for the axes of the
    entity. `is_free_space`: True for distances between bounding boxes, False for distances between reference points.
    """

    kind: str
    along_road: bool
    is_free_space: bool

    def measure_to_entity(self, world: World, e: int, other: int) -> FloatArray:
        """Return the signed distance in m from entity `e` to another entity, shape (N,).

        The distance is negative if the other entity is behind, or to the right for a lateral distance. In road
        coordinates, right is seen along s if both entities are on the same road.
        """
        if (kernel_kind := self.kernel_kind(to_entity=True)) is not None:
            return world.compiled.measure_to_entity(e, other, kernel_kind)
        if self.kind == "euclidean":
            is_behind = world.compiled.measure_to_entity(e, other, LONGITUDINAL_DISTANCE + FREE_SPACE) < 0.0
            return np.where(is_behind, -1.0, 1.0) * _box_distance(world, e, other)
        position = road_pose(world, other)
        if self.kind == "lateral":
            is_linked = np.isfinite(distance_along_roads(world, e, position))
            offset = np.where(is_linked, offset_of_entity(world, e, other) - world.offset[e], np.inf)
            half = 0.5 * (world.entities[e].width + world.entities[other].width)
            if not self.is_free_space:
                return lateral_distance_on_road(world, e, position, offset)
            narrowed = np.sign(offset) * np.maximum(np.abs(offset) - half, 0.0)
            return free_space_to_entity_on_road(world, e, other, True, narrowed)
        distance = distance_ahead_on_road(world, e, position, distance_along_roads(world, e, position))
        if not self.is_free_space:
            return distance
        return free_space_to_entity_on_road(world, e, other, False, free_space_to_entity(world, e, other, distance))

    def measure_to_point(self, world: World, e: int, pose: Pose) -> FloatArray:
        """Return the signed distance in m from entity `e` to a point, shape (N,).

        The distance is negative if the point is behind, or to the right for a lateral distance. In road coordinates,
        right is seen along s if entity and point are on the same road.
        """
        if (kernel_kind := self.kernel_kind(to_entity=False)) is not None:
            return world.compiled.measure_to_point(e, pose.x, pose.y, kernel_kind)
        entity, along_roads = world.entities[e], distance_along_roads(world, e, pose)
        if self.kind == "lateral":
            offset = offset_of_point(world, e, pose.x, pose.y) - world.offset[e]
            across = np.where(np.isfinite(along_roads), offset, np.inf)
            if not self.is_free_space:
                return lateral_distance_on_road(world, e, pose, across)
            narrowed = np.sign(across) * np.maximum(np.abs(across) - 0.5 * entity.width, 0.0)
            return free_space_to_point_on_road(world, e, pose, True, narrowed)
        distance = distance_ahead_on_road(world, e, pose, along_roads)
        if not self.is_free_space:
            return distance
        front, rear = 0.5 * entity.length + entity.center_x, 0.5 * entity.length - entity.center_x
        return free_space_to_point_on_road(world, e, pose, False, subtract_boxes_from_distance(distance, front, rear))

    def kernel_kind(self, *, to_entity: bool) -> int | None:
        """Return the number by which kernels know this kind of distance; None if only Python can measure it."""
        is_euclidean = self.kind == "euclidean"
        if (self.along_road and not is_euclidean) or (to_entity and self.is_free_space and is_euclidean):
            return None
        return _KERNEL_KINDS[self.kind] + FREE_SPACE * self.is_free_space


def read_distance_measure(element: etree._Element, scope: Scope) -> DistanceMeasure:
    """Read from the attributes of an element how a distance is measured.

    Raises `InputError` for an unknown coordinate system or distance type.
    """
    kind = scope.read_text(element, "relativeDistanceType", "euclidianDistance")
    system = scope.read_text(element, "coordinateSystem", "entity")
    kinds = {
        "euclidianDistance": "euclidean", "cartesianDistance": "euclidean",
        "longitudinal": "longitudinal", "lateral": "lateral",
    }  # fmt: skip
    if kind not in kinds or system not in ("entity", "lane", "road", "trajectory", "world"):
        raise scope.error_at(
            element,
            f"<{element.tag}>: there is no distance of type '{kind}' in the coordinate system '{system}'; use"
            " euclidianDistance, longitudinal or lateral, and the system entity, lane, road or trajectory.",
        )
    if system in ("trajectory", "world") and kinds[kind] != "euclidean":
        raise scope.error_at(
            element,
            f"<{element.tag}>: a {kind} distance in the system '{system}'"
            " cannot be measured; use entity, lane or road.",
        )
    return DistanceMeasure(kinds[kind], system in ("lane", "road"), scope.read_boolean(element, "freespace", False))


def _box_distance(world: World, e: int, other: int) -> FloatArray:
    corners_a, corners_b = world.box_corners()[[e, other]]
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
    return np.where(world.compiled.find_overlaps(e, other), 0.0, smallest)
