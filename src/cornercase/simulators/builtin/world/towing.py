"""Trailers: what a vehicle pulls comes after it."""

from __future__ import annotations

import numpy as np

from cornercase._common.geometry import within_half_turn
from cornercase._common.typing import BoolArray
from cornercase.simulators.builtin.world.state import World


def hold_trailers(world: World) -> None:
    """Let no trailer move by itself in the coming step.

    Parameters
    ----------
    world : World
    """
    for tow in world.tows:
        world.moved[tow.trailer] = True


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


def pull_trailers(world: World) -> None:
    """Bring every trailer to where it is pulled: its axle comes after the hitch as on a rod.

    Parameters
    ----------
    world : World
    """
    for tow in world.tows:
        e, t = tow.vehicle, tow.trailer
        align_trailers(world, e, world.present[e] & np.isnan(world.x[t]))
        world.present[t] = world.present[e]
        x = world.x[e] + tow.hitch * np.cos(world.heading[e])
        y = world.y[e] + tow.hitch * np.sin(world.heading[e])
        heading = np.arctan2(y - world.y[t], x - world.x[t])
        # No full turn from one step to the next.
        turn = within_half_turn(heading - world.heading[t])
        pulled = world.present[t] & world.running
        for state, value in (
            (world.heading, world.heading[t] + turn),
            (world.x, x - tow.coupler * np.cos(heading)),
            (world.y, y - tow.coupler * np.sin(heading)),
            (world.speed, world.speed[e]),
        ):
            state[t][pulled] = value[pulled]
