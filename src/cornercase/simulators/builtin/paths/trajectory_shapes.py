"""Shapes of trajectories, as they stand in a file or a catalog."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.recorded_xml import adapt, made_once
from cornercase._common.typing import FloatArray
from cornercase.scenario import Scope, VariesError
from cornercase.simulators.builtin.tracks.clothoids import ClothoidSpline
from cornercase.simulators.builtin.tracks.nurbs import nurbs_points
from cornercase.simulators.builtin.tracks.polyline import Polyline
from cornercase.simulators.builtin.tracks.track import ALONG_LEGS, AT_CORNERS, Pose, Trajectory
from cornercase.simulators.builtin.world.state import World

Position = Callable[[World], Pose]
"""A place, as it is at the instant when the world is asked for it."""

PositionReader = Callable[[etree._Element, Scope, World], Position]
"""Reads the position that an element holds."""


class WorldPlace:
    """A place that a file gives by its coordinates; on which road it is, is looked up only for who asks.

    Parameters
    ----------
    pose : Pose
        Without a road.

    Attributes
    ----------
    pose : Pose
    """

    def __init__(self, pose: Pose) -> None:
        self.pose = pose

    def __call__(self, world: World) -> Pose:
        """Return the place with its road."""
        if world.network is None:
            return self.pose
        return replace(self.pose, **world.network.locate(self.pose.x, self.pose.y)._asdict())


# Times that differ by less, in s, are the same.
_SAME_TIME: Final = 1e-6


@dataclass(frozen=True)
class Clock:
    """How the times of a file become those of a trajectory: scaled, then shifted, each (N,)."""

    scale: FloatArray
    shift: FloatArray

    def times(self, given: FloatArray) -> FloatArray:
        """Times of the trajectory of those in the file, each (N, V).

        Where they go back on the way to the latest, they stand still until the time is reached again.
        """
        times = given * self.scale[:, None] + self.shift[:, None]
        latest = np.maximum.accumulate(times, axis=1)
        return np.where(times[:, -1:] == latest[:, -1:], latest, times)


class Shape(Protocol):
    """Lays a trajectory out in the world as it is now.

    `smooth` is the following mode ``follow``; without a `clock` the trajectory has no times. `entity` is who follows
    it.
    """

    def __call__(
        self, world: World, smooth: bool = False, clock: Clock | None = None, entity: int | None = None
    ) -> Trajectory:
        """Return the trajectory."""
        ...


def read_trajectory(holder: etree._Element, scope: Scope, world: World, read: PositionReader) -> Shape:
    """Read the ``Trajectory`` or ``CatalogReference`` in `holder`.

    Parameters
    ----------
    holder : lxml element
    scope : Scope
    world : World
    read : callable
        Reads the positions of its vertices, which may lie on trajectories themselves.

    Raises
    ------
    InputError
        There is none, or it is malformed.
    """
    element, inner = scope.referred(holder, "Trajectory")
    shape = element.find("Shape")
    kind = None if shape is None else next(iter(shape.iterchildren("*")), None)
    if kind is None or kind.tag not in ("Polyline", "Clothoid", "ClothoidSpline", "Nurbs"):
        raise InputError(
            f"{scope.source}, line {element.sourceline}: a <Trajectory> is not a <Polyline>, <Clothoid>,"
            " <ClothoidSpline> or <Nurbs>."
        )
    closed = inner.flag(element, "closed", False)
    if kind.tag == "Polyline":
        return _polyline(kind, inner, world, read, closed)
    if closed:
        raise InputError(
            f"{scope.source}, line {element.sourceline}: a closed <Trajectory> has to be a <Polyline> here; give closed"
            " as false."
        )
    return (_nurbs if kind.tag == "Nurbs" else _clothoids)(kind, inner, world, read)


def takes_time(holder: etree._Element, scope: Scope) -> bool:
    """Whether the times of the ``Trajectory`` or ``CatalogReference`` in `holder` differ.

    Parameters
    ----------
    holder : lxml element
    scope : Scope

    Returns
    -------
    bool

    Raises
    ------
    InputError
        They do, and the trajectory is closed: no time says when its first vertex is reached again.
    VariesError
        They do in some scenarios only.
    """
    element, inner = scope.referred(holder, "Trajectory")
    timed = [
        (one, name)
        for one in element.iterfind("Shape//*")
        for name in ("time", "startTime", "stopTime", "timeStart", "timeEnd")
        if one.get(name) is not None
    ]
    given = [inner.number(one, name) for one, name in timed]
    origins = {origin for one, name in timed for origin in inner.origins(one.get(name, ""))}
    if element.find("Shape/Polyline") is None and element.find("Shape/Nurbs") is None:
        # The times of clothoids are 0 where they are left out.
        given.append(np.zeros(scope.scenarios))
    differ = np.zeros(scope.scenarios, dtype=np.bool_)
    for one in given:
        differ |= np.abs(one - given[0]) > _SAME_TIME
    if differ.any() != differ.all():
        raise VariesError(origins)
    inner.used |= origins
    times = np.array(given)
    if {name for _, name in timed} == {"time"} and (times[-1] == times.max(axis=0)).all():
        back = next((k for k in range(1, len(timed)) if (times[k] < times[k - 1] - _SAME_TIME).any()), None)
        if back is not None:
            why = f"time goes back to {times[back].min():g} s; vertices are passed over until it is reached again"
            adapt(timed[back][0], f"time of <{timed[back][0].tag}>", why, "times of a trajectory never go back")
    if differ.all() and inner.flag(element, "closed", False):
        raise InputError(
            f"{scope.source}, line {element.sourceline}: no time says when a closed <Trajectory> is back at its first"
            " vertex; give closed as false, and the first vertex once more at the end, with its time."
        )
    return bool(differ.all())


def _polyline(element: etree._Element, scope: Scope, world: World, read: PositionReader, closed: bool) -> Shape:
    vertices = list(element.iterfind("Vertex"))
    if len(vertices) < 2:
        raise InputError(f"{scope.source}, line {element.sourceline}: a <Polyline> needs at least two vertices.")
    corners = _corners(element, vertices, scope, world, read)

    def lay_out(
        world: World, smooth: bool = False, clock: Clock | None = None, entity: int | None = None
    ) -> Trajectory:
        turning, begin_speed = ALONG_LEGS if smooth else AT_CORNERS, None
        if entity is not None:
            turning = world.entities[entity].turning or turning
        if smooth:
            begin_speed = np.zeros(world.scenarios) if entity is None else world.speed[entity].copy()
        x, y, heading, times = corners(world)
        reached = None if clock is None else clock.times(times)
        return Polyline(x, y, heading, reached, closed, turning, begin_speed)

    return lay_out


_Corners = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""x, y, heading (NaN where the file says none) and time of all vertices, each (N, V)."""


def _corners(
    element: etree._Element, vertices: list[etree._Element], scope: Scope, world: World, read: PositionReader
) -> Callable[[World], _Corners]:
    """Read the vertices of a polyline; what is found is asked where they are now."""
    fixed = made_once(element, "corners", lambda: _fixed_corners(vertices, scope, world, read))
    if fixed is not None:
        x, y, heading, times = (np.tile(one, (scope.scenarios, 1)) for one in fixed)
        return lambda world: (x, y, heading, times)
    positions = [read(_position(one, scope), scope, world) for one in vertices]
    oriented = _oriented(vertices)
    times = np.stack([scope.number(one, "time", 0.0) for one in vertices], axis=1)

    def corners(world: World) -> _Corners:
        poses = [_coordinates(position, world) for position in positions]
        headings = [
            pose.heading if said else np.full_like(pose.heading, np.nan)
            for pose, said in zip(poses, oriented, strict=True)
        ]
        x, y = np.stack([pose.x for pose in poses], axis=1), np.stack([pose.y for pose in poses], axis=1)
        return x, y, np.stack(headings, axis=1), times

    return corners


def _fixed_corners(
    vertices: list[etree._Element], scope: Scope, world: World, read: PositionReader
) -> tuple[FloatArray, ...] | None:
    """Rows of `_Corners` that no parameter changes, each (V,); None where one may, or a place is given otherwise."""
    held = [_position(one, scope) for one in vertices]
    if any(len(one) != 1 or one[0].tag != "WorldPosition" or len(one[0]) for one in held):
        return None
    if any("$" in text for one in vertices for below in one.iter() for text in below.attrib.values()):
        return None
    places = [read(one, scope, world) for one in held]
    times = np.array([scope.one_number(one, "time", 0.0) for one in vertices])
    x, y, heading = np.array(
        [(one.pose.x[0], one.pose.y[0], one.pose.heading[0]) for one in places if isinstance(one, WorldPlace)]
    ).T
    return x, y, np.where(_oriented(vertices), heading, np.nan), times


def _oriented(vertices: list[etree._Element]) -> list[bool]:
    """Whether the file says the heading of each vertex."""
    return [
        one.find("Position//Orientation[@h]") is not None or next(one.iterfind("Position/*")).get("h") is not None
        for one in vertices
    ]


def _clothoids(element: etree._Element, scope: Scope, world: World, read: PositionReader) -> Shape:
    segments = [element] if element.tag == "Clothoid" else list(element.iterfind("ClothoidSplineSegment"))
    if not segments:
        raise InputError(f"{scope.source}, line {element.sourceline}: a <ClothoidSpline> has no segments.")
    length = np.stack([scope.number(one, "length") for one in segments], axis=1)
    for one, each in zip(segments, length.T, strict=True):
        if not scope.origins(one.get("length", "")) and not each[0] > 0:
            raise InputError(f"{scope.source}, line {one.sourceline}: length of <{one.tag}> is not above 0.")
        scope.refuse(one, "length", "is not above 0", ~(each > 0))
    length = np.where(length > 0, length, 1.0)
    if element.tag == "Clothoid":
        start = scope.number(element, "curvature")[:, None]
        name = "curvaturePrime" if element.get("curvatureDot") is None else "curvatureDot"
        end = start + scope.number(element, name)[:, None] * length
        times = np.stack([scope.number(element, name, 0.0) for name in ("startTime", "stopTime")], axis=1)
        holder = element.find("Position")
    else:
        start = np.stack([scope.number(one, "curvatureStart") for one in segments], axis=1)
        end = np.stack([scope.number(one, "curvatureEnd") for one in segments], axis=1)
        times = _segment_times(element, segments, length, scope)
        holder = segments[0].find("PositionStart")
    position = None if holder is None else read(holder, scope, world)
    # Where later segments begin elsewhere than the ones before them end.
    holders = {k: one.find("PositionStart") for k, one in enumerate(segments[1:], start=1)}
    later = {k: read(holder, scope, world) for k, holder in holders.items() if holder is not None}
    turns = np.stack([scope.number(one, "hOffset", 0.0) for one in segments], axis=1)

    def lay_out(
        world: World, smooth: bool = False, clock: Clock | None = None, entity: int | None = None
    ) -> Trajectory:
        if position is not None:
            pose = position(world)
            x, y, heading = pose.x, pose.y, pose.heading
        elif entity is not None:
            x, y, heading = world.x[entity].copy(), world.y[entity].copy(), world.heading[entity].copy()
        else:
            raise InputError(f"{scope.source}, line {element.sourceline}: the trajectory has no start position.")
        begins = {k: place(world) for k, place in later.items()}
        reached = None if clock is None else clock.times(times)
        return ClothoidSpline(x, y, heading, start, end, length, reached, begins, turns)

    return lay_out


def _segment_times(
    element: etree._Element, segments: list[etree._Element], length: FloatArray, scope: Scope
) -> FloatArray:
    """Times at which the segments of a spline begin, and the last one ends; even between those that are given."""
    given: dict[int, FloatArray] = {
        k: scope.number(one, "timeStart") for k, one in enumerate(segments) if one.get("timeStart") is not None
    }
    places = np.concatenate([np.zeros((len(length), 1)), np.cumsum(length, axis=1)], axis=1)
    given = {0: np.zeros(len(length)), **given, len(segments): scope.number(element, "timeEnd", 0.0)}
    known = sorted(given)
    at, times = places[:, known], np.stack([given[k] for k in known], axis=1)
    # As a rule the file gives the same times to all scenarios.
    if (times == times[0]).all() and (places == places[0]).all():
        return np.tile(np.interp(places[0], at[0], times[0]), (len(places), 1))
    return np.stack([np.interp(*one) for one in zip(places, at, times, strict=True)])


def _nurbs(element: etree._Element, scope: Scope, world: World, read: PositionReader) -> Shape:
    controls, order = list(element.iterfind("ControlPoint")), scope.whole_number(element, "order")
    knots = np.array([scope.one_number(one, "value") for one in element.iterfind("Knot")])
    where = f"{scope.source}, line {element.sourceline}"
    if not 2 <= order <= len(controls) or len(knots) != len(controls) + order or (np.diff(knots) < 0).any():
        raise InputError(
            f"{where}: a <Nurbs> of order {order} with {len(controls)} control points needs"
            f" {len(controls) + order} rising knots, and at least as many control points as its order."
        )
    weights = np.array([scope.one_number(one, "weight", 1.0) for one in controls])
    if not (weights > 0).all():
        raise InputError(f"{where}: a weight of a <Nurbs> is not above 0.")
    positions = [read(_position(one, scope), scope, world) for one in controls]
    times = np.stack([scope.number(one, "time", 0.0) for one in controls], axis=1)

    def lay_out(
        world: World, smooth: bool = False, clock: Clock | None = None, entity: int | None = None
    ) -> Trajectory:
        poses = [_coordinates(position, world) for position in positions]
        x, y = np.stack([pose.x for pose in poses], axis=1), np.stack([pose.y for pose in poses], axis=1)
        px, py, heading, reached = nurbs_points(x, y, times, weights, knots, order)
        # On a curve, every heading is that of the curve, and turns from point to point.
        return Polyline(px, py, heading, None if clock is None else clock.times(reached), False, ALONG_LEGS)

    return lay_out


def _coordinates(position: Position, world: World) -> Pose:
    """Place as it is now, with a road only where it is found by its road."""
    return position.pose if isinstance(position, WorldPlace) else position(world)


def _position(element: etree._Element, scope: Scope) -> etree._Element:
    found = element.find("Position")
    if found is None or not len(found):
        raise InputError(f"{scope.source}, line {element.sourceline}: <{element.tag}> has no <Position>.")
    return found
