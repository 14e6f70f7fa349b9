"""A road of an OpenDRIVE file: reference line, lanes and links."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.io.tracked_xml import find_untracked
from cornercase._common.text.element_locations import replace_line_number
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads._lane import (
    PERMANENT_LAYER,
    CubicPolynomial,
    LaneSection,
    differentiate_polynomials,
    evaluate_polynomials,
    is_in_permanent_layer,
    read_lane_sections,
    read_polynomials,
)
from cornercase.roads._lane_path import MIN_JUMP
from cornercase.roads._reference_line import (
    ReferenceGeometry,
    read_enumeration,
    read_finite_number,
    read_geometry,
    record_wrong_order,
)
from cornercase.roads._signs import RoadSignal, SpeedLimits, read_road_speed_limits, read_signals, speed_limit_at

_MIN_ROAD_LENGTH: Final = 1e-9
_MAX_ROAD_LENGTH: Final = 1e5
# Tolerance in m for rounded coordinates.
_COORDINATE_TOLERANCE: Final = 1e-6
# Largest lateral slope of a lane.
_MAX_LATERAL_SLOPE: Final = 10.0


@dataclass(frozen=True)
class RoadLink:
    """Link at one end of a road: to a junction, or to the start, the end or another position of a target road.

    `target_type` is ``"road"``, ``"junction"``, or empty if it is not known yet. `contact_point` is ``"start"`` or
    ``"end"`` of the target road. `s` is the position along the target road in m, for a link to another position.
    In this case `forward` tells whether a vehicle that follows increasing s on this road does so on the target road.
    """

    target_type: str
    target_id: str
    contact_point: str
    s: float | None = None
    forward: bool = True


@dataclass(frozen=True)
class Road:
    """A road. Lengths are in m, angles in rad."""

    road_id: str
    length: float
    junction: str
    is_right_hand_traffic: bool
    geometries: tuple[ReferenceGeometry, ...]
    lane_offsets: tuple[CubicPolynomial, ...]
    sections: tuple[LaneSection, ...]
    predecessor: RoadLink | None
    successor: RoadLink | None
    speed_limits: SpeedLimits = ()
    signals: tuple[RoadSignal, ...] = ()

    def reference_pose(self, s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return x, y and heading of the reference line at each s, shape (N,) each."""
        x, y, heading = (np.empty(len(s)) for _ in range(3))
        for geometry, rows in self._geometries_at(s):
            x[rows], y[rows], heading[rows] = geometry.pose_at(s[rows] - geometry.s)
        return x, y, heading

    def reference_curvature(self, s: FloatArray) -> FloatArray:
        """Return the curvature of the reference line at each s in 1/m, positive to the left, shape (N,)."""
        bend = np.empty(len(s))
        for geometry, rows in self._geometries_at(s):
            bend[rows] = geometry.curvature_at(s[rows] - geometry.s)
        return bend

    def sample_curvature(self, start: float, end: float, step: float) -> tuple[FloatArray, FloatArray]:
        """Return samples of the curvature for linear interpolation: s coordinates and curvatures, shape (K,) each.

        Where two geometries meet, s occurs twice, with the curvature of each. On poly3 and paramPoly3, samples are at
        most `step` m apart.
        """
        at, bend = [np.zeros(0)], [np.zeros(0)]
        for k, geometry in enumerate(self.geometries):
            is_last = k + 1 == len(self.geometries)
            first_s = start if k == 0 else max(start, geometry.s)
            last_s = end if is_last else min(end, self.geometries[k + 1].s)
            if first_s > last_s:
                continue
            steps = 1 if geometry.kind in ("line", "arc", "spiral") else int(np.ceil((last_s - first_s) / step))
            at.append(np.linspace(first_s, last_s, max(steps, 1) + 1))
            bend.append(geometry.curvature_at(at[-1] - geometry.s))
        return np.concatenate(at), np.concatenate(bend)

    @cached_property
    def jumps(self) -> tuple[float, ...]:
        """Coordinates s in m at which there is a gap between two consecutive geometries."""
        jumps = []
        for before, after in zip(self.geometries, self.geometries[1:], strict=False):
            x, y, _ = before.pose_at(np.array([after.s - before.s]))
            if np.hypot(x[0] - after.x, y[0] - after.y) > MIN_JUMP:
                jumps.append(after.s)
        return tuple(jumps)

    def _geometries_at(self, s: FloatArray) -> Iterator[tuple[ReferenceGeometry, BoolArray]]:
        """Yield each geometry on which some of the coordinates `s` lie, and a mask of these coordinates."""
        if len(self.geometries) == 1:
            yield self.geometries[0], np.ones(len(s), dtype=np.bool_)
            return
        starts = np.array([g.s for g in self.geometries])
        piece = np.clip(np.searchsorted(starts, s, "right") - 1, 0, len(starts) - 1)
        for k in np.unique(piece):
            yield self.geometries[k], piece == k

    def pose_at(self, s: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return x, y and heading at road coordinates s and t, shape (N,) each."""
        x, y, heading = self.reference_pose(s)
        return x - t * np.sin(heading), y + t * np.cos(heading), heading

    def lane_pose_at(
        self, lane: int, s: FloatArray, offset: FloatArray | float = 0.0
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return x, y and heading at a lateral offset in m from a lane's center, shape (N,) each.

        The offset is positive to the left of the reference line. The heading is that of the reference line.
        """
        section, t = self.section_at(s), np.empty(len(s))
        for k in sorted(set(section.tolist())):
            t[section == k] = self.lane_center(k, lane, s[section == k])
        return self.pose_at(s, t + offset)

    @cached_property
    def section_bounds(self) -> FloatArray:
        """Starts of all lane sections, and the end of the last section, in m; shape (number of sections + 1,)."""
        return np.array([*(start for start, _ in self.sections), self.length])

    def section_interval(self, section: int) -> tuple[float, float]:
        """Return start and end of a lane section, in m."""
        start, end = self.section_bounds[section : section + 2].tolist()
        return max(start, 0.0), max(end, start, 0.0)

    def section_at(self, s: FloatArray) -> IntArray:
        """Return the index of the lane section at each s, shape (N,)."""
        if len(self.sections) == 1:
            return np.zeros(len(s), dtype=np.int64)
        return np.clip(np.searchsorted(self.section_bounds[:-1], s, "right") - 1, 0, len(self.sections) - 1)

    def lane_center(self, section: int, lane: int, s: FloatArray) -> FloatArray:
        """Return the lateral coordinate t of a lane's center at each s in m, shape (N,)."""
        inner, outer = self.lane_edge_offsets(section, lane, s)
        return 0.5 * (inner + outer)

    def lane_width(self, section: int, lane: int, s: FloatArray) -> FloatArray:
        """Return the width of a lane at each s in m, shape (N,)."""
        inner, outer = self.lane_edge_offsets(section, lane, s)
        return np.asarray(np.abs(outer - inner))

    def lane_angle(self, section: int, lane: int, s: FloatArray) -> FloatArray:
        """Return the angle between the reference line and a lane's center line, in rad, shape (N,)."""
        inner, outer = self.lane_edge_offsets(section, lane, s, derivative=True)
        slope = 0.5 * (inner + outer)
        if not slope.any():
            return slope
        # On the inside of a bend a lane is shorter than the reference line.
        ahead = np.maximum(1.0 - self.reference_curvature(s) * self.lane_center(section, lane, s), 0.1)
        return np.asarray(np.arctan(np.clip(slope / ahead, -_MAX_LATERAL_SLOPE, _MAX_LATERAL_SLOPE)))

    def road_edge_offsets(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the lateral coordinates t of the road's right and left edge, shape (N,) each."""
        right, left = np.zeros(len(s)), np.zeros(len(s))
        section = self.section_at(s)
        for k in np.unique(section):
            rows, lanes = section == k, self.sections[int(k)][1]
            right[rows] = self.lane_edge_offsets(int(k), min((*lanes, 0)), s[rows])[1]
            left[rows] = self.lane_edge_offsets(int(k), max((*lanes, 0)), s[rows])[1]
        return right, left

    def is_traffic_forward(self, lane: int, s: FloatArray) -> BoolArray:
        """Return whether traffic on a lane runs in the direction of s, at each s, shape (N,)."""
        usual = lane == 0 or (lane < 0) == self.is_right_hand_traffic
        reverse = np.array([lane in lanes and lanes[lane].is_reversed for _, lanes in self.sections])
        return usual ^ reverse[self.section_at(s)]

    def speed_limit(self, section: int, lane: int, s: FloatArray) -> FloatArray:
        """Return the speed limit of a lane at each s in m/s, shape (N,).

        Where the lane has no limit of its own, the limit of the road holds; NaN if that is unknown, too.
        """
        start, lanes = self.sections[section]
        of_lane = speed_limit_at(lanes[lane].speed_limits if lane in lanes else (), s - start)
        return np.where(np.isnan(of_lane), speed_limit_at(self.speed_limits, s), of_lane)

    def lane_edge_offsets(
        self, section: int, lane: int, s: FloatArray, derivative: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """Return the lateral coordinates t of a lane's inner and outer edge at each s, shape (N,) each.

        The inner edge is the one nearer to lane 0. If `derivative` is set, return the derivatives of t by s.
        """
        start, lanes = self.sections[section]
        sign = 1 if lane > 0 else -1
        zero = evaluate_polynomials(
            differentiate_polynomials(self.lane_offsets) if derivative else self.lane_offsets, s
        )
        inner = outer = zero
        last_number = 0
        for number in sorted(
            n for n in (abs(candidate) for candidate in lanes if candidate * sign > 0) if n <= abs(lane)
        ):
            inner, last_number = outer, number
            current = lanes[sign * number]
            lines = current.borders or current.widths
            value = evaluate_polynomials(lines, s - start)
            change = evaluate_polynomials(differentiate_polynomials(lines), s - start) if derivative else value
            outer = zero + change if current.borders else inner + sign * np.where(value > 0.0, change, 0.0)
        # A lane that does not exist has no width.
        return (inner, outer) if last_number == abs(lane) else (outer, outer)


def read_road(element: etree._Element, location: str, forced_starts: Iterable[float] = ()) -> Road:
    """Read a <road>; `forced_starts` are positions in m along it where other roads start or end."""
    geometries = _read_geometries(element, location)
    length = read_finite_number(
        element, "length", location, max(geometry.s + geometry.length for geometry in geometries)
    )
    if length < _MIN_ROAD_LENGTH:
        raise InputError(f"{location}: <road> has the length {length:g} m; it must be at least {_MIN_ROAD_LENGTH:g} m.")
    if length > _MAX_ROAD_LENGTH:
        raise InputError(f"{location}: <road> is {length:g} m long; at most {_MAX_ROAD_LENGTH:g} m are allowed.")
    # Geometries of almost no length have no shape to continue.
    geometries = (
        tuple(geometry for geometry in geometries if geometry.length > _COORDINATE_TOLERANCE) or geometries[-1:]
    )
    if geometries[-1].length <= 0.0:
        raise InputError(f"{location}: a <geometry> has the length 0 m; it must be above 0.")
    lanes = find_permanent_lanes(element, location)
    sections = [] if lanes is None else lanes.findall("laneSection")
    if lanes is None or not sections:
        raise InputError(f"{location}: has no <laneSection>.")
    offsets = read_polynomials(lanes.iterfind("laneOffset"), "s", location)
    if offsets and offsets[0][0] > _COORDINATE_TOLERANCE:
        # As in CARLA, the first offset also holds before its start.
        offsets = ((0.0, offsets[0][1], 0.0, 0.0, 0.0), *offsets)
    return Road(
        element.get("id", ""),
        length,
        element.get("junction", "-1"),
        read_enumeration(element, "rule", ("RHT", "LHT"), "RHT", location) != "LHT",
        geometries,
        offsets,
        tuple(read_lane_sections(sections, length, forced_starts, location)),
        _read_road_link(element.find("link/predecessor"), location),
        _read_road_link(element.find("link/successor"), location),
        read_road_speed_limits(element),
        read_signals(element),
    )


def _read_geometries(road: etree._Element, location: str) -> tuple[ReferenceGeometry, ...]:
    """Return the geometries of the reference line, in the order of their starts."""
    elements, geometries = list(road.iterfind("planView/geometry")), list[ReferenceGeometry]()
    if not elements:
        raise InputError(f"{location}: has no <geometry> in its <planView>.")
    for k, element in enumerate(elements):
        start = geometries[-1].s + geometries[-1].length if geometries else 0.0
        following = elements[k + 1].attrib.get("s") if k + 1 < len(elements) else road.attrib.get("length")
        geometries.append(read_geometry(element, location, start, following))
    record_wrong_order(elements, [geometry.s for geometry in geometries])
    return tuple(sorted(geometries, key=lambda geometry: geometry.s))


def find_permanent_lanes(road: etree._Element, location: str) -> etree._Element | None:
    """Return the <lanes> of a road in its permanent state, without roadworks; None if the road has no <lanes>."""
    layers = find_untracked(road, "lanes")
    permanent = [element for element in layers if element.attrib.get("layer", PERMANENT_LAYER) == PERMANENT_LAYER]
    if len(permanent) > 1:
        raise InputError(
            f"{replace_line_number(location, permanent[1])}: has a second <lanes> of the layer"
            f" '{PERMANENT_LAYER}'; keep one of them, or give the other <lanes> another layer."
        )
    if layers and not permanent:
        layer = layers[0].attrib.get("layer")
        raise InputError(
            f"{replace_line_number(location, layers[0])}: has only <lanes> of the layer '{layer}'; give it"
            f" <lanes> of the layer"
            f" '{PERMANENT_LAYER}'."
        )
    return next((element for element in permanent if is_in_permanent_layer(element)), None)


def _read_road_link(element: etree._Element | None, location: str) -> RoadLink | None:
    if element is None:
        return None
    along = element.get("elementS") is not None
    return RoadLink(
        read_enumeration(element, "elementType", ("road", "junction"), "", location),
        element.get("elementId", ""),
        read_enumeration(element, "contactPoint", ("start", "end"), "", location),
        read_finite_number(element, "elementS", location) if along else None,
        element.get("elementDir", "+") != "-",
    )
