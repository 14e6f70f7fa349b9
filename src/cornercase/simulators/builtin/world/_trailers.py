"""Trailers, and their connections to the vehicles that pull them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray
from cornercase.simulators.builtin.world._world import Entity, Tow, World

# A longer row of trailers means that a catalog entry pulls itself.
MAX_TRAILERS: Final = 20


def read_tow(vehicle: int, trailer: int, entities: Sequence[Entity]) -> Tow:
    """Read how a trailer is connected to a vehicle (both indices); raise `InputError` without hitch or coupler."""
    bodies = entities[vehicle].body, entities[trailer].body
    assert bodies[0] is not None
    assert bodies[1] is not None
    (front, front_scope), (rear, rear_scope) = bodies[0], bodies[1]
    hitch, coupler = front.find("TrailerHitch"), rear.find("TrailerCoupler")
    if hitch is None or coupler is None:
        scope, entity, part = (
            (front_scope, vehicle, "TrailerHitch") if hitch is None else (rear_scope, trailer, "TrailerCoupler")
        )
        raise InputError(
            f"{scope.file_name}: '{entities[vehicle].name}' cannot pull '{entities[trailer].name}', as"
            f" '{entities[entity].name}' has no <{part}>."
        )
    return Tow(vehicle, trailer, front_scope.read_number(hitch, "dx"), rear_scope.read_number(coupler, "dx"))


def sort_front_to_back(tows: Sequence[Tow]) -> tuple[Tow, ...]:
    """Sort connections so that the connection of a vehicle comes before the connections of trailers behind it."""
    behind = {tow.trailer: tow.vehicle for tow in tows}

    def depth(entity: int) -> int:
        count = 0
        while entity in behind and count < MAX_TRAILERS:
            entity, count = behind[entity], count + 1
        return count

    return tuple(sorted(tows, key=lambda tow: depth(tow.vehicle)))


def align_trailers(world: World, entity: int, where: BoolArray) -> None:
    """Place all trailers of an entity, and their own trailers, straight behind the entity."""
    for tow in world.tows:
        if tow.vehicle == entity:
            pulled = where & (world.pulled_by[tow.trailer] == entity)
            heading, offset = world.heading[entity], tow.hitch - tow.coupler
            x, y = world.x[entity] + offset * np.cos(heading), world.y[entity] + offset * np.sin(heading)
            t = tow.trailer
            world.x[t][pulled], world.y[t][pulled], world.heading[t][pulled] = x[pulled], y[pulled], heading[pulled]
            world.from_x[t][pulled], world.from_y[t][pulled] = x[pulled], y[pulled]
            world.speed[t][pulled] = world.speed[entity][pulled]
            world.present[t] |= pulled
            if pulled.any():
                align_trailers(world, t, pulled)


def place_trailers(world: World) -> None:
    """Place trailers that have no position straight behind their vehicles."""
    for tow in world.tows:
        align_trailers(world, tow.vehicle, world.running & world.present[tow.vehicle] & np.isnan(world.x[tow.trailer]))
