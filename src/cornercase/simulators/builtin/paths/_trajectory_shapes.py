"""Reader of the shapes of trajectories in scenario files and catalogs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.io.tracked_xml import cached_on_element, note_adaptation
from cornercase._common.typing import FloatArray
from cornercase.scenario._batch_split import BatchSplitError
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.track_kernels._track_layout import ALONG_SEGMENTS, AT_CORNERS
from cornercase.simulators.builtin.tracks._clothoid_spline import ClothoidSpline
from cornercase.simulators.builtin.tracks._nurbs import evaluate_nurbs
from cornercase.simulators.builtin.tracks._polyline import Polyline
from cornercase.simulators.builtin.tracks._track import Pose, Trajectory
from cornercase.simulators.builtin.world._world import World

PositionResolver = Callable[[World], Pose]
"""Function that returns the pose of a position in the current state of a world."""

PositionReader = Callable[[etree._Element, Scope, World], PositionResolver]
"""Function that reads the position in an element, and returns a resolver for it."""


class WorldPosition:
    """A position given by x and y; the road at this position is looked up only when needed."""

    def __init__(self, pose: Pose) -> None:
        self.pose = pose

    def __call__(self, world: World) -> Pose:
        if world.network is None:
            return self.pose
        return replace(self.pose, **world.network.locate(self.pose.x, self.pose.y)._asdict())


# s; times that differ by less are equal.
_TIME_TOLERANCE: Final = 1e-6


@dataclass(frozen=True)
class TimeConversion:
    """Conversion of times in a file into times of a trajectory: factor `scale`, then offset `shift` in s, both (N,)."""

    scale: FloatArray
    shift: FloatArray

    def convert(self, file_times: FloatArray) -> FloatArray:
        """Convert times in s from the file, shape (N, V): one row of V successive times per scenario.

        If the last time of a row is the largest, the converted times never decrease: a smaller time is replaced by the
        largest time before it.
        """
        times = file_times * self.scale[:, None] + self.shift[:, None]
        latest = np.maximum.accumulate(times, axis=1)
        return np.where(times[:, -1:] == latest[:, -1:], latest, times)


TrajectoryBuilder = Callable[[World, bool, TimeConversion | None, int | None], Trajectory]
"""Function that builds a trajectory for the current state of a world.

The other arguments say whether the following mode is ``follow``, how times are converted (None: without times), and
which entity follows the trajectory (None: no entity).
"""


def read_trajectory(
    holder: etree._Element, scope: Scope, world: World, read_position: PositionReader
) -> TrajectoryBuilder:
    """Read the ``Trajectory`` or ``CatalogReference`` in an element; return a function that builds the trajectory.

    `read_position` reads the positions in the trajectory.
    """
    element, inner = scope.resolve_element_or_reference(holder, "Trajectory")
    shape = element.find("Shape")
    kind = None if shape is None else shape.find("*")
    if kind is None or kind.tag not in ("Polyline", "Clothoid", "ClothoidSpline", "Nurbs"):
        raise scope.error_at(element, "a <Trajectory> needs a <Polyline>, <Clothoid>, <ClothoidSpline> or <Nurbs>.")
    closed = inner.read_boolean(element, "closed", False)
    if kind.tag == "Polyline":
        return _read_polyline(kind, inner, world, read_position, closed)
    if closed:
        raise scope.error_at(element, "only a <Polyline> can be a closed <Trajectory>; set closed to false.")
    return (_read_nurbs if kind.tag == "Nurbs" else _read_clothoids)(kind, inner, world, read_position)


def has_times(holder: etree._Element, scope: Scope) -> bool:
    """Return whether the trajectory in an element has times; times that are all equal count as no times.

    Raises `BatchSplitError` if the trajectory has times in some scenarios only.
    """
    element, inner = scope.resolve_element_or_reference(holder, "Trajectory")
    timed = [
        (part, name)
        for part in element.iterfind("Shape//*")
        for name in ("time", "startTime", "stopTime", "timeStart", "timeEnd")
        if part.get(name) is not None
    ]
    times_given = [inner.read_numbers(part, name) for part, name in timed]
    origins = {origin for part, name in timed for origin in inner.find_origin_parameters(part.get(name, ""))}
    if element.find("Shape/Polyline") is None and element.find("Shape/Nurbs") is None:
        # Missing times of clothoids are 0.
        times_given.append(np.zeros(scope.n_scenarios))
    differ = np.zeros(scope.n_scenarios, dtype=np.bool_)
    for values in times_given:
        differ |= np.abs(values - times_given[0]) > _TIME_TOLERANCE
    if differ.any() != differ.all():
        raise BatchSplitError(origins)
    inner.split_parameters |= origins
    times = np.array(times_given)
    if {name for _, name in timed} == {"time"} and (times[-1] == times.max(axis=0)).all():
        back = next((k for k in range(1, len(timed)) if (times[k] < times[k - 1] - _TIME_TOLERANCE).any()), None)
        if back is not None:
            reason = f"time goes back to {times[back].min():g} s; vertices are skipped until it is reached again"
            note_adaptation(
                timed[back][0], f"time of <{timed[back][0].tag}>", reason, "times of a trajectory never go back"
            )
    if differ.all() and inner.read_boolean(element, "closed", False):
        raise scope.error_at(
            element,
            "a closed <Trajectory> has no time for its return to the first vertex; set closed to false, and add the"
            " first vertex again at the end, with the time of the return.",
        )
    return bool(differ.all())


def _read_polyline(
    element: etree._Element, scope: Scope, world: World, read_position: PositionReader, closed: bool
) -> TrajectoryBuilder:
    vertices = list(element.iterfind("Vertex"))
    if len(vertices) < 2:
        raise scope.error_at(element, "a <Polyline> needs at least two vertices.")
    resolve_vertices = _read_vertices(element, vertices, scope, world, read_position)

    def build_trajectory(world: World, smooth: bool, clock: TimeConversion | None, entity: int | None) -> Trajectory:
        turning, begin_speed = ALONG_SEGMENTS if smooth else AT_CORNERS, None
        chosen = None if entity is None else world.entities[entity].polyline_turning
        turning = turning if chosen is None else chosen
        if smooth:
            begin_speed = np.zeros(world.scenarios) if entity is None else world.speed[entity].copy()
        x, y, heading, times = resolve_vertices(world)
        reached = None if clock is None else clock.convert(times)
        return Polyline(x, y, heading, reached, closed, turning, begin_speed)

    return build_trajectory


_Vertices = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""x, y, heading (NaN if not given in the file) and time of all vertices, shape (N, V) each."""


def _read_vertices(
    element: etree._Element, vertices: list[etree._Element], scope: Scope, world: World, read_position: PositionReader
) -> Callable[[World], _Vertices]:
    """Read the vertices of a polyline; return a function that resolves the vertices in the state of a world."""
    constant = cached_on_element(
        element, "corners", lambda: _read_constant_vertices(vertices, scope, world, read_position)
    )
    if constant is not None:
        x, y, heading, times = (np.tile(vertex, (scope.n_scenarios, 1)) for vertex in constant)
        return lambda world: (x, y, heading, times)
    positions = [read_position(_require_position(vertex, scope), scope, world) for vertex in vertices]
    oriented = _vertices_with_heading(vertices)
    times = np.stack([scope.read_numbers(vertex, "time", 0.0) for vertex in vertices], axis=1)

    def resolve_vertices(world: World) -> _Vertices:
        poses = [_resolve_coordinates(position, world) for position in positions]
        headings = [
            pose.heading if has_heading else np.full_like(pose.heading, np.nan)
            for pose, has_heading in zip(poses, oriented, strict=True)
        ]
        x, y = np.stack([pose.x for pose in poses], axis=1), np.stack([pose.y for pose in poses], axis=1)
        return x, y, np.stack(headings, axis=1), times

    return resolve_vertices


def _read_constant_vertices(
    vertices: list[etree._Element], scope: Scope, world: World, read_position: PositionReader
) -> tuple[FloatArray, ...] | None:
    """Return x, y, heading and time of V vertices, shape (V,) each, if they are the same in all scenarios.

    Returns None unless all vertices are world positions without parameters.
    """
    elements = [_require_position(vertex, scope) for vertex in vertices]
    if any(len(element) != 1 or element[0].tag != "WorldPosition" or len(element[0]) for element in elements):
        return None
    if any("$" in text for vertex in vertices for below in vertex.iter() for text in below.attrib.values()):
        return None
    positions = [read_position(element, scope, world) for element in elements]
    times = np.array([scope.read_number(vertex, "time", 0.0) for vertex in vertices])
    poses = [position.pose for position in positions if isinstance(position, WorldPosition)]
    x, y, heading = np.array([(pose.x[0], pose.y[0], pose.heading[0]) for pose in poses]).T
    return x, y, np.where(_vertices_with_heading(vertices), heading, np.nan), times


def _vertices_with_heading(vertices: list[etree._Element]) -> list[bool]:
    return [
        vertex.find("Position//Orientation[@h]") is not None or next(vertex.iterfind("Position/*")).get("h") is not None
        for vertex in vertices
    ]


def _read_clothoids(
    element: etree._Element, scope: Scope, world: World, read_position: PositionReader
) -> TrajectoryBuilder:
    segments = [element] if element.tag == "Clothoid" else list(element.iterfind("ClothoidSplineSegment"))
    if not segments:
        raise scope.error_at(element, "a <ClothoidSpline> has no segments.")
    length = np.stack([scope.read_numbers(segment, "length") for segment in segments], axis=1)
    for segment, values in zip(segments, length.T, strict=True):
        if not scope.find_origin_parameters(segment.get("length", "")) and not values[0] > 0:
            raise scope.error_at(segment, f"length of <{segment.tag}> is not above 0.")
        scope.mark_invalid(segment, "length", "is not above 0", ~(values > 0))
    length = np.where(length > 0, length, 1.0)
    if element.tag == "Clothoid":
        start = scope.read_numbers(element, "curvature")[:, None]
        name = "curvaturePrime" if element.get("curvatureDot") is None else "curvatureDot"
        end = start + scope.read_numbers(element, name)[:, None] * length
        times = np.stack([scope.read_numbers(element, name, 0.0) for name in ("startTime", "stopTime")], axis=1)
        holder = element.find("Position")
    else:
        start = np.stack([scope.read_numbers(segment, "curvatureStart") for segment in segments], axis=1)
        end = np.stack([scope.read_numbers(segment, "curvatureEnd") for segment in segments], axis=1)
        times = _read_segment_times(element, segments, length, scope)
        holder = segments[0].find("PositionStart")
    position = None if holder is None else read_position(holder, scope, world)
    # Start positions of later segments that do not continue the previous one.
    holders = {k: segment.find("PositionStart") for k, segment in enumerate(segments[1:], start=1)}
    later_starts = {k: read_position(holder, scope, world) for k, holder in holders.items() if holder is not None}
    turns = np.stack([scope.read_numbers(segment, "hOffset", 0.0) for segment in segments], axis=1)

    def build_trajectory(world: World, smooth: bool, clock: TimeConversion | None, entity: int | None) -> Trajectory:
        if position is not None:
            pose = position(world)
            x, y, heading = pose.x, pose.y, pose.heading
        elif entity is not None:
            x, y, heading = world.x[entity].copy(), world.y[entity].copy(), world.heading[entity].copy()
        else:
            raise scope.error_at(element, "the trajectory has no start position.")
        begins = {k: resolve(world) for k, resolve in later_starts.items()}
        reached = None if clock is None else clock.convert(times)
        return ClothoidSpline(x, y, heading, start, end, length, reached, begins, turns)

    return build_trajectory


def _read_segment_times(
    element: etree._Element, segments: list[etree._Element], length: FloatArray, scope: Scope
) -> FloatArray:
    """Return the times in s at which the segments of a spline begin, and the time at which the last segment ends.

    Missing times are interpolated, but a missing first or last time is 0.
    """
    given: dict[int, FloatArray] = {
        k: scope.read_numbers(segment, "timeStart")
        for k, segment in enumerate(segments)
        if segment.get("timeStart") is not None
    }
    distances = np.concatenate([np.zeros((len(length), 1)), np.cumsum(length, axis=1)], axis=1)
    given = {0: np.zeros(len(length)), **given, len(segments): scope.read_numbers(element, "timeEnd", 0.0)}
    indices = sorted(given)
    given_distances, times = distances[:, indices], np.stack([given[k] for k in indices], axis=1)
    # Usually the times are the same in all scenarios.
    if (times == times[0]).all() and (distances == distances[0]).all():
        return np.tile(np.interp(distances[0], given_distances[0], times[0]), (len(distances), 1))
    return np.stack([np.interp(*row) for row in zip(distances, given_distances, times, strict=True)])


def _read_nurbs(
    element: etree._Element, scope: Scope, world: World, read_position: PositionReader
) -> TrajectoryBuilder:
    controls, order = list(element.iterfind("ControlPoint")), scope.read_integer(element, "order")
    knots = np.array([scope.read_number(control, "value") for control in element.iterfind("Knot")])
    if not 2 <= order <= len(controls) or len(knots) != len(controls) + order or (np.diff(knots) < 0).any():
        raise scope.error_at(
            element,
            f"a <Nurbs> of order {order} with {len(controls)} control points needs"
            f" {len(controls) + order} knots that do not decrease, an order of at least 2, and at least as many control"
            " points as its order.",
        )
    weights = np.array([scope.read_number(control, "weight", 1.0) for control in controls])
    if not (weights > 0).all():
        raise scope.error_at(element, "a weight of a <Nurbs> is not above 0.")
    positions = [read_position(_require_position(control, scope), scope, world) for control in controls]
    times = np.stack([scope.read_numbers(control, "time", 0.0) for control in controls], axis=1)

    def build_trajectory(world: World, smooth: bool, clock: TimeConversion | None, entity: int | None) -> Trajectory:
        poses = [_resolve_coordinates(position, world) for position in positions]
        x, y = np.stack([pose.x for pose in poses], axis=1), np.stack([pose.y for pose in poses], axis=1)
        px, py, heading, reached = evaluate_nurbs(x, y, times, weights, knots, order)
        # On a curve, all headings are tangents, which change continuously from point to point.
        return Polyline(px, py, heading, None if clock is None else clock.convert(reached), False, ALONG_SEGMENTS)

    return build_trajectory


def _resolve_coordinates(position: PositionResolver, world: World) -> Pose:
    """Return the present pose of a position, without looking up the road of a position given by x and y."""
    return position.pose if isinstance(position, WorldPosition) else position(world)


def _require_position(element: etree._Element, scope: Scope) -> etree._Element:
    position = element.find("Position")
    if position is None or not len(position):
        raise scope.error_at(element, f"<{element.tag}> has no <Position>.")
    return position
