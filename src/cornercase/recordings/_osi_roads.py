"""Road networks as lanes and lane boundaries of ASAM OSI messages."""

from __future__ import annotations

from itertools import product
from typing import Any, Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.roads._network import RoadNetwork
from cornercase.roads._road import Road

FIRST_ID: Final = 1 << 20
"""Ids of lanes and boundaries begin here; those of moving objects are below."""
# Distance of samples of a line in m. A sample is written if the line has turned this far since the last one, in rad,
# or has gone this far, in m.
_SAMPLING, _MAX_TURN, _MAX_DISTANCE = 1.0, 0.01, 50.0
_SUBTYPES: Final = {
    "driving": "NORMAL", "bidirectional": "NORMAL", "biking": "BIKING", "sidewalk": "SIDEWALK", "walking": "SIDEWALK",
    "parking": "PARKING", "stop": "STOP", "restricted": "RESTRICTED", "border": "BORDER", "shoulder": "SHOULDER",
    "exit": "EXIT", "entry": "ENTRY", "onRamp": "ONRAMP", "offRamp": "OFFRAMP", "connectingRamp": "CONNECTINGRAMP",
}  # fmt: skip


def fill_roads(truth: Any, network: RoadNetwork) -> None:
    """Add all lanes and their boundaries to a GroundTruth; heights are 0, and the kinds of markings are not known."""
    keys = [
        (number, section, lane)
        for number, road in enumerate(network.roads)
        for section, (_, lanes) in enumerate(road.sections)
        for lane in sorted(lanes, reverse=True)
    ]
    ids = {key: FIRST_ID + k for k, key in enumerate(keys)}
    boundary_id = FIRST_ID + len(keys)
    for number, road in enumerate(network.roads):
        for section, (_, lanes) in enumerate(road.sections):
            s = _sample_section(road, section)
            # From left to right, seen along s.
            for k, lane in enumerate(sorted(lanes, reverse=True)):
                center, half = road.lane_center(section, lane, s), 0.5 * road.lane_width(section, lane, s)
                if k == 0:
                    _add_boundary(truth, boundary_id, road, s, center + half, is_edge=True)
                _add_boundary(truth, boundary_id + k + 1, road, s, center - half, is_edge=k + 1 == len(lanes))
                _add_lane(truth, network, ids, (number, section, lane), s, boundary_id + k)
            boundary_id += len(lanes) + 1 if lanes else 0


def _add_lane(
    truth: Any,
    network: RoadNetwork,
    ids: dict[tuple[int, int, int], int],
    key: tuple[int, int, int],
    s: FloatArray,
    left_boundary: int,
) -> None:
    """Add a lane with its center line in the direction of traffic.

    `s` are the positions along the road in m. `left_boundary` is the id of the lane boundary on the left when looking
    in the direction of rising s; the boundary on the right has the next id.
    """
    number, section, lane = key
    road = network.roads[number]
    is_along = bool(road.is_traffic_forward(lane, s[:1])[0])
    message = truth.lane.add()
    message.id.value = ids[key]
    classification = message.classification
    described, kind = road.sections[section][1][lane], "NONDRIVING"
    if described.is_drivable:
        kind = "DRIVING" if road.junction in ("", "-1") else "INTERSECTION"
    subtype = _SUBTYPES.get(described.lane_type, "OTHER")
    classification.type = classification.Type.Value(f"TYPE_{kind}")
    classification.subtype = classification.Subtype.Value(f"SUBTYPE_{subtype}")
    classification.centerline_is_driving_direction = True
    x, y = _drop_needless_samples(road, s, road.lane_center(section, lane, s))
    for px, py in zip(*((x, y) if is_along else (x[::-1], y[::-1])), strict=True):
        point = classification.centerline.add()
        point.x, point.y, point.z = px, py, 0.0
    numbers = sorted(road.sections[section][1], reverse=True)
    index = numbers.index(lane)
    left, right = numbers[max(index - 1, 0) : index], numbers[index + 1 : index + 2]
    boundaries = (left_boundary, left_boundary + 1)
    if not is_along:
        left, right, boundaries = right, left, boundaries[::-1]
    for field, neighbours in (("left_adjacent_lane_id", left), ("right_adjacent_lane_id", right)):
        for neighbour in neighbours:
            getattr(classification, field).add().value = ids[number, section, neighbour]
    classification.left_lane_boundary_id.add().value = boundaries[0]
    classification.right_lane_boundary_id.add().value = boundaries[1]
    before, after = (
        [ids.get(linked) for linked in network.find_linked_lanes(number, section, lane, forward=direction)] or [None]
        for direction in (not is_along, is_along)
    )
    for source, target in product(before, after):
        if source is not None or target is not None:
            pairing = classification.lane_pairing.add()
            if source is not None:
                pairing.antecessor_lane_id.value = source
            if target is not None:
                pairing.successor_lane_id.value = target


def _add_boundary(truth: Any, number: int, road: Road, s: FloatArray, t: FloatArray, *, is_edge: bool) -> None:
    boundary = truth.lane_boundary.add()
    boundary.id.value = number
    kinds = boundary.classification.Type
    boundary.classification.type = kinds.Value("TYPE_ROAD_EDGE" if is_edge else "TYPE_UNKNOWN")
    for px, py in zip(*_drop_needless_samples(road, s, t), strict=True):
        point = boundary.boundary_line.add()
        point.position.x, point.position.y, point.position.z = px, py, 0.0


def _sample_section(road: Road, section: int) -> FloatArray:
    start, end = road.section_interval(section)
    return np.linspace(start, end, max(2, int(np.ceil((end - start) / _SAMPLING)) + 1))


def _drop_needless_samples(road: Road, s: FloatArray, t: FloatArray) -> tuple[list[float], list[float]]:
    """Leave out samples of a line along a road where the line hardly turns; return x and y in m of the others.

    Samples are given as positions `s` along the road and offsets `t` to the left of its reference line, both in m.
    """
    x, y, _ = road.pose_at(s, t)
    turns = np.abs(np.diff(np.unwrap(np.arctan2(np.diff(y), np.diff(x)))))
    turned = np.concatenate([[0.0], np.cumsum(turns), [np.sum(turns)]])
    keep: BoolArray = np.ones(len(s), dtype=np.bool_)
    marks = np.stack((turned // _MAX_TURN, (s - s[0]) // _MAX_DISTANCE))
    keep[1:-1] = (np.diff(marks, axis=1) != 0.0).any(axis=0)[:-1]
    return x[keep].tolist(), y[keep].tolist()
