"""Moving entities along their tracks by one time step."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.geometry import within_half_turn
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.tracks.lane import LaneTrack
from cornercase.simulators.builtin.tracks.track import FREE, Track
from cornercase.simulators.builtin.world.lanes import go_on
from cornercase.simulators.builtin.world.state import World
from cornercase.simulators.builtin.world.towing import hold_trailers, pull_trailers
from cornercase.simulators.builtin.world.whereabouts import on_lane, on_road

# An entity this close to the end of a road, in m, is at the end.
_ON_END: Final = 1e-3
# Slower than this, in m/s, it stands.
_STILL: Final = 1e-6
# Slower than this, in m/s, who stands is not moved sideways, but looked up anew.
_DRIFT: Final = 1e-3


def move_entities(world: World, dt: float) -> None:
    """Advance every entity by one time step with its present speed, then the clock.

    Parameters
    ----------
    world : World
    dt : float
        s; with 0 entities are only put on their tracks.
    """
    world.last_step = dt
    hold_trailers(world)
    for e in range(len(world.entities)):
        rows = world.running & world.present[e]
        way = np.where(np.isnan(world.pace[e]), world.speed[e], world.pace[e]) * dt
        way = np.sign(way) * np.sqrt(np.maximum(way**2 - world.sideways[e] ** 2, 0.0))
        way = np.where(rows & ~world.moved[e], way, 0.0)
        for _, track, at in world.followed(e, rows & ~world.moved[e]):
            _advance(world, e, track, at, way[at])
        for k, track in enumerate([*world.tracks[e]]):
            if isinstance(track, LaneTrack) and track.goes_over:
                go_on(world, e, k)
        free = rows & (world.track[e] == FREE)
        if not free.any():
            continue
        # An entity stops at the end of its trajectory if there is no road on which to continue.
        lost = free & world.stranded[e] & ~world.moved[e]
        world.speed[e][lost], way = 0.0, np.where(lost, 0.0, way)
        world.x[e] += np.where(free, way * np.cos(world.heading[e]), 0.0)
        world.y[e] += np.where(free, way * np.sin(world.heading[e]), 0.0)
    _stop_at_ends(world)
    pull_trailers(world)
    gone_x, gone_y = world.x - world.from_x, world.y - world.from_y
    chord = np.hypot(gone_x, gone_y)
    # A jump counts neither as a way nor as a velocity.
    held = velocity_ahead(world)
    before, world.gone = world.gone, held
    if dt > 0:
        chord = np.where(np.isfinite(chord) & ~world.jumped, chord, 0.0)
        world.gone = (np.where(world.jumped, held[0], gone_x / dt), np.where(world.jumped, held[1], gone_y / dt))
        world.pull = ((world.gone[0] - before[0]) / dt, (world.gone[1] - before[1]) / dt)
        world.odometer += chord
        world.velocity = chord / dt
        # Who stands and is only moved sideways has from then on the speed of that, as in esmini.
        drifts = (np.abs(world.speed) < _STILL) & (world.velocity > _DRIFT) & world.running
        drifts &= ~(world.decided | world.moved | world.driven)
        world.speed = np.where(drifts, world.velocity, world.speed)
    world.time += dt
    world.from_x, world.from_y, world.from_heading = world.x.copy(), world.y.copy(), world.heading.copy()
    world.begun = True
    world.moved[:] = world.jumped[:] = world.decided[:] = False
    world.pace[:] = np.nan
    world.sideways[:] = 0.0
    # As in esmini, nobody stands or is off the road before the first frame that takes time.
    now = world.time if dt > 0 else np.inf
    moving = np.abs(world.speed) > _STILL
    world.standing_since = np.where(moving, np.inf, np.minimum(world.standing_since, now))
    if world.watches_roads:
        for e, since in enumerate(world.off_road_since):
            off = world.present[e] if world.network is None else world.present[e] & ~on_road(world, e)
            since[:] = np.where(off, np.minimum(since, now), np.inf)


def velocity_ahead(world: World) -> tuple[FloatArray, FloatArray]:
    """Velocity along x and y with which all would go on along their headings, in m/s, each (E, N).

    Parameters
    ----------
    world : World

    Returns
    -------
    tuple of two ndarray of float64, each (E, N)
    """
    return world.speed * np.cos(world.heading), world.speed * np.sin(world.heading)


def acceleration_ahead(world: World) -> FloatArray:
    """Acceleration along the heading in the last step, in m/s², shape (E, N).

    Parameters
    ----------
    world : World

    Returns
    -------
    ndarray of float64, shape (E, N)
    """
    return np.asarray(world.pull[0] * np.cos(world.heading) + world.pull[1] * np.sin(world.heading))


def settle_on_track(world: World, entity: int, where: BoolArray) -> None:
    """Move an entity to its place on its track at once, before the step ends.

    Parameters
    ----------
    world : World
    entity : int
        Row of the entity.
    where : ndarray of bool, shape (N,)
        Scenarios.
    """
    for _, track, at in world.followed(entity, where):
        _settle(world, entity, track, at)


def move_at_once(world: World, entity: int, where: BoolArray, way: FloatArray) -> None:
    """Move an entity along its track, and to its offset beside it, so that later actions of the frame see it.

    Parameters
    ----------
    world : World
    entity : int
        Row of the entity.
    where : ndarray of bool, shape (N,)
        Scenarios.
    way : ndarray of float64, shape (N,)
        m; negative backwards.
    """
    world.moved[entity] |= where
    for _, track, at in world.followed(entity, where & world.running):
        _advance(world, entity, track, at, way[at])


def put_ahead(world: World, entity: int, where: BoolArray, way: FloatArray) -> None:
    """Put an entity further along its track before it moves in the frame.

    Parameters
    ----------
    world : World
    entity : int
        Row of the entity.
    where : ndarray of bool, shape (N,)
        Scenarios.
    way : ndarray of float64, shape (N,)
        m; negative backwards.
    """
    for _, track, at in world.followed(entity, where):
        world.distance[entity][at] = _along(track, world.distance[entity][at], world.offset[entity][at], way[at])
        _settle(world, entity, track, at)


def pull_entity(
    world: World, entity: int, x: FloatArray, y: FloatArray, heading: FloatArray, speed: FloatArray
) -> None:
    """Set the motion of an entity that another simulator moves in the coming step, each array (N,).

    Parameters
    ----------
    world : World
    entity : int
        Row of the entity.
    x, y, heading, speed : ndarray of float64, shape (N,)
        Motion at the end of the step in m, rad and m/s.
    """
    world.x[entity], world.y[entity], world.heading[entity], world.speed[entity] = x, y, heading, speed
    world.moved[entity] = True
    for _, track, at in world.followed(entity, world.running):
        along = track.nearest(x[at], y[at], at, world.distance[entity][at])
        on_x, on_y, ahead = track.at(along, np.zeros(len(at)), at)
        world.distance[entity][at] = along
        world.offset[entity][at] = (y[at] - on_y) * np.cos(ahead) - (x[at] - on_x) * np.sin(ahead)
        world.turn[entity][at] = within_half_turn(heading[at] - ahead)


def _stop_at_ends(world: World) -> None:
    """Stop who is at the end of its road once the last step has moved it neither on nor sideways, as in esmini."""
    was_there = world.at_end_since < world.time + 0.5 * world.last_step
    still = was_there & (np.hypot(*world.gone) < _STILL) & world.running & world.present
    for e in np.flatnonzero(still.any(axis=1)):
        stops = still[e] & on_lane(world, int(e))
        world.speed[e][stops], world.decided[e][stops] = 0.0, True


def _advance(world: World, e: int, track: Track, at: IntArray, way: FloatArray) -> None:
    distance = _along(track, world.distance[e][at], world.offset[e][at], way)
    if isinstance(track, LaneTrack):
        since = world.at_end_since[e][at]
        back = (way < 0.0) | ((way == 0.0) & np.isfinite(since))
        there = (distance >= track.length - _ON_END) | ((distance <= _ON_END) & back)
        arrived = world.time + world.last_step if world.last_step > 0.0 else np.inf
        world.at_end_since[e][at] = np.where(there, np.minimum(since, arrived), np.inf)
    world.distance[e][at] = distance
    _settle(world, e, track, at)


def _along(track: Track, distance: FloatArray, offset: FloatArray, way: FloatArray) -> FloatArray:
    return track.advance(distance, offset, way) if isinstance(track, LaneTrack) else distance + way


def _settle(world: World, e: int, track: Track, at: IntArray) -> None:
    x, y, heading = track.at(world.distance[e][at], world.offset[e][at], at)
    world.x[e][at], world.y[e][at] = x, y
    world.heading[e][at] = heading + world.turn[e][at]
