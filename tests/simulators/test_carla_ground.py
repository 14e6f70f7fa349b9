"""What CARLA gets of a road file: where its own map has lanes, and ground beside the roads."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from contextlib import suppress

import numpy as np
import pytest

from conftest import at_night
from cornercase._common.errors import InputError
from cornercase.roads._network import RoadNetwork
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._xml import read_xml
from cornercase.simulators import simulate
from cornercase.simulators.carla._openscenario_1_0 import ConversionOptions, make_concrete_tree, write_openscenario_1_0
from cornercase.simulators.carla._road_conversion import (
    VERGE_WIDTH,
    find_entities_beyond_ground,
    is_flat,
    road_text_for_carla,
)
from helpers.isolation import REFERENCE, ROOT, scenario_files

carla = pytest.importorskip("carla", reason="the extra 'carla' is not installed")

EXAMPLES = ROOT / "examples"
T = EXAMPLES / "t_intersection" / "t_intersection.xosc"
# m and degrees
NEAR, TURNED = 0.01, 0.3
# In a process of its own, as CARLA's map may abort.
ASK = """
import carla, json, sys
road_map = carla.Map("map", sys.stdin.read())
found = []
for road, lane, s in json.loads(sys.argv[1]):
    point = road_map.get_waypoint_xodr(road, lane, s)
    if point is not None:
        there, right = point.transform, point.transform.get_right_vector()
        point = [there.location.x, -there.location.y, -there.rotation.yaw, right.x, -right.y]
    found.append(point)
print(json.dumps(found))
"""


def carla_lanes(text, points):
    """Centres of lanes by CARLA's map, in right-handed axes: x, y, heading in degrees, and a vector to the right."""
    command = [sys.executable, "-c", ASK, json.dumps(points)]
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def turn(one, other):
    return abs((one - other + 180.0) % 360.0 - 180.0)


def placed(file):
    """Initial positions on lanes: name, road, lane, s, offset, and the angle to the lane's direction in degrees."""
    root = make_concrete_tree(ScenarioFile.read(file), {})
    for private in root.iterfind("Storyboard/Init/Actions/Private"):
        if private.find(".//LateralAction") is not None:
            # Who moves aside from the first moment on is turned.
            continue
        positions = private.findall("PrivateAction/TeleportAction/Position/LanePosition")
        for lane in positions[-1:]:
            orientation = lane.find("Orientation")
            if orientation is not None and orientation.get("type") != "relative":
                continue
            if not lane.get("roadId", "").isdecimal():
                continue
            angle = 0.0 if orientation is None else math.degrees(float(orientation.get("h", "0")))
            number = int(lane.get("laneId", "0"))
            yield (
                private.get("entityRef", ""), int(lane.get("roadId", "0")), number, float(lane.get("s", "0")),
                float(lane.get("offset", "0")), angle,
            )  # fmt: skip


def check_placed(file, folder):
    """Compare converted positions on lanes with CARLA's; return how many."""
    scenario = ScenarioFile.read(file)
    road, points = scenario.road_path_for({}), list(placed(file))
    if road is None or not points:
        return 0
    ego = "Ego" if "Ego" in scenario.entities else next(iter(scenario.entities))
    target = folder / f"{file.stem}.xosc"
    write_openscenario_1_0(scenario, {}, target, ego=ego, options=ConversionOptions(duration=0.1))
    root = read_xml(target)
    lanes = carla_lanes(road_text_for_carla(scenario.get_root(road)), [one[1:4] for one in points])
    for (name, _, lane, _, offset, angle), there in zip(points, lanes, strict=True):
        found = root.find(f"Storyboard/Init/Actions/Private[@entityRef='{name}']//WorldPosition")
        assert found is not None
        assert there is not None
        x, y, heading, right_x, right_y = there
        to_right = offset if lane > 0 else -offset
        apart = (
            float(found.get("x", "0")) - x - to_right * right_x,
            float(found.get("y", "0")) - y - to_right * right_y,
        )
        assert math.hypot(*apart) < NEAR, (file, name)
        assert turn(math.degrees(float(found.get("h", "0"))), heading + angle) < TURNED, (file, name)
    return len(points)


@pytest.mark.parametrize("each", at_night([12, 1], {1}))
@pytest.mark.skipif(not REFERENCE.is_dir(), reason="the reference scenarios are not here")
def test_protocols_and_examples_begin_where_carla_has_the_lane(tmp_path, each):
    files = scenario_files(EXAMPLES / "t_intersection", EXAMPLES / "x_intersection")
    files += scenario_files(REFERENCE / "ncap", REFERENCE / "alks")[::each]
    assert sum(check_placed(file, tmp_path) for file in files) >= (3 if each > 1 else 39)


@pytest.mark.slow
@pytest.mark.skipif(not REFERENCE.is_dir(), reason="the reference scenarios are not here")
def test_files_of_others_begin_where_carla_has_the_lane(tmp_path):
    count = 0
    for file in scenario_files(REFERENCE.parent / "wild"):
        with suppress(InputError):
            count += check_placed(file, tmp_path)
    assert count >= 143


def sampled_motion(file):
    """Poses of vehicles in the builtin simulator, and where they are on roads."""
    scenario = ScenarioFile.read(file)
    road = scenario.road_path_for({})
    assert road is not None
    recording = simulate(scenario, duration=8.0)
    network = RoadNetwork.from_xml(scenario.get_root(road), road)
    for k in range(len(recording.names)):
        rows = np.flatnonzero(np.isfinite(recording.x[k]))[::20]
        x, y = recording.x[k][rows], recording.y[k][rows]
        found = network.locate(x, y)
        for row in range(len(rows)):
            index = int(found.road[row])
            if found.s[row] >= network.roads[index].length - 1e-3:
                # CARLA has no point at the very end.
                continue
            yield (
                (int(network.roads[index].road_id), int(found.lane[row]), float(found.s[row])),
                float(found.offset[row]), float(x[row]), float(y[row]),
            )  # fmt: skip


@pytest.mark.parametrize("file", [T, EXAMPLES / "x_intersection" / "x_intersection.xosc"], ids=lambda file: file.stem)
def test_all_positions_of_the_examples_are_beside_their_lanes_as_in_carla(file):
    motion = list(sampled_motion(file))
    text = road_text_for_carla(read_xml(file.with_suffix(".xodr")))
    lanes = carla_lanes(text, [one[0] for one in motion])
    for ((_, lane, s), offset, x, y), there in zip(motion, lanes, strict=True):
        assert there is not None, (lane, s)
        to_right = offset if lane > 0 else -offset
        apart = math.hypot(x - there[0] - to_right * there[3], y - there[1] - to_right * there[4])
        # A point far beside a lane that narrows is not at a right angle to it.
        assert apart < max(NEAR, 0.01 * abs(offset)), (lane, x, y)


VIEW = """
import carla, json, sys
def key(point):
    there = point.transform
    return [point.road_id, point.section_id, point.lane_id, round(point.s, 3), str(point.lane_type),
        round(there.location.x, 3), round(there.location.y, 3), round(there.rotation.yaw, 2)]
road_map = carla.Map("map", sys.stdin.read())
points = road_map.generate_waypoints(5.0)
any_lane = [key(road_map.get_waypoint(one.transform.location, lane_type=carla.LaneType.Any)) for one in points[::4]]
print(json.dumps([sorted([key(a), key(b)] for a, b in road_map.get_topology()), [key(one) for one in points], any_lane]))
"""


def views(text):
    """What routes and waypoints CARLA's map has."""
    done = subprocess.run([sys.executable, "-c", VIEW], input=text, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def road_files():
    towns = REFERENCE.parent / "wild" / "_towns"
    return [T.with_suffix(".xodr"), EXAMPLES / "x_intersection" / "x_intersection.xodr", *sorted(towns.glob("*.xodr"))]


@pytest.mark.parametrize("file", [*road_files()[:2], *at_night(road_files()[2:], set(road_files()[2:]))], ids=str)
def test_ground_beside_roads_changes_no_route_and_no_waypoint_of_carlas(file):
    text = road_text_for_carla(read_xml(file))
    # As ScenarioRunner 0.9.13 looks for it.
    assert text.startswith("<OpenDRIVE>")
    topology, *_ = found = views(text)
    assert topology
    assert found == views(file.read_text(encoding="utf-8"))


def test_flat_roads_get_ground_on_both_sides_and_others_none():
    root = read_xml(T.with_suffix(".xodr"))
    sections = read_xml(T.with_suffix(".xodr")).findall("road/lanes/laneSection")
    wider = carla_xml(road_text_for_carla(root)).findall("road/lanes/laneSection")
    assert len(sections) == len(wider) > 5
    for before, after in zip(sections, wider, strict=True):
        lanes = {int(one.get("id", "0")) for one in before.iterfind("*/lane")}
        added = {int(one.get("id", "0")): one for one in after.iterfind("*/lane")}
        assert set(added) == {*lanes, max(lanes) + 1, min(lanes) - 1}
        assert [one.tag for one in after if one.tag in ("left", "center", "right")] == ["left", "center", "right"]
        for number in (max(lanes) + 1, min(lanes) - 1):
            assert added[number].get("type") == "none"
            assert float(added[number].find("width").get("a")) == VERGE_WIDTH
        # CARLA's agents fail at lanes without marks.
        assert all(one.find("roadMark") is not None for one in added.values())
    assert is_flat(root)
    road = root.find("road")
    assert road is not None
    climb = '<elevationProfile><elevation s="0" a="0" b="0.02" c="0" d="0"/></elevationProfile>'
    road.append(carla_xml(climb))
    assert not is_flat(root)
    assert len(carla_xml(road_text_for_carla(root)).findall("road/lanes/laneSection/*/lane")) == sum(
        len(section.findall("*/lane")) for section in sections
    )


def carla_xml(text):
    from lxml import etree

    return etree.fromstring(text)


def test_who_goes_where_there_is_no_ground_is_named():
    network = RoadNetwork.read(T.with_suffix(".xodr"))
    recording = simulate(T, duration=1.0)
    assert find_entities_beyond_ground(recording, network, 0.6) == {}
    beside = type(recording)(**{**vars(recording), "y": recording.y + 500.0})
    found = find_entities_beyond_ground(beside, network, 0.6)
    assert set(found) == set(recording.names)
    assert all(300.0 < distance < 501.0 for distance in found.values())
