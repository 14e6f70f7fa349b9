"""The road that a scene is drawn on."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest

from cornercase.recordings import Recording
from cornercase.report._road_drawing import encode_road_outline, recorded_bounds
from cornercase.roads._network import RoadNetwork
from cornercase.roads._outline import RoadOutline, outline_roads
from helpers.road_networks import lane, network, road

EXAMPLES = Path(__file__).parents[2] / "examples"
WALK = '<lane id="-2" type="sidewalk"><width sOffset="0" a="2" b="0" c="0" d="0"/></lane>'
FAR = (-1e4, -1e4, 1e4, 1e4)


def distance(points, line):
    """Distance of points from a line of straight pieces."""
    first, way = line[:-1], np.diff(line, axis=0)
    away = points[:, None] - first
    part = np.clip((away * way).sum(axis=2) / np.maximum((way**2).sum(axis=1), 1e-12), 0.0, 1.0)
    return np.hypot(*np.moveaxis(away - part[..., None] * way, 2, 0)).min(axis=1)


def unpacked(packed):
    def points(numbers):
        return np.cumsum(np.reshape(numbers, (-1, 2)), axis=0) / 100.0 + packed["origin"]

    return RoadOutline(*([(kind, points(each)) for kind, each in packed[name]] for name in ("areas", "lines")))


def recording(x, y):
    still = np.zeros((1, len(x)))
    return Recording(
        time=np.arange(float(len(x))), names=("Ego",), object_types=("car",), x=np.array([x]), y=np.array([y]), heading=still,
        speed=still, acceleration=still, length=np.ones(1), width=np.ones(1), center_x=np.zeros(1),
    )  # fmt: skip


def test_lanes_of_two_directions_have_a_centre_line_and_a_walk_beside_them(tmp_path):
    both = network(tmp_path, road("1", 100.0, left=lane(1), right=lane(-1) + WALK))
    sketch = outline_roads(both, FAR)
    areas = dict(sketch.areas)
    assert sorted(areas) == ["road", "walk"]
    assert sorted(map(tuple, areas["road"].tolist())) == [(0.0, -4.0), (0.0, 4.0), (100.0, -4.0), (100.0, 4.0)]
    assert sorted(map(tuple, areas["walk"].tolist())) == [(0.0, -6.0), (0.0, -4.0), (100.0, -6.0), (100.0, -4.0)]
    ((kind, line),) = sketch.lines
    assert kind == "centre"
    assert line.tolist() == [[0.0, 0.0], [100.0, 0.0]]


def test_lanes_of_one_direction_have_a_border_and_junctions_have_none(tmp_path):
    lanes = lane(-1) + lane(-2)
    one_way = network(tmp_path, road("1", 50.0, right=lanes), road("2", 50.0, right=lanes, junction="7"))
    assert [kind for kind, _ in outline_roads(one_way, FAR).lines] == ["lane"]
    assert len(outline_roads(one_way, FAR).areas) == 2


@pytest.mark.parametrize("radius", [4.0, 30.0, 1000.0])
def test_chords_stay_within_five_centimetres_of_the_lane(tmp_path, radius):
    bend = network(tmp_path, road("1", 3.0 * radius, shape=f'<arc curvature="{-1.0 / radius}"/>', left=lane(1)))
    ((_, area),) = unpacked(encode_road_outline(outline_roads(bend, FAR))).areas
    one, s = bend.roads[0], np.linspace(0.0, 3.0 * radius, 4000)
    outline = np.concatenate([area, area[:1]])
    for t in (4.0, -4.0):
        x, y, _ = one.pose_at(s, np.full(len(s), t))
        if abs(radius - abs(t)) > 0.1:
            assert distance(np.stack([x, y], axis=1), outline).max() < 0.05
    assert len(area) < 600


def test_only_what_is_near_is_drawn(tmp_path):
    long = network(tmp_path, road("1", 5000.0), road("2", 100.0, at=(0.0, 900.0, 0.0)))
    region = recorded_bounds([recording([1000.0, 1100.0, np.nan], [0.0, 1.0, np.nan])])
    assert region == (960.0, -40.0, 1140.0, 41.0)
    ((_, area),) = outline_roads(long, region).areas
    assert 940.0 < area[:, 0].min() < 960.0
    assert 1140.0 < area[:, 0].max() < 1160.0


def test_recordings_of_nothing_lie_nowhere():
    assert recorded_bounds([recording([np.nan], [np.nan])]) is None


@pytest.mark.parametrize("example", ["x_intersection", "t_intersection"])
def test_what_the_page_holds_is_small_and_exact_to_a_centimetre(example):
    whole = RoadNetwork.read(EXAMPLES / example / f"{example}.xodr")
    sketch = outline_roads(whole, FAR)
    packed = json.loads(json.dumps(encode_road_outline(sketch)))
    assert len(json.dumps(packed)) < 5000
    for (kind, points), (other, again) in zip(sketch.areas, unpacked(packed).areas, strict=True):
        assert kind == other
        assert np.max(distance(points, np.concatenate([again, again[:1]]))) < 0.011


def test_of_thousands_of_roads_only_the_near_ones_are_looked_at(tmp_path):
    roads = [road(f"{k}", 90.0, at=(100.0 * (k % 60), 100.0 * (k // 60), 0.3), left=lane(1)) for k in range(3600)]
    city = network(tmp_path, *roads)
    begin = time.process_time()
    assert 10 < len(outline_roads(city, (2000.0, 2000.0, 2300.0, 2300.0)).areas) < 40
    assert time.process_time() - begin < 2.0
