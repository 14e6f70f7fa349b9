"""State and recordings of a batch of scenarios, as arrays for kernels."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.world._world import World

LENGTH, WIDTH, CENTER_X, MAX_SPEED, MAX_ACCELERATION, MAX_DECELERATION, MAX_EXTENT = range(7)
"""Columns of `SimulationState.dimensions`. No point of a box is farther than `MAX_EXTENT` from its reference point."""

RECORDED_QUANTITIES: Final = ("x", "y", "heading", "speed", "acceleration")
"""Recorded quantities of an entity, in this order."""

PAGE_LENGTH: Final = 32
"""Number of frames that a page (a block of a recording) holds."""


class SimulationState(NamedTuple):
    """State of E entities in N scenarios, and the recordings, which are stored in blocks (pages) of 32 frames."""

    floats: FloatArray  # (N, K, E): table of the world; its rows are named in `world/_state_layout.py`
    flags: BoolArray  # (N, K, E)
    integers: IntArray  # (N, K, E)
    overlaps: BoolArray  # (N, E, E)
    time: FloatArray  # (N,), s
    last_step: FloatArray  # (N,), s
    dimensions: FloatArray  # (E, 7): columns `LENGTH` to `MAX_EXTENT`, in m and s
    trailers: FloatArray  # (T, 4): indices of vehicle and trailer; positions of hitch and coupler in m
    n_frames: IntArray  # (N,): number of recorded frames
    pages: FloatArray  # (P, 5, E, 32): recorded quantities; NaN for absent entities
    page_numbers: IntArray  # (N, R): pages of each scenario; R pages hold the maximum duration, P = R N
    n_pages_used: IntArray  # (N,): number of pages in use, at the first of the scenarios that run together
    collision_time: FloatArray  # (N, E, E): time in s of the first collision; NaN before, and below the diagonal


def make_state_arrays(world: World, max_instants: int) -> SimulationState:
    """Create the arrays for kernels; state arrays share their memory with the world.

    `max_instants` is the largest number of frames in a recording.
    """
    scenarios, entities, max_pages = world.scenarios, world.entities, -(-max_instants // PAGE_LENGTH)
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
    return SimulationState(
        floats=world.floats,
        flags=world.flags,
        integers=world.numbers,
        overlaps=world.overlaps,
        time=world.time,
        last_step=world.last_step,
        dimensions=np.array(boxes, dtype=np.float64).reshape(-1, 7),
        trailers=np.array(tows, dtype=np.float64).reshape(-1, 4),
        n_frames=np.zeros(scenarios, dtype=np.int64),
        # Many scenarios end early. Each takes the next free page when needed, and pages never used take no memory.
        pages=np.empty((scenarios * max_pages, len(RECORDED_QUANTITIES), len(entities), PAGE_LENGTH)),
        page_numbers=np.full((scenarios, max_pages), -1),
        n_pages_used=np.zeros(scenarios, dtype=np.int64),
        collision_time=np.full((scenarios, len(entities), len(entities)), np.nan),
    )
