"""How a driver's decisions move an entity."""

from __future__ import annotations

import numpy as np

from cornercase.drivers import Driver, Path, Situation
from cornercase.simulators.builtin.tracks import LaneTrack
from cornercase.simulators.builtin.world import World


class Driving:
    """One entity of a batch whose speed a driver decides, along the lanes that it follows.

    Parameters
    ----------
    world : World
    entity : int
        Row of the entity.
    driver : Driver
        Started anew for each track, since the road ahead is another then.
    """

    def __init__(self, world: World, entity: int, driver: Driver) -> None:
        self._world, self._entity, self._driver = world, entity, driver
        self._paths: dict[int, Path] = {}
        self._started = False
        world.driven[entity] = True

    def step(self, dt: float) -> None:
        """Set the entity's speed for the coming time step."""
        world, e = self._world, self._entity
        active = world.running & world.present[e]
        if dt == 0.0 or not active.any():
            return
        followed = [k for k, t in enumerate(world.tracks[e]) if isinstance(t, LaneTrack) and (world.track[e] == k).any()]
        for k in followed:
            rows = active & (world.track[e] == k)
            if rows.any():
                self._drive(k, dt, rows)

    def _drive(self, track: int, dt: float, rows: np.ndarray) -> None:
        world, e = self._world, self._entity
        others = [a for a in range(len(world.entities)) if a != e]
        if track not in self._paths:
            self._paths[track] = _path(world.tracks[e][track])
            self._drivers[track] = self._driver.fresh()
            self._drivers[track].start(world.scenarios, len(others))
        box = world.entities[e]
        there = world.present[others]
        situation = Situation()
