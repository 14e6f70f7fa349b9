"""Graph of lanes: which lanes continue a lane, and routes from lane to lane."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.geometry.boxes import wrap_angle
from cornercase.roads._lane_path import MIN_PATH_LENGTH, SAMPLE_DISTANCE, LanePath, find_first_after_jumps
from cornercase.roads._road import Road, RoadLink
from cornercase.roads._road_graph import MAX_GAP, JunctionConnection, RoadGraph

# Lane ends at most this far apart, in m, are not reported: their widths differ.
_MAX_UNREPORTED_GAP: Final = 0.5
# Loops are followed up to this length in m.
_MAX_LOOP_LENGTH: Final = 3000.0
_MAX_STRETCHES: Final = 500
# Tolerance for equal changes of heading, in rad. If tied, the last road in the file is taken; esmini draws one.
_EQUAL_TURN_TOLERANCE: Final = 1e-6


class DirectedLane(NamedTuple):
    """A lane of one lane section, with a direction of travel: `forward` is along the road's s."""

    road: int
    section: int
    lane: int
    forward: bool

    def reversed(self) -> DirectedLane:
        """Return the same lane in the opposite direction."""
        return self._replace(forward=not self.forward)


class LaneWalk(NamedTuple):
    """A sequence of directed lanes.

    `stretches` are the lanes in the order of travel. `goals_passed` has, for each of these lanes, the number of goals
    (roads on the route) reached so far. `is_dead_end` is True if no lane follows the last lane.
    """

    stretches: list[DirectedLane]
    goals_passed: list[int]
    is_dead_end: bool


class LaneGraph:
    """Lanes of a road network, and their connections.

    `connections` has the connections of each junction, by junction id. `road_indices` maps road ids to indices.
    """

    def __init__(
        self,
        roads: Sequence[Road],
        connections: Mapping[str, Sequence[JunctionConnection]],
        road_indices: Mapping[str, int],
    ) -> None:
        self._roads, self._connections, self._road_indices = roads, connections, road_indices
        self.road_graph = RoadGraph(roads, connections, road_indices)

    def follow_lanes(self, start: DirectedLane, goals: Sequence[int], max_length: float) -> LaneWalk:
        """Follow lanes from `start` through the goals, or as straight on as possible if the goals cannot be reached.

        `goals` are roads, in the order in which to pass them; the first may be the road of `start`. The walk ends about
        `max_length` m after the first lane.
        """
        n_passed = int(bool(goals) and goals[0] == start.road)
        stretches, passed, length, seen = [start], [n_passed], 0.0, {start}
        for k in range(_MAX_STRETCHES):
            first, last = self.s_interval(start)
            length += last - first if k else 0.0
            options = self.find_exits(start)
            if not options:
                return LaneWalk(stretches, passed, is_dead_end=True)
            if length > max_length:
                break
            start = self._choose_exit(start, options, goals[n_passed] if n_passed < len(goals) else None)
            if start in seen and length > _MAX_LOOP_LENGTH:
                break
            n_passed += n_passed < len(goals) and goals[n_passed] == start.road
            seen.add(start)
            stretches.append(start)
            passed.append(n_passed)
        return LaneWalk(stretches, passed, is_dead_end=False)

    def _choose_exit(self, lane: DirectedLane, options: list[DirectedLane], goal: int | None) -> DirectedLane:
        if goal is not None:
            lengths = [
                self.road_graph.length_to_goal(option.road, option.section, option.forward, goal) for option in options
            ]
            if np.isfinite(min(lengths)):
                return options[int(np.argmin(lengths))]
        if options[0].road == lane.road and options[0].forward == lane.forward:
            return options[0]
        bends = np.array([self._heading_change(lane, option) for option in options])
        return options[int(np.flatnonzero(bends <= bends.min() + _EQUAL_TURN_TOLERANCE)[-1])]

    def s_interval(self, lane: DirectedLane) -> tuple[float, float]:
        """Return the s coordinates of a lane's ends, lower one first, in m."""
        return self._roads[lane.road].section_interval(lane.section)

    def lane_center_path(self, lane: DirectedLane, goals_passed: int = 0) -> LanePath:
        """Return the center line of a lane in the direction of travel.

        `goals_passed`, the number of goals reached so far on the route, is only copied to the path.
        """
        road = self._roads[lane.road]
        start, end = self.s_interval(lane)
        s = np.linspace(start, end, max(2, int(np.ceil((end - start) / SAMPLE_DISTANCE)) + 1))
        center = road.lane_center(lane.section, lane.lane, s)
        x, y, heading = road.pose_at(s, center)
        if max(np.ptp(x), np.ptp(y)) <= MIN_PATH_LENGTH:
            # Its direction would be a rounding error.
            s, center, aside = np.array([start, end]), center[[0, -1]], np.array([-0.5, 0.5]) * MIN_PATH_LENGTH
            x, y = x[0] + aside * np.cos(heading[0]), y[0] + aside * np.sin(heading[0])
        at, bend = road.sample_curvature(start, end, SAMPLE_DISTANCE)
        order, left = (slice(None), 1.0) if lane.forward else (slice(None, None, -1), -1.0)
        begin, until = (start, end) if lane.forward else (end, start)
        n = len(s)
        jumps = [abs(jump - begin) for jump in road.jumps if start < jump < end]
        path = LanePath.from_points(
            x[order], y[order], s[order], np.full(n, lane.road), np.full(n, lane.lane), np.full(n, lane.forward),
            np.full(n, goals_passed), np.abs(s - begin)[order], left * center[order],
            np.abs(at - begin)[order], left * bend[order],
            find_first_after_jumps(np.abs(s - begin)[order], jumps, forward=lane.forward),
        )  # fmt: skip
        if jumps:
            turned = 0.0 if lane.forward else np.pi
            path = path.with_jump_headings(jumps, road.lane_pose_at(lane.lane, path.s)[2] + turned)
        return replace(path, lane_s=(begin, until), lane_span=(0.0, float(path.distance[-1])))

    def find_exits(self, lane: DirectedLane) -> list[DirectedLane]:
        """Return the directed lanes that continue a directed lane; none if it is a dead end."""
        following = []
        for option in self._linked_lanes(lane):
            meets = self._gap_beyond_widths(lane, option) <= 0.0
            if meets:
                following.append(option)
            distance = self._end_distance_and_width(lane, option)[0] if self._connects_road_ends(lane, option) else 0.0
            if not meets or distance > _MAX_UNREPORTED_GAP:
                pair = min(lane.road, option.road), max(lane.road, option.road)
                distances = self.links_with_small_gap if meets else self.unconnected_links
                distances[pair] = max(distances.get(pair, 0.0), self._end_distance_and_width(lane, option)[0])
        return following

    @cached_property
    def links_with_small_gap(self) -> dict[tuple[int, int], float]:
        """Largest gap in m between lane ends of two connected roads, by pair of road indices; only gaps above 0.5 m.

        `find_exits` adds each pair that it finds.
        """
        return {}

    @cached_property
    def unconnected_links(self) -> dict[tuple[int, int], float]:
        """Largest gap in m between lane ends of two linked roads, by pair of road indices, if the roads do not meet.

        `find_exits` adds each pair that it finds.
        """
        return {}

    def _connects_road_ends(self, lane: DirectedLane, option: DirectedLane) -> bool:
        """Return whether `lane` ends at an end of its road, and `option` starts at an end of another road."""
        ends = [(self._end_s(lane), self._roads[lane.road]), (self._start_s(option), self._roads[option.road])]
        return lane.road != option.road and all(s in (0.0, road.length) for s, road in ends)

    def _linked_lanes(self, lane: DirectedLane) -> list[DirectedLane]:
        """Return the directed lanes that the file links to the end of a directed lane, even across a gap."""
        road = self._roads[lane.road]
        section_lane = road.sections[lane.section][1].get(lane.lane)
        linked = (
            () if section_lane is None else (section_lane.successors if lane.forward else section_lane.predecessors)
        )
        following = lane.section + (1 if lane.forward else -1)
        if 0 <= following < len(road.sections):
            lanes = road.sections[following][1]
            numbers = linked or (lane.lane,)
            onward = [DirectedLane(lane.road, following, number, lane.forward) for number in numbers if number in lanes]
            s = road.sections[max(lane.section, following)][0]
            neighbours = [
                option
                for at, name, contact in self.road_graph.connecting_roads_along.get((road.road_id, lane.forward), ())
                if at == s
                for option in self._connecting_lanes(name, contact, lane.lane)
            ]
            return [*onward, *neighbours]
        link = road.successor if lane.forward else road.predecessor
        if link is None:
            return []
        if link.target_type == "road":
            return self._enter_linked_road(link, linked, lane.forward)
        # The links of a connecting road say more than those of the junction: which end of this road is met. They also
        # hold for an entity that drives against the traffic.
        end = "end" if lane.forward else "start"
        options = list[DirectedLane]()
        for name, contact in self.road_graph.connecting_roads_at_ends.get((link.target_id, road.road_id, end), ()):
            options += self._connecting_lanes(name, contact, lane.lane)
        if not options:
            for incoming, connecting, contact, links in self._connections.get(link.target_id, ()):
                if incoming == road.road_id and (lane.lane in links or not links):
                    options += self._enter_linked_road(
                        RoadLink("road", connecting, contact), (links.get(lane.lane, lane.lane),), True
                    )
        return list(dict.fromkeys(options))

    def _connecting_lanes(self, road_id: str, contact_point: str, lane: int) -> list[DirectedLane]:
        """Return the lanes of a connecting road that are linked to the lane `lane` of an adjacent road.

        The adjacent road is at the `contact_point`, the start or end of the connecting road.
        """
        road = self._roads[self._road_indices[road_id]]
        lanes = road.sections[0 if contact_point == "start" else -1][1]
        return [
            option
            for number, candidate in lanes.items()
            if lane in (candidate.predecessors if contact_point == "start" else candidate.successors)
            for option in self._enter_linked_road(RoadLink("road", road_id, contact_point), (number,), True)
        ]

    def _enter_linked_road(self, link: RoadLink, lanes: Sequence[int], forward: bool) -> list[DirectedLane]:
        """Return the given lanes of a linked road, with the direction of travel on it.

        `forward` is the direction of travel on the road that has the link.
        """
        if link.target_id not in self._road_indices:
            return []
        road = self._road_indices[link.target_id]
        sections = self._roads[road].sections
        if link.s is None:
            onward = link.contact_point != "end"
            section = 0 if onward else len(sections) - 1
        else:
            onward = link.forward == forward
            starts = [start for start, _ in sections]
            section = int(np.searchsorted(starts, link.s, "right" if onward else "left")) - 1
            section = max(section, 0)
        return [DirectedLane(road, section, lane, onward) for lane in lanes if lane in sections[section][1]]

    def _gap_beyond_widths(self, lane: DirectedLane, option: DirectedLane) -> float:
        """Return by how many m two lane ends are too far from each other to be connected; 0 if they are connected.

        Wide lanes may be farther from each other than narrow lanes.
        """
        if lane.road == option.road and lane.forward == option.forward:
            return 0.0
        distance, wide = self._end_distance_and_width(lane, option)
        return max(distance - wide - MAX_GAP, 0.0)

    def _end_distance_and_width(self, lane: DirectedLane, option: DirectedLane) -> tuple[float, float]:
        """Return the distance in m from the end of a lane to the start of the next, and their mean width in m."""
        key = lane, option
        if key not in self._end_distances:
            ends = []
            for stretch, at in ((lane, self._end_s(lane)), (option, self._start_s(option))):
                road, s = self._roads[stretch.road], np.array([at])
                x, y, _ = road.pose_at(s, road.lane_center(stretch.section, stretch.lane, s))
                ends.append((float(x[0]), float(y[0]), float(road.lane_width(stretch.section, stretch.lane, s)[0])))
            (x0, y0, width0), (x1, y1, width1) = ends
            self._end_distances[key] = float(np.hypot(x1 - x0, y1 - y0)), 0.5 * (width0 + width1)
        return self._end_distances[key]

    @cached_property
    def _end_distances(self) -> dict[tuple[DirectedLane, DirectedLane], tuple[float, float]]:
        return {}

    def _start_s(self, lane: DirectedLane) -> float:
        return self.s_interval(lane)[0 if lane.forward else 1]

    def _end_s(self, lane: DirectedLane) -> float:
        return self.s_interval(lane)[1 if lane.forward else 0]

    def _heading_change(self, lane: DirectedLane, option: DirectedLane) -> float:
        """Return the change of heading in rad from the end of a lane to the far end of the next road."""
        road = self._roads[option.road]
        far_end = road.length if option.forward else 0.0
        heading = self._roads[lane.road].reference_pose(np.array([self._end_s(lane)]))[2][0] + (
            0.0 if lane.forward else np.pi
        )
        new_heading = road.reference_pose(np.array([far_end]))[2][0] + (0.0 if option.forward else np.pi)
        return float(abs(wrap_angle(new_heading - heading)))
