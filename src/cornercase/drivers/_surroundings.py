"""Lanes, speed limits and signals around the egos of a batch."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.drivers._base import Situation
from cornercase.drivers._kernels.ego_view import ALONG, LATERAL
from cornercase.drivers._kernels.path_projection import project_onto_path
from cornercase.drivers._lanes import PathAlongLanes, driven_path
from cornercase.roads._cross_sections import NO_LANE, CrossSections

if TYPE_CHECKING:
    from cornercase.roads._lane_path import LanePath
    from cornercase.roads._network import RoadNetwork


@dataclass(frozen=True, slots=True)
class LaneView:
    """Lane of the ego's road at the position of the ego, as a system under test sees it.

    Attributes
    ----------
    number : int
        0 for the ego's own lane, 1 for the next to the left, -1 for the next to the right.
    lane_type : str
        Type of OpenDRIVE, such as ``"driving"`` or ``"shoulder"``.
    same_direction : bool
        True if traffic on the lane runs in the direction of the ego's path.
    width : float
        Width in m.
    offset : float
        Lateral distance of the lane's centre from the ego's reference point in m, positive to the left.
    curvature : float
        Curvature of the centre line in 1/m, positive to the left in the direction of the ego's path.
    speed_limit : float
        Speed limit in m/s; infinite if the road file says that speed is not limited, NaN if it says nothing.

    Examples
    --------
    >>> import cornercase as cc
    >>> class ChangeLeft(cc.SystemUnderTest):
    ...     def step(self, view, dt):
    ...         left = next((lane for lane in view.lanes if lane.number == 1), None)
    ...         if left is None or left.lane_type != "driving" or not left.same_direction:
    ...             return 0.0
    ...         return cc.Control(acceleration=0.0, lane_change="left")
    >>> recording = cc.simulate("examples/r157/deceleration.xosc", drivers={"Ego": ChangeLeft()}, duration=6.0)
    >>> y = recording.y[recording.entity_index("Ego")]
    >>> round(float(y[-1] - y[0]), 2)
    3.5
    """

    number: int
    lane_type: str
    same_direction: bool
    width: float
    offset: float
    curvature: float
    speed_limit: float


@dataclass(frozen=True, eq=False)
class _EgoGroup:
    """Egos of n scenarios on the same path along lanes, and the A other entities in each scenario.

    `sections` has the lanes along the path, one column per lane from left to right. `along`, `offset` (n,): position of
    the egos along the path, and to the left of the path, in m. `column` (n,): column of the egos' lane in `sections`.
    `others_along`, `others_offset` (n, A): positions of the other entities along and to the left of the path, in m.
    """

    sections: CrossSections
    along: FloatArray
    offset: FloatArray
    column: IntArray
    others_along: FloatArray
    others_offset: FloatArray

    @cached_property
    def edges(self) -> tuple[IntArray, FloatArray, FloatArray]:
        """Index of the path sample at each ego, (n,), and left and right edges of L lanes at the ego in m, (n, L)."""
        return self.sections.edges_at(self.along)

    @cached_property
    def others_column(self) -> IntArray:
        """Column in `sections` of the lane that each other entity is on, (n, A)."""
        return self.sections.lane_column_at(self.others_along, self.others_offset)


class Surroundings:
    """Lanes, speed limits and signals around the egos of N scenarios.

    `own` (N, 3) and `objects` (N, A, 8) are what the compiled function `look` computes: the egos' poses on their paths,
    and the A other entities as seen from the egos.
    """

    def __init__(self, situation: Situation, network: RoadNetwork | None, own: FloatArray, objects: FloatArray) -> None:
        self._situation, self._network = situation, network
        self._group_of: dict[int, tuple[_EgoGroup, int]] = {}
        if network is None:
            return
        rows = np.flatnonzero(situation.active & np.isfinite(situation.x))
        if isinstance(situation.path, PathAlongLanes):
            along, offset = own[rows, 0], own[rows, 1]
            others = objects[rows, :, ALONG], objects[rows, :, LATERAL]
            rows = self._add_group(network, situation.path.lane_path, rows, along, offset, *others)
        if len(rows):
            self._group_by_lane(network, rows)

    def _add_group(
        self,
        network: RoadNetwork,
        path: LanePath,
        rows: IntArray,
        along: FloatArray,
        offset: FloatArray,
        others_along: FloatArray,
        others_offset: FloatArray,
    ) -> IntArray:
        """Add a group of the scenarios in `rows` whose ego is on a lane along a path; return the other scenarios."""
        sections = CrossSections.along(network, path)
        column = sections.lane_column_at(along, offset)
        group = _EgoGroup(sections, along, offset, column, others_along, others_offset)
        is_on: BoolArray = column != NO_LANE
        self._group_of |= {n: (group, i) for i, n in enumerate(rows.tolist()) if is_on[i]}
        others: IntArray = rows[~is_on]
        return others

    def _group_by_lane(self, network: RoadNetwork, rows: IntArray) -> None:
        """Group the scenarios in `rows` by the lane that the ego is on, regardless of the ego's path."""
        s = self._situation
        x, y, heading = s.x[rows], s.y[rows], s.heading[rows]
        road, at = network.track_road(np.full(len(rows), -1), np.zeros(len(rows)), x, y, heading)
        lane, forward = np.zeros(len(rows), dtype=np.int64), np.zeros(len(rows), dtype=np.bool_)
        section = np.zeros(len(rows), dtype=np.int64)
        for r in np.unique(road):
            of_road = road == r
            px, py, direction = network.roads[r].reference_pose(at[of_road])
            t = (y[of_road] - py) * np.cos(direction) - (x[of_road] - px) * np.sin(direction)
            lane[of_road], _ = network.find_lane(int(r), at[of_road], t)
            forward[of_road] = np.cos(heading[of_road] - direction) >= 0.0
            section[of_road] = network.roads[r].section_at(at[of_road])
        keys, which = np.unique(np.stack((road, section, lane, forward)), axis=1, return_inverse=True)
        for k, (r, _, number, along_s) in enumerate(keys.T.tolist()):
            same = which.reshape(-1) == k
            path = network.lane_path_from(r, number, float(at[same][0]), bool(along_s))
            if path is None:
                continue
            center = s.others_center_x
            points = (
                np.column_stack((x[same], s.others_x[rows[same]] + center * np.cos(s.others_heading[rows[same]]))),
                np.column_stack((y[same], s.others_y[rows[same]] + center * np.sin(s.others_heading[rows[same]]))),
            )
            along, offset, _, is_within = project_onto_path(driven_path(path), path.distance_of_s(at[same]), *points)
            along[~is_within] = np.nan
            self._add_group(network, path, rows[same], along[:, 0], offset[:, 0], along[:, 1:], offset[:, 1:])

    def lanes(self, scenario: int) -> tuple[LaneView, ...]:
        """Return all lanes of the road at the ego, from left to right; none if the ego is on no lane."""
        if scenario not in self._group_of:
            return ()
        group, i = self._group_of[scenario]
        sections, (samples, lefts, rights) = group.sections, group.edges
        k, own, ego_offset = int(samples[i]), int(group.column[i]), float(group.offset[i])
        curvature = float(sections.path.curvature[k])
        lanes = []
        for column, (left, right) in enumerate(zip(lefts[i].tolist(), rights[i].tolist(), strict=True)):
            if not left > right:
                continue
            center = 0.5 * (left + right)
            lanes.append(
                LaneView(
                    own - column,
                    sections.types[sections.lane_type[k, column]],
                    bool(sections.is_along[k, column]),
                    left - right,
                    center - ego_offset,
                    curvature / (1.0 - curvature * center) if curvature * center < 1.0 else math.nan,
                    float(sections.speed_limit[k, column]),
                )
            )
        return tuple(lanes)

    def lane_of(self, scenario: int, other: int) -> int | None:
        """Return the number of another entity's lane, counted from the ego's lane to the left; None without a lane."""
        if scenario not in self._group_of:
            return None
        group, i = self._group_of[scenario]
        column = int(group.others_column[i, other])
        return None if column == NO_LANE else int(group.column[i]) - column

    def speed_limit(self, scenario: int) -> float:
        """Return the speed limit of the ego's lane in m/s; NaN if unknown."""
        if scenario not in self._group_of:
            return math.nan
        group, i = self._group_of[scenario]
        return float(group.sections.speed_limit[group.edges[0][i], group.column[i]])

    def signals(self, scenario: int) -> list[tuple[str, str, float]]:
        """Return name, type and distance ahead in m of each signal along the path, from the ego's reference point."""
        if scenario not in self._group_of:
            return []
        group, i = self._group_of[scenario]
        return [(name, kind, at - float(group.along[i])) for name, kind, at in group.sections.signals]
