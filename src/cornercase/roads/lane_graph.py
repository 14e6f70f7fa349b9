"""The way from lane to lane."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.geometry import within_half_turn
from cornercase.roads.lane_path import SHORTEST, STEP, LanePath, jumped_at
from cornercase.roads.road import Link, Road
from cornercase.roads.road_graph import GAP, Connection, RoadGraph

# m; lanes of linked roads that are no further apart meet: their widths differ.
_NOTABLE: Final = 0.5
# A way that leads back to where it was is followed in circles until it is this long, in m.
_LONGEST_LOOP: Final = 3000.0
# A way passes at most so many stretches.
_MOST_ROADS: Final = 500
# Bends that differ by less, in rad, are equal. Of such roads the last in the file is taken; esmini draws one.
_AS_STRAIGHT: Final = 1e-6


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


class Walk(NamedTuple):
    """Stretches that follow each other.

    Attributes
    ----------
    stretches : list of Stretch
    passed : list of int
        How many of the goals lie behind at the end of each.
    ends : bool
        Whether the last one ends where nothing follows; else the way goes on from there.
    """

    stretches: list[Stretch]
    passed: list[int]
    ends: bool


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
        self.roads = RoadGraph(roads, connections, index)

    def walk(self, here: Stretch, goals: Sequence[int], longest: float) -> Walk:
        """Stretches from one on, through the goals where they can be reached, else as straight on as possible.

        Parameters
        ----------
        here : Stretch
            Where it begins.
        goals : sequence of int
            Roads to pass, in this order. The first may be the one where it begins.
        longest : float
            m beyond the first stretch after which it is cut.

        Returns
        -------
        Walk
            The first stretch is `here`.
        """
        behind = int(bool(goals) and goals[0] == here.road)
        found, passed, length, seen = [here], [behind], 0.0, {here}
        for k in range(_MOST_ROADS):
            start, end = self.span(here)
            length += end - start if k else 0.0
            options = self.exits(here)
            if not options:
                return Walk(found, passed, ends=True)
            if length > longest:
                break
            here = self._choose(here, options, goals[behind] if behind < len(goals) else None)
            if here in seen and length > _LONGEST_LOOP:
                break
            behind += behind < len(goals) and goals[behind] == here.road
            seen.add(here)
            found.append(here)
            passed.append(behind)
        return Walk(found, passed, ends=False)

    def _choose(self, here: Stretch, options: list[Stretch], goal: int | None) -> Stretch:
        if goal is not None:
            ways = [self.roads.length_to(option.road, option.section, option.along, goal) for option in options]
            if np.isfinite(min(ways)):
                return options[int(np.argmin(ways))]
        if options[0].road == here.road and options[0].along == here.along:
            return options[0]
        bends = np.array([self._bend(here, option) for option in options])
        return options[int(np.flatnonzero(bends <= bends.min() + _AS_STRAIGHT)[-1])]

    def span(self, here: Stretch) -> tuple[float, float]:
        """Coordinates s between which a stretch lies, in m, the lower one first."""
        return self._roads[here.road].section_span(here.section)

    def piece(self, here: Stretch, passed: int = 0) -> LanePath:
        """Centre line of a stretch, in the direction of travel, with as many goals behind."""
        one = self._roads[here.road]
        start, end = self.span(here)
        s = np.linspace(start, end, max(2, int(np.ceil((end - start) / STEP)) + 1))
        center = one.center(here.section, here.lane, s)
        x, y, heading = one.at(s, center)
        if max(np.ptp(x), np.ptp(y)) <= SHORTEST:
            # Rounding would decide where it leads.
            s, center, aside = np.array([start, end]), center[[0, -1]], np.array([-0.5, 0.5]) * SHORTEST
            x, y = x[0] + aside * np.cos(heading[0]), y[0] + aside * np.sin(heading[0])
        at, bend = one.bends(start, end, STEP)
        order, left = (slice(None), 1.0) if here.along else (slice(None, None, -1), -1.0)
        begin, until = (start, end) if here.along else (end, start)
        n = len(s)
        jumps = [abs(jump - begin) for jump in one.jumps if start < jump < end]
        path = LanePath.of_points(
            x[order], y[order], s[order], np.full(n, here.road), np.full(n, here.lane), np.full(n, here.along),
            np.full(n, passed), np.abs(s - begin)[order], left * center[order],
            np.abs(at - begin)[order], left * bend[order],
            jumped_at(np.abs(s - begin)[order], jumps),
        )  # fmt: skip
        if jumps:
            turned = 0.0 if here.along else np.pi
            path = path.across_jumps(jumps, one.at_lane(here.lane, path.s)[2] + turned)
        return replace(path, lane_s=(begin, until), lane_span=(0.0, float(path.distance[-1])))

    def exits(self, here: Stretch) -> list[Stretch]:
        """Stretches that follow one in the direction of travel; none where its lane ends."""
        found = []
        for option in self._linked(here):
            meets = self._gap(here, option) <= 0.0
            if meets:
                found.append(option)
            apart = self._apart(here, option)[0] if self._at_ends(here, option) else 0.0
            if not meets or apart > _NOTABLE:
                pair = min(here.road, option.road), max(here.road, option.road)
                known = self.crossed if meets else self.gaps
                known[pair] = max(known.get(pair, 0.0), self._apart(here, option)[0])
        return found

    @cached_property
    def crossed(self) -> dict[tuple[int, int], float]:
        """Indices of roads that are linked and do not quite meet, and how far apart lanes end, as `exits` found."""
        return {}

    @cached_property
    def gaps(self) -> dict[tuple[int, int], float]:
        """Indices of roads that are linked but do not meet, and how far apart lanes end, in m, as `exits` found."""
        return {}

    def _at_ends(self, here: Stretch, option: Stretch) -> bool:
        """Whether a way leads from an end of a road to an end of another, not to or from a place along one."""
        ends = [(self._end(here), self._roads[here.road]), (self._begin(option), self._roads[option.road])]
        return here.road != option.road and all(s in (0.0, road.length) for s, road in ends)

    def _linked(self, here: Stretch) -> list[Stretch]:
        """Stretches that are linked to the end of one, whether they meet it or not."""
        one = self._roads[here.road]
        lane = one.sections[here.section][1].get(here.lane)
        linked = () if lane is None else (lane.successors if here.along else lane.predecessors)
        following = here.section + (1 if here.along else -1)
        if 0 <= following < len(one.sections):
            lanes = one.sections[following][1]
            numbers = linked or (here.lane,)
            onward = [Stretch(here.road, following, number, here.along) for number in numbers if number in lanes]
            s = one.sections[max(here.section, following)][0]
            beside = [
                option
                for at, name, contact in self.roads.leaving.get((one.name, here.along), ())
                if at == s
                for option in self._onto(name, contact, here.lane)
            ]
            return [*onward, *beside]
        link = one.successor if here.along else one.predecessor
        if link is None:
            return []
        if link.kind == "road":
            return self._enter(link, linked, here.along)
        # A connecting road's own links tell more than the junction's: at which end of this road it meets it, and they
        # also hold for an entity that drives against the traffic.
        end = "end" if here.along else "start"
        found = list[Stretch]()
        for name, contact in self.roads.connecting.get((link.element, one.name, end), ()):
            found += self._onto(name, contact, here.lane)
        if not found:
            for incoming, connecting, contact, links in self._connections.get(link.element, ()):
                if incoming == one.name and (here.lane in links or not links):
                    found += self._enter(Link("road", connecting, contact), (links.get(here.lane, here.lane),), True)
        return list(dict.fromkeys(found))

    def _onto(self, name: str, contact: str, lane: int) -> list[Stretch]:
        """Lanes of a connecting road, entered at one of its ends, that are linked to a lane there."""
        road = self._roads[self._index[name]]
        lanes = road.sections[0 if contact == "start" else -1][1]
        return [
            option
            for number, other in lanes.items()
            if lane in (other.predecessors if contact == "start" else other.successors)
            for option in self._enter(Link("road", name, contact), (number,), True)
        ]

    def _enter(self, link: Link, lanes: Sequence[int], along: bool) -> list[Stretch]:
        """Lanes of a linked road, by who comes along the s of the road that has the link, or against it."""
        if link.element not in self._index:
            return []
        road = self._index[link.element]
        sections = self._roads[road].sections
        if link.s is None:
            onward = link.contact != "end"
            section = 0 if onward else len(sections) - 1
        else:
            onward = link.forward == along
            starts = [start for start, _ in sections]
            section = int(np.searchsorted(starts, link.s, "right" if onward else "left")) - 1
            section = max(section, 0)
        return [Stretch(road, section, lane, onward) for lane in lanes if lane in sections[section][1]]

    def _gap(self, here: Stretch, option: Stretch) -> float:
        """How much further apart than their width allows a stretch ends and another begins, in m; 0 where they meet."""
        if here.road == option.road and here.along == option.along:
            return 0.0
        apart, wide = self._apart(here, option)
        return max(apart - wide - GAP, 0.0)

    def _apart(self, here: Stretch, option: Stretch) -> tuple[float, float]:
        """Distance in m between the end of a stretch and the begin of another, and half their widths together."""
        key = here, option
        if key not in self._distances:
            ends = []
            for one, at in ((here, self._end(here)), (option, self._begin(option))):
                road, s = self._roads[one.road], np.array([at])
                x, y, _ = road.at(s, road.center(one.section, one.lane, s))
                ends.append((float(x[0]), float(y[0]), float(road.width(one.section, one.lane, s)[0])))
            (x0, y0, width0), (x1, y1, width1) = ends
            self._distances[key] = float(np.hypot(x1 - x0, y1 - y0)), 0.5 * (width0 + width1)
        return self._distances[key]

    @cached_property
    def _distances(self) -> dict[tuple[Stretch, Stretch], tuple[float, float]]:
        return {}

    def _begin(self, here: Stretch) -> float:
        return self.span(here)[0 if here.along else 1]

    def _end(self, here: Stretch) -> float:
        return self.span(here)[1 if here.along else 0]

    def _bend(self, here: Stretch, option: Stretch) -> float:
        """How much a road turns who takes it from where a stretch ends to its far end, in rad."""
        one = self._roads[option.road]
        far = one.length if option.along else 0.0
        before = self._roads[here.road].reference(np.array([self._end(here)]))[2][0] + (0.0 if here.along else np.pi)
        after = one.reference(np.array([far]))[2][0] + (0.0 if option.along else np.pi)
        return float(abs(within_half_turn(after - before)))
