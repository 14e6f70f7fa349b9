"""A batch as compiled code sees it."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.world.state import World

LENGTH, WIDTH, CENTER_X, MAX_SPEED, MAX_ACCELERATION, MAX_DECELERATION, REACH = range(7)
"""Columns of what does not change about an entity."""

QUANTITIES: Final = ("x", "y", "heading", "speed", "acceleration")
"""What is recorded of an entity, in this order."""

PAGE: Final = 32
"""So many instants are recorded together."""


class Scene(NamedTuple):
    """State of E entities in N scenarios, and what is recorded of them, on pages of 32 instants.

    Attributes
    ----------
    floats, flags, numbers : ndarray, each (N, K, E)
        Tables of the world.
    overlaps : ndarray of bool, shape (N, E, E)
    time, last_step : ndarray of float64, shape (N,)
        s.
    boxes : ndarray of float64, shape (E, 7)
        Length, width and how far the centre is ahead, in m; largest speed, acceleration and deceleration; how far the
        box reaches from the reference point at most, in m.
    tows : ndarray of float64, shape (T, 4)
        Rows of vehicle and trailer, hitch and coupler in m.
    frames : ndarray of int64, shape (N,)
        How many are recorded.
    pages : ndarray of float64, shape (P, 5, E, 32)
        What is recorded; NaN for who is not there.
    page : ndarray of int64, shape (N, R)
        Which pages are a scenario's; R are as many as one can need, and R times N pages there are.
    taken : ndarray of int64, shape (N,)
        By the first of scenarios that are run together, how many of their pages are in use.
    collided : ndarray of float64, shape (N, E, E)
        Time in s at which two first collided; NaN before, and below the diagonal.
    """

    floats: FloatArray
    flags: BoolArray
    numbers: IntArray
    overlaps: BoolArray
    time: FloatArray
    last_step: FloatArray
    boxes: FloatArray
    tows: FloatArray
    frames: IntArray
    pages: FloatArray
    page: IntArray
    taken: IntArray
    collided: FloatArray


def scene_of(world: World, instants: int) -> Scene:
    """Share the state of a world with compiled code.

    Parameters
    ----------
    world : World
    instants : int
        How many can be recorded of each scenario.

    Returns
    -------
    Scene
    """
    scenarios, entities, most = world.scenarios, world.entities, -(-instants // PAGE)
    boxes = [
        (
            one.length,
            one.width,
            one.center_x,
            one.max_speed,
            one.max_acceleration,
            one.max_deceleration,
            1.001 * (abs(one.center_x) + 0.5 * np.hypot(one.length, one.width)),
        )
        for one in entities
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
        # Memory of which nothing is used takes none: many scenarios end early, so each takes the next page as it goes.
        pages=np.empty((scenarios * most, len(QUANTITIES), len(entities), PAGE)),
        page=np.full((scenarios, most), -1),
        taken=np.zeros(scenarios, dtype=np.int64),
        collided=np.full((scenarios, len(entities), len(entities)), np.nan),
    )
