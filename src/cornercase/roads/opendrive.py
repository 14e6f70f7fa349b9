"""OpenDRIVE road networks: lanes in the plane, and the way from lane to lane."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError, suggestion
from cornercase._common.places import place_of
from cornercase._common.recorded_xml import adapt
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads.distance import LaneDistance
from cornercase.roads.lane_graph import LaneGraph, Stretch
from cornercase.roads.lane_path import LanePath, join
from cornercase.roads.ledger import LEDGER
from cornercase.roads.links import read_connections, settled
from cornercase.roads.locating import Locator, Place
from cornercase.roads.reference_line import read_number
from cornercase.roads.road import Road, permanent_lanes, read_road
from cornercase.roads.road_graph import Connection
from cornercase.roads.soundness import require_sound
from cornercase.scenario import read_xml

if TYPE_CHECKING:
    from cornercase.roads.direction import RoadTables

_LONGEST_PATH: Final = 5000.0
_LONGEST_BACK: Final = 500.0
_JUMP: Final = 0.3


@dataclass(frozen=True, eq=False)
class RoadNetwork:
    """All roads of an OpenDRIVE file.

    Attributes
    ----------
    path : Path
    roads : tuple of Road
    connections : dict
        Junction to its (incoming road, connecting road, contact point, lane links).
    left_out : dict
        Id of each road that cannot be used, to what is wrong with it. Nothing is there.
    line : int, default 1
        Where the first road stands in the file, for messages.
    """

    path: Path
    roads: tuple[Road, ...]
    connections: dict[str, tuple[Connection, ...]] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    line: int = 1

    @classmethod
    def read(cls, path: Path | str) -> RoadNetwork:
        """Read an OpenDRIVE file, of version 1.4 to 1.9; elevation and temporary lanes are left out.

        Parameters
        ----------
        path : path

        Returns
        -------
        RoadNetwork

        Raises
        ------
        InputError
            The file, or none of its roads, can be used; the message names the road.
        """
        return cls.of_xml(read_xml(path), Path(path))

    @classmethod
    def of_xml(cls, root: etree._Element, path: Path) -> RoadNetwork:
        """Network of an OpenDRIVE document that was read already.

        Parameters
        ----------
        root : lxml element
            It loses its namespaces.
        path : Path
            Where it comes from.

        Returns
        -------
        RoadNetwork

        Raises
        ------
        InputError
            As in `read`.
        """
        for element in root.iter():
            if isinstance(element.tag, str) and "}" in element.tag:
                element.tag = element.tag.split("}", 1)[1]
        if root.tag != "OpenDRIVE":
            place = place_of(root, str(path))
            raise InputError(f"{place}: the root element is <{root.tag}>; a road file starts with <OpenDRIVE>.")
        LEDGER.refuse(root, path)
        cuts = _places_of_links(root, path)
        if root.find("header") is None:
            adapt(root, "<header>", "is missing, and the file is read as OpenDRIVE 1.9", "a file has a <header>")
        elements: dict[str, etree._Element] = {}
        roads, left_out = list[Road](), dict[str, str]()
        for element in root.iterfind("road"):
            name, line = element.get("id", ""), element.sourceline
            if not name:
                raise InputError(f"{path}, line {line}: a <road> has no id; give it one.")
            if name in elements:
                raise InputError(f"{path}, line {line}: <road>: a second road has the id '{name}'; give it another.")
            elements[name], where = element, f"{place_of(element, str(path))}, road {name}"
            # Which lanes are meant is asked of the whole file.
            permanent_lanes(element, where)
            try:
                road = read_road(element, where, cuts.get(name, ()))
                require_sound(road, element, where)
            except InputError as error:
                left_out[name] = str(error)
            else:
                roads.append(road)
        if not elements:
            raise InputError(f"{place_of(root, str(path))}: <OpenDRIVE> has no <road>.")
        if not roads:
            raise InputError(next(iter(left_out.values())))
        for name, message in left_out.items():
            reason = message.partition(f", road {name}: ")[2].removesuffix(".")
            adapt(elements[name], f"road {name}", f"is left out: {reason}", "a road is complete and without jumps")
        junctions = {e.get("id", ""): e for e in root.iterfind("junction")}
        known = settled(roads, elements, {*junctions})
        by_name = {road.name: road for road in known}
        connections = {
            name: read_connections(e, f"{place_of(e, str(path))}, junction {name}", by_name, elements)
            for name, e in junctions.items()
        }
        begin = int(str(elements[known[0].name].sourceline or 1))
        return cls(path, known, connections, left_out, begin)

    @cached_property
    def lengths(self) -> FloatArray:
        """Length of each road in m, shape (R,)."""
        return np.array([road.length for road in self.roads])

    def index_of(self, name: str) -> int:
        """Return the index of a road.

        Parameters
        ----------
        name : str
            Its id.

        Returns
        -------
        int

        Raises
        ------
        InputError
            There is none, or it cannot be used.
        """
        if name in self.left_out:
            raise InputError(self.left_out[name])
        if name not in self._index:
            raise InputError(f"{self.path}: has no road '{name}'; {suggestion(name, self._index)}")
        return self._index[name]

    @cached_property
    def _index(self) -> dict[str, int]:
        return {road.name: i for i, road in enumerate(self.roads)}

    def has_lane_at(self, road: int, lane: int, s: FloatArray) -> BoolArray:
        """Tell whether a road has a lane of that number at places along it; each has a lane 0, its centre.

        Parameters
        ----------
        road, lane : int
            Index of the road, and lane.
        s : ndarray of float64, shape (N,)
            m.

        Returns
        -------
        ndarray of bool, shape (N,)
        """
        one = self.roads[road]
        held = np.array([lane == 0 or lane in lanes for _, lanes in one.sections])
        return np.asarray(held[one.section_at(s)])

    def runs_along(self, road: int, lane: int, s: float) -> bool:
        """Tell whether traffic on a lane runs along the road's s.

        Parameters
        ----------
        road, lane : int
            Index of the road, and lane.
        s : float
            Place on the road, in m.

        Returns
        -------
        bool
        """
        return bool(self.roads[road].along(lane, np.array([s]))[0])

    def road_world(self, road: int, s: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Find where road coordinates lie in the plane.

        Parameters
        ----------
        road : int
            Its index.
        s, t : ndarray of float64, shape (N,)
            m.

        Returns
        -------
        x, y : ndarray of float64, shape (N,)
            m.
        heading : ndarray of float64, shape (N,)
            Direction of the road's s, in rad.
        """
        return self.roads[road].at(s, t)

    def world(
        self, road: int, lane: int, s: FloatArray, offset: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Find where places on a lane lie in the plane.

        Parameters
        ----------
        road, lane : int
            Index of the road, and lane.
        s : ndarray of float64, shape (N,)
            m.
        offset : ndarray of float64, shape (N,)
            m to the left of the lane's centre, seen along s.

        Returns
        -------
        x, y : ndarray of float64, shape (N,)
            m.
        heading : ndarray of float64, shape (N,)
            Direction of the lane's traffic, in rad.
        """
        one = self.roads[road]
        x, y, heading = one.at_lane(lane, s, offset)
        section = one.section_at(s)
        for k in sorted(set(section.tolist())):
            heading[section == k] += one.slant(k, lane, s[section == k])
        return x, y, np.where(one.along(lane, s), heading, heading + np.pi)

    def lane_at(self, road: int, s: FloatArray, t: FloatArray) -> tuple[IntArray, FloatArray]:
        """Find the lane that holds points of a road, or is nearest to them.

        Parameters
        ----------
        road : int
            Its index.
        s, t : ndarray of float64, shape (N,)
            m.

        Returns
        -------
        lane : ndarray of int64, shape (N,)
        offset : ndarray of float64, shape (N,)
            From the lane's centre, in m, positive to the left along s.
        """
        one = self.roads[road]
        lane, offset = np.zeros(len(s), dtype=np.int64), np.zeros(len(s))
        best = np.full(len(s), np.inf)
        section = one.section_at(s)
        for k in np.unique(section):
            for number in one.sections[int(k)][1]:
                rows = np.flatnonzero(section == k)
                beside = t[rows] - one.center(int(k), number, s[rows])
                cost = np.abs(beside) - 0.5 * one.width(int(k), number, s[rows])
                rows = rows[nearer := cost < best[rows]]
                lane[rows], offset[rows], best[rows] = number, beside[nearer], cost[nearer]
        return lane, offset

    def along_route(
        self, waypoints: list[tuple[int, int, float]], way: FloatArray
    ) -> tuple[IntArray, FloatArray, BoolArray]:
        """Find where one is on a route after some way.

        Parameters
        ----------
        waypoints : list of (int, int, float)
            Road, lane and s in m of each.
        way : ndarray of float64, shape (N,)
            m from the first waypoint.

        Returns
        -------
        road : ndarray of int64, shape (N,)
        s : ndarray of float64, shape (N,)
            m.
        along : ndarray of bool, shape (N,)
            Whether the route runs along the road's s there.
        """
        road, lane, s = waypoints[0]
        section = int(self.roads[road].section_at(np.array([s]))[0])
        walk = self._graph.walk(
            Stretch(road, section, lane, self.runs_along(road, lane, s)),
            [goal for goal, _, _ in waypoints],
            max(_LONGEST_PATH, float(np.max(way, initial=0.0))),
        ).stretches
        roads, begins, starts, directions = [], [], [], []
        length = 0.0
        for k, here in enumerate(walk):
            start, end = self._graph.span(here)
            first = (s if k == 0 else start) if here.along else (s if k == 0 else end)
            roads.append(here.road)
            begins.append(length)
            starts.append(first)
            directions.append(here.along)
            length += (end - first) if here.along else (first - start)
        leg = np.clip(np.searchsorted(begins, way, "right") - 1, 0, len(roads) - 1)
        along = np.array(directions)[leg]
        beyond = way - np.array(begins)[leg]
        return np.array(roads)[leg], np.array(starts)[leg] + np.where(along, beyond, -beyond), along

    def way(self, road: IntArray, s: FloatArray, along: BoolArray, goal: IntArray, goal_s: FloatArray) -> FloatArray:
        """Measure the ways along the roads from places to others, by the shortest way ahead or back.

        Lanes do not matter.

        Parameters
        ----------
        road : ndarray of int64, shape (N,)
            Indices of the roads where they begin.
        s : ndarray of float64, shape (N,)
            Places on these, in m.
        along : ndarray of bool, shape (N,)
            Whether ahead is along the s of the road where it begins.
        goal : ndarray of int64, shape (N,)
            Indices of the roads where they end.
        goal_s : ndarray of float64, shape (N,)
            Places on these, in m.

        Returns
        -------
        ndarray of float64, shape (N,)
            m; negative where the way leads back, infinite where the roads do not connect.
        """
        return self._graph.roads.way(road, s, along, goal, goal_s)

    def gaps(self) -> list[tuple[str, str, float]]:
        """Find roads that are linked but do not meet, where somebody's path came to the end of one of them so far.

        Returns
        -------
        list of (str, str, float)
            Their ids, and how far apart their lanes end, in m. No way leads from one to the other.
        """
        found = sorted((*pair, apart) for pair, apart in self._graph.gaps.items())
        return [(self.roads[a].name, self.roads[b].name, apart) for a, b, apart in found]

    def crossings(self) -> list[tuple[str, str, float]]:
        """Find linked roads that lie apart by more than half a metre, where somebody's path leads across so far.

        Returns
        -------
        list of (str, str, float)
            Their ids, and how far apart their lanes end, in m.
        """
        found = sorted((*pair, apart) for pair, apart in self._graph.crossed.items())
        return [(self.roads[a].name, self.roads[b].name, apart) for a, b, apart in found]

    def locate(self, x: FloatArray, y: FloatArray) -> Place:
        """Find where points are on the roads.

        A lane that holds the point goes before a nearer one, and a driving lane before others.

        Parameters
        ----------
        x, y : ndarray of float64, shape (N,)
            m.

        Returns
        -------
        Place
        """
        return self._locator.locate(x, y)

    def road_from(
        self, last: IntArray, last_s: FloatArray, x: FloatArray, y: FloatArray, heading: FloatArray
    ) -> tuple[IntArray, FloatArray]:
        """Find the road of points that move, given where they were a moment ago.

        Where roads overlap, as in a junction, a point stays on its road as long as it can. Then it goes over to the
        road that runs most like its heading.

        Parameters
        ----------
        last : ndarray of int64, shape (N,)
            Index of the road of each a moment ago; -1 where it is not known.
        last_s : ndarray of float64, shape (N,)
            Its s there, in m.
        x, y : ndarray of float64, shape (N,)
            m.
        heading : ndarray of float64, shape (N,)
            rad.

        Returns
        -------
        road : ndarray of int64, shape (N,)
        s : ndarray of float64, shape (N,)
            m.
        """
        return self._locator.road_from(last, last_s, x, y, heading)

    @cached_property
    def tables(self) -> RoadTables:
        """Tables of the roads for compiled code."""
        # Who needs none does not load the compiler.
        from cornercase.roads.direction import road_tables

        return road_tables(self.roads)

    def distance_from_lanes(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Find how far points are from the nearest of all lanes.

        Parameters
        ----------
        x, y : ndarray of float64, shape (N,)
            m.

        Returns
        -------
        ndarray of float64, shape (N,)
            m; 0 where that is at most 10 m.
        """
        return self._distance.of(x, y)

    @cached_property
    def _distance(self) -> LaneDistance:
        return LaneDistance(self.roads)

    @cached_property
    def _locator(self) -> Locator:
        if not any(held for road in self.roads for _, held in road.sections):
            raise InputError(
                f"{self.path}, line {self.line}: <road>: none of the roads has a lane, so nothing can be placed on"
                " them; give one of them a <lane>."
            )
        return Locator(self.roads)

    def path_of_lane(
        self,
        road: int,
        lane: int,
        s: float,
        along: bool,
        via: tuple[tuple[int, int, float], ...] = (),
    ) -> LanePath | None:
        """Centre line of a lane and those that follow it, and of those before it for an entity that drives backwards.

        Parameters
        ----------
        road, lane : int
        s : float
            Place on the road at which the lane has this number, in m.
        along : bool
            Whether the path runs along the road's s there, or against it.
        via : tuple of (road, lane, s)
            Roads to pass; they choose the exits of junctions. Beyond them, and without any, it goes as straight on
            as possible.

        Returns
        -------
        LanePath or None
            None where there is no such lane.
        """
        one = self.roads[road]
        section = int(one.section_at(np.array([s]))[0])
        if lane == 0 or lane not in one.sections[section][1]:
            return None
        here = Stretch(road, section, lane, along)
        key = (here, via)
        if key not in self._paths:
            # The road it starts on may be among those to pass, as it is in most routes.
            ahead = self._graph.walk(here, [goal for goal, _, _ in via], _LONGEST_PATH)
            behind = self._graph.walk(here.reversed(), (), _LONGEST_BACK)
            after = [self._graph.piece(*piece) for piece in zip(ahead.stretches, ahead.passed, strict=True)]
            kept, begins = [after[0]], behind.ends
            for stretch in behind.stretches[1:]:
                piece = self._graph.piece(stretch.reversed())
                # A lane that opens beside another names it as the one before, but does not go on from its middle.
                if np.hypot(piece.x[-1] - kept[0].x[0], piece.y[-1] - kept[0].y[0]) > _JUMP:
                    begins = True
                    break
                kept.insert(0, piece)
            path = join([*kept[:-1], *after], len(kept) - 1)
            self._paths[key] = replace(path, ends=ahead.ends, begins=begins)
        return self._paths[key]

    @cached_property
    def _graph(self) -> LaneGraph:
        return LaneGraph(self.roads, self.connections, self._index)

    @cached_property
    def _paths(self) -> dict[Any, LanePath]:
        return {}


def _places_of_links(root: etree._Element, path: Path) -> dict[str, list[float]]:
    """Where roads begin or end along others, in m on these, by their id."""
    found: dict[str, list[float]] = {}
    for road in root.iterfind("road"):
        for link in (*road.iterfind("link/predecessor"), *road.iterfind("link/successor")):
            if link.get("elementS") is not None:
                s = read_number(link, "elementS", f"{place_of(link, str(path))}, road {road.get('id')}")
                found.setdefault(link.get("elementId", ""), []).append(s)
    return found
