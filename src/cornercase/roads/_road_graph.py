"""Routes from road to road, regardless of lanes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from heapq import heappop, heappush
from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads._road import Road, RoadLink

MAX_GAP: Final = 1.0
"""Largest gap in m between the ends of connected roads, or between connected lanes beyond their widths."""

JunctionConnection = tuple[str, str, str, dict[int, int]]
"""Incoming road, connecting road, contact point and lane links."""


class RoadGraph:
    """Connections between the roads of a network, regardless of lanes.

    `connections` has the connections of each junction, by junction id. `road_indices` maps road ids to indices.
    """

    def __init__(
        self,
        roads: Sequence[Road],
        connections: Mapping[str, Sequence[JunctionConnection]],
        road_indices: Mapping[str, int],
    ) -> None:
        self._roads, self._connections, self._road_indices = roads, connections, road_indices
        self._routes: dict[tuple[int, int, bool, int], list[tuple[float, float, bool]]] = {}
        self._touching: dict[tuple[int, float, int, float], bool] = {}

    def driving_distance(
        self, road: IntArray, s: FloatArray, forward: BoolArray, goal_road: IntArray, goal_s: FloatArray
    ) -> FloatArray:
        """Return the distances along roads from positions to goals, in m, shape (N,).

        `RoadNetwork.driving_distance` explains the arguments and the signs.
        """
        ahead = np.where(road == goal_road, np.where(forward, goal_s - s, s - goal_s), np.inf)
        back = np.full(len(s), np.inf)
        section = np.zeros(len(s), dtype=np.int64)
        for r in np.unique(road):
            section[road == r] = self._roads[r].section_at(s[road == r])
        others = np.flatnonzero(road != goal_road)
        keys = np.stack([road, section, forward, goal_road])[:, others]
        for key in np.unique(keys, axis=1).T:
            rows = others[(keys == key[:, None]).all(axis=0)]
            for distances, direction in ((ahead, bool(key[2])), (back, not key[2])):
                distances[rows] = self._directed_distance(
                    int(key[0]), int(key[1]), direction, s[rows], int(key[3]), goal_s[rows]
                )
        return np.where(ahead <= back, ahead, -back)

    def length_to_goal(self, road: int, section: int, forward: bool, goal_road: int) -> float:
        """Return the driving distance in m over a lane section and on to the nearest entry of a goal road.

        Return 0 if the section is on the goal road, and infinity if no route leads to the goal road.
        """
        if road == goal_road:
            return 0.0
        start, end = self._roads[road].section_interval(section)
        return (
            end
            - start
            + min((length for length, _, _ in self._routes_to(road, section, forward, goal_road)), default=float("inf"))
        )

    def _directed_distance(
        self, road: int, section: int, forward: bool, s: FloatArray, goal_road: int, goal_s: FloatArray
    ) -> FloatArray:
        start, end = self._roads[road].section_interval(section)
        rest, best = end - s if forward else s - start, np.full(len(s), np.inf)
        for length, entry, onward in self._routes_to(road, section, forward, goal_road):
            beyond = (goal_s - entry) * (1 if onward else -1)
            best = np.where(beyond >= 0.0, np.minimum(best, rest + length + beyond), best)
        return best

    def _routes_to(self, road: int, section: int, forward: bool, goal_road: int) -> list[tuple[float, float, bool]]:
        """Return the routes from the end of a lane section to a goal road.

        Each is a tuple: length in m, s at which the route enters the goal road, whether s increases from there on.
        """
        key = road, section, forward, goal_road
        if key in self._routes:
            return self._routes[key]
        s = self._roads[road].section_interval(section)[1 if forward else 0]
        arrivals, done, queue = list[tuple[float, float, bool]](), set[tuple[int, bool]](), [(0.0, road, forward, s)]
        while queue:
            length, road, forward, s = heappop(queue)
            if road == goal_road:
                arrivals.append((length, s, forward))
                continue
            if (road, forward) in done:
                continue
            done.add((road, forward))
            for leg, next_road, onward, entry in self._next_roads(road, forward, s):
                if (next_road, onward) not in done:
                    heappush(queue, (length + leg, next_road, onward, entry))
        self._routes[key] = list(dict.fromkeys(arrivals))
        return self._routes[key]

    def _next_roads(self, road: int, forward: bool, s: float) -> list[tuple[float, int, bool, float]]:
        """Return the next roads that a vehicle can enter from position `s` of a road.

        Each is a tuple: distance in m to the entry, index of the next road, whether s increases there, s of the entry.
        """
        current, ahead = self._roads[road], 1 if forward else -1
        candidates = [
            (abs(at - s), *self._entry_at_road_end(name, contact))
            for at, name, contact in self.connecting_roads_along.get((current.road_id, forward), ())
            if (at - s) * ahead >= 0.0
        ]
        link = current.successor if forward else current.predecessor
        rest = current.length - s if forward else s
        if link is not None and link.target_type == "road":
            if link.s is not None and link.target_id in self._road_indices:
                candidates.append((rest, self._road_indices[link.target_id], link.forward == forward, link.s))
            elif link.target_id in self._road_indices:
                candidates.append((rest, *self._entry_at_road_end(link.target_id, link.contact_point)))
        elif link is not None:
            key = (link.target_id, current.road_id, "end" if forward else "start")
            names = [*self.connecting_roads_at_ends.get(key, ())]
            for incoming, connecting, contact, _ in self._connections.get(link.target_id, ()):
                if incoming == current.road_id and connecting in self._road_indices:
                    names.append((connecting, contact))
            candidates += [(rest, *self._entry_at_road_end(name, contact)) for name, contact in names]
        end = current.length if forward else 0.0
        return [
            (leg, next_road, onward, entry)
            for leg, next_road, onward, entry in dict.fromkeys(candidates)
            if self._do_roads_touch(road, s + leg * ahead if leg < rest else end, next_road, entry)
        ]

    def _do_roads_touch(self, road: int, s: float, other: int, other_s: float) -> bool:
        """Return whether two roads are at most `MAX_GAP` apart at the given positions."""
        key = road, s, other, other_s
        if key not in self._touching:
            edge, other_edge = (self._edge_points(r, at) for r, at in ((road, s), (other, other_s)))
            distance = min(
                _distance_to_segment(point, *line)
                for points, line in ((edge, other_edge), (other_edge, edge))
                for point in points
            )
            self._touching[key] = distance <= MAX_GAP
        return self._touching[key]

    def _edge_points(self, road: int, s: float) -> tuple[complex, complex]:
        """Return the points of a road's right and left edge at s, as complex numbers x + iy in m."""
        current, at = self._roads[road], np.array([s])
        x, y, _ = current.pose_at(np.repeat(at, 2), np.concatenate(current.road_edge_offsets(at)))
        return complex(x[0], y[0]), complex(x[1], y[1])

    def _entry_at_road_end(self, road_id: str, contact_point: str) -> tuple[int, bool, float]:
        road = self._road_indices[road_id]
        return road, contact_point != "end", self._roads[road].length if contact_point == "end" else 0.0

    @cached_property
    def connecting_roads_at_ends(self) -> dict[tuple[str, str, str], list[tuple[str, str]]]:
        """Connecting roads of junctions that touch an end of another road; by (junction, other road, end of that road).

        Each connecting road is a pair: id, and which of its ends touches.
        """
        ends: dict[tuple[str, str, str], list[tuple[str, str]]] = {}
        for name, contact, link in self._connecting_road_links():
            if link.s is None:
                key = (self._roads[self._road_indices[name]].junction, link.target_id, link.contact_point or "end")
                ends.setdefault(key, []).append((name, contact))
        return ends

    @cached_property
    def connecting_roads_along(self) -> dict[tuple[str, bool], list[tuple[float, str, str]]]:
        """Connecting roads that touch another road between its ends; by (other road, direction of driving on it).

        The direction is True for increasing s. Each connecting road is a tuple: s on the other road, id, and which end
        of the connecting road touches.
        """
        ends: dict[tuple[str, bool], list[tuple[float, str, str]]] = {}
        for name, contact, link in self._connecting_road_links():
            if link.s is not None:
                ends.setdefault((link.target_id, link.forward == (contact == "start")), []).append(
                    (link.s, name, contact)
                )
        return ends

    def _connecting_road_links(self) -> list[tuple[str, str, RoadLink]]:
        return [
            (road.road_id, contact, link)
            for road in self._roads
            if road.junction not in ("-1", "")
            for link, contact in ((road.predecessor, "start"), (road.successor, "end"))
            if link is not None and link.target_type == "road"
        ]


def _distance_to_segment(point: complex, start: complex, end: complex) -> float:
    """Return the distance of a point from a line segment, in m."""
    line, offset = end - start, point - start
    part = (offset * line.conjugate()).real / max(abs(line) ** 2, 1e-12)
    return abs(offset - min(max(part, 0.0), 1.0) * line)
