"""The way from lane to lane."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from heapq import heappop, heappush
from typing import Final, NamedTuple

import numpy as np

from cornercase.roads.lane_path import STEP, LanePath
from cornercase.roads.road import Road

# A way that leads back to where it was is followed in circles until it is this long, in m.
_LONGEST_LOOP: Final = 3000.0
# A way passes at most so many stretches.
_MOST_ROADS: Final = 500

Connection = tuple[str, str, str, dict[int, int]]
"""Incoming road, connecting road, contact point and lane links of a junction's connection."""


class Stretch(NamedTuple):
    """A lane of one lane section, travelled along the road's s or against it.

    Attributes
    ----------
    road, section : int
        Index of the road, and of the section on it.
    lane : int
        Number of the lane.
    along : bool
    """

    road: int
    section: int
    lane: int
    along: bool

    def reversed(self) -> Stretch:
        """Return the same, travelled the other way."""
        return self._replace(along=not self.along)


class LaneGraph:
    """Lanes of a road network, and which of them follow each other.

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

    def walk(self, here: Stretch, goals: list[int], longest: float) -> list[Stretch]:
        """Stretches from one on, through the goals where they can be reached, else as straight on as possible.

        Parameters
        ----------
        here : Stretch
            Where it begins.
        goals : list of int
            Roads to pass, in this order.
        longest : float
            m after which it ends.

        Returns
        -------
        list of Stretch
            The first is `here`.
        """
        found, length, seen = [here], 0.0, {here}
        for _ in range(_MOST_ROADS):
            goals = goals[1:] if goals and goals[0] == here.road else goals
            start, end = self.span(here)
            length += end - start
            options = self.exits(here)
            if not options or length > longest:
                break
            ways = [self._way(option, goals[0]) if goals else np.inf for option in options]
            if np.isfinite(min(ways)):
                here = options[int(np.argmin(ways))]
            else:
                bends = [self._bend(option.road) for option in options]
                here = options[int(np.argmin(bends))]
            if here in seen and length > _LONGEST_LOOP:
                break
            seen.add(here)
            found.append(here)
        return found

    def span(self, here: Stretch) -> tuple[float, float]:
        """Coordinates s between which a stretch lies, in m, the lower one first."""
        one = self._roads[here.road]
        start = max(one.sections[here.section][0], 0.0)
        end = one.sections[here.section + 1][0] if here.section + 1 < len(one.sections) else one.length
        return start, max(end, start)

    def piece(self, here: Stretch) -> LanePath:
        """Centre line of a stretch, in the direction of travel."""
        one = self._roads[here.road]
        start, end = self.span(here)
        s = np.linspace(start, end, max(2, int(np.ceil((end - start) / STEP)) + 1))
        x, y, _ = one.at(s, one.center(here.section, here.lane, s))
        order = slice(None) if here.along else slice(None, None, -1)
        n = len(s)
        return LanePath.of_points(
            x[order], y[order], s[order], np.full(n, here.road), np.full(n, here.lane), np.full(n, here.along)
        )

    def exits(self, here: Stretch) -> list[Stretch]:
        """Stretches that follow one in the direction of travel; none where its lane ends."""
        one = self._roads[here.road]
        lane = one.sections[here.section][1].get(here.lane)
        linked = None if lane is None else (lane.successor if here.along else lane.predecessor)
        following = here.section + (1 if here.along else -1)
        if 0 <= following < len(one.sections):
            lanes = one.sections[following][1]
            number = linked if linked is not None else here.lane
            return [Stretch(here.road, following, number, here.along)] if number in lanes else []
        link = one.successor if here.along else one.predecessor
        if link is None:
            return []
        if link.kind == "road":
            return self._enter(link.element, linked, link.contact)
        # A connecting road's own links tell more than the junction's: at which end of this road it meets it, and they
        # also hold for an entity that drives against the traffic.
        end = "end" if here.along else "start"
        found = list[Stretch]()
        for name, contact in self._connecting.get((link.element, one.name, end), ()):
            road = self._roads[self._index[name]]
            lanes = road.sections[0 if contact == "start" else -1][1]
            for number, other in lanes.items():
                if (other.predecessor if contact == "start" else other.successor) == here.lane:
                    found += self._enter(name, number, contact)
        if not found:
            for incoming, connecting, contact, links in self._connections.get(link.element, ()):
                if incoming == one.name and (here.lane in links or not links):
                    found += self._enter(connecting, links.get(here.lane, here.lane), contact)
        return list(dict.fromkeys(found))

    def _enter(self, name: str, lane: int | None, contact: str) -> list[Stretch]:
        if name not in self._index or lane is None:
            return []
        road = self._index[name]
        sections = self._roads[road].sections
        section = 0 if contact != "end" else len(sections) - 1
        return [Stretch(road, section, lane, contact != "end")] if lane in sections[section][1] else []

    @cached_property
    def _connecting(self) -> dict[tuple[str, str, str], list[tuple[str, str]]]:
        """Roads of a junction that begin or end at the end of a road, with their own end that meets it."""
        found: dict[tuple[str, str, str], list[tuple[str, str]]] = {}
        for road in self._roads:
            if road.junction in ("-1", ""):
                continue
            for link, contact in ((road.predecessor, "start"), (road.successor, "end")):
                if link is not None and link.kind == "road":
                    key = (road.junction, link.element, link.contact or "end")
                    found.setdefault(key, []).append((road.name, contact))
        return found

    def _way(self, start: Stretch, goal: int) -> float:
        """Length in m of the roads before a goal; lanes do not matter, as a route never changes them."""
        done, queue = set[tuple[int, bool]](), [(0.0, start.road, start.along)]
        while queue:
            way, road, along = heappop(queue)
            if road == goal:
                return way
            if (road, along) in done:
                continue
            done.add((road, along))
            for option in self._road_exits(road, along):
                if option not in done:
                    heappush(queue, (way + self._roads[road].length, *option))
        return float("inf")

    def _road_exits(self, road: int, along: bool) -> list[tuple[int, bool]]:
        one = self._roads[road]
        link = one.successor if along else one.predecessor
        if link is None:
            return []
        if link.kind == "road":
            return [(self._index[link.element], link.contact != "end")] if link.element in self._index else []
        key = (link.element, one.name, "end" if along else "start")
        found = [(self._index[name], contact == "start") for name, contact in self._connecting.get(key, ())]
        for incoming, connecting, contact, _ in self._connections.get(link.element, ()):
            if incoming == one.name and connecting in self._index:
                found.append((self._index[connecting], contact == "start"))
        return list(dict.fromkeys(found))

    def _bend(self, road: int) -> float:
        ends = np.array([0.0, self._roads[road].length])
        heading = self._roads[road].reference(ends)[2]
        return float(abs(heading[1] - heading[0]))
