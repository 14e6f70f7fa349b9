"""Traffic rules from the roads: who has to yield at a junction, and who is on the wrong side."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.geometry.boxes import wrap_angle
from cornercase.metrics._recorded_roads import read_recorded_roads
from cornercase.metrics.fault._party import Party
from cornercase.recordings import Recording
from cornercase.roads._network import RoadNetwork
from cornercase.roads._road import Road
from cornercase.roads._road_graph import JunctionConnection

_LOOK_BACK: Final = 8.0
_STEP: Final = 0.2

_SIGN_DISTANCE: Final = 30.0
"""Distance in m before the end of a road within which a sign belongs to the junction behind it."""

_SPACING: Final = 0.5

_LEAST_CROSSING: Final = np.radians(30.0)
"""Angle in rad between two roads, or between a road and the extension of the other, from which the roads cross."""

_YIELD_SIGNS: Final = frozenset(
    {("", "205"), ("DE", "205"), ("DEU", "205"), ("", "206"), ("DE", "206"), ("DEU", "206")}
)
"""Country and type of signs to yield or to stop: the German ones, which OpenDRIVE uses as its example."""


def roads_of(recording: Recording) -> RoadNetwork | None:
    """Return the roads of a recording; None if they are unknown, or if their file can no longer be read."""
    if recording.road_file is None:
        return None
    try:
        return read_recorded_roads(recording.road_file)
    except InputError:
        return None


def find_who_yields(network: RoadNetwork, parties: tuple[Party, Party], contact: float) -> int | None:
    """Return which of two parties (0 or 1) has to yield to the other at a junction.

    The ``<priority>`` elements of the junction decide first; a priority may name roads that lead to the junction or
    roads through the junction. Next come signs to yield or to stop before the junction. If there are neither priorities
    nor signs, the party has to yield that sees the other come from the right, or from the left in left-hand traffic
    (Vienna Convention on Road Traffic 1968, Article 18, 4). Traffic lights have no effect, since recordings do not
    contain their state. None if the road file does not say who has to yield.
    """
    routes = [_roads_driven(network, party, contact) for party in parties]
    junctions = [{network.roads[k].junction for k in route} - {"", "-1"} for route in routes]
    for junction in sorted(junctions[0] & junctions[1]):
        entries = [
            _find_entry_and_junction_road(network, junction, route, party, contact)
            for route, party in zip(routes, parties, strict=True)
        ]
        ids = [
            {network.roads[k].road_id for k in route} if entry is None else set(entry)
            for route, entry in zip(routes, entries, strict=True)
        ]
        priorities = network.priorities.get(junction, ())
        for high, low in priorities:
            for k in (0, 1):
                if high in ids[1 - k] and low in ids[k] and low not in ids[1 - k]:
                    return k
        yields = [_has_yield_sign(network, route, junction) for route in routes]
        if yields[0] != yields[1]:
            return yields.index(True)
        if not priorities and not any(yields) and entries[0] is not None and entries[1] is not None:
            return _find_who_yields_to_the_right(network, junction, (entries[0][0], entries[1][0]))
    return None


def _find_who_yields_to_the_right(network: RoadNetwork, junction: str, roads: tuple[str, str]) -> int | None:
    """Return which of two parties (0 or 1) sees the other come from the right, and so has to yield.

    In left-hand traffic, left replaces right. `roads` are the ids of the roads from which the parties enter the
    junction. None if the directions of these roads differ by less than 30°, or are opposite to within 30°.
    """
    first, second = (_heading_into(network, road, junction) for road in roads)
    turn = float(wrap_angle(second - first))
    if not _LEAST_CROSSING < abs(turn) < np.pi - _LEAST_CROSSING:
        return None
    # Whoever drives to the left of another's direction comes from its right.
    second_is_from_right = turn > 0.0
    if not network.roads[network.road_index(roads[0])].is_right_hand_traffic:
        second_is_from_right = not second_is_from_right
    return 0 if second_is_from_right else 1


def _heading_into(network: RoadNetwork, road_id: str, junction: str) -> float:
    """Return the heading in rad with which a road leads into a junction."""
    road = network.roads[network.road_index(road_id)]
    leads_forward = _leads_forward_into(road, junction)
    s = np.array([road.length if leads_forward else 0.0])
    heading = float(road.lane_pose_at(0, s, np.zeros(1))[2][0])
    return heading if leads_forward else heading + np.pi


def is_on_wrong_side(network: RoadNetwork, party: Party, contact: float) -> bool | None:
    """Return whether an entity drives against the direction of traffic of the lane below its centre.

    None if the entity is in a junction or off the road.
    """
    x, y = (np.array([np.interp(contact, party.time, values)]) for values in (party.x, party.y))
    position = network.locate(x, y)
    road, lane = int(position.road[0]), int(position.lane[0])
    if (
        lane == 0
        or network.roads[road].junction not in ("", "-1")
        or not network.has_lane_at(road, lane, position.s)[0]
    ):
        return None
    lane_x, lane_y, heading = network.lane_to_xy_heading(road, lane, position.s, position.offset)
    if np.hypot(lane_x[0] - x[0], lane_y[0] - y[0]) > 1.0:
        return None
    return abs(float(wrap_angle(party.direction_at(contact) - heading[0]))) > np.pi / 2.0


def _roads_driven(network: RoadNetwork, party: Party, contact: float) -> list[int]:
    """Return the indices of the roads that an entity was on in the last 8 s before the contact, in order."""
    begin = max(float(party.time[0]), contact - _LOOK_BACK)
    route: list[int] = []
    road, s = np.array([-1]), np.array([0.0])
    for time in np.arange(begin, contact + 1e-9, _STEP):
        x, y, heading = party.poses_at(np.array([time]))
        road, s = network.track_road(road, s, x, y, heading)
        if road[0] >= 0 and (not route or route[-1] != road[0]):
            route.append(int(road[0]))
    return route


def _leads_forward_into(road: Road, junction: str) -> bool:
    """Return whether a road leads into a junction with its end; otherwise it does so with its start."""
    return road.successor is not None and road.successor.target_id == junction


def _find_entry_and_junction_road(
    network: RoadNetwork, junction: str, route: list[int], party: Party, contact: float
) -> tuple[str, str] | None:
    """Return two road ids: of the road from which a party enters a junction, and of the party's road through it.

    Of the roads through the junction, the one that fits best to the pose of the party at the contact is chosen. None if
    no road of the party's route leads into the junction.
    """
    driven = {network.roads[k].road_id for k in route}
    connections = [link for link in network.connections.get(junction, ()) if link[0] in driven and link[1]]
    if not connections:
        return None
    x, y, heading = (float(values[0]) for values in party.poses_at(np.array([contact])))

    def deviation(link: JunctionConnection) -> float:
        road = network.roads[network.road_index(link[1])]
        lane = next(iter(link[3].values()), -1)
        s = np.arange(0.0, road.length, _SPACING)
        lane_x, lane_y, direction = network.lane_to_xy_heading(network.road_index(link[1]), lane, s, np.zeros(len(s)))
        # A turn of one rad counts as two metres.
        return float((np.hypot(lane_x - x, lane_y - y) + 2.0 * np.abs(wrap_angle(direction - heading))).min())

    best = min(connections, key=deviation)
    return best[0], best[1]


def _has_yield_sign(network: RoadNetwork, route: list[int], junction: str) -> bool:
    """Return whether a sign to yield or to stop is in the last 30 m of the road by which a route enters a junction."""
    for k, after in pairwise(route):
        road = network.roads[k]
        if network.roads[after].junction != junction or road.junction == junction:
            continue
        is_forward = _leads_forward_into(road, junction)
        return any(
            (signal.country.upper(), signal.signal_type) in _YIELD_SIGNS
            and (signal.faces_forward if is_forward else signal.faces_backward)
            and (road.length - signal.s if is_forward else signal.s) <= _SIGN_DISTANCE
            for signal in road.signals
        )
    return False
