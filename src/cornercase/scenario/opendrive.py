"""OpenDRIVE road networks: lanes in the plane, and the way from lane to lane."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from lxml import etree
from scipy.spatial import cKDTree

from cornercase.errors import InputError, suggestion
from cornercase.scenario.lane_path import STEP, LanePath, join
from cornercase.scenario.reference_line import Geometry, read_geometry
from cornercase.scenario.xml import read_xml
from cornercase.typing import BoolArray, FloatArray, IntArray

_LONGEST_PATH: Final = 5000.0
_MOST_ROADS: Final = 500
_DRIVABLE: Final = ("driving", "bidirectional", "entry", "exit", "onRamp", "offRamp", "connectingRamp")

Polynomial = tuple[float, float, float, float, float]


class Place(NamedTuple):
    """Where points are on the roads, each array of shape (N,).

    Attributes
    ----------
    road, lane : ndarray of int64
        Index of the road, and lane.
    s, offset : ndarray of float64
        Along the road, and to the left of the lane's centre as seen along the road, in m.
    """

    road: IntArray
    lane: IntArray
    s: FloatArray
    offset: FloatArray


@dataclass(frozen=True)
class Lane:
    """A lane of one lane section."""

    kind: str
    widths: tuple[Polynomial, ...]
    borders: tuple[Polynomial, ...]
    predecessor: int | None
    successor: int | None


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

    def along(self, lane: int) -> bool:
        """Whether traffic on the lane runs along s."""
        return (lane < 0) == self.right_hand

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


@dataclass(frozen=True, eq=False)
class RoadNetwork:
    """All roads of an OpenDRIVE file.

    Attributes
    ----------
    path : Path
    roads : tuple of Road
    connections : dict
        Junction to its (incoming road, connecting road, contact point, lane links).
    """

    path: Path
    roads: tuple[Road, ...]
    connections: dict[str, tuple[tuple[str, str, str, dict[int, int]], ...]] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path | str) -> RoadNetwork:
        """Read an OpenDRIVE file, of version 1.4 to 1.8; elevation is left out.

        Raises
        ------
        InputError
            The file cannot be used; the message names the road.
        """
        path = Path(path)
        root = read_xml(path)
        for element in root.iter():
            if isinstance(element.tag, str) and "}" in element.tag:
                element.tag = element.tag.split("}", 1)[1]
        if root.tag != "OpenDRIVE":
            raise InputError(f"{path}: the root element is <{root.tag}>; a road file starts with <OpenDRIVE>.")
        roads = tuple(_road(e, f"{path}, road {e.get('id')}") for e in root.iterfind("road"))
        if not roads:
            raise InputError(f"{path}: has no <road>.")
        names = [road.name for road in roads]
        if len(set(names)) < len(names):
            raise InputError(f"{path}: two roads have the same id.")
        for road in roads:
            for link in (road.predecessor, road.successor):
                if link is not None and link.kind == "road" and link.element not in names:
                    raise InputError(
                        f"{path}, road {road.name}: is linked to the road {link.element}, which does not exist."
                    )
        return cls(path, roads, {e.get("id", ""): tuple(_connections(e)) for e in root.iterfind("junction")})

    @cached_property
    def lengths(self) -> FloatArray:
        """Length of each road in m."""
        return np.array([road.length for road in self.roads])

    def index_of(self, name: str) -> int:
        """Index of the road with an id.

        Raises
        ------
        InputError
            There is none.
        """
        if name not in self._index:
            raise InputError(f"{self.path}: has no road '{name}'; {suggestion(name, self._index)}")
        return self._index[name]

    @cached_property
    def _index(self) -> dict[str, int]:
        return {road.name: i for i, road in enumerate(self.roads)}

    def has_lane(self, road: int, lane: int) -> bool:
        """Whether a road has a lane of that number anywhere."""
        return lane != 0 and any(lane in lanes for _, lanes in self.roads[road].sections)

    def runs_along(self, road: int, lane: int) -> bool:
        """Whether traffic on a lane runs along the road's s."""
        return self.roads[road].along(lane)

    def road_world(self, road: int, s: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return x, y and heading of the road's direction at road coordinates, each (N,)."""
        return self.roads[road].at(s, t)

    def world(
        self, road: int, lane: int, s: FloatArray, offset: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return x, y and heading of the lane's traffic, `offset` to the left of its centre along s, each (N,)."""
        one = self.roads[road]
        section = one.section_at(s)
        t = np.empty(len(s))
        for k in np.unique(section):
            t[section == k] = one.center(int(k), lane, s[section == k])
        x, y, heading = one.at(s, t + offset)
        return x, y, heading if one.along(lane) else heading + np.pi

    def locate(self, x: FloatArray, y: FloatArray) -> Place:
        """Where points are on the roads; a lane that holds the point beats a nearer one, driving beats others."""
        tree, road, lane, s, half, bad = self._samples
        known = np.isfinite(x) & np.isfinite(y)
        points = np.stack([np.where(known, x, 0.0), np.where(known, y, 0.0)], axis=1)
        gap, near = tree.query(points, k=min(24, len(road)))
        gap, near = np.reshape(gap, (len(x), -1)), np.reshape(near, (len(x), -1))
        cost = np.maximum(gap - half[near], 0.0) + 1e-3 * gap + np.where(gap <= half[near], 0.01, 0.0) * bad[near]
        best = near[np.arange(len(x)), cost.argmin(axis=1)]
        place = Place(road[best], lane[best], s[best].copy(), np.zeros(len(x)))
        for r, ln in sorted({*zip(place.road.tolist(), place.lane.tolist(), strict=True)}):
            rows = (place.road == r) & (place.lane == ln)
            for _ in range(2):
                cx, cy, heading = self.world(r, ln, place.s[rows], np.zeros(int(rows.sum())))
                heading = heading if self.runs_along(r, ln) else heading - np.pi
                dx, dy = points[rows, 0] - cx, points[rows, 1] - cy
                step = dx * np.cos(heading) + dy * np.sin(heading)
                place.s[rows] = np.clip(place.s[rows] + step, 0.0, self.lengths[r])
                place.offset[rows] = dy * np.cos(heading) - dx * np.sin(heading)
        return place

    def path_of_lane(self, road: int, lane: int, via: tuple[tuple[int, int, float], ...] = ()) -> LanePath | None:
        """Centre line from the beginning of a lane through all that follow it.

        Parameters
        ----------
        road, lane : int
        via : tuple of (road, lane, s)
            Roads to pass; they choose the exits of junctions. Beyond them, and without any, it goes as straight on
            as possible.

        Returns
        -------
        LanePath or None
            None where there is no such lane, or the roads to pass cannot be reached.
        """
        if not self.has_lane(road, lane):
            return None
        goals = [goal for goal, _, _ in via]
        pieces, length, here = [], 0.0, (road, lane)
        for _ in range(_MOST_ROADS):
            goals = goals[1:] if goals and goals[0] == here[0] else goals
            piece = self._piece(*here)
            pieces.append(piece)
            length += piece.distance[-1]
            options = self._exits(*here)
            if not options or length > _LONGEST_PATH:
                break
            if goals:
                ways = {option: self._hops(option, goals[0]) for option in options}
                chosen = min(options, key=lambda option: (ways[option], options.index(option)))
                if not np.isfinite(ways[chosen]):
                    return None
            else:
                chosen = min(options, key=lambda option: (self._bend(*option), options.index(option)))
            here = chosen
        return None if goals else join(pieces)

    def _piece(self, road: int, lane: int) -> LanePath:
        one = self.roads[road]
        s = np.linspace(0.0, one.length, max(2, int(np.ceil(one.length / STEP)) + 1))
        along = one.along(lane)
        x, y, _ = self.world(road, lane, s, np.zeros(len(s)))
        order = slice(None) if along else slice(None, None, -1)
        return LanePath.of_points(
            x[order], y[order], s[order], np.full(len(s), road), np.full(len(s), lane), np.full(len(s), along)
        )

    def _exits(self, road: int, lane: int) -> list[tuple[int, int]]:
        """Lanes that follow at the end of a lane, in the direction of its traffic."""
        one = self.roads[road]
        along = one.along(lane)
        link = one.successor if along else one.predecessor
        section = one.sections[-1 if along else 0][1]
        if link is None or lane not in section:
            return []
        if link.kind == "road":
            linked = section[lane].successor if along else section[lane].predecessor
            return self._existing([(link.element, linked)])
        found = []
        for incoming, connecting, contact, links in self.connections.get(link.element, ()):
            if incoming == one.name and lane in links:
                found.append((connecting, links[lane]))
            elif incoming == one.name and not links and contact == "start":
                found.append((connecting, lane))
        return self._existing(found)

    def _existing(self, found: Sequence[tuple[str, int | None]]) -> list[tuple[int, int]]:
        return [
            (self._index[name], lane)
            for name, lane in found
            if name in self._index and lane is not None and self.has_lane(self._index[name], lane)
        ]

    def _hops(self, start: tuple[int, int], goal: int) -> float:
        seen, queue = {start}, deque([(start, 0)])
        while queue:
            here, hops = queue.popleft()
            if here[0] == goal:
                return hops
            for option in self._exits(*here):
                if option not in seen:
                    seen.add(option)
                    queue.append((option, hops + 1))
        return float("inf")

    def _bend(self, road: int, lane: int) -> float:
        ends = np.array([0.0, self.lengths[road]])
        heading = self.roads[road].reference(ends)[2]
        return float(abs(heading[1] - heading[0]))

    @cached_property
    def _samples(self) -> tuple[cKDTree, IntArray, IntArray, FloatArray, FloatArray, BoolArray]:
        points, road, lane, where, half, bad = [], [], [], [], [], []
        for r, one in enumerate(self.roads):
            stops = [start for start, _ in one.sections[1:]] + [one.length]
            for k, (start, lanes) in enumerate(one.sections):
                s = np.linspace(start, stops[k], max(2, int(np.ceil((stops[k] - start) / 0.5)) + 1))
                for number, one_lane in lanes.items():
                    x, y, _ = one.at(s, one.center(k, number, s))
                    points.append(np.stack([x, y], axis=1))
                    road.append(np.full(len(s), r))
                    lane.append(np.full(len(s), number))
                    where.append(s)
                    half.append(0.5 * one.width(k, number, s))
                    bad.append(np.full(len(s), one_lane.kind not in _DRIVABLE))
        return (
            cKDTree(np.concatenate(points)),
            np.concatenate(road),
            np.concatenate(lane),
            np.concatenate(where),
            np.concatenate(half),
            np.concatenate(bad),
        )


def _road(element: etree._Element, where: str) -> Road:
    length = _float(element, "length", where)
    if length <= 0:
        raise InputError(f"{where}: has the length {length:g} m; it must be above 0.")
    geometries = tuple(
        sorted((read_geometry(e, where) for e in element.iterfind("planView/geometry")), key=lambda g: g.s)
    )
    if not geometries:
        raise InputError(f"{where}: has no <geometry> in its <planView>.")
    sections = tuple(
        (_float(section, "s", where), dict(_lanes(section, where))) for section in element.iterfind("lanes/laneSection")
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
        numbers = [None if link is None else int(_float(link, "id", where)) for link in links]
        lane = Lane(
            element.get("type", "none"),
            _read_polynomials(element.iterfind("width"), "sOffset", where),
            _read_polynomials(element.iterfind("border"), "sOffset", where),
            numbers[0],
            numbers[1],
        )
        lanes.append((int(_float(element, "id", where)), lane))
    return lanes


def _link(element: etree._Element | None) -> Link | None:
    if element is None:
        return None
    return Link(element.get("elementType", "road"), element.get("elementId", ""), element.get("contactPoint", ""))


def _connections(junction: etree._Element) -> list[tuple[str, str, str, dict[int, int]]]:
    found = []
    for e in junction.iterfind("connection"):
        links = {int(k.get("from", "0")): int(k.get("to", "0")) for k in e.iterfind("laneLink")}
        connecting = e.get("connectingRoad") or e.get("linkedRoad") or ""
        found.append((e.get("incomingRoad", ""), connecting, e.get("contactPoint", "start"), links))
    return found


def _read_polynomials(elements: Iterable[etree._Element], name: str, where: str) -> tuple[Polynomial, ...]:
    found: list[Polynomial] = []
    for e in elements:
        start, a, b, c, d = (_float(e, key, where) for key in (name, "a", "b", "c", "d"))
        found.append((start, a, b, c, d))
    return tuple(sorted(found))


def _polynomials(polynomials: tuple[Polynomial, ...], s: FloatArray) -> FloatArray:
    if not polynomials:
        return np.zeros(len(s))
    table = np.array(polynomials)
    k = np.clip(np.searchsorted(table[:, 0], s, "right") - 1, 0, len(table) - 1)
    d = s - table[k, 0]
    return np.asarray(table[k, 1] + d * (table[k, 2] + d * (table[k, 3] + d * table[k, 4])))


def _float(element: etree._Element, name: str, where: str) -> float:
    try:
        number = float(element.get(name, ""))
    except ValueError:
        number = float("nan")
    if not np.isfinite(number):
        raise InputError(f"{where}: {name} of <{element.tag}> is '{element.get(name)}', not a finite number.")
    return number
