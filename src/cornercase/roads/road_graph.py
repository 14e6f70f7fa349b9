"""Routes from road to road, regardless of lanes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from heapq import heappop, heappush
from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads.road import Link, Road

GAP: Final = 1.0
"""Largest gap in m between ends of roads, or of lanes beyond their widths, that are connected."""

Connection = tuple[str, str, str, dict[int, int]]
"""Incoming road, connecting road, contact point and lane links."""


class RoadGraph:
    """Roads of a network, and how they are connected; see `LaneGraph`."""

    def __init__(
        self, roads: Sequence[Road], connections: Mapping[str, Sequence[Connection]], index: Mapping[str, int]
    ) -> None:
        self._roads, self._connections, self._index = roads, connections, index
        self._entries: dict[tuple[int, int, bool, int], list[tuple[float, float, bool]]] = {}
        self._touching: dict[tuple[int, float, int, float], bool] = {}

    def way(self, road: IntArray, s: FloatArray, along: BoolArray, goal: IntArray, goal_s: FloatArray) -> FloatArray:
        """Return distances in m as `RoadNetwork.driving_distance`, shape (N,)."""
        ahead = np.where(road == goal, np.where(along, goal_s - s, s - goal_s), np.inf)
        back = np.full(len(s), np.inf)
        section = np.zeros(len(s), dtype=np.int64)
        for r in np.unique(road):
            section[road == r] = self._roads[r].section_at(s[road == r])
        others = np.flatnonzero(road != goal)
        keys = np.stack([road, section, along, goal])[:, others]
        for key in np.unique(keys, axis=1).T:
            rows = others[(keys == key[:, None]).all(axis=0)]
            for distances, direction in ((ahead, bool(key[2])), (back, not key[2])):
                distances[rows] = self._way(int(key[0]), int(key[1]), direction, s[rows], int(key[3]), goal_s[rows])
        return np.where(ahead <= back, ahead, -back)

    def length_to(self, road: int, section: int, along: bool, goal: int) -> float:
        """Return the length in m of the roads from the start of a section to a goal; infinite if unreachable."""
        if road == goal:
            return 0.0
        start, end = self._roads[road].section_span(section)
        return (
            end
            - start
            + min((length for length, _, _ in self._ways_to(road, section, along, goal)), default=float("inf"))
        )

    def _way(self, road: int, section: int, along: bool, s: FloatArray, goal: int, goal_s: FloatArray) -> FloatArray:
        start, end = self._roads[road].section_span(section)
        rest, best = end - s if along else s - start, np.full(len(s), np.inf)
        for length, entry, onward in self._ways_to(road, section, along, goal):
            beyond = (goal_s - entry) * (1 if onward else -1)
            best = np.where(beyond >= 0.0, np.minimum(best, rest + length + beyond), best)
        return best

    def _ways_to(self, road: int, section: int, along: bool, goal: int) -> list[tuple[float, float, bool]]:
        """Return routes from the end of a lane section to a road: length in m, s of arrival, whether along its s."""
        key = road, section, along, goal
        if key in self._entries:
            return self._entries[key]
        s = self._roads[road].section_span(section)[1 if along else 0]
        arrivals, done, queue = list[tuple[float, float, bool]](), set[tuple[int, bool]](), [(0.0, road, along, s)]
        while queue:
            length, road, along, s = heappop(queue)
            if road == goal:
                arrivals.append((length, s, along))
                continue
            if (road, along) in done:
                continue
            done.add((road, along))
            for leg, next_road, onward, entry in self._exits(road, along, s):
                if (next_road, onward) not in done:
                    heappush(queue, (length + leg, next_road, onward, entry))
        self._entries[key] = list(dict.fromkeys(arrivals))
        return self._entries[key]

    def _exits(self, road: int, along: bool, s: float) -> list[tuple[float, int, bool, float]]:
        """Return the next roads: distance in m to their start, index, whether along their s, and s at their start."""
        current, ahead = self._roads[road], 1 if along else -1
        candidates = [
            (abs(at - s), *self._at_end(name, contact))
            for at, name, contact in self.leaving.get((current.name, along), ())
            if (at - s) * ahead >= 0.0
        ]
        link = current.successor if along else current.predecessor
        rest = current.length - s if along else s
        if link is not None and link.kind == "road":
            if link.s is not None and link.element in self._index:
                candidates.append((rest, self._index[link.element], link.forward == along, link.s))
            elif link.element in self._index:
                candidates.append((rest, *self._at_end(link.element, link.contact)))
        elif link is not None:
            key = (link.element, current.name, "end" if along else "start")
            names = [*self.connecting.get(key, ())]
            for incoming, connecting, contact, _ in self._connections.get(link.element, ()):
                if incoming == current.name and connecting in self._index:
                    names.append((connecting, contact))
            candidates += [(rest, *self._at_end(name, contact)) for name, contact in names]
        end = current.length if along else 0.0
        return [
            (leg, next_road, onward, entry)
            for leg, next_road, onward, entry in dict.fromkeys(candidates)
            if self._meet(road, s + leg * ahead if leg < rest else end, next_road, entry)
        ]

    def _meet(self, road: int, s: float, other: int, other_s: float) -> bool:
        """Whether two roads touch at given positions."""
        key = road, s, other, other_s
        if key not in self._touching:
            edge, other_edge = (self._across(r, at) for r, at in ((road, s), (other, other_s)))
            distance = min(
                _apart_from(point, *line)
                for points, line in ((edge, other_edge), (other_edge, edge))
                for point in points
            )
            self._touching[key] = distance <= GAP
        return self._touching[key]

    def _across(self, road: int, s: float) -> tuple[complex, complex]:
        """Return the right and left edge of a road at s, as x + iy in m."""
        current, at = self._roads[road], np.array([s])
        x, y, _ = current.at(np.repeat(at, 2), np.concatenate(current.margins(at)))
        return complex(x[0], y[0]), complex(x[1], y[1])

    def _at_end(self, name: str, contact: str) -> tuple[int, bool, float]:
        road = self._index[name]
        return road, contact != "end", self._roads[road].length if contact == "end" else 0.0

    @cached_property
    def connecting(self) -> dict[tuple[str, str, str], list[tuple[str, str]]]:
        """Connecting roads (id and touching end) of a junction, by junction, road and end of that road."""
        ends: dict[tuple[str, str, str], list[tuple[str, str]]] = {}
        for name, contact, link in self._connecting_ends():
            if link.s is None:
                key = (self._roads[self._index[name]].junction, link.element, link.contact or "end")
                ends.setdefault(key, []).append((name, contact))
        return ends

    @cached_property
    def leaving(self) -> dict[tuple[str, bool], list[tuple[float, str, str]]]:
        """Connecting roads that start or end along another road (s, id, touching end), by road and direction."""
        ends: dict[tuple[str, bool], list[tuple[float, str, str]]] = {}
        for name, contact, link in self._connecting_ends():
            if link.s is not None:
                ends.setdefault((link.element, link.forward == (contact == "start")), []).append(
                    (link.s, name, contact)
                )
        return ends

    def _connecting_ends(self) -> list[tuple[str, str, Link]]:
        return [
            (road.name, contact, link)
            for road in self._roads
            if road.junction not in ("-1", "")
            for link, contact in ((road.predecessor, "start"), (road.successor, "end"))
            if link is not None and link.kind == "road"
        ]


def _apart_from(point: complex, start: complex, end: complex) -> float:
    """Return the distance of a point from a line segment, in m."""
    line, offset = end - start, point - start
    part = (offset * line.conjugate()).real / max(abs(line) ** 2, 1e-12)
    return abs(offset - min(max(part, 0.0), 1.0) * line)
