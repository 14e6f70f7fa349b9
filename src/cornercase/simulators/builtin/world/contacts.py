"""Which entities' boxes overlap."""

from __future__ import annotations

import numpy as np

from cornercase._common.geometry import box_corners, boxes_overlap
from cornercase._common.typing import FloatArray
from cornercase.simulators.builtin.world.state import World


def find_contacts(world: World) -> None:
    """Update which boxes overlap.

    Parameters
    ----------
    world : World
    """
    ahead = np.array([[entity.center_x] for entity in world.entities])
    x = np.where(world.present, world.x + ahead * np.cos(world.heading), np.nan)
    y = np.where(world.present, world.y + ahead * np.sin(world.heading), np.nan)
    reach = [0.5 * float(np.hypot(entity.length, entity.width)) for entity in world.entities]
    corners = None
    for a in range(len(world.entities)):
        for b in range(a + 1, len(world.entities)):
            gap = np.hypot(x[a] - x[b], y[a] - y[b])
            near = np.flatnonzero(gap <= reach[a] + reach[b])
            world.touching[a, b] = False
            if near.size:
                corners = entity_corners(world) if corners is None else corners
                world.touching[a, b, near] = boxes_overlap(corners[a][near], corners[b][near])
            world.touching[b, a] = world.touching[a, b]


def entity_corners(world: World) -> FloatArray:
    """Corners of all boxes, shape (E, N, 4, 2).

    Parameters
    ----------
    world : World

    Returns
    -------
    ndarray of float64, shape (E, N, 4, 2)
        m.
    """
    ahead = np.array([[entity.center_x] for entity in world.entities])
    length = np.array([[entity.length] for entity in world.entities])
    width = np.array([[entity.width] for entity in world.entities])
    x = world.x + ahead * np.cos(world.heading)
    y = world.y + ahead * np.sin(world.heading)
    return box_corners(x, y, world.heading, length, width)
