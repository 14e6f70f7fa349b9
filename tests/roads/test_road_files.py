"""Road files that cannot be used, and equivalent descriptions of the same shape."""

from __future__ import annotations

import numpy as np
import pytest

from conftest import ROAD
from cornercase._common.errors import InputError
from cornercase.roads._network import RoadNetwork

LINE = "<line/>"


def network(folder, *edits: tuple[str, str]) -> RoadNetwork:
    text = ROAD
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    path = folder / "road.xodr"
    path.write_text(text)
    return RoadNetwork.read(path)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("OpenDRIVE>", "Roads>", "the root element is <Roads>"),
        (ROAD[ROAD.index("<road ") : ROAD.index("</OpenDRIVE>")], "", "has no <road>"),
        ("</OpenDRIVE>", ROAD[ROAD.index("<road ") :], "line 6: <road>: a second road has the id '1'"),
        (LINE, "<loop/>", "has no <line>, <arc>, <spiral>, <poly3> or <paramPoly3>"),
        ('hdg="0" length="500"', 'hdg="0" length="0"', r"a <geometry> has the length 0(\.0)? m"),
        ('hdg="0" length="500"', 'hdg="here" length="500"', "line 2, road 1: hdg of <geometry> is 'here', not a finite number"),
        (ROAD[ROAD.index("<geometry") : ROAD.index("</planView>")], "", "has no <geometry>"),
        (ROAD[ROAD.index("<laneSection") : ROAD.index("</lanes>")], "", "has no <laneSection>"),
        ('<road id="1" length="500"', '<road id="1" length="1e9"', "at most"),
    ],
)  # fmt: skip
def test_a_road_file_that_cannot_be_used_is_refused_by_the_road(tmp_path, old, new, words):
    with pytest.raises(InputError, match=words) as refused:
        network(tmp_path, (old, new))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "shape",
    [
        LINE,
        '<arc curvature="0"/>',
        '<spiral curvStart="0" curvEnd="0"/>',
        '<poly3 a="0" b="0" c="0" d="0"/>',
        '<paramPoly3 pRange="arcLength" aU="0" bU="1" cU="0" dU="0" aV="0" bV="0" cV="0" dV="0"/>',
        '<paramPoly3 pRange="normalized" aU="0" bU="500" cU="0" dU="0" aV="0" bV="0" cV="0" dV="0"/>',
    ],
)
def test_a_straight_line_is_straight_in_every_shape(tmp_path, shape):
    roads = network(tmp_path, (LINE, shape))
    s = np.linspace(0.0, 500.0, 11)
    x, y, heading = roads.road_to_xy_heading(0, s, np.full(11, -2.0))
    np.testing.assert_allclose(x, s, atol=1e-6)
    np.testing.assert_allclose(y, -2.0, atol=1e-9)
    np.testing.assert_allclose(heading, 0.0, atol=1e-9)


def test_a_parabola_is_the_same_as_a_polynomial_of_either_kind(tmp_path):
    s = np.linspace(0.0, 100.0, 9)
    one = network(tmp_path, (LINE, '<poly3 a="0" b="0" c="0.001" d="0"/>')).road_to_xy_heading(0, s, 0.0 * s)
    x, y, heading = one
    np.testing.assert_allclose(y, 0.001 * x**2, atol=1e-6)
    np.testing.assert_allclose(np.tan(heading), 0.002 * x, atol=1e-5)
    # The curve length is s.
    arc = 0.5 * x * np.hypot(1.0, 0.002 * x) + np.arcsinh(0.002 * x) / 0.004
    np.testing.assert_allclose(arc, s, atol=1e-3)


def test_where_a_point_is_on_the_road(tmp_path):
    roads = network(tmp_path)
    found = roads.locate(np.array([100.0, 200.0]), np.array([-2.0, 2.5]))
    assert (found.lane.tolist(), found.s.tolist()) == ([-1, 1], pytest.approx([100.0, 200.0], abs=1e-6))
    lane, offset = roads.find_lane(0, np.array([10.0, 10.0]), np.array([-3.0, 1.0]))
    assert (lane.tolist(), offset.tolist()) == ([-1, 1], pytest.approx([-1.0, -1.0]))
    with pytest.raises(InputError, match="has no road '7'"):
        roads.road_index("7")
