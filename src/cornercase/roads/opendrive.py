"""OpenDRIVE road networks: lanes in the plane, and the way from lane to lane."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from lxml import etree
from scipy.spatial import cKDTree

from cornercase._common.errors import InputError, suggestion
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads.lane_graph import LaneGraph, Stretch
from cornercase.roads.lane_path import LanePath, join
from cornercase.roads.road import Road, read_road
from cornercase.scenario import read_xml

_LONGEST_PATH: Final = 5000.0
_LONGEST_BACK: Final = 500.0
_JUMP: Final = 0.3
# So far beside it, in m, an entity still counts as on the road that it was on; esmini's figure.
_SLACK: Final = 2.0


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

        Parameters
        ----------
        path : path

        Returns
        -------
        RoadNetwork

        Raises
        ------
        InputError
            The file cannot be used; the message names the road.
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
            raise InputError(f"{path}: the root element is <{root.tag}>; a road file starts with <OpenDRIVE>.")
        roads = tuple(read_road(e, f"{path}, road {e.get('id')}") for e in root.iterfind("road"))
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
            There is none.
        """
        if name not in self._index:
            raise InputError(f"{self.path}: has no road '{name}'; {suggestion(name, self._index)}")
        return self._index[name]

    @cached_property
    def _index(self) -> dict[str, int]:
        return {road.name: i for i, road in enumerate(self.roads)}

    def has_lane(self, road: int, lane: int) -> bool:
        """Tell whether a road has a lane of that number anywhere.

        Parameters
        ----------
        road, lane : int
            Index of the road, and lane.

        Returns
        -------
        bool
        """
        return lane != 0 and any(lane in lanes for _, lanes in self.roads[road].sections)

    def runs_along(self, road: int, lane: int) -> bool:
        """Tell whether traffic on a lane runs along the road's s.

        Parameters
        ----------
        road, lane : int
            Index of the road, and lane.

        Returns
        -------
        bool
        """
        return self.roads[road].along(lane)

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
        section = one.section_at(s)
        t = np.empty(len(s))
        for k in np.unique(section):
            t[section == k] = one.center(int(k), lane, s[section == k])
        x, y, heading = one.at(s, t + offset)
        return x, y, heading if one.along(lane) else heading + np.pi

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
            Stretch(road, section, lane, self.runs_along(road, lane)), [goal for goal, _, _ in waypoints], _LONGEST_PATH
        )
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
        road, s = last.copy(), last_s.copy()
        lost = ~self._holds(last, x, y, s, 1, _SLACK)
        if lost.any():
            at = np.flatnonzero(lost)
            new = self.locate(x[at], y[at])
            road[at], s[at] = new.road, new.s
            apart = np.full(len(at), np.inf)
            inside = np.isin(road[at], self._overlapping)
            for r in self._overlapping if inside.any() else ():
                tree, places = self._reference(r)
                along = places[tree.query(np.stack([x[at], y[at]], axis=1))[1]]
                found = self._holds(np.full(len(at), r), x[at], y[at], along, 2, 0.0) & inside
                turn = np.abs(np.sin(heading[at] - self.roads[r].reference(along)[2]))
                better = found & (turn < apart)
                apart[better] = turn[better]
                road[at[better]], s[at[better]] = r, along[better]
        return road, s

    def _holds(
        self, road: IntArray, x: FloatArray, y: FloatArray, s: FloatArray, projections: int, slack: float
    ) -> BoolArray:
        """Whether points lie on given roads; `s`, a first guess, becomes their s where they do."""
        inside = np.zeros(len(x), dtype=np.bool_)
        for r in np.unique(road[(road >= 0) & np.isfinite(x)]):
            rows = np.flatnonzero((road == r) & np.isfinite(x))
            one, along = self.roads[r], s[rows]
            for _ in range(projections):
                px, py, heading = one.reference(np.clip(along, 0.0, one.length))
                dx, dy, cos, sin = x[rows] - px, y[rows] - py, np.cos(heading), np.sin(heading)
                along = np.clip(along, 0.0, one.length) + dx * cos + dy * sin
            t = dy * cos - dx * sin
            within = (along >= 0.0) & (along <= one.length)
            along = np.clip(along, 0.0, one.length)
            right, left = one.margins(along)
            good = within & (t >= right - slack) & (t <= left + slack)
            inside[rows] = good
            s[rows[good]] = along[good]
        return inside

    def _reference(self, road: int) -> tuple[cKDTree, FloatArray]:
        if road not in self._trees:
            length = self.roads[road].length
            s = np.linspace(0.0, length, max(2, int(length) + 1))
            x, y, _ = self.roads[road].reference(s)
            self._trees[road] = cKDTree(np.stack([x, y], axis=1)), s
        return self._trees[road]

    @cached_property
    def _trees(self) -> dict[int, tuple[cKDTree, FloatArray]]:
        return {}

    @cached_property
    def _overlapping(self) -> list[int]:
        return [i for i, road in enumerate(self.roads) if road.junction not in ("-1", "")]

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
            Its ``origin`` is the distance at which the piece that holds `s` begins. None where there is no such lane.
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
            behind = [piece.reversed() for piece in self._graph.walk(here.reversed(), [], _LONGEST_BACK)[1:]][::-1]
            before = [self._graph.piece(piece) for piece in behind]
            after = [self._graph.piece(piece) for piece in ahead]
            # A lane that opens beside another names it as the one before, but does not go on from its middle.
            kept, start = list[LanePath](), after[0]
            for piece in reversed(before):
                if np.hypot(piece.x[-1] - start.x[0], piece.y[-1] - start.y[0]) > _JUMP:
                    break
                kept.insert(0, piece)
                start = piece
            self._paths[key] = join([*kept, *after], len(kept))
        return self._paths[key]

    @cached_property
    def _graph(self) -> LaneGraph:
        return LaneGraph(self.roads, self.connections, self._index)

    @cached_property
    def _paths(self) -> dict[Any, LanePath]:
        return {}

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
                    bad.append(np.full(len(s), not one_lane.drivable))
        return (
            cKDTree(np.concatenate(points)),
            np.concatenate(road),
            np.concatenate(lane),
            np.concatenate(where),
            np.concatenate(half),
            np.concatenate(bad),
        )


def _connections(junction: etree._Element) -> list[tuple[str, str, str, dict[int, int]]]:
    found = []
    for e in junction.iterfind("connection"):
        links = {int(k.get("from", "0")): int(k.get("to", "0")) for k in e.iterfind("laneLink")}
        connecting = e.get("connectingRoad") or e.get("linkedRoad") or ""
        found.append((e.get("incomingRoad", ""), connecting, e.get("contactPoint", "start"), links))
    return found
