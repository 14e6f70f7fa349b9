"""Overlaps of bounding boxes."""

from __future__ import annotations

import numpy as np

from cornercase._common.geometry.boxes import box_corners, boxes_overlap
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.simulators.builtin.world._world import World


def update_overlaps(world: World) -> None:
    """Update which boxes overlap."""
    entities = list(range(len(world.entities)))
    x, y = _box_centers(world, entities)
    for a in entities:
        for b in entities[a + 1 :]:
            world.overlapping[a, b] = world.overlapping[b, a] = _do_pair_boxes_overlap(
                world, [a, b], x[[a, b]], y[[a, b]]
            )


def do_boxes_overlap(world: World, first: int, second: int) -> BoolArray:
    """Check whether the boxes of two entities overlap now, also within a step, shape (N,)."""
    pair = [first, second]
    return _do_pair_boxes_overlap(world, pair, *_box_centers(world, pair))


def _box_centers(world: World, entities: list[int]) -> tuple[FloatArray, FloatArray]:
    """Centres of the boxes of K entities, each (K, N) in m; NaN if absent."""
    center_x = np.array([[world.entities[e].center_x] for e in entities])
    heading, is_present = world.heading[entities], world.present[entities]
    x, y = world.x[entities] + center_x * np.cos(heading), world.y[entities] + center_x * np.sin(heading)
    return np.where(is_present, x, np.nan), np.where(is_present, y, np.nan)


def _do_pair_boxes_overlap(world: World, pair: list[int], x: FloatArray, y: FloatArray) -> BoolArray:
    """Check whether the boxes of two entities with centres (2, N) overlap, shape (N,)."""
    length = np.array([[world.entities[e].length] for e in pair])
    width = np.array([[world.entities[e].width] for e in pair])
    result = np.zeros(world.scenarios, dtype=np.bool_)
    near = np.flatnonzero(np.hypot(x[0] - x[1], y[0] - y[1]) <= 0.5 * np.hypot(length, width).sum())
    if near.size:
        heading = world.heading[pair][:, near]
        result[near] = boxes_overlap(*box_corners(x[:, near], y[:, near], heading, length, width))
    return result


def all_box_corners(world: World) -> FloatArray:
    """Corners of all boxes in m, shape (E, N, 4, 2)."""
    center_x = np.array([[entity.center_x] for entity in world.entities])
    length = np.array([[entity.length] for entity in world.entities])
    width = np.array([[entity.width] for entity in world.entities])
    x = world.x + center_x * np.cos(world.heading)
    y = world.y + center_x * np.sin(world.heading)
    return box_corners(x, y, world.heading, length, width)
