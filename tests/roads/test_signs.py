"""Speed limits and signals of road files."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from conftest import car, scenario_file, teleport
from cornercase.roads._network import RoadNetwork
from cornercase.simulators import check
from helpers import road_networks as rn


def with_parts(text: str, before_lanes: str = "", after_lanes: str = "") -> str:
    return text.replace("<planView>", before_lanes + "<planView>").replace("</lanes>", "</lanes>" + after_lanes)


def limits(network: RoadNetwork, lane: int, *s: float) -> list[float]:
    (road,) = network.roads
    section = road.section_at(np.array(s))
    return [float(road.speed_limit(int(k), lane, np.array([at]))[0]) for k, at in zip(section, s, strict=True)]


@pytest.mark.parametrize(
    ("speed", "expected"),
    [
        ('<speed max="50" unit="km/h"/>', 50 / 3.6),
        # 60 mph are 26.8224 m/s by the definition of the mile (1609.344 m).
        ('<speed max="60" unit="mph"/>', 60 * 1609.344 / 3600),
        ('<speed max="13.5" unit="m/s"/>', 13.5),
        ('<speed max="13.5"/>', 13.5),
        ('<speed max="no limit" unit="km/h"/>', math.inf),
        ('<speed max="undefined"/>', math.nan),
        ('<speed max="50" unit="knots"/>', math.nan),
        ('<speed max="-1"/>', math.nan),
        ('<speed max="fast"/>', math.nan),
        ("", math.nan),
    ],
)
def test_the_type_of_a_road_has_its_speed_limit(tmp_path, speed, expected):
    road = with_parts(rn.road("1", 100.0), f'<type s="0" type="town">{speed}</type>')
    assert limits(rn.network(tmp_path, road), -1, 50.0) == pytest.approx([expected], nan_ok=True)


def test_a_road_without_a_type_has_no_known_limit(tmp_path):
    assert np.isnan(limits(rn.network(tmp_path, rn.road("1", 100.0)), -1, 50.0)).all()


def test_a_limit_holds_from_where_its_type_begins(tmp_path):
    types = "".join(
        f'<type s="{s}" type="town"><speed max="{v}"/></type>' for s, v in ((60, 30), (0, 10), (30, "no limit"))
    )
    found = limits(rn.network(tmp_path, with_parts(rn.road("1", 100.0), types)), -1, 0.0, 29.9, 30.0, 59.9, 60.0, 100.0)
    assert found == [10.0, 10.0, math.inf, math.inf, 30.0, 30.0]


def test_the_limit_of_a_lane_counts_more_than_that_of_its_road(tmp_path):
    own = rn.WIDTH + '<speed sOffset="20" max="20"/><speed sOffset="40" max="undefined"/>'
    road = rn.road("1", 100.0, right=rn.lane(-1, inside=own) + rn.lane(-2))
    network = rn.network(tmp_path, with_parts(road, '<type s="0" type="rural"><speed max="30"/></type>'))
    assert limits(network, -1, 10.0, 20.0, 39.0, 41.0) == [30.0, 20.0, 20.0, 30.0]
    assert limits(network, -2, 30.0) == [30.0]


def test_the_offset_of_a_lanes_limit_is_measured_from_its_lane_section(tmp_path):
    center = '<center><lane id="0" type="none"/></center>'
    own = rn.lane(-1, -1, -1, inside=rn.WIDTH + '<speed sOffset="10" max="20"/>')
    sections = (
        f'<laneSection s="0">{center}<right>{rn.lane(-1, -1, -1)}</right></laneSection>'
        f'<laneSection s="40">{center}<right>{own}</right></laneSection>'
        # A new section on the left only: the right one goes on.
        f'<laneSection s="45" singleSide="true"><left>{rn.lane(1)}</left>{center}</laneSection>'
    )
    network = rn.network(tmp_path, rn.road("1", 100.0, sections=sections))
    found = limits(network, -1, 39.0, 49.0, 50.0, 99.0)
    assert np.isnan(found[:2]).all()
    assert found[2:] == [20.0, 20.0]


def test_signals_are_read_with_whom_they_concern(tmp_path):
    signals = (
        '<signals><signal id="light" s="80" t="-4" orientation="+" type="1000001"/>'
        '<signal id="sign" s="20" t="4" orientation="-" type="274"><validity fromLane="2" toLane="1"/></signal>'
        '<signal id="lost" s="here" t="0"/><signalReference id="other" s="50" t="0" orientation="none"/></signals>'
    )
    (road,) = rn.network(tmp_path, with_parts(rn.road("1", 100.0), "", signals)).roads
    assert [(one.name, one.s, one.signal_type) for one in road.signals] == [
        ("sign", 20.0, "274"),
        ("other", 50.0, ""),
        ("light", 80.0, "1000001"),
    ]
    sign, other, light = road.signals
    assert light.concerns(-1, True)
    assert not light.concerns(1, False)
    assert sign.concerns(2, False)
    assert not sign.concerns(3, False)
    assert other.concerns(-1, True)
    assert other.concerns(1, False)


def test_check_says_that_only_systems_under_test_see_limits_and_signals(tmp_path: Path):
    road = with_parts(rn.road("1", 100.0), '<type s="0" type="town"><speed max="50"/></type>', "<signals/>")
    scenario = scenario_file(tmp_path, init=f"<Private entityRef='Ego'>{teleport('10')}</Private>", entities=car("Ego"))
    rn.write(tmp_path, road)
    notices = [str(one) for one in check(scenario).notices if one.file.name == "road.xodr"]
    assert len(notices) == 2
    assert all("a system under test" in notice for notice in notices)
