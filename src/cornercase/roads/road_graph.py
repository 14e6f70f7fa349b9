"""The way from road to road, whatever the lanes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from heapq import heappop, heappush
from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads.road import Link, Road

GAP: Final = 1.0
"""Ends of roads, and of lanes beyond their widths, that lie further apart than this, in m, do not meet."""

Connection = tuple[str, str, str, dict[int, int]]
"""Incoming road, connecting road, contact point and lane links of a junction's connection."""


class RoadGraph:
    """Roads of a network, and which of them follow each other.

    Parameters
    ----------
    roads : sequence of Road
    connections : mapping of str to sequence of Connection
        By junction.
    index : mapping of str to int
        Place of each road among the `roads`, by its id.
    """

    def __init__(
        self, roads: Sequence[Road], connections: Mapping[str, Sequence[Connection]], index: Mapping[str, int]
    ) -> None:
        self._roads, self._connections, self._index = roads, connections, index
        self._entries: dict[tuple[int, int, bool, int], list[tuple[float, float, bool]]] = {}
        self._touching: dict[tuple[int, float, int, float], bool] = {}

    def way(self, road: IntArray, s: FloatArray, along: BoolArray, goal: IntArray, goal_s: FloatArray) -> FloatArray:
        """Ways in m from places on roads to others, as `RoadNetwork.way` measures them, shape (N,)."""
        ahead = np.where(road == goal, np.where(along, goal_s - s, s - goal_s), np.inf)
        back = np.full(len(s), np.inf)
        section = np.zeros(len(s), dtype=np.int64)
        for r in np.unique(road):
            section[road == r] = self._roads[r].section_at(s[road == r])
        elsewhere = np.flatnonzero(road != goal)
        keys = np.stack([road, section, along, goal])[:, elsewhere]
        for one in np.unique(keys, axis=1).T:
            rows = elsewhere[(keys == one[:, None]).all(axis=0)]
            for ways, direction in ((ahead, bool(one[2])), (back, not one[2])):
                ways[rows] = self._way(int(one[0]), int(one[1]), direction, s[rows], int(one[3]), goal_s[rows])
        return np.where(ahead <= back, ahead, -back)

    def length_to(self, road: int, section: int, along: bool, goal: int) -> float:
        """Length in m of the roads before a goal, from the begin of a lane section; infinite where none leads there."""
        if road == goal:
            return 0.0
        start, end = self._roads[road].section_span(section)
        return end - start + min((way for way, _, _ in self._ways_to(road, section, along, goal)), default=float("inf"))

    def _way(self, road: int, section: int, along: bool, s: FloatArray, goal: int, goal_s: FloatArray) -> FloatArray:
        start, end = self._roads[road].section_span(section)
        rest, best = end - s if along else s - start, np.full(len(s), np.inf)
        for way, begin, onward in self._ways_to(road, section, along, goal):
            beyond = (goal_s - begin) * (1 if onward else -1)
            best = np.where(beyond >= 0.0, np.minimum(best, rest + way + beyond), best)
        return best

    def _ways_to(self, road: int, section: int, along: bool, goal: int) -> list[tuple[float, float, bool]]:
        """Ways from the end of a lane section onto a road: m, where they come onto it, and whether along its s."""
        key = road, section, along, goal
        if key in self._entries:
            return self._entries[key]
        s = self._roads[road].section_span(section)[1 if along else 0]
        found, done, queue = list[tuple[float, float, bool]](), set[tuple[int, bool]](), [(0.0, road, along, s)]
        while queue:
            way, road, along, s = heappop(queue)
            if road == goal:
                found.append((way, s, along))
                continue
            if (road, along) in done:
                continue
            done.add((road, along))
            for leg, other, onward, begin in self._exits(road, along, s):
                if (other, onward) not in done:
                    heappush(queue, (way + leg, other, onward, begin))
        self._entries[key] = list(dict.fromkeys(found))
        return self._entries[key]

    def _exits(self, road: int, along: bool, s: float) -> list[tuple[float, int, bool, float]]:
        """Roads that follow: m to where they begin, their index, direction of travel on them, and where they begin."""
        one, ahead = self._roads[road], 1 if along else -1
        found = [
            (abs(at - s), *self._at_end(name, contact))
            for at, name, contact in self.leaving.get((one.name, along), ())
            if (at - s) * ahead >= 0.0
        ]
        link = one.successor if along else one.predecessor
        rest = one.length - s if along else s
        if link is not None and link.kind == "road":
            if link.s is not None and link.element in self._index:
                found.append((rest, self._index[link.element], link.forward == along, link.s))
            elif link.element in self._index:
                found.append((rest, *self._at_end(link.element, link.contact)))
        elif link is not None:
            key = (link.element, one.name, "end" if along else "start")
            names = [*self.connecting.get(key, ())]
            for incoming, connecting, contact, _ in self._connections.get(link.element, ()):
                if incoming == one.name and connecting in self._index:
                    names.append((connecting, contact))
            found += [(rest, *self._at_end(name, contact)) for name, contact in names]
        end = one.length if along else 0.0
        return [
            (leg, other, onward, begin)
            for leg, other, onward, begin in dict.fromkeys(found)
            if self._meet(road, s + leg * ahead if leg < rest else end, other, begin)
        ]

    def _meet(self, road: int, s: float, other: int, other_s: float) -> bool:
        """Whether two roads touch at a place of each."""
        key = road, s, other, other_s
        if key not in self._touching:
            one, two = (self._across(r, at) for r, at in ((road, s), (other, other_s)))
            apart = min(_apart_from(point, *line) for points, line in ((one, two), (two, one)) for point in points)
            self._touching[key] = apart <= GAP
        return self._touching[key]

    def _across(self, road: int, s: float) -> tuple[complex, complex]:
        """Right and left edge of a road, as x + iy in m."""
        one, at = self._roads[road], np.array([s])
        x, y, _ = one.at(np.repeat(at, 2), np.concatenate(one.margins(at)))
        return complex(x[0], y[0]), complex(x[1], y[1])

    def _at_end(self, name: str, contact: str) -> tuple[int, bool, float]:
        road = self._index[name]
        return road, contact != "end", self._roads[road].length if contact == "end" else 0.0

    @cached_property
    def connecting(self) -> dict[tuple[str, str, str], list[tuple[str, str]]]:
        """Roads of a junction that begin or end at the end of a road, with their own end that meets it."""
        found: dict[tuple[str, str, str], list[tuple[str, str]]] = {}
        for name, contact, link in self._connecting_ends():
            if link.s is None:
                key = (self._roads[self._index[name]].junction, link.element, link.contact or "end")
                found.setdefault(key, []).append((name, contact))
        return found

    @cached_property
    def leaving(self) -> dict[tuple[str, bool], list[tuple[float, str, str]]]:
        """Connecting roads that leave a road on its way, by the road and whether it is driven along its s."""
        found: dict[tuple[str, bool], list[tuple[float, str, str]]] = {}
        for name, contact, link in self._connecting_ends():
            if link.s is not None:
                found.setdefault((link.element, link.forward == (contact == "start")), []).append(
                    (link.s, name, contact)
                )
        return found

    def _connecting_ends(self) -> list[tuple[str, str, Link]]:
        return [
            (road.name, contact, link)
            for road in self._roads
            if road.junction not in ("-1", "")
            for link, contact in ((road.predecessor, "start"), (road.successor, "end"))
            if link is not None and link.kind == "road"
        ]


def _apart_from(point: complex, start: complex, end: complex) -> float:
    """Distance of a point from a straight line between two others, in m."""
    line, way = end - start, point - start
    part = (way * line.conjugate()).real / max(abs(line) ** 2, 1e-12)
    return abs(way - min(max(part, 0.0), 1.0) * line)
