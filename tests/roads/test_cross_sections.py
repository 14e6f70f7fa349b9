"""Lanes beside a path along lanes."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cornercase.roads._cross_sections import NO_LANE, CrossSections
from cornercase.roads._network import RoadNetwork
from cornercase.roads._road import Road
from helpers import road_networks as rn
from helpers.lane_centres import read_centres

WILD = Path(__file__).parents[3] / "shared" / "reference" / "wild"
CENTRES = WILD / "lane_centres.csv.gz"
SHOULDER = '<lane id="-3" type="shoulder"><width sOffset="0" a="2" b="0" c="0" d="0"/></lane>'
TWO_WAY: dict[str, Any] = {"right": rn.lane(-1) + rn.lane(-2) + SHOULDER, "left": rn.lane(1)}


def along(network: RoadNetwork, road: str, lane: int, s: float, forward: bool) -> CrossSections:
    path = network.lane_path_from(network.road_index(road), lane, s, forward)
    assert path is not None
    return CrossSections.along(network, path)


def listed(sections: CrossSections, distance: float) -> list[tuple[int, str, bool, float, float]]:
    """Number, type, direction, left and right edge of each lane."""
    k, left, right = (values[0] for values in sections.edges_at(np.array([distance])))
    return [
        (sections.own - c, sections.types[sections.lane_type[k, c]], bool(sections.is_along[k, c]), left[c], right[c])
        for c in range(len(left))
    ]


def test_lanes_are_numbered_from_that_of_the_path(tmp_path):
    network = rn.network(tmp_path, rn.road("1", 100.0, **TWO_WAY))
    assert listed(along(network, "1", -1, 50.0, True), 40.0) == [
        (1, "driving", False, 6.0, 2.0),
        (0, "driving", True, 2.0, -2.0),
        (-1, "driving", True, -2.0, -6.0),
        (-2, "shoulder", True, -6.0, -8.0),
    ]


def test_seen_against_s_left_and_right_change_sides(tmp_path):
    network = rn.network(tmp_path, rn.road("1", 100.0, **TWO_WAY))
    assert listed(along(network, "1", 1, 50.0, False), 40.0) == [
        (3, "shoulder", False, 12.0, 10.0),
        (2, "driving", False, 10.0, 6.0),
        (1, "driving", False, 6.0, 2.0),
        (0, "driving", True, 2.0, -2.0),
    ]


def test_a_lane_that_widens_is_as_wide_as_its_polynomial(tmp_path):
    widening = '<lane id="-2" type="driving"><width sOffset="0" a="1" b="0.02" c="0" d="0"/></lane>'
    network = rn.network(tmp_path, rn.road("1", 100.0, right=rn.lane(-1) + widening))
    sections = along(network, "1", -1, 50.0, True)
    for distance in (0.0, 33.333, 100.0):
        *_, (number, _, _, left, right) = listed(sections, distance)
        assert number == -1
        assert (left, right) == pytest.approx((-2.0, -3.0 - 0.02 * distance), abs=1e-9)


def test_lanes_begin_and_end_with_their_sections(tmp_path):
    center = '<center><lane id="0" type="none"/></center>'
    second = rn.lane(-1, -1, -1) + rn.lane(-2)
    sections = (
        f'<laneSection s="0">{center}<right>{rn.lane(-1, -1, -1)}</right></laneSection>'
        f'<laneSection s="40.03">{center}<right>{second}</right></laneSection>'
    )
    found = along(rn.network(tmp_path, rn.road("1", 100.0, sections=sections)), "1", -1, 10.0, True)
    columns = found.lane_column_at(np.array([20.0, 39.9, 40.2, 60.0]), np.full(4, -4.0))
    assert columns.tolist() == [NO_LANE, NO_LANE, found.own + 1, found.own + 1]


def test_a_point_on_a_border_belongs_to_the_left_lane_and_one_beside_the_road_to_none(tmp_path):
    network = rn.network(tmp_path, rn.road("1", 100.0, **TWO_WAY))
    sections = along(network, "1", -1, 50.0, True)
    columns = sections.lane_column_at(np.full(5, 50.0), np.array([6.1, 6.0, 2.0, -2.0, -8.1]))
    assert [int(c) if c == NO_LANE else sections.own - int(c) for c in columns] == [NO_LANE, 1, 1, 0, NO_LANE]


def test_signals_along_a_path_stand_where_their_roads_have_them(tmp_path):
    def signal(s: float, name: str, orientation: str) -> str:
        return f'<signals><signal id="{name}" s="{s}" t="0" orientation="{orientation}" type="294"/></signals>'

    first, second = rn.chain(2, 100.0)
    first = first.replace("</lanes>", "</lanes>" + signal(30.0, "ahead", "+"))
    second = second.replace("</lanes>", "</lanes>" + signal(0.0, "start", "none"))
    network = rn.network(tmp_path, first, second)
    signals = along(network, "0", -1, 10.0, True).signals
    assert [(name, signal_type) for name, signal_type, _ in signals] == [("ahead", "294"), ("start", "294")]
    assert [distance for *_, distance in signals] == pytest.approx([30.0, 100.0])
    # Against the lane, the first does not face the traffic.
    ((name, _, distance),) = along(network, "1", -1, 90.0, False).signals
    assert name == "start"
    assert distance == pytest.approx(100.0)


@pytest.mark.skipif(not CENTRES.is_file(), reason="the folder of others' roads is not there")
@pytest.mark.parametrize("every", [pytest.param(12, marks=pytest.mark.slow), 150])
def test_lanes_beside_a_path_are_where_esmini_has_their_centres(every):
    apart = list[float]()
    for file, points in list(read_centres(CENTRES).items())[3::every]:
        network = RoadNetwork.read(WILD / file)
        by_place = defaultdict(list)
        for point in points:
            road = next((one for one in network.roads if one.road_id == point["road"]), None)
            if road is not None and point["esmini_x"] and not leans(road, point):
                by_place[point["road"], float(point["s"])].append(point)
        for (name, s), lanes in by_place.items():
            own = int(lanes[0]["lane"])
            if not network.has_lane_at(network.road_index(name), own, np.array([s]))[0]:
                continue
            sections = along(network, name, own, s, own < 0)
            path, distance = sections.path, sections.path.distance_of_s(np.array([s]))
            x, y, heading = (np.interp(distance, path.distance, column) for column in (path.x, path.y, path.heading))
            _, left, right = sections.edges_at(distance)
            center = 0.5 * (left + right)[0]
            center_x, center_y = x - center * np.sin(heading), y + center * np.cos(heading)
            apart += [
                np.nanmin(np.hypot(center_x - float(point["esmini_x"]), center_y - float(point["esmini_y"])))
                for point in lanes
            ]
    assert len(apart) > 30
    # Beside a lane that begins at an angle to its road, the path's normal is another than the road's.
    assert np.mean(np.array(apart) < 0.01) > 0.99


def leans(road: Road, point: dict[str, str]) -> bool:
    """Whether esmini has a lane centre elsewhere, since the road leans."""
    s = np.array([float(point["s"])])
    x, y, _ = road.lane_pose_at(int(point["lane"]), s)
    return bool(np.hypot(x - float(point["esmini_x"]), y - float(point["esmini_y"]))[0] > 0.01)
