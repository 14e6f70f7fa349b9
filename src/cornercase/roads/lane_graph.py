"""Routes from lane to lane."""

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

# Lane ends at most this far apart, in m, are not reported: their widths differ.
_NOTABLE: Final = 0.5
# Loops are followed up to this length in m.
_LONGEST_LOOP: Final = 3000.0
_MOST_ROADS: Final = 500
# Tolerance for equal changes of heading, in rad. If tied, the last road in the file is taken; esmini draws one.
_AS_STRAIGHT: Final = 1e-6


class Stretch(NamedTuple):
    """A lane of one lane section, travelled along the road's s or against it."""

    road: int
    section: int
    lane: int
    along: bool

    def reversed(self) -> Stretch:
        """Return the same lane in the opposite direction."""
        return self._replace(along=not self.along)


class Walk(NamedTuple):
    """Consecutive directed lanes.

    `goals_passed` is the number of goals passed at the end of each; `is_dead_end` is whether the last one is one.
    """

    stretches: list[Stretch]
    passed: list[int]
    ends: bool


class LaneGraph:
    """Lanes of a road network, and how they are connected.

    `connections` are those of each junction; `road_indices` maps road ids to indices.
    """

    def __init__(
        self, roads: Sequence[Road], connections: Mapping[str, Sequence[Connection]], index: Mapping[str, int]
    ) -> None:
        self._roads, self._connections, self._index = roads, connections, index
        self.roads = RoadGraph(roads, connections, index)

    def walk(self, here: Stretch, goals: Sequence[int], longest: float) -> Walk:
        """Follow lanes from a start through the goals if they are reachable, else as straight on as possible.

        `goals` are roads in the order to pass them; the first may be that of the start. The walk is cut `max_length` m
        after the first lane.
        """
        behind = int(bool(goals) and goals[0] == here.road)
        stretches, passed, length, seen = [here], [behind], 0.0, {here}
        for k in range(_MOST_ROADS):
            start, end = self.span(here)
            length += end - start if k else 0.0
            options = self.exits(here)
            if not options:
                return Walk(stretches, passed, ends=True)
            if length > longest:
                break
            here = self._choose(here, options, goals[behind] if behind < len(goals) else None)
            if here in seen and length > _LONGEST_LOOP:
                break
            behind += behind < len(goals) and goals[behind] == here.road
            seen.add(here)
            stretches.append(here)
            passed.append(behind)
        return Walk(stretches, passed, ends=False)

    def _choose(self, here: Stretch, options: list[Stretch], goal: int | None) -> Stretch:
        if goal is not None:
            lengths = [self.roads.length_to(option.road, option.section, option.along, goal) for option in options]
            if np.isfinite(min(lengths)):
                return options[int(np.argmin(lengths))]
        if options[0].road == here.road and options[0].along == here.along:
            return options[0]
        bends = np.array([self._bend(here, option) for option in options])
        return options[int(np.flatnonzero(bends <= bends.min() + _AS_STRAIGHT)[-1])]

    def span(self, here: Stretch) -> tuple[float, float]:
        """Return the s coordinates of a lane's ends, lower one first, in m."""
        return self._roads[here.road].section_span(here.section)

    def piece(self, here: Stretch, passed: int = 0) -> LanePath:
        """Return the center line in the direction of travel; `goals_passed` is the number of goals passed."""
        road = self._roads[here.road]
        start, end = self.span(here)
        s = np.linspace(start, end, max(2, int(np.ceil((end - start) / STEP)) + 1))
        center = road.center(here.section, here.lane, s)
        x, y, heading = road.at(s, center)
        if max(np.ptp(x), np.ptp(y)) <= SHORTEST:
            # Its direction would be a rounding error.
            s, center, aside = np.array([start, end]), center[[0, -1]], np.array([-0.5, 0.5]) * SHORTEST
            x, y = x[0] + aside * np.cos(heading[0]), y[0] + aside * np.sin(heading[0])
        at, bend = road.bends(start, end, STEP)
        order, left = (slice(None), 1.0) if here.along else (slice(None, None, -1), -1.0)
        begin, until = (start, end) if here.along else (end, start)
        n = len(s)
        jumps = [abs(jump - begin) for jump in road.jumps if start < jump < end]
        path = LanePath.of_points(
            x[order], y[order], s[order], np.full(n, here.road), np.full(n, here.lane), np.full(n, here.along),
            np.full(n, passed), np.abs(s - begin)[order], left * center[order],
            np.abs(at - begin)[order], left * bend[order],
            jumped_at(np.abs(s - begin)[order], jumps),
        )  # fmt: skip
        if jumps:
            turned = 0.0 if here.along else np.pi
            path = path.across_jumps(jumps, road.at_lane(here.lane, path.s)[2] + turned)
        return replace(path, lane_s=(begin, until), lane_span=(0.0, float(path.distance[-1])))

    def exits(self, here: Stretch) -> list[Stretch]:
        """Return the directed lanes that follow one; none if it ends."""
        following = []
        for option in self._linked(here):
            meets = self._gap(here, option) <= 0.0
            if meets:
                following.append(option)
            distance = self._apart(here, option)[0] if self._at_ends(here, option) else 0.0
            if not meets or distance > _NOTABLE:
                pair = min(here.road, option.road), max(here.road, option.road)
                distances = self.crossed if meets else self.gaps
                distances[pair] = max(distances.get(pair, 0.0), self._apart(here, option)[0])
        return following

    @cached_property
    def crossed(self) -> dict[tuple[int, int], float]:
        """Distance in m of lane ends of loosely linked roads, by pair of road indices; filled by `find_exits`."""
        return {}

    @cached_property
    def gaps(self) -> dict[tuple[int, int], float]:
        """Distance in m of lane ends of roads that do not meet, by pair of road indices; filled by `find_exits`."""
        return {}

    def _at_ends(self, here: Stretch, option: Stretch) -> bool:
        """Whether a transition leads from an end of a road to an end of another one."""
        ends = [(self._end(here), self._roads[here.road]), (self._begin(option), self._roads[option.road])]
        return here.road != option.road and all(s in (0.0, road.length) for s, road in ends)

    def _linked(self, here: Stretch) -> list[Stretch]:
        """Return the directed lanes that are linked to the end of one, whether they meet or not."""
        road = self._roads[here.road]
        lane = road.sections[here.section][1].get(here.lane)
        linked = () if lane is None else (lane.successors if here.along else lane.predecessors)
        following = here.section + (1 if here.along else -1)
        if 0 <= following < len(road.sections):
            lanes = road.sections[following][1]
            numbers = linked or (here.lane,)
            onward = [Stretch(here.road, following, number, here.along) for number in numbers if number in lanes]
            s = road.sections[max(here.section, following)][0]
            beside = [
                option
                for at, name, contact in self.roads.leaving.get((road.name, here.along), ())
                if at == s
                for option in self._onto(name, contact, here.lane)
            ]
            return [*onward, *beside]
        link = road.successor if here.along else road.predecessor
        if link is None:
            return []
        if link.kind == "road":
            return self._enter(link, linked, here.along)
        # A connecting road's own links tell more than the junction's: which end of this road it meets, and they
        # also hold for an entity that drives against the traffic.
        end = "end" if here.along else "start"
        options = list[Stretch]()
        for name, contact in self.roads.connecting.get((link.element, road.name, end), ()):
            options += self._onto(name, contact, here.lane)
        if not options:
            for incoming, connecting, contact, links in self._connections.get(link.element, ()):
                if incoming == road.name and (here.lane in links or not links):
                    options += self._enter(Link("road", connecting, contact), (links.get(here.lane, here.lane),), True)
        return list(dict.fromkeys(options))

    def _onto(self, name: str, contact: str, lane: int) -> list[Stretch]:
        """Return the lanes of a connecting road that are linked to a lane at one of its ends."""
        road = self._roads[self._index[name]]
        lanes = road.sections[0 if contact == "start" else -1][1]
        return [
            option
            for number, candidate in lanes.items()
            if lane in (candidate.predecessors if contact == "start" else candidate.successors)
            for option in self._enter(Link("road", name, contact), (number,), True)
        ]

    def _enter(self, link: Link, lanes: Sequence[int], along: bool) -> list[Stretch]:
        """Return lanes of a linked road, and the direction of travel on it.

        `forward` is the direction of travel on the road that has the link.
        """
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
        """Return by how many m the distance between two lane ends exceeds what their widths allow."""
        if here.road == option.road and here.along == option.along:
            return 0.0
        distance, wide = self._apart(here, option)
        return max(distance - wide - GAP, 0.0)

    def _apart(self, here: Stretch, option: Stretch) -> tuple[float, float]:
        """Return the distance in m from the end of a lane to another's start, and half their summed width."""
        key = here, option
        if key not in self._distances:
            ends = []
            for stretch, at in ((here, self._end(here)), (option, self._begin(option))):
                road, s = self._roads[stretch.road], np.array([at])
                x, y, _ = road.at(s, road.center(stretch.section, stretch.lane, s))
                ends.append((float(x[0]), float(y[0]), float(road.width(stretch.section, stretch.lane, s)[0])))
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
        """Return the change of heading from the end of a lane to the far end of the next road, in rad."""
        road = self._roads[option.road]
        far_end = road.length if option.along else 0.0
        heading = self._roads[here.road].reference(np.array([self._end(here)]))[2][0] + (0.0 if here.along else np.pi)
        new_heading = road.reference(np.array([far_end]))[2][0] + (0.0 if option.along else np.pi)
        return float(abs(within_half_turn(new_heading - heading)))
