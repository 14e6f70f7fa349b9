"""One road of an OpenDRIVE file: reference line, lanes and links."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.places import at_line
from cornercase._common.recorded_xml import unrecorded
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads.lane import (
    PERMANENT,
    Polynomial,
    Section,
    differentiated,
    evaluate_polynomials,
    is_permanent,
    read_polynomials,
    read_sections,
)
from cornercase.roads.lane_path import APART
from cornercase.roads.reference_line import Geometry, note_disorder, read_geometry, read_number, read_word

_SHORTEST_ROAD: Final = 1e-9
_LONGEST_ROAD: Final = 1e5
# Tolerance in m for rounded coordinates.
_ROUNDING: Final = 1e-6
# Largest lateral slope of a lane.
_STEEPEST: Final = 10.0


@dataclass(frozen=True)
class Link:
    """What a road is linked to at one end: another road's ``start`` or ``end``, a position along it, or a junction.

    `target_type` is ``"road"``, ``"junction"`` or empty until it is resolved. `s` is the position along a road in m,
    where `forward` tells whether one continues along its s when coming along the s of the road that has the link.
    """

    kind: str
    element: str
    contact: str
    s: float | None = None
    forward: bool = True


@dataclass(frozen=True)
class Road:
    """A road; all in m and rad."""

    name: str
    length: float
    junction: str
    right_hand: bool
    geometries: tuple[Geometry, ...]
    offsets: tuple[Polynomial, ...]
    sections: tuple[Section, ...]
    predecessor: Link | None
    successor: Link | None

    def reference(self, s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return x, y and heading of the reference line, shape (N,) each."""
        x, y, heading = (np.empty(len(s)) for _ in range(3))
        for geometry, rows in self._pieces(s):
            x[rows], y[rows], heading[rows] = geometry.at(s[rows] - geometry.s)
        return x, y, heading

    def bend(self, s: FloatArray) -> FloatArray:
        """Return the curvature of the reference line in 1/m, positive to the left, shape (N,)."""
        bend = np.empty(len(s))
        for geometry, rows in self._pieces(s):
            bend[rows] = geometry.bend(s[rows] - geometry.s)
        return bend

    def bends(self, start: float, end: float, step: float) -> tuple[FloatArray, FloatArray]:
        """Return s coordinates and curvatures, shape (K,), that are piecewise linear with jumps.

        For polynomials, coordinates are at most `step` m apart.
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
            bend.append(geometry.bend(at[-1] - geometry.s))
        return np.concatenate(at), np.concatenate(bend)

    @cached_property
    def jumps(self) -> tuple[float, ...]:
        """Coordinates s at which consecutive geometries do not meet, in m."""
        jumps = []
        for before, after in zip(self.geometries, self.geometries[1:], strict=False):
            x, y, _ = before.at(np.array([after.s - before.s]))
            if np.hypot(x[0] - after.x, y[0] - after.y) > APART:
                jumps.append(after.s)
        return tuple(jumps)

    def _pieces(self, s: FloatArray) -> Iterator[tuple[Geometry, BoolArray]]:
        """Yield geometries, and which of the coordinates are on each."""
        if len(self.geometries) == 1:
            yield self.geometries[0], np.ones(len(s), dtype=np.bool_)
            return
        starts = np.array([g.s for g in self.geometries])
        piece = np.clip(np.searchsorted(starts, s, "right") - 1, 0, len(starts) - 1)
        for k in np.unique(piece):
            yield self.geometries[k], piece == k

    def at(self, s: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return x, y and heading at road coordinates s and t, shape (N,) each."""
        x, y, heading = self.reference(s)
        return x - t * np.sin(heading), y + t * np.cos(heading), heading

    def at_lane(
        self, lane: int, s: FloatArray, offset: FloatArray | float = 0.0
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return x, y and the heading of the reference line beside a lane's center, shape (N,) each."""
        section, t = self.section_at(s), np.empty(len(s))
        for k in sorted(set(section.tolist())):
            t[section == k] = self.center(k, lane, s[section == k])
        return self.at(s, t + offset)

    @cached_property
    def seams(self) -> FloatArray:
        """Starts of lane sections, and the end of the last one, in m, shape (sections + 1,)."""
        return np.array([*(start for start, _ in self.sections), self.length])

    def section_span(self, section: int) -> tuple[float, float]:
        """Return start and end of a lane section, in m."""
        start, end = self.seams[section : section + 2].tolist()
        return max(start, 0.0), max(end, start, 0.0)

    def section_at(self, s: FloatArray) -> IntArray:
        """Return the index of the lane section at each s, shape (N,)."""
        if len(self.sections) == 1:
            return np.zeros(len(s), dtype=np.int64)
        return np.clip(np.searchsorted(self.seams[:-1], s, "right") - 1, 0, len(self.sections) - 1)

    def center(self, section: int, lane: int, s: FloatArray) -> FloatArray:
        """Return the lateral coordinate t of a lane's center, shape (N,)."""
        inner, outer = self.edges(section, lane, s)
        return 0.5 * (inner + outer)

    def width(self, section: int, lane: int, s: FloatArray) -> FloatArray:
        """Return the width of a lane, shape (N,)."""
        inner, outer = self.edges(section, lane, s)
        return np.asarray(np.abs(outer - inner))

    def slant(self, section: int, lane: int, s: FloatArray) -> FloatArray:
        """Return the angle between the reference line and a lane's center line, in rad, shape (N,)."""
        inner, outer = self.edges(section, lane, s, rate=True)
        slope = 0.5 * (inner + outer)
        if not slope.any():
            return slope
        # On the inside of a bend a lane is shorter than the reference line.
        ahead = np.maximum(1.0 - self.bend(s) * self.center(section, lane, s), 0.1)
        return np.asarray(np.arctan(np.clip(slope / ahead, -_STEEPEST, _STEEPEST)))

    def margins(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the lateral coordinates t of the road's right and left edge, shape (N,) each."""
        right, left = np.zeros(len(s)), np.zeros(len(s))
        section = self.section_at(s)
        for k in np.unique(section):
            rows, lanes = section == k, self.sections[int(k)][1]
            right[rows] = self.edges(int(k), min((*lanes, 0)), s[rows])[1]
            left[rows] = self.edges(int(k), max((*lanes, 0)), s[rows])[1]
        return right, left

    def along(self, lane: int, s: FloatArray) -> BoolArray:
        """Return whether traffic on a lane runs along s, shape (N,)."""
        usual = lane == 0 or (lane < 0) == self.right_hand
        reverse = np.array([lane in lanes and lanes[lane].reverse for _, lanes in self.sections])
        return usual ^ reverse[self.section_at(s)]

    def edges(self, section: int, lane: int, s: FloatArray, rate: bool = False) -> tuple[FloatArray, FloatArray]:
        """Return the lateral coordinates t of a lane's inner and outer edge, or their derivatives by s, (N,)."""
        start, lanes = self.sections[section]
        sign = 1 if lane > 0 else -1
        zero = evaluate_polynomials(differentiated(self.offsets) if rate else self.offsets, s)
        inner = outer = zero
        last_number = 0
        for number in sorted(
            n for n in (abs(candidate) for candidate in lanes if candidate * sign > 0) if n <= abs(lane)
        ):
            inner, last_number = outer, number
            current = lanes[sign * number]
            lines = current.borders or current.widths
            value = evaluate_polynomials(lines, s - start)
            change = evaluate_polynomials(differentiated(lines), s - start) if rate else value
            outer = zero + change if current.borders else inner + sign * np.where(value > 0.0, change, 0.0)
        # A lane that does not exist has no width.
        return (inner, outer) if last_number == abs(lane) else (outer, outer)


def read_road(element: etree._Element, where: str, cuts: Iterable[float] = ()) -> Road:
    """Read a <road>; `forced_starts` are positions in m at which other roads start or end along it."""
    geometries = _geometries(element, where)
    length = read_number(element, "length", where, max(geometry.s + geometry.length for geometry in geometries))
    if length < _SHORTEST_ROAD:
        raise InputError(f"{where}: <road> has the length {length:g} m; it must be at least {_SHORTEST_ROAD:g} m.")
    if length > _LONGEST_ROAD:
        raise InputError(f"{where}: <road> is {length:g} m long; at most {_LONGEST_ROAD:g} m are read.")
    # Geometries of almost no length have no shape to continue.
    geometries = tuple(geometry for geometry in geometries if geometry.length > _ROUNDING) or geometries[-1:]
    if geometries[-1].length <= 0.0:
        raise InputError(f"{where}: a <geometry> has the length 0 m; it must be above 0.")
    lanes = permanent_lanes(element, where)
    sections = [] if lanes is None else lanes.findall("laneSection")
    if lanes is None or not sections:
        raise InputError(f"{where}: has no <laneSection>.")
    offsets = read_polynomials(lanes.iterfind("laneOffset"), "s", where)
    if offsets and offsets[0][0] > _ROUNDING:
        # As in CARLA, the first offset also holds before its start.
        offsets = ((0.0, offsets[0][1], 0.0, 0.0, 0.0), *offsets)
    return Road(
        element.get("id", ""),
        length,
        element.get("junction", "-1"),
        read_word(element, "rule", ("RHT", "LHT"), "RHT", where) != "LHT",
        geometries,
        offsets,
        tuple(read_sections(sections, length, cuts, where)),
        _link(element.find("link/predecessor"), where),
        _link(element.find("link/successor"), where),
    )


def _geometries(road: etree._Element, where: str) -> tuple[Geometry, ...]:
    """Return the geometries of the reference line, in order."""
    elements, geometries = list(road.iterfind("planView/geometry")), list[Geometry]()
    if not elements:
        raise InputError(f"{where}: has no <geometry> in its <planView>.")
    for k, element in enumerate(elements):
        start = geometries[-1].s + geometries[-1].length if geometries else 0.0
        following = elements[k + 1].attrib.get("s") if k + 1 < len(elements) else road.attrib.get("length")
        geometries.append(read_geometry(element, where, start, following))
    note_disorder(elements, [geometry.s for geometry in geometries])
    return tuple(sorted(geometries, key=lambda one: one.s))


def permanent_lanes(road: etree._Element, where: str) -> etree._Element | None:
    """Return the <lanes> of the permanent layer; None if the road has no <lanes>."""
    layers = unrecorded(road, "lanes")
    permanent = [element for element in layers if element.attrib.get("layer", PERMANENT) == PERMANENT]
    if len(permanent) > 1:
        raise InputError(
            f"{at_line(where, permanent[1])}: has a second <lanes> of the layer '{PERMANENT}'; keep one of them,"
            " or name the layer of the other."
        )
    if layers and not permanent:
        layer = layers[0].attrib.get("layer")
        raise InputError(
            f"{at_line(where, layers[0])}: has only <lanes> of the layer '{layer}'; give it <lanes> of the layer"
            f" '{PERMANENT}'."
        )
    return next((element for element in permanent if is_permanent(element)), None)


def _link(element: etree._Element | None, where: str) -> Link | None:
    if element is None:
        return None
    along = element.get("elementS") is not None
    return Link(
        read_word(element, "elementType", ("road", "junction"), "", where),
        element.get("elementId", ""),
        read_word(element, "contactPoint", ("start", "end"), "", where),
        read_number(element, "elementS", where) if along else None,
        element.get("elementDir", "+") != "-",
    )
