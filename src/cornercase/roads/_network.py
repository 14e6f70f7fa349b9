"""OpenDRIVE road networks in the plane."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.io.tracked_xml import note_adaptation
from cornercase._common.text.element_locations import format_location
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads._lane_distance import LaneDistanceIndex
from cornercase.roads._lane_graph import DirectedLane, LaneGraph
from cornercase.roads._lane_path import LanePath, join_paths
from cornercase.roads._links import read_junction_connections, resolve_links
from cornercase.roads._locator import LaneCoordinates, RoadLocator
from cornercase.roads._reference_line import read_finite_number
from cornercase.roads._require_drivable import require_drivable_road
from cornercase.roads._road import Road, find_permanent_lanes, read_road
from cornercase.roads._road_graph import JunctionConnection
from cornercase.roads._signs import read_junction_priorities
from cornercase.roads._support_table import SUPPORT_TABLE
from cornercase.scenario._xml import read_xml

if TYPE_CHECKING:
    from cornercase.roads._kernels.heading import RoadTables

_MAX_PATH_LENGTH: Final = 5000.0
_MAX_BACKWARD_LENGTH: Final = 500.0
_MAX_CONTINUATION_GAP: Final = 0.3


@dataclass(frozen=True, eq=False)
class RoadNetwork:
    """All roads of an OpenDRIVE file.

    `connections` has the connections of each junction. `priorities` has pairs of roads for each junction; the first
    road has right of way over the second. Roads that cannot be used are left out; `excluded_roads` maps the ids of
    these roads to the reasons. `first_line` is the line of the first road in the file, for messages.
    """

    path: Path
    roads: tuple[Road, ...]
    connections: dict[str, tuple[JunctionConnection, ...]] = field(default_factory=dict)
    excluded_roads: dict[str, str] = field(default_factory=dict)
    first_line: int = 1
    priorities: dict[str, tuple[tuple[str, str], ...]] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path | str) -> RoadNetwork:
        """Read an OpenDRIVE file of version 1.4 to 1.9; elevation and temporary lanes are ignored."""
        return cls.from_xml(read_xml(path), Path(path))

    @classmethod
    def from_xml(cls, root: etree._Element, path: Path) -> RoadNetwork:
        """Create the network of a parsed OpenDRIVE file; namespaces are removed from `root`."""
        for element in root.iter():
            if isinstance(element.tag, str) and "}" in element.tag:
                element.tag = element.tag.split("}", 1)[1]
        if root.tag != "OpenDRIVE":
            location = format_location(root, str(path))
            raise InputError(f"{location}: the root element is <{root.tag}>; a road file starts with <OpenDRIVE>.")
        SUPPORT_TABLE.check_supported(root, path)
        cuts = _link_positions(root, path)
        if root.find("header") is None:
            note_adaptation(
                root, "<header>", "is missing, and the file is read as OpenDRIVE 1.9", "a file has a <header>"
            )
        elements: dict[str, etree._Element] = {}
        roads, left_out = list[Road](), dict[str, str]()
        for element in root.iterfind("road"):
            name, line = element.get("id", ""), element.sourceline
            if not name:
                raise InputError(f"{path}, line {line}: a <road> has no id; give it one.")
            if name in elements:
                raise InputError(f"{path}, line {line}: <road>: a second road has the id '{name}'; give it another.")
            elements[name], where = element, f"{format_location(element, str(path))}, road {name}"
            # Raises if it is not clear which lanes are meant.
            find_permanent_lanes(element, where)
            try:
                road = read_road(element, where, cuts.get(name, ()))
                require_drivable_road(road, element, where)
            except InputError as error:
                left_out[name] = str(error)
            else:
                roads.append(road)
        if not elements:
            raise InputError(f"{format_location(root, str(path))}: <OpenDRIVE> has no <road>.")
        if not roads:
            raise InputError(next(iter(left_out.values())))
        for name, message in left_out.items():
            reason = message.partition(f", road {name}: ")[2].removesuffix(".")
            note_adaptation(
                elements[name], f"road {name}", f"is left out: {reason}", "a road is complete and without jumps"
            )
        junctions = {e.get("id", ""): e for e in root.iterfind("junction")}
        linked = resolve_links(roads, elements, {*junctions})
        by_name = {road.road_id: road for road in linked}
        connections = {
            name: read_junction_connections(e, f"{format_location(e, str(path))}, junction {name}", by_name, elements)
            for name, e in junctions.items()
        }
        first_line = int(str(elements[linked[0].road_id].sourceline or 1))
        priorities = {name: read_junction_priorities(e) for name, e in junctions.items()}
        return cls(path, linked, connections, left_out, first_line, priorities)

    @cached_property
    def road_lengths(self) -> FloatArray:
        """Length of each road in m, shape (R,)."""
        return np.array([road.length for road in self.roads])

    def road_index(self, road_id: str) -> int:
        """Return the index of a road by its id; raises `InputError` if the road does not exist or cannot be used."""
        if road_id in self.excluded_roads:
            raise InputError(self.excluded_roads[road_id])
        if road_id not in self._road_indices:
            raise InputError(f"{self.path}: has no road '{road_id}'; {suggest_name(road_id, self._road_indices)}")
        return self._road_indices[road_id]

    def find_road(self, road_id: str) -> int | None:
        """Return the index of a road by its id; None if the road does not exist or cannot be used."""
        return self._road_indices.get(road_id)

    @cached_property
    def _road_indices(self) -> dict[str, int]:
        return {road.road_id: i for i, road in enumerate(self.roads)}

    def has_lane_at(self, road: int, lane: int, s: FloatArray) -> BoolArray:
        """Return whether a road has a lane at each s in m, shape (N,); the center lane 0 exists everywhere."""
        current = self.roads[road]
        exists = np.array([lane == 0 or lane in lanes for _, lanes in current.sections])
        return np.asarray(exists[current.section_at(s)])

    def is_traffic_forward(self, road: int, lane: int, s: float) -> bool:
        """Return whether traffic on a lane runs along the road's s, at the coordinate `s` in m."""
        return bool(self.roads[road].is_traffic_forward(lane, np.array([s]))[0])

    def road_to_xy_heading(self, road: int, s: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Convert road coordinates s and t in m to x, y and the heading of the reference line, shape (N,) each."""
        return self.roads[road].pose_at(s, t)

    def lane_to_xy_heading(
        self, road: int, lane: int, s: FloatArray, offset: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Convert lane coordinates to x and y, and the heading of the lane's traffic, shape (N,) each.

        `offset` is the offset from the lane's center in m, positive to the left, seen along s.
        """
        current = self.roads[road]
        x, y, heading = current.lane_pose_at(lane, s, offset)
        section = current.section_at(s)
        for k in sorted(set(section.tolist())):
            heading[section == k] += current.lane_angle(k, lane, s[section == k])
        return x, y, np.where(current.is_traffic_forward(lane, s), heading, heading + np.pi)

    def find_lane(self, road: int, s: FloatArray, t: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return the lane at road coordinates s and t, or else the nearest lane, and the offset from the lane's center.

        The offset is in m, positive to the left, seen along s. All arrays have shape (N,).
        """
        current = self.roads[road]
        lane, offset = np.zeros(len(s), dtype=np.int64), np.zeros(len(s))
        best = np.full(len(s), np.inf)
        section = current.section_at(s)
        for k in np.unique(section):
            for number in current.sections[int(k)][1]:
                rows = np.flatnonzero(section == k)
                from_center = t[rows] - current.lane_center(int(k), number, s[rows])
                cost = np.abs(from_center) - 0.5 * current.lane_width(int(k), number, s[rows])
                rows = rows[nearer := cost < best[rows]]
                lane[rows], offset[rows], best[rows] = number, from_center[nearer], cost[nearer]
        return lane, offset

    def locate_on_route(
        self, waypoints: list[tuple[int, int, float]], distance: FloatArray
    ) -> tuple[IntArray, FloatArray, BoolArray]:
        """Return road, s and direction (whether along s) at distances along a route, shape (N,) each.

        `waypoints` are (road, lane, s). `distance` is measured from the first waypoint, in m.
        """
        road, lane, s = waypoints[0]
        section = int(self.roads[road].section_at(np.array([s]))[0])
        walk = self._lane_graph.follow_lanes(
            DirectedLane(road, section, lane, self.is_traffic_forward(road, lane, s)),
            [goal for goal, _, _ in waypoints],
            max(_MAX_PATH_LENGTH, float(np.max(distance, initial=0.0))),
        ).stretches
        roads, begins, starts, directions = [], [], [], []
        length = 0.0
        for k, stretch in enumerate(walk):
            start, end = self._lane_graph.s_interval(stretch)
            entry = (s if k == 0 else start) if stretch.forward else (s if k == 0 else end)
            roads.append(stretch.road)
            begins.append(length)
            starts.append(entry)
            directions.append(stretch.forward)
            length += (end - entry) if stretch.forward else (entry - start)
        leg = np.clip(np.searchsorted(begins, distance, "right") - 1, 0, len(roads) - 1)
        along = np.array(directions)[leg]
        beyond = distance - np.array(begins)[leg]
        return np.array(roads)[leg], np.array(starts)[leg] + np.where(along, beyond, -beyond), along

    def driving_distance(
        self, road: IntArray, s: FloatArray, forward: BoolArray, goal_road: IntArray, goal_s: FloatArray
    ) -> FloatArray:
        """Return the distances along roads from positions to goals, in m, shape (N,); lanes are ignored.

        `forward` is True if an entity that drives ahead drives along s. The distance is negative if the shortest route
        leads backwards, and infinite if the roads are not connected. If the goal is on the road of the position, only
        the way along this road counts, even if a way around, as in a ring, is shorter.
        """
        return self._lane_graph.road_graph.driving_distance(road, s, forward, goal_road, goal_s)

    def unconnected_links(self) -> list[tuple[str, str, float]]:
        """Return pairs of linked roads that do not meet, and the distance between their lane ends in m.

        Only links at the lanes that paths or `find_linked_lanes` have followed so far are checked.
        """
        pairs = sorted((*pair, distance) for pair, distance in self._lane_graph.unconnected_links.items())
        return [(self.roads[a].road_id, self.roads[b].road_id, distance) for a, b, distance in pairs]

    def links_with_small_gap(self) -> list[tuple[str, str, float]]:
        """Return pairs of connected roads with a gap of more than 0.5 m, and the distance between their lane ends in m.

        Only links at the lanes that paths or `find_linked_lanes` have followed so far are checked.
        """
        pairs = sorted((*pair, distance) for pair, distance in self._lane_graph.links_with_small_gap.items())
        return [(self.roads[a].road_id, self.roads[b].road_id, distance) for a, b, distance in pairs]

    def locate(self, x: FloatArray, y: FloatArray) -> LaneCoordinates:
        """Return the positions of points on the roads; x and y in m, shape (N,).

        A lane that contains the point is preferred to other lanes nearby. If several lanes contain the point, drivable
        lanes are preferred.
        """
        return self._locator.locate(x, y)

    def track_road(
        self, last_road: IntArray, last_s: FloatArray, x: FloatArray, y: FloatArray, heading: FloatArray
    ) -> tuple[IntArray, FloatArray]:
        """Return road and s of moving points, shape (N,) each, given their previous road and s.

        `last_road` is -1 if the previous road is unknown. Where roads overlap, as in a junction, a point stays on its
        previous road as long as possible. A point that leaves this road changes to the nearest road or, in a junction,
        to the road that is most nearly parallel to the point's heading.
        """
        return self._locator.track_road(last_road, last_s, x, y, heading)

    @cached_property
    def road_tables(self) -> RoadTables:
        """The roads as arrays for compiled functions."""
        # Imported here, so that the compiler is loaded only if needed.
        from cornercase.roads._kernels.heading import build_road_tables

        return build_road_tables(self.roads)

    def distance_from_lanes(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the distances from the nearest lane in m, shape (N,); distances up to 10 m are returned as 0."""
        return self._lane_distance_index.distances(x, y)

    @cached_property
    def _lane_distance_index(self) -> LaneDistanceIndex:
        return LaneDistanceIndex(self.roads)

    @cached_property
    def _locator(self) -> RoadLocator:
        if not any(lanes for road in self.roads for _, lanes in road.sections):
            raise InputError(
                f"{self.path}, line {self.first_line}: <road>: none of the roads has a lane, so"
                f" nothing can be placed on"
                " them; give one of them a <lane>."
            )
        return RoadLocator(self.roads)

    def lane_path_from(
        self, road: int, lane: int, s: float, forward: bool, waypoints: tuple[tuple[int, int, float], ...] = ()
    ) -> LanePath | None:
        """Return the path along a lane, and the lanes before and after it; None if there is no such lane.

        `s` is a position at which the lane exists. `forward` says whether the path runs along the road's s. The
        `waypoints` (road, lane, s) determine the exits from junctions. After the last waypoint the path goes as
        straight on as possible.
        """
        current = self.roads[road]
        section = int(current.section_at(np.array([s]))[0])
        if lane == 0 or lane not in current.sections[section][1]:
            return None
        start = DirectedLane(road, section, lane, forward)
        key = (start, waypoints)
        if key not in self._paths:
            ahead = self._lane_graph.follow_lanes(start, [goal for goal, _, _ in waypoints], _MAX_PATH_LENGTH)
            behind = self._lane_graph.follow_lanes(start.reversed(), (), _MAX_BACKWARD_LENGTH)
            after = [
                self._lane_graph.lane_center_path(*piece)
                for piece in zip(ahead.stretches, ahead.goals_passed, strict=True)
            ]
            before, begins = [after[0]], behind.is_dead_end
            for stretch in behind.stretches[1:]:
                piece = self._lane_graph.lane_center_path(stretch.reversed())
                # A lane that opens beside its predecessor does not continue its center line.
                if np.hypot(piece.x[-1] - before[0].x[0], piece.y[-1] - before[0].y[0]) > _MAX_CONTINUATION_GAP:
                    begins = True
                    break
                before.insert(0, piece)
            path = join_paths([*before[:-1], *after], len(before) - 1)
            self._paths[key] = replace(path, has_end=ahead.is_dead_end, has_start=begins)
        return self._paths[key]

    def find_linked_lanes(self, road: int, section: int, lane: int, *, forward: bool) -> list[tuple[int, int, int]]:
        """Return the lanes (road, section, lane) that continue a lane: along s if `forward` is True, else against s."""
        exits = self._lane_graph.find_exits(DirectedLane(road, section, lane, forward))
        return [(after.road, after.section, after.lane) for after in exits]

    @cached_property
    def _lane_graph(self) -> LaneGraph:
        return LaneGraph(self.roads, self.connections, self._road_indices)

    @cached_property
    def _paths(self) -> dict[Any, LanePath]:
        return {}


def _link_positions(root: etree._Element, path: Path) -> dict[str, list[float]]:
    """Return the positions in m at which other roads start or end along a road, by id of this road."""
    positions: dict[str, list[float]] = {}
    for road in root.iterfind("road"):
        for link in (*road.iterfind("link/predecessor"), *road.iterfind("link/successor")):
            if link.get("elementS") is not None:
                s = read_finite_number(link, "elementS", f"{format_location(link, str(path))}, road {road.get('id')}")
                positions.setdefault(link.get("elementId", ""), []).append(s)
    return positions
