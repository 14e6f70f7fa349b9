"""Trajectory shapes as files and catalogs define them."""

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
"""Resolves a position in the world's current state."""

PositionReader = Callable[[etree._Element, Scope, World], Position]
"""Reads the position in an element."""


class WorldPlace:
    """A position given by coordinates; its road is looked up only when needed."""

    def __init__(self, pose: Pose) -> None:
        self.pose = pose

    def __call__(self, world: World) -> Pose:
        """Return the pose with its road."""
        if world.network is None:
            return self.pose
        return replace(self.pose, **world.network.locate(self.pose.x, self.pose.y)._asdict())


# s; times that differ by less are equal.
_SAME_TIME: Final = 1e-6


@dataclass(frozen=True)
class Clock:
    """Conversion of a file's times into a trajectory's: scaled, then shifted, each (N,)."""

    scale: FloatArray
    shift: FloatArray

    def times(self, given: FloatArray) -> FloatArray:
        """Convert times of the file, each (N, V).

        If they go back before the latest one, time stands still until it is reached again.
        """
        times = given * self.scale[:, None] + self.shift[:, None]
        latest = np.maximum.accumulate(times, axis=1)
        return np.where(times[:, -1:] == latest[:, -1:], latest, times)


class Shape(Protocol):
    """Builds a trajectory in the world's current state.

    `smooth` is the following mode ``follow``; without `clock` the trajectory has no times; `entity` follows it.
    """

    def __call__(
        self, world: World, smooth: bool = False, clock: Clock | None = None, entity: int | None = None
    ) -> Trajectory:
        """Return the trajectory."""
        ...


def read_trajectory(holder: etree._Element, scope: Scope, world: World, read: PositionReader) -> Shape:
    """Read the ``Trajectory`` or ``CatalogReference`` in `holder`; `read_position` reads positions of its vertices.

    `InputError` if there is none, or it is malformed.
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
    """Whether the trajectory in `holder` has different times.

    `InputError` if it has, but is closed: no time says when its first vertex is reached again. `BatchSplitError` if it
    has in some scenarios only.
    """
    element, inner = scope.referred(holder, "Trajectory")
    timed = [
        (part, name)
        for part in element.iterfind("Shape//*")
        for name in ("time", "startTime", "stopTime", "timeStart", "timeEnd")
        if part.get(name) is not None
    ]
    times_given = [inner.number(part, name) for part, name in timed]
    origins = {origin for part, name in timed for origin in inner.origins(part.get(name, ""))}
    if element.find("Shape/Polyline") is None and element.find("Shape/Nurbs") is None:
        # Missing times of clothoids are 0.
        times_given.append(np.zeros(scope.scenarios))
    differ = np.zeros(scope.scenarios, dtype=np.bool_)
    for values in times_given:
        differ |= np.abs(values - times_given[0]) > _SAME_TIME
    if differ.any() != differ.all():
        raise VariesError(origins)
    inner.used |= origins
    times = np.array(times_given)
    if {name for _, name in timed} == {"time"} and (times[-1] == times.max(axis=0)).all():
        back = next((k for k in range(1, len(timed)) if (times[k] < times[k - 1] - _SAME_TIME).any()), None)
        if back is not None:
            reason = f"time goes back to {times[back].min():g} s; vertices are skipped until it is reached again"
            adapt(timed[back][0], f"time of <{timed[back][0].tag}>", reason, "times of a trajectory never go back")
    if differ.all() and inner.flag(element, "closed", False):
        raise InputError(
            f"{scope.source}, line {element.sourceline}: a closed <Trajectory> has no time for its return to the"
            " first vertex; set closed to false, and repeat the first vertex at the end, with its time."
        )
    return bool(differ.all())


def _polyline(element: etree._Element, scope: Scope, world: World, read: PositionReader, closed: bool) -> Shape:
    vertices = list(element.iterfind("Vertex"))
    if len(vertices) < 2:
        raise InputError(f"{scope.source}, line {element.sourceline}: a <Polyline> needs at least two vertices.")
    resolve_vertices = _corners(element, vertices, scope, world, read)

    def lay_out(
        world: World, smooth: bool = False, clock: Clock | None = None, entity: int | None = None
    ) -> Trajectory:
        turning, begin_speed = ALONG_LEGS if smooth else AT_CORNERS, None
        if entity is not None:
            turning = world.entities[entity].turning or turning
        if smooth:
            begin_speed = np.zeros(world.scenarios) if entity is None else world.speed[entity].copy()
        x, y, heading, times = resolve_vertices(world)
        reached = None if clock is None else clock.times(times)
        return Polyline(x, y, heading, reached, closed, turning, begin_speed)

    return lay_out


_Corners = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""x, y, heading (NaN if the file gives none) and time of all vertices, each (N, V)."""


def _corners(
    element: etree._Element, vertices: list[etree._Element], scope: Scope, world: World, read: PositionReader
) -> Callable[[World], _Corners]:
    """Read the vertices of a polyline; the returned function resolves them in a world."""
    constant = made_once(element, "corners", lambda: _fixed_corners(vertices, scope, world, read))
    if constant is not None:
        x, y, heading, times = (np.tile(vertex, (scope.scenarios, 1)) for vertex in constant)
        return lambda world: (x, y, heading, times)
    positions = [read(_position(vertex, scope), scope, world) for vertex in vertices]
    oriented = _oriented(vertices)
    times = np.stack([scope.number(vertex, "time", 0.0) for vertex in vertices], axis=1)

    def corners(world: World) -> _Corners:
        poses = [_coordinates(position, world) for position in positions]
        headings = [
            pose.heading if has_heading else np.full_like(pose.heading, np.nan)
            for pose, has_heading in zip(poses, oriented, strict=True)
        ]
        x, y = np.stack([pose.x for pose in poses], axis=1), np.stack([pose.y for pose in poses], axis=1)
        return x, y, np.stack(headings, axis=1), times

    return corners


def _fixed_corners(
    vertices: list[etree._Element], scope: Scope, world: World, read: PositionReader
) -> tuple[FloatArray, ...] | None:
    """Rows of vertices, each (V,), if no parameter changes them and all are world positions; else None."""
    elements = [_position(vertex, scope) for vertex in vertices]
    if any(len(element) != 1 or element[0].tag != "WorldPosition" or len(element[0]) for element in elements):
        return None
    if any("$" in text for vertex in vertices for below in vertex.iter() for text in below.attrib.values()):
        return None
    positions = [read(element, scope, world) for element in elements]
    times = np.array([scope.one_number(vertex, "time", 0.0) for vertex in vertices])
    poses = [position.pose for position in positions if isinstance(position, WorldPlace)]
    x, y, heading = np.array([(pose.x[0], pose.y[0], pose.heading[0]) for pose in poses]).T
    return x, y, np.where(_oriented(vertices), heading, np.nan), times


def _oriented(vertices: list[etree._Element]) -> list[bool]:
    return [
        vertex.find("Position//Orientation[@h]") is not None or next(vertex.iterfind("Position/*")).get("h") is not None
        for vertex in vertices
    ]


def _clothoids(element: etree._Element, scope: Scope, world: World, read: PositionReader) -> Shape:
    segments = [element] if element.tag == "Clothoid" else list(element.iterfind("ClothoidSplineSegment"))
    if not segments:
        raise InputError(f"{scope.source}, line {element.sourceline}: a <ClothoidSpline> has no segments.")
    length = np.stack([scope.number(segment, "length") for segment in segments], axis=1)
    for segment, values in zip(segments, length.T, strict=True):
        if not scope.origins(segment.get("length", "")) and not values[0] > 0:
            raise InputError(f"{scope.source}, line {segment.sourceline}: length of <{segment.tag}> is not above 0.")
        scope.refuse(segment, "length", "is not above 0", ~(values > 0))
    length = np.where(length > 0, length, 1.0)
    if element.tag == "Clothoid":
        start = scope.number(element, "curvature")[:, None]
        name = "curvaturePrime" if element.get("curvatureDot") is None else "curvatureDot"
        end = start + scope.number(element, name)[:, None] * length
        times = np.stack([scope.number(element, name, 0.0) for name in ("startTime", "stopTime")], axis=1)
        holder = element.find("Position")
    else:
        start = np.stack([scope.number(segment, "curvatureStart") for segment in segments], axis=1)
        end = np.stack([scope.number(segment, "curvatureEnd") for segment in segments], axis=1)
        times = _segment_times(element, segments, length, scope)
        holder = segments[0].find("PositionStart")
    position = None if holder is None else read(holder, scope, world)
    # Start positions of later segments that do not continue the previous one.
    holders = {k: segment.find("PositionStart") for k, segment in enumerate(segments[1:], start=1)}
    later_starts = {k: read(holder, scope, world) for k, holder in holders.items() if holder is not None}
    turns = np.stack([scope.number(segment, "hOffset", 0.0) for segment in segments], axis=1)

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
        begins = {k: resolve(world) for k, resolve in later_starts.items()}
        reached = None if clock is None else clock.times(times)
        return ClothoidSpline(x, y, heading, start, end, length, reached, begins, turns)

    return lay_out


def _segment_times(
    element: etree._Element, segments: list[etree._Element], length: FloatArray, scope: Scope
) -> FloatArray:
    """Times at which spline segments begin, and the last one ends; evenly interpolated where not given."""
    given: dict[int, FloatArray] = {
        k: scope.number(segment, "timeStart")
        for k, segment in enumerate(segments)
        if segment.get("timeStart") is not None
    }
    distances = np.concatenate([np.zeros((len(length), 1)), np.cumsum(length, axis=1)], axis=1)
    given = {0: np.zeros(len(length)), **given, len(segments): scope.number(element, "timeEnd", 0.0)}
    indices = sorted(given)
    given_distances, times = distances[:, indices], np.stack([given[k] for k in indices], axis=1)
    # Usually the times are the same in all scenarios.
    if (times == times[0]).all() and (distances == distances[0]).all():
        return np.tile(np.interp(distances[0], given_distances[0], times[0]), (len(distances), 1))
    return np.stack([np.interp(*row) for row in zip(distances, given_distances, times, strict=True)])


def _nurbs(element: etree._Element, scope: Scope, world: World, read: PositionReader) -> Shape:
    controls, order = list(element.iterfind("ControlPoint")), scope.whole_number(element, "order")
    knots = np.array([scope.one_number(control, "value") for control in element.iterfind("Knot")])
    location = f"{scope.source}, line {element.sourceline}"
    if not 2 <= order <= len(controls) or len(knots) != len(controls) + order or (np.diff(knots) < 0).any():
        raise InputError(
            f"{location}: a <Nurbs> of order {order} with {len(controls)} control points needs"
            f" {len(controls) + order} rising knots, and at least as many control points as its order."
        )
    weights = np.array([scope.one_number(control, "weight", 1.0) for control in controls])
    if not (weights > 0).all():
        raise InputError(f"{location}: a weight of a <Nurbs> is not above 0.")
    positions = [read(_position(control, scope), scope, world) for control in controls]
    times = np.stack([scope.number(control, "time", 0.0) for control in controls], axis=1)

    def lay_out(
        world: World, smooth: bool = False, clock: Clock | None = None, entity: int | None = None
    ) -> Trajectory:
        poses = [_coordinates(position, world) for position in positions]
        x, y = np.stack([pose.x for pose in poses], axis=1), np.stack([pose.y for pose in poses], axis=1)
        px, py, heading, reached = nurbs_points(x, y, times, weights, knots, order)
        # On a curve, all headings are tangents, and change from point to point.
        return Polyline(px, py, heading, None if clock is None else clock.times(reached), False, ALONG_LEGS)

    return lay_out


def _coordinates(position: Position, world: World) -> Pose:
    """Current pose; with a road only if the position is given by its road."""
    return position.pose if isinstance(position, WorldPlace) else position(world)


def _position(element: etree._Element, scope: Scope) -> etree._Element:
    position = element.find("Position")
    if position is None or not len(position):
        raise InputError(f"{scope.source}, line {element.sourceline}: <{element.tag}> has no <Position>.")
    return position
