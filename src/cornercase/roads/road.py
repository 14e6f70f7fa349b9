"""One road of an OpenDRIVE file: its reference line, its lanes, and what they are linked to."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray, IntArray
from cornercase.roads.reference_line import Geometry, read_geometry, read_number

_LONGEST_ROAD: Final = 1e5
_DRIVABLE: Final = ("driving", "bidirectional", "entry", "exit", "onRamp", "offRamp", "connectingRamp")

Polynomial = tuple[float, float, float, float, float]


@dataclass(frozen=True)
class Lane:
    """A lane of one lane section."""

    kind: str
    widths: tuple[Polynomial, ...]
    borders: tuple[Polynomial, ...]
    predecessor: int | None
    successor: int | None

    @property
    def drivable(self) -> bool:
        """Whether vehicles may drive on it."""
        return self.kind in _DRIVABLE


@dataclass(frozen=True)
class Link:
    """What lies at an end of a road: another road's ``start`` or ``end``, or a junction."""

    kind: str
    element: str
    contact: str


@dataclass(frozen=True)
class Road:
    """A road; all in m and rad."""

    name: str
    length: float
    junction: str
    right_hand: bool
    geometries: tuple[Geometry, ...]
    offsets: tuple[Polynomial, ...]
    sections: tuple[tuple[float, dict[int, Lane]], ...]
    predecessor: Link | None
    successor: Link | None

    def reference(self, s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return x, y and heading of the reference line, each (N,)."""
        starts = np.array([g.s for g in self.geometries])
        piece = np.clip(np.searchsorted(starts, s, "right") - 1, 0, len(starts) - 1)
        x, y, heading = (np.empty(len(s)) for _ in range(3))
        for k in np.unique(piece):
            rows = piece == k
            x[rows], y[rows], heading[rows] = self.geometries[k].at(s[rows] - starts[k])
        return x, y, heading

    def at(self, s: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return x, y and heading of points beside the reference line, each (N,)."""
        x, y, heading = self.reference(s)
        return x - t * np.sin(heading), y + t * np.cos(heading), heading

    def section_at(self, s: FloatArray) -> IntArray:
        """Index of the lane section at each s, shape (N,)."""
        starts = np.array([start for start, _ in self.sections])
        return np.clip(np.searchsorted(starts, s, "right") - 1, 0, len(starts) - 1)

    def center(self, section: int, lane: int, s: FloatArray) -> FloatArray:
        """Lateral coordinate t of a lane's centre in a section, shape (N,)."""
        inner, outer = self._edges(section, lane, s)
        return 0.5 * (inner + outer)

    def width(self, section: int, lane: int, s: FloatArray) -> FloatArray:
        """Width of a lane in a section, shape (N,)."""
        inner, outer = self._edges(section, lane, s)
        return np.asarray(np.abs(outer - inner))

    def margins(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Lateral coordinates t of the road's right and left edge, each (N,)."""
        right, left = np.zeros(len(s)), np.zeros(len(s))
        section = self.section_at(s)
        for k in np.unique(section):
            rows, lanes = section == k, self.sections[int(k)][1]
            right[rows] = self._edges(int(k), min((*lanes, 0)), s[rows])[1]
            left[rows] = self._edges(int(k), max((*lanes, 0)), s[rows])[1]
        return right, left

    def along(self, lane: int) -> bool:
        """Whether traffic on the lane runs along s."""
        return lane == 0 or (lane < 0) == self.right_hand

    def _edges(self, section: int, lane: int, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        start, lanes = self.sections[section]
        sign = 1.0 if lane > 0 else -1.0
        zero = _polynomials(self.offsets, s)
        inner = outer = zero
        for i in range(1, abs(lane) + 1):
            inner = outer
            one = lanes.get(int(sign) * i)
            if one is None:
                continue
            if one.borders:
                outer = zero + _polynomials(one.borders, s - start)
            else:
                outer = inner + sign * np.maximum(_polynomials(one.widths, s - start), 0.0)
        return inner, outer


def read_road(element: etree._Element, where: str) -> Road:
    """Read a <road>.

    Parameters
    ----------
    element : lxml element
    where : str
        File and road, for messages.

    Raises
    ------
    InputError
        The road cannot be used.
    """
    length = read_number(element, "length", where)
    if length <= 0:
        raise InputError(f"{where}: has the length {length:g} m; it must be above 0.")
    if length > _LONGEST_ROAD:
        raise InputError(f"{where}: is {length:g} m long; at most {_LONGEST_ROAD:g} m are read.")
    geometries = tuple(
        sorted((read_geometry(e, where) for e in element.iterfind("planView/geometry")), key=lambda g: g.s)
    )
    if not geometries:
        raise InputError(f"{where}: has no <geometry> in its <planView>.")
    sections = tuple(
        (read_number(section, "s", where), dict(_lanes(section, where)))
        for section in element.iterfind("lanes/laneSection")
    )
    if not sections:
        raise InputError(f"{where}: has no <laneSection>.")
    return Road(
        element.get("id", ""),
        length,
        element.get("junction", "-1"),
        element.get("rule", "RHT") != "LHT",
        geometries,
        _read_polynomials(element.iterfind("lanes/laneOffset"), "s", where),
        tuple(sorted(sections, key=lambda section: section[0])),
        _link(element.find("link/predecessor")),
        _link(element.find("link/successor")),
    )


def _lanes(section: etree._Element, where: str) -> list[tuple[int, Lane]]:
    lanes = []
    for element in (*section.iterfind("left/lane"), *section.iterfind("right/lane")):
        links = [element.find(f"link/{end}") for end in ("predecessor", "successor")]
        numbers = [None if link is None else int(read_number(link, "id", where)) for link in links]
        lane = Lane(
            element.get("type", "none"),
            _read_polynomials(element.iterfind("width"), "sOffset", where),
            _read_polynomials(element.iterfind("border"), "sOffset", where),
            numbers[0],
            numbers[1],
        )
        lanes.append((int(read_number(element, "id", where)), lane))
    return lanes


def _link(element: etree._Element | None) -> Link | None:
    if element is None:
        return None
    return Link(element.get("elementType", "road"), element.get("elementId", ""), element.get("contactPoint", ""))


def _read_polynomials(elements: Iterable[etree._Element], name: str, where: str) -> tuple[Polynomial, ...]:
    found: list[Polynomial] = []
    for e in elements:
        start, a, b, c, d = (read_number(e, key, where) for key in (name, "a", "b", "c", "d"))
        found.append((start, a, b, c, d))
    return tuple(sorted(found))


def _polynomials(polynomials: tuple[Polynomial, ...], s: FloatArray) -> FloatArray:
    if not polynomials:
        return np.zeros(len(s))
    if len(polynomials) == 1:
        start, *cubic = polynomials[0]
        d = s - start
        return np.asarray(cubic[0] + d * (cubic[1] + d * (cubic[2] + d * cubic[3])))
    table = np.array(polynomials)
    k = np.clip(np.searchsorted(table[:, 0], s, "right") - 1, 0, len(table) - 1)
    d = s - table[k, 0]
    return np.asarray(table[k, 1] + d * (table[k, 2] + d * (table[k, 3] + d * table[k, 4])))
