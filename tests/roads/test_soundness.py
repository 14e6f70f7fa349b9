"""Inconsistent roads are refused in a sentence, or reported."""

from __future__ import annotations

import numpy as np
import pytest

from conftest import ROAD, car, scenario_file, speed_action, teleport
from cornercase import check, convert
from cornercase._common.errors import InputError
from cornercase.roads._lane_path import LanePath
from cornercase.roads._network import RoadNetwork
from cornercase.roads._unsupported import list_unsupported
from cornercase.scenario._xml import read_xml

WIDTH = '<width sOffset="0" a="4" b="0" c="0" d="0"/>'
CUBIC = '<paramPoly3 pRange="arcLength" aU="0" bU="{b}" cU="0" dU="{d}" aV="0" bV="0" cV="0" dV="0"/>'


def written(folder, old, new):
    assert old in ROAD
    path = folder / "road.xodr"
    path.write_text(ROAD.replace(old, new))
    return path


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('road id="1" ', 'road ', "line 1: a <road> has no id"),
        ('laneSection s="0"', 'laneSection s="100"', "the first <laneSection> begins at s = 100 m; it must begin at 0"),
        ('laneSection s="0"', 'laneSection s="600"', "the first <laneSection> begins at s = 600 m"),
        ('laneSection s="0"', 'laneSection s="-1e300"', "the first <laneSection> begins at s = -1e[+]300 m"),
        ("</planView>", '<geometry s="20" x="300" y="50" hdg="0" length="480"><line/></geometry></planView>',
         "the <geometry> at s = 20 m begins 284 m away from the end of the one before"),
        (' x="0"', ' x="1e308"', "lies more than 100000 km from the origin"),
        ("<line/>", '<arc curvature="1e300"/>', "curvature of 1e[+]300 1/m; in such a turn, at most 10 1/m are allowed"),
        ("<line/>", '<spiral curvStart="-1e200" curvEnd="1e200"/>', "lies more than|curvature of"),
        ('hdg="0" length="500"><line/>', f'hdg="0" length="1e-308">{CUBIC.format(b=1, d=1).replace("arcLength", "normalized")}',
         "lies more than"),
        ("<line/>", CUBIC.format(b=1, d=0.01), "whose curve is 1.25e[+]06 m long, but its attribute length is 500 m"),
        ("<line/>", CUBIC.format(b=0.1, d=0), "has a <paramPoly3> whose curve is 50 m long"),
        (WIDTH, WIDTH.replace('b="0"', 'b="1e6"'), "the lane 1 at s = 0 m reaches 5e[+]08 m; at most 10000 m"),
        (WIDTH, WIDTH.replace('d="0"', 'd="1e308"'), "the lane 1 at s = 0 m reaches inf m"),
        ("<laneSection", '<laneOffset s="0" a="1e9" b="0" c="0" d="0"/><laneSection', "<laneOffset> reaches 1e[+]09 m"),
        ("</right>", f'<lane id="-1" type="driving">{WIDTH}</lane></right>', "line 5, road 1: a <laneSection> has two lanes with the number -1; keep one"),
        ('lane id="1"', 'lane id="-1"', "line 3, road 1: the lane -1 is in <left>"),
        ('lane id="-1"', 'lane id="0"', "line 5, road 1: the lane 0 is in <right>"),
    ],
)  # fmt: skip
def test_a_road_that_contradicts_itself_is_refused(tmp_path, old, new, words):
    with pytest.raises(InputError, match=words) as refused:
        RoadNetwork.read(written(tmp_path, old, new))
    assert str(refused.value).startswith(str(tmp_path / "road.xodr"))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(("start", "end", "turn"), [(0, 11, 3.3), (-12, 12, 0.0)])
def test_a_tight_spiral_of_less_than_a_full_circle_is_a_road(tmp_path, start, end, turn):
    path = written(tmp_path, "<line/>", f'<spiral curvStart="{start}" curvEnd="{end}"/>')
    path.write_text(path.read_text().replace('length="500"', 'length="0.6"'))
    network = RoadNetwork.read(path)
    heading = network.road_to_xy_heading(0, np.array([0.6]), np.zeros(1))[2]
    assert heading == pytest.approx(turn)
    assert len(network.excluded_roads) == 0


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ('hdg="0" length="500"', 'hdg="0" length="100"', "length of roads that have less geometry"),
        ('geometry s="0"', 'geometry s="100"', "length of roads that have less geometry"),
        (WIDTH, WIDTH.replace('a="4"', 'a="-4"'), "width of lanes below 0"),
    ],
)
def test_what_is_missing_of_a_road_is_named(tmp_path, old, new, what):
    path = written(tmp_path, old, new)
    root = read_xml(path)
    network = RoadNetwork.from_xml(root, path)
    assert [one.parts for one in list_unsupported(root, path, network, fully_read=False)] == [(what,)]


def test_a_lane_that_swings_to_and_fro_is_sampled_more_coarsely(tmp_path):
    fine = RoadNetwork.read(written(tmp_path, "<line/>", "<line/>")).lane_path_from(0, -1, 0.0, True)
    assert fine is not None
    assert len(fine.x) > 1000
    path = LanePath.from_points(
        fine.x,
        fine.y,
        fine.s,
        fine.road,
        fine.lane,
        fine.forward,
        fine.goals_passed,
        fine.reference_distance,
        fine.center_offset,
        fine.curvature_distance,
        fine.reference_curvature,
        max_samples=1000,
    )
    assert len(path.x) == 1000
    assert path.distance[-1] == pytest.approx(500.0)


def test_an_elevation_that_is_no_number_is_refused_where_it_is_needed(tmp_path):
    entities, init = car("Ego"), f'<Private entityRef="Ego">{teleport("10")}{speed_action("10")}</Private>'
    path = scenario_file(tmp_path, init=init, entities=entities)
    climb = '<elevationProfile><elevation s="0" a="0" b="road" c="0" d="0"/></elevationProfile><lanes>'
    (tmp_path / "road.xodr").write_text(ROAD.replace("<lanes>", climb))
    assert check(path).run_errors == ()
    with pytest.raises(InputError, match="line 3, road 1: b of <elevation> is 'road', not a finite number"):
        convert(path, tmp_path / "out.xosc", ego="Ego")
    assert not (tmp_path / "out.xosc").exists()
