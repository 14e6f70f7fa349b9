"""Trailers: what a vehicle pulls comes after it."""

from __future__ import annotations

import numpy as np

from cornercase._common.typing import BoolArray
from cornercase.simulators.builtin.world.state import World


def align_trailers(world: World, entity: int, where: BoolArray) -> None:
    """Put all that an entity pulls straight behind it.

    Parameters
    ----------
    world : World
    entity : int
        Row of the entity in front.
    where : ndarray of bool, shape (N,)
        Scenarios.
    """
    for tow in world.tows:
        if tow.vehicle == entity:
            heading, back = world.heading[entity], tow.hitch - tow.coupler
            x, y = world.x[entity] + back * np.cos(heading), world.y[entity] + back * np.sin(heading)
            t = tow.trailer
            world.x[t][where], world.y[t][where], world.heading[t][where] = x[where], y[where], heading[where]
            world.from_x[t][where], world.from_y[t][where] = x[where], y[where]
            world.speed[t][where] = world.speed[entity][where]
            world.present[t] |= where
            align_trailers(world, t, where)


def place_trailers(world: World) -> None:
    """Put trailers that are nowhere yet straight behind the vehicles that are there.

    Parameters
    ----------
    world : World
    """
    for tow in world.tows:
        align_trailers(world, tow.vehicle, world.running & world.present[tow.vehicle] & np.isnan(world.x[tow.trailer]))
