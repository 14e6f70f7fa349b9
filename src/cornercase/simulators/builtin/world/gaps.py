"""How far apart entities are, along and across their headings, tracks and roads."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.tracks.lane import LaneTrack
from cornercase.simulators.builtin.tracks.track import Pose, Track
from cornercase.simulators.builtin.world.contacts import entity_corners
from cornercase.simulators.builtin.world.state import World
from cornercase.simulators.builtin.world.whereabouts import lane_of, looks_along

# Beyond this distance from a track, in m, a target is not on it.
_ASTRAY: Final = 20.0


class KnownPlaces(NamedTuple):
    """Where a target that stays where it is lies on the track that an entity follows, kept from one step to the next.

    Attributes
    ----------
    track : ndarray of float64, shape (N,)
        Number of that track.
    place : ndarray of float64, shape (N,)
        Distance along it in m, infinite where it does not lead there; NaN where that is not known.
    """

    track: FloatArray
    place: FloatArray


def remaining(world: World, entity: int, target: Pose, known: KnownPlaces, where: BoolArray) -> FloatArray:
    """Distance along the entity's track to a target, in m, shape (N,); negative once it is passed.

    A trajectory leads to where it comes nearest to the target. Where the entity has no track that leads there it is the
    distance as the crow flies.

    Parameters
    ----------
    world : World
    entity : int
        Row of the entity.
    target : Pose
    known : KnownPlaces
        What is known of the target; what is found out is added.
    where : ndarray of bool, shape (N,)
        Scenarios in which it is asked for.

    Returns
    -------
    ndarray of float64, shape (N,)
        m.
    """
    way = np.full(world.scenarios, np.inf)
    for k, track, rows in world.followed(entity, where & np.isfinite(target.x + target.y)):
        new = rows[(known.track[rows] != k) | np.isnan(known.place[rows])]
        if new.size:
            known.track[new], known.place[new] = k, _place_on(world, entity, track, target, new, beside=True)
        way[rows] = known.place[rows] - world.distance[entity][rows]
    crow = np.hypot(target.x - world.x[entity], target.y - world.y[entity])
    return np.where(np.isfinite(way), way, crow)


def along_roads(world: World, entity: int, target: Pose) -> FloatArray:
    """Distance to a target along the entity's track, else along the roads, in m, shape (N,); negative behind it.

    Parameters
    ----------
    world : World
    entity : int
        Row of the entity.
    target : Pose

    Returns
    -------
    ndarray of float64, shape (N,)
        m; infinite where no road leads from one to the other.
    """
    result = np.full(world.scenarios, np.inf)
    for _, track, rows in world.followed(entity, np.isfinite(target.x + target.y)):
        result[rows] = _place_on(world, entity, track, target, rows) - world.distance[entity][rows]
    rows = np.flatnonzero(~np.isfinite(result) & np.isfinite(world.x[entity] + target.x))
    own = lane_of(world, entity) if rows.size else None
    if world.network is not None and own is not None and own.road is not None and own.s is not None:
        assert target.road is not None
        assert target.s is not None
        ahead = looks_along(world, own)
        result[rows] = world.network.way(own.road[rows], own.s[rows], ahead[rows], target.road[rows], target.s[rows])
    return result


def _place_on(
    world: World, entity: int, track: Track, target: Pose, rows: IntArray, *, beside: bool = False
) -> FloatArray:
    """Distance along a track to a target in m, shape (R,); infinite where the track does not lead there.

    With `beside`, a trajectory leads to places however far beside it, too.
    """
    along = track.nearest(target.x[rows], target.y[rows], rows, world.distance[entity][rows])
    x, y, _ = track.at(along, np.zeros(len(rows)), rows)
    near = np.hypot(x - target.x[rows], y - target.y[rows]) < _ASTRAY
    return np.where(near | (beside and not isinstance(track, LaneTrack)), along, np.inf)


def offset_from(world: World, entity: int, other: int) -> FloatArray:
    """Offset that another entity would have from this one's track, shape (N,); positive to the left.

    Parameters
    ----------
    world : World
    entity : int
        Row of the entity.
    other : int
        Row of the other entity.

    Returns
    -------
    ndarray of float64, shape (N,)
        m.
    """
    there, (x, y) = world.present[other], _beside_its_track(world, other)
    return offset_of(world, entity, np.where(there, x, np.nan), np.where(there, y, np.nan))


def offset_of(world: World, entity: int, x: FloatArray, y: FloatArray) -> FloatArray:
    """Offset that a place has from an entity's track, shape (N,); positive to the left.

    Parameters
    ----------
    world : World
    entity : int
        Row of the entity.
    x, y : ndarray of float64, shape (N,)
        m; NaN where there is no such place.

    Returns
    -------
    ndarray of float64, shape (N,)
        m; across the entity's heading where it follows no track.
    """
    cos, sin = np.cos(world.heading[entity]), np.sin(world.heading[entity])
    result = (y - world.y[entity]) * cos - (x - world.x[entity]) * sin + world.offset[entity]
    for _, track, rows in world.followed(entity, np.isfinite(x)):
        along = track.nearest(x[rows], y[rows], rows)
        at_x, at_y, heading = track.at(along, np.zeros(len(rows)), rows)
        result[rows] = (y[rows] - at_y) * np.cos(heading) - (x[rows] - at_x) * np.sin(heading)
    return np.asarray(result)


def _beside_its_track(world: World, entity: int) -> tuple[FloatArray, FloatArray]:
    """Where an entity is once what it goes sideways in the coming step is done, each (N,)."""
    x, y = world.x[entity].copy(), world.y[entity].copy()
    for _, track, rows in world.followed(entity, world.present[entity] & ~world.moved[entity]):
        x[rows], y[rows], _ = track.at(world.distance[entity][rows], world.offset[entity][rows], rows)
    return x, y


def distance_ahead(world: World, entity: int, other: int) -> FloatArray:
    """How far ahead of an entity another is, between reference points along its heading, shape (N,).

    Parameters
    ----------
    world : World
    entity : int
        Row of the entity.
    other : int
        Row of the other entity.

    Returns
    -------
    ndarray of float64, shape (N,)
        m; negative behind it.
    """
    dx, dy = world.x[other] - world.x[entity], world.y[other] - world.y[entity]
    return np.asarray(dx * np.cos(world.heading[entity]) + dy * np.sin(world.heading[entity]))


def distance_beside(world: World, entity: int, other: int) -> FloatArray:
    """How far to the left of an entity another is, between reference points, shape (N,).

    Parameters
    ----------
    world : World
    entity : int
        Row of the entity.
    other : int
        Row of the other entity.

    Returns
    -------
    ndarray of float64, shape (N,)
        m; negative to the right.
    """
    dx, dy = world.x[other] - world.x[entity], world.y[other] - world.y[entity]
    return np.asarray(dy * np.cos(world.heading[entity]) - dx * np.sin(world.heading[entity]))


def longitudinal_gap(world: World, entity: int, other: int) -> FloatArray:
    """Signed free space to another's box along an entity's heading, 0 where they are abreast, shape (N,).

    Parameters
    ----------
    world : World
    entity : int
        Row of the entity.
    other : int
        Row of the other entity.

    Returns
    -------
    ndarray of float64, shape (N,)
        m; negative behind it.
    """
    near, far, _, _ = extent(world, entity, other)
    half = 0.5 * world.entities[entity].length
    return np.where(near > half, near - half, np.where(far < -half, far + half, 0.0))


def lateral_gap(world: World, entity: int, other: int) -> FloatArray:
    """Signed free space to another's box across an entity's heading, positive to the left, shape (N,).

    Parameters
    ----------
    world : World
    entity : int
        Row of the entity.
    other : int
        Row of the other entity.

    Returns
    -------
    ndarray of float64, shape (N,)
        m; 0 where they overlap across it.
    """
    _, _, near, far = extent(world, entity, other)
    half = 0.5 * world.entities[entity].width
    return np.where(near > half, near - half, np.where(far < -half, far + half, 0.0))


def longitudinal_reach(world: World, entity: int, other: int) -> tuple[float, float]:
    """Parts of two boxes between their reference points in m: with the other one ahead, and with it behind.

    Parameters
    ----------
    world : World
    entity : int
        Row of the entity.
    other : int
        Row of the other entity.

    Returns
    -------
    tuple of (float, float)
        m.
    """
    one, two = world.entities[entity], world.entities[other]
    fronts = [0.5 * box.length + box.center_x for box in (one, two)]
    rears = [0.5 * box.length - box.center_x for box in (one, two)]
    return fronts[0] + rears[1], rears[0] + fronts[1]


def extent(world: World, entity: int, other: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Least and largest coordinate of another's box ahead of and to the left of an entity's centre, each (N,).

    Parameters
    ----------
    world : World
    entity : int
        Row of the entity.
    other : int
        Row of the other entity.

    Returns
    -------
    tuple of ndarray of float64, each (N,)
        m: least and largest ahead, least and largest to the left.
    """
    corners = entity_corners(world)[other]
    one = world.entities[entity]
    cos, sin = np.cos(world.heading[entity]), np.sin(world.heading[entity])
    x = corners[..., 0] - (world.x[entity] + one.center_x * cos)[:, None]
    y = corners[..., 1] - (world.y[entity] + one.center_x * sin)[:, None]
    along, across = x * cos[:, None] + y * sin[:, None], y * cos[:, None] - x * sin[:, None]
    return along.min(axis=1), along.max(axis=1), across.min(axis=1), across.max(axis=1)
