"""Which entities' boxes overlap."""

from __future__ import annotations

import numpy as np

from cornercase._common.geometry import box_corners, boxes_overlap
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.simulators.builtin.world.state import World


def find_contacts(world: World) -> None:
    """Update which boxes overlap.

    Parameters
    ----------
    world : World
    """
    for a in range(len(world.entities)):
        for b in range(a + 1, len(world.entities)):
            world.touching[a, b] = world.touching[b, a] = overlap(world, a, b)


def overlap(world: World, first: int, second: int) -> BoolArray:
    """Whether the boxes of two entities overlap as they stand now, also in the middle of a step, shape (N,).

    Parameters
    ----------
    world : World
    first, second : int
        Rows of the entities.

    Returns
    -------
    ndarray of bool, shape (N,)
    """
    pair = [first, second]
    length, width, ahead = (
        np.array([[getattr(world.entities[e], name)] for e in pair]) for name in ("length", "width", "center_x")
    )
    heading = world.heading[pair]
    x = np.where(world.present[pair], world.x[pair] + ahead * np.cos(heading), np.nan)
    y = np.where(world.present[pair], world.y[pair] + ahead * np.sin(heading), np.nan)
    result = np.zeros(world.scenarios, dtype=np.bool_)
    near = np.flatnonzero(np.hypot(x[0] - x[1], y[0] - y[1]) <= 0.5 * np.hypot(length, width).sum())
    if near.size:
        result[near] = boxes_overlap(*box_corners(x[:, near], y[:, near], heading[:, near], length, width))
    return result


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
