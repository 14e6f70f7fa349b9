"""Overlaps of bounding boxes."""

from __future__ import annotations

import numpy as np

from cornercase._common.geometry.boxes import box_corners
from cornercase._common.typing import FloatArray
from cornercase.simulators.builtin.world._world import World


def update_overlaps(world: World) -> None:
    """Update which bounding boxes overlap."""
    entities = range(len(world.entities))
    for a in entities:
        for b in entities[a + 1 :]:
            world.overlapping[a, b] = world.overlapping[b, a] = world.compiled.find_overlaps(a, b)


def all_box_corners(world: World) -> FloatArray:
    """Return the corners of all bounding boxes in m, shape (E, N, 4, 2)."""
    center_x = np.array([[entity.center_x] for entity in world.entities])
    length = np.array([[entity.length] for entity in world.entities])
    width = np.array([[entity.width] for entity in world.entities])
    x = world.x + center_x * np.cos(world.heading)
    y = world.y + center_x * np.sin(world.heading)
    return box_corners(x, y, world.heading, length, width)
