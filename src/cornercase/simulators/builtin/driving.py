"""How a driver's decisions move an entity."""

from __future__ import annotations

import numpy as np

from cornercase.drivers import Driver, Path, Situation
from cornercase.simulators.builtin.tracks import LaneTrack
from cornercase.simulators.builtin.world import World
from cornercase.typing import BoolArray


class Driving:
    """One entity of a batch whose speed a driver decides, along the lanes that it follows.

    Parameters
    ----------
    world : World
    entity : int
        Row of the entity.
    driver : Driver
    """

    def __init__(self, world: World, entity: int, driver: Driver) -> None:
        self._world, self._entity, self._driver = world, entity, driver
        self._others = [a for a in range(len(world.entities)) if a != entity]
        self._paths: dict[int, Path] = {}
        driver.start(world.scenarios, len(self._others))
        world.driven[entity] = True

    def step(self, dt: float) -> None:
        """Decide the entity's speed at the end of the coming time step."""
        world, e = self._world, self._entity
        active = world.running & world.present[e]
        if dt == 0.0:
            return
        for k, track in enumerate(world.tracks[e]):
            rows = active & (world.track[e] == k)
            if isinstance(track, LaneTrack) and rows.any():
                acceleration = self._driver.acceleration(self._situation(k, track, dt, rows))
                speed = np.maximum(world.speed[e] + acceleration * dt, 0.0)
                world.speed[e][rows] = np.minimum(speed, world.entities[e].max_speed)[rows]

    def _situation(self, k: int, track: LaneTrack, dt: float, rows: BoolArray) -> Situation:
        world, e, others = self._world, self._entity, self._others
        if k not in self._paths:
            line = track.path
            self._paths[k] = Path(line.distance, line.x, line.y, line.heading, line.curvature)
        box, boxes = world.entities[e], [world.entities[a] for a in others]
        there = world.present[others].T
        return Situation(
            time=world.time,
            time_step=dt,
            path=self._paths[k],
            distance=world.distance[e],
            x=world.x[e],
            y=world.y[e],
            heading=world.heading[e],
            speed=world.speed[e],
            acceleration=world.acceleration[e],
            length=box.length,
            width=box.width,
            center_x=box.center_x,
            target_speed=world.target_speed[e],
            others_x=np.where(there, world.x[others].T, np.nan),
            others_y=np.where(there, world.y[others].T, np.nan),
            others_heading=np.where(there, world.heading[others].T, np.nan),
            others_speed=np.where(there, world.speed[others].T, np.nan),
            others_length=np.array([one.length for one in boxes]),
            others_width=np.array([one.width for one in boxes]),
            others_center_x=np.array([one.center_x for one in boxes]),
            others_kind=tuple(one.kind for one in boxes),
            active=rows,
        )
