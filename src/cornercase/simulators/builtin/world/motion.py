"""Move entities along their tracks outside of kernels."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.geometry import within_half_turn
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.tracks.lane import LaneTrack
from cornercase.simulators.builtin.tracks.track import Track
from cornercase.simulators.builtin.world.lanes import go_on
from cornercase.simulators.builtin.world.state import World
from cornercase.simulators.builtin.world.whereabouts import on_road

# Distance in m to the end of a road that counts as the end.
_ON_END: Final = 1e-3


def watch_roads(world: World, where: BoolArray) -> None:
    """Update since when entities are off the road, in the scenarios of a mask."""
    # As in esmini, no entity is off the road before the first time step.
    current_time = np.where(world.last_step > 0.0, world.time, np.inf)
    for e, since in enumerate(world.off_road_since):
        is_off = world.present[e] if world.network is None else world.present[e] & ~on_road(world, e)
        since[where] = np.where(is_off, np.minimum(since, current_time), np.inf)[where]


def go_on_along_lanes(world: World) -> None:
    """Make entities near the end of their lane's cut path follow the next part."""
    for e, tracks in enumerate(world.tracks):
        for k, track in enumerate([*tracks]):
            if isinstance(track, LaneTrack) and track.goes_over:
                go_on(world, e, k)


def velocity_ahead(world: World) -> tuple[FloatArray, FloatArray]:
    """Velocity in x and y along the headings in m/s, each (E, N)."""
    return world.speed * np.cos(world.heading), world.speed * np.sin(world.heading)


def acceleration_ahead(world: World) -> FloatArray:
    """Acceleration along the heading in the last step in m/s², shape (E, N)."""
    return np.asarray(world.pull[0] * np.cos(world.heading) + world.pull[1] * np.sin(world.heading))


def settle_on_track(world: World, entity: int, where: BoolArray) -> None:
    """Update an entity's pose from its position on the track immediately."""
    for _, track, at in world.followed(entity, where):
        _settle(world, entity, track, at)


def move_at_once(world: World, entity: int, where: BoolArray, way: FloatArray) -> None:
    """Move an entity by `distance` m (N,) along its track and to its offset within the frame."""
    world.moved[entity] |= where
    for _, track, at in world.followed(entity, where & world.running):
        _advance(world, entity, track, at, way[at])


def put_ahead(world: World, entity: int, where: BoolArray, way: FloatArray) -> None:
    """Shift an entity by `distance` m (N,) along its track before it moves in the frame."""
    for _, track, at in world.followed(entity, where):
        world.distance[entity][at] = _along(track, world.distance[entity][at], world.offset[entity][at], way[at])
        _settle(world, entity, track, at)


def pull_entity(
    world: World, entity: int, x: FloatArray, y: FloatArray, heading: FloatArray, speed: FloatArray
) -> None:
    """Set the motion of an entity that another simulator moves, at the end of the coming step, each (N,)."""
    world.x[entity], world.y[entity], world.heading[entity], world.speed[entity] = x, y, heading, speed
    world.moved[entity] = True
    for _, track, at in world.followed(entity, world.running):
        along = track.nearest(x[at], y[at], at, world.distance[entity][at])
        on_x, on_y, track_heading = track.at(along, np.zeros(len(at)), at)
        world.distance[entity][at] = along
        world.offset[entity][at] = (y[at] - on_y) * np.cos(track_heading) - (x[at] - on_x) * np.sin(track_heading)
        world.turn[entity][at] = within_half_turn(heading[at] - track_heading)


def _advance(world: World, e: int, track: Track, at: IntArray, way: FloatArray) -> None:
    distance = _along(track, world.distance[e][at], world.offset[e][at], way)
    if isinstance(track, LaneTrack):
        since = world.at_end_since[e][at]
        backwards = (way < 0.0) | ((way == 0.0) & np.isfinite(since))
        at_end = (distance >= track.length - _ON_END) | ((distance <= _ON_END) & backwards)
        arrived = np.where(world.last_step > 0.0, world.time + world.last_step, np.inf)[at]
        world.at_end_since[e][at] = np.where(at_end, np.minimum(since, arrived), np.inf)
    world.distance[e][at] = distance
    _settle(world, e, track, at)


def _along(track: Track, distance: FloatArray, offset: FloatArray, way: FloatArray) -> FloatArray:
    return track.advance(distance, offset, way) if isinstance(track, LaneTrack) else distance + way


def _settle(world: World, e: int, track: Track, at: IntArray) -> None:
    x, y, heading = track.at(world.distance[e][at], world.offset[e][at], at)
    world.x[e][at], world.y[e][at] = x, y
    world.heading[e][at] = heading + world.turn[e][at]
