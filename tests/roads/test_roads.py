from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from lxml import etree
from scipy.integrate import quad

from conftest import EXAMPLES, ROAD, at_night, private, run, scenario_file, speed_action, teleport
from cornercase._common.errors import InputError
from cornercase.roads._lane_graph import DirectedLane
from cornercase.roads._network import RoadNetwork
from cornercase.roads._reference_line import ReferenceGeometry
from cornercase.scenario._xml import XmlFileCache
from cornercase.simulators import check
from cornercase.simulators.builtin.tracks._lane import LaneTrack
from helpers import road_networks as rn

REFERENCE = Path(__file__).parents[3] / "shared" / "reference" / "openscenario"


def test_arc_is_a_circle():
    x, y, heading = ReferenceGeometry(0, 1, 2, 0.3, 50, "arc", (0.02,)).pose_at(np.linspace(0, 50, 7))
    center = np.array([1 - 50 * np.sin(0.3), 2 + 50 * np.cos(0.3)])
    np.testing.assert_allclose(np.hypot(x - center[0], y - center[1]), 50, rtol=1e-12)
    np.testing.assert_allclose(heading, 0.3 + 0.02 * np.linspace(0, 50, 7))


@pytest.mark.parametrize("curvatures", [(0.0, 0.05), (0.05, 0.0), (-0.02, 0.04), (0.01, 0.01), (0.03, 0.03 + 1e-9)])
def test_spiral_against_numeric_integration(curvatures):
    start, end = curvatures
    length = 40.0
    spiral = ReferenceGeometry(0, 0, 0, 0.5, length, "spiral", curvatures)

    def heading(s):
        return 0.5 + start * s + 0.5 * (end - start) / length * s * s

    for along in (5.0, 23.0, 40.0):
        x, y, h = spiral.pose_at(np.array([along]))
        assert x[0] == pytest.approx(quad(lambda s: np.cos(heading(s)), 0, along)[0], abs=1e-6)
        assert y[0] == pytest.approx(quad(lambda s: np.sin(heading(s)), 0, along)[0], abs=1e-6)
        assert h[0] == pytest.approx(heading(along))


def test_parametric_cubic_of_a_straight_line():
    cubic = ReferenceGeometry(0, 0, 0, 0, 10, "paramPoly3", (1.0, 0, 10, 0, 0, 0, 5, 0, 0))
    x, y, h = cubic.pose_at(np.array([5.0]))
    assert (x[0], y[0], h[0]) == pytest.approx((5.0, 2.5, np.arctan2(5, 10)))


@pytest.mark.parametrize("name", ["x_intersection", "t_intersection"])
def test_examples_are_valid_opendrive(name):
    import qc_opendrive

    schema = Path(qc_opendrive.__file__).parent / "schema" / "1.7.0" / "opendrive_17_core.xsd"
    etree.XMLSchema(etree.parse(schema)).assertValid(etree.parse(EXAMPLES / name / f"{name}.xodr"))


def test_right_turn_is_smooth_and_ends_in_the_eastern_arm():
    network = RoadNetwork.read(EXAMPLES / "x_intersection" / "x_intersection.xodr")
    path = network.lane_path_from(network.road_index("1"), -1, 0.0, True, ((network.road_index("2"), 1, 20.0),))
    assert path is not None
    assert (path.x[-1], path.y[-1]) == pytest.approx((112.0, -1.75))
    assert np.hypot(np.diff(path.x), np.diff(path.y)).max() < 0.11
    assert np.abs(path.curvature).max() == pytest.approx(1 / 7, rel=1e-3)
    # 100 m, a turn of two lines and a quarter circle, 100 m.
    assert path.distance[-1] == pytest.approx(200 + 2 * 3.25 + 7 * np.pi / 2, abs=1e-3)


def test_between_samples_s_is_that_of_the_reference_line():
    network = RoadNetwork.read(EXAMPLES / "x_intersection" / "x_intersection.xodr")
    path = network.lane_path_from(network.road_index("1"), -1, 0.0, True, ((network.road_index("2"), 1, 20.0),))
    assert path is not None
    # In the middle of the turn, the lane is longer or shorter than the reference line.
    turn = np.flatnonzero(np.abs(path.curvature) > 0.1)[10:-10]
    distance = path.distance[turn][:, None] + np.array([0.0, 0.05, 0.0999])
    track = LaneTrack(path)
    s = np.apply_along_axis(track.s_at, 1, distance)
    road = network.roads[int(path.road[turn[0]])]
    x, y, _ = road.pose_at(s.ravel(), np.interp(distance.ravel(), path.distance, path.center_offset))
    at_x, at_y, _ = track.pose_at(distance.ravel(), np.zeros(distance.size), np.zeros(distance.size, dtype=np.int64))
    np.testing.assert_allclose(np.hypot(x - at_x, y - at_y), 0.0, atol=2e-3)
    np.testing.assert_allclose(path.advance_along_reference(distance[:, 0], s[:, 1] - s[:, 0]), distance[:, 1])


def test_without_a_route_the_way_goes_straight_on():
    network = RoadNetwork.read(EXAMPLES / "x_intersection" / "x_intersection.xodr")
    path = network.lane_path_from(network.road_index("1"), -1, 0.0, True)
    assert path is not None
    assert (path.x[-1], path.y[-1]) == pytest.approx((1.75, 112.0))


def test_locate_inverts_world():
    network = RoadNetwork.read(EXAMPLES / "x_intersection" / "x_intersection.xodr")
    rng = np.random.default_rng(1)
    for road in ("1", "2", "3", "4"):
        r = network.road_index(road)
        s, offset = rng.uniform(1, 95, 20), rng.uniform(-1.5, 1.5, 20)
        for lane in (-1, 1):
            x, y, _ = network.lane_to_xy_heading(r, lane, s, offset)
            place = network.locate(x, y)
            assert (place.road == r).all()
            assert (place.lane == lane).all()
            np.testing.assert_allclose(place.s, s, atol=1e-6)
            np.testing.assert_allclose(place.offset, offset, atol=1e-6)
            # A cached result does not change if the returned arrays are changed.
            for _ in range(2):
                alone = network.locate(x[:1], y[:1])
                assert [one[0] for one in alone] == [one[0] for one in place]
                alone.s[:], alone.lane[:] = 0.0, 7


# Lanes of foreign files that do not meet, as (road, lane, linked lane).
APART = {
    # A lane starts or ends with zero width beside the linked one, so their centers are half a lane apart.
    "soderleden.xodr": {("0", -3, -2)},
    "two_plus_one.xodr": {("1", 1, 1), ("1", -1, -1)},
    # The file links the outer border of a road to the inner one of the other road instead of the outer one.
    "straight_2x100m_opposite.xodr": {("2", -3, 2)},
    # Lanes of type none are 20 m wide on one road and 4.7 m on the other.
    "multi_intersections.xodr": {("284", 4, 4), ("284", -4, -4)},
}


@pytest.mark.parametrize("each", at_night([9, 1], {1}))
def test_all_lanes_of_roads_of_others_join(each):
    files = sorted(REFERENCE.glob("**/*.xodr")) or [EXAMPLES / "x_intersection" / "x_intersection.xodr"]
    joins, apart = 0, []
    for file in files[::each]:
        network = RoadNetwork.read(file)
        graph = network._lane_graph
        for road, one in enumerate(network.roads):
            for section, (_, lanes) in enumerate(one.sections):
                for lane, along in ((lane, along) for lane in lanes for along in (True, False)):
                    here = DirectedLane(road, section, lane, along)
                    path = graph.lane_center_path(here)
                    for option in graph.find_exits(here):
                        joins += 1
                        follows = graph.lane_center_path(option)
                        gap = np.hypot(path.x[-1] - follows.x[0], path.y[-1] - follows.y[0])
                        if gap > 0.05 and (one.road_id, lane, option.lane) not in APART.get(file.name, ()):
                            apart.append((file.name, one.road_id, here, option, gap))
        assert graph.unconnected_links == {}, file.name
    assert joins > (20 if each > 1 or not REFERENCE.is_dir() else 1000)
    assert apart == []


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            '<geometry s="0" x="0" y="0" hdg="0" length="500">',
            '<geometry s="0" x="0" y="0" hdg="0" length="0">',
            "above 0",
        ),
        ('id="1" length="500"', 'id="1" length="nan"', "finite"),
        ("<line/>", "<wave/>", "has no <line>, <arc>"),
        ('x="0"', 'x="NaN"', "finite"),
    ],
)
def test_bad_roads_are_refused(tmp_path, old, new, words):
    path = tmp_path / "road.xodr"
    path.write_text(ROAD.replace(old, new))
    with pytest.raises(InputError, match=words):
        RoadNetwork.read(path)


def test_a_ring_of_roads_ends(tmp_path):
    path = tmp_path / "ring.xodr"
    ring = ROAD.replace(
        "<planView>",
        '<link><successor elementType="road" elementId="1" contactPoint="start"/></link><planView>',
    )
    path.write_text(
        ring.replace('<lane id="-1" type="driving">', '<lane id="-1" type="driving"><link><successor id="-1"/></link>')
    )
    network = RoadNetwork.read(path)
    endless = network.lane_path_from(0, -1, 0.0, True)
    assert endless is not None
    assert endless.distance[-1] < 12_000


def _parametric(text: str, length: float, top: float) -> ReferenceGeometry:
    return ReferenceGeometry(0, 0, 0, 0, length, "paramPoly3", (top, *map(float, text.split())))


CURVES = ("0 10 0 0  0 0 5 -3", "0 1 0.4 -0.2  0 0.1 -2 1.7", "0 200 50 -30  0 10 -80 40", "0 3 20 -9  0 0 2 1")


@pytest.mark.parametrize("top", [1.0, 7.0])
@pytest.mark.parametrize("text", CURVES)
def test_43_3_a_parametric_cubic_is_followed_by_its_length(text, top):
    u, v = (np.array(text.split()[k : k + 4], dtype=float) / top ** np.arange(4) for k in (0, 4))

    def speed(p):
        return float(np.hypot(*(np.polyval(np.polyder(one[::-1]), p) for one in (u, v))))

    length = quad(speed, 0.0, top, epsabs=1e-12, limit=200)[0]
    cubic = ReferenceGeometry(0, 0, 0, 0, length, "paramPoly3", (top, *u, *v))
    along = np.linspace(0.0, length, 41)
    for s, p in zip(along, cubic.curve_parameter(along), strict=True):
        assert quad(speed, 0.0, p, epsabs=1e-12, limit=200)[0] == pytest.approx(s, abs=1e-5 * length)
    x, y, _ = cubic.pose_at(along)
    assert (x[-1], y[-1]) == pytest.approx((np.polyval(u[::-1], top), np.polyval(v[::-1], top)))
    fine = np.linspace(0.0, length, 20_001)
    turned = np.gradient(np.unwrap(cubic.pose_at(fine)[2]), fine)
    np.testing.assert_allclose(cubic.curvature_at(fine[5:-5]), turned[5:-5], atol=2e-2 * np.abs(turned).max())
    # Straight continuation beyond its ends.
    x, y, heading = cubic.pose_at(np.array([-7.0, 0.0, length, length + 9.0]))
    assert np.hypot(np.diff(x), np.diff(y))[[0, 2]] == pytest.approx([7.0, 9.0])
    assert np.arctan2(np.diff(y), np.diff(x))[[0, 2]] == pytest.approx(heading[[0, 3]])
    assert cubic.curvature_at(np.array([-1.0, length + 1.0])).tolist() == [0.0, 0.0]


def test_43_3_a_parametric_cubic_of_another_length_ends_where_the_file_says():
    stretched = _parametric(CURVES[0], 12.0, 1.0)
    x, y, _ = stretched.pose_at(np.array([0.0, 12.0]))
    assert (x.tolist(), y.tolist()) == ([0.0, pytest.approx(10.0)], [0.0, pytest.approx(2.0)])
    x, y, _ = stretched.pose_at(np.linspace(0.0, 12.0, 101))
    steps = np.hypot(np.diff(x), np.diff(y))
    np.testing.assert_allclose(steps, steps[0], rtol=1e-3)


def test_43_3_a_car_keeps_its_speed_on_a_parametric_cubic(tmp_path):
    # The parameter changes 1.9 times as fast at the start as at the end.
    shape = '<paramPoly3 pRange="normalized" aU="0" bU="131" cU="-46" dU="0" aV="0" bV="0" cV="0" dV="38"/>'
    cubic = _parametric("0 131 -46 0  0 0 0 38", 100.0, 1.0)
    u = np.linspace(0.0, 1.0, 200_001)
    length = float(np.hypot(np.diff(131 * u - 46 * u**2), np.diff(38 * u**3)).sum())
    assert cubic.kind == "paramPoly3"
    path = scenario_file(tmp_path, init=private("Ego", teleport("0"), speed_action("20")))
    rn.write(tmp_path, rn.road("1", round(length, 9), shape=shape))
    recording = run(path, duration=4.0)
    speed = np.hypot(np.diff(recording.x[0]), np.diff(recording.y[0])) / np.diff(recording.time)
    # Each step is straight, with the curvature of its start.
    np.testing.assert_allclose(speed, 20.0, rtol=5e-3)
    assert speed.mean() == pytest.approx(20.0, rel=1e-3)


LAYERS = (
    '<lanes layer="permanent"><laneSection s="0"><center><lane id="0" type="none"/></center><right>'
    '<lane id="-1" type="driving"><link>{links}</link><width sOffset="0" a="4" b="0" c="0" d="0"/></lane></right>'
    '</laneSection></lanes><lanes layer="temporary"><laneOffset s="0" a="-50" b="0" c="3" d="0"/>'
    '<laneSection s="0" length="50"><center><lane id="0" type="none"/></center><right><lane id="-1" type="driving">'
    '<width sOffset="0" a="2" b="0" c="0" d="0"/></lane></right></laneSection></lanes>'
)


def _layered(folder, links="", old="", new=""):
    text = rn.road("1", 100.0, links=rn.linked("successor", "2", "start"))
    start, end = text.index("<lanes>"), text.index("</road>")
    text = text[:start] + LAYERS.format(links=links) + text[end:]
    second = rn.road("2", 100.0, at=(100.0, 0.0, 0.0), links=rn.linked("predecessor", "1", "end"))
    path = rn.write(folder, text.replace(old, new), second)
    path.write_text(path.read_text().replace('revMinor="8"', 'revMinor="9"'))
    return path


def test_43_4_only_the_permanent_lanes_are_driven_on(tmp_path):
    links = '<successor id="-1" layer="permanent"/><successor id="-2" layer="temporary"/>'
    path = _layered(tmp_path, links)
    root = XmlFileCache().get_root(path)
    network = RoadNetwork.from_xml(root, path)
    assert network.roads[0].lane_offsets == ()
    assert network.roads[0].sections[0][1][-1].successors == (-1,)
    scenario = scenario_file(tmp_path, init=private("Ego", teleport("1"), speed_action("10")))
    path = _layered(tmp_path, links)
    recording = run(scenario, duration=15.0)
    np.testing.assert_allclose(recording.y[0], -2.0)
    assert recording.x[0, -1] == pytest.approx(151.0)
    found = [str(one) for one in check(scenario).notices if "road.xodr" in str(one)]
    assert found == [
        "<lanes> in <road> (road.xodr, line 1): it is not read here; only the lanes of the layer 'permanent' are driven on"
    ]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            '"temporary"',
            '"permanent"',
            "line 1, road 1: has a second <lanes> of the layer 'permanent'; keep one of them",
        ),
        ('"permanent"', '"temporary"', "line 1, road 1: has only <lanes> of the layer 'temporary'; give it <lanes> of"),
        ('layer="temporary"', "", "line 1, road 1: has a second <lanes> of the layer 'permanent'"),
        ('layer="temporary"', 'layer="winter"', "line 1: layer 'winter' of <lanes> cannot be used"),
    ],
)
def test_43_4_layers_that_cannot_be_told_apart_are_refused(tmp_path, old, new, words):
    with pytest.raises(InputError, match=words):
        RoadNetwork.read(_layered(tmp_path, old=old, new=new))


def test_43_4_links_of_temporary_lanes_in_a_junction_are_left_out(tmp_path):
    links = "".join(
        f'<laneLink from="-1" to="{to}" fromLayer="{one}" toLayer="{other}"/>'
        for to, one, other in (
            (-1, "permanent", "permanent"),
            (-2, "permanent", "temporary"),
            (-3, "temporary", "temporary"),
        )
    )
    junction = f'<junction id="j"><connection id="0" incomingRoad="1" connectingRoad="2" contactPoint="start">{links}</connection></junction>'
    network = rn.network(tmp_path, rn.road("1", 10.0), rn.road("2", 10.0, junction="j"), junction)
    assert network.connections["j"] == (("1", "2", "start", {-1: -1}),)
