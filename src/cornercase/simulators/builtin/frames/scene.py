"""State and recordings of a batch, as arrays for compiled code."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.world.state import World

LENGTH, WIDTH, CENTER_X, MAX_SPEED, MAX_ACCELERATION, MAX_DECELERATION, REACH = range(7)
"""Constant properties of an entity: columns of `dimensions`. The last is how far the box reaches from the pose."""

QUANTITIES: Final = ("x", "y", "heading", "speed", "acceleration")
"""Recorded quantities of an entity, in this order."""

PAGE: Final = 32
"""Number of frames of a page."""


class Scene(NamedTuple):
    """State of E entities in N scenarios, and their recordings, stored in pages of 32 instants."""

    floats: FloatArray  # (N, K, E): the world's table; rows as in `world/layout.py`
    flags: BoolArray  # (N, K, E)
    numbers: IntArray  # (N, K, E)
    overlaps: BoolArray  # (N, E, E)
    time: FloatArray  # (N,), s
    last_step: FloatArray  # (N,), s
    boxes: FloatArray  # (E, 7): columns as above, in m and s
    tows: FloatArray  # (T, 4): rows of vehicle and trailer; hitch and coupler in m
    frames: IntArray  # (N,): number of recorded frames
    pages: FloatArray  # (P, 5, E, 32): recorded quantities; NaN for absent entities
    page: IntArray  # (N, R): pages of each scenario; R pages hold the maximum duration, P = R N
    taken: IntArray  # (N,): number of pages in use, at the first of the scenarios that run together
    collided: FloatArray  # (N, E, E): time in s of the first collision; NaN before, and below the diagonal


def scene_of(world: World, instants: int) -> Scene:
    """Share the state of a world with compiled code; `max_instants` is the maximum length of a recording."""
    scenarios, entities, max_pages = world.scenarios, world.entities, -(-instants // PAGE)
    boxes = [
        (
            entity.length,
            entity.width,
            entity.center_x,
            entity.max_speed,
            entity.max_acceleration,
            entity.max_deceleration,
            1.001 * (abs(entity.center_x) + 0.5 * np.hypot(entity.length, entity.width)),
        )
        for entity in entities
    ]
    tows = [(tow.vehicle, tow.trailer, tow.hitch, tow.coupler) for tow in world.tows]
    return Scene(
        floats=world.floats,
        flags=world.flags,
        numbers=world.numbers,
        overlaps=world.overlaps,
        time=world.time,
        last_step=world.last_step,
        boxes=np.array(boxes, dtype=np.float64).reshape(-1, 7),
        tows=np.array(tows, dtype=np.float64).reshape(-1, 4),
        frames=np.zeros(scenarios, dtype=np.int64),
        # Untouched memory is not allocated: many scenarios end early, so each takes the next free page as it goes.
        pages=np.empty((scenarios * max_pages, len(QUANTITIES), len(entities), PAGE)),
        page=np.full((scenarios, max_pages), -1),
        taken=np.zeros(scenarios, dtype=np.int64),
        collided=np.full((scenarios, len(entities), len(entities)), np.nan),
    )
