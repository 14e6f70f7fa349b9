"""Routes through networks: continuations, exits, ends."""

from __future__ import annotations

import numpy as np
import pytest

from cornercase._common.errors import InputError
from cornercase.roads._locator import RoadLocator
from cornercase.roads._nearest import NearestPointIndex
from helpers.road_networks import WIDTH, chain, lane, linked, network, road, virtual

TURN = 2 * np.pi


@pytest.mark.parametrize("first", [0.0, TURN, -TURN])
@pytest.mark.parametrize("order", [1, -1])
def test_who_goes_straight_on_takes_no_notice_of_whole_turns_in_headings(tmp_path, first, order):
    # The straight road of the junction has two geometries, whose headings differ by a full turn.
    straight = road("straight", 20.0, at=(100.0, 0.0, first), junction="j",
                    links=linked("predecessor", "in", "end") + linked("successor", "east", "start"))  # fmt: skip
    straight = straight.replace('length="20.0"><line/></geometry>', 'length="10.0"><line/></geometry>'
                                '<geometry s="10" x="110" y="0" hdg="0" length="10"><line/></geometry>')  # fmt: skip
    bend = road("bend", 10 * np.pi / 2, at=(100.0, 0.0, 0.0), junction="j", shape='<arc curvature="0.1"/>',
                links=linked("predecessor", "in", "end") + linked("successor", "north", "start"))  # fmt: skip
    connections = "".join(
        f'<connection id="{k}" incomingRoad="in" connectingRoad="{name}" contactPoint="start">'
        '<laneLink from="-1" to="-1"/></connection>' for k, name in enumerate(["straight", "bend"])
    )  # fmt: skip
    roads = network(
        tmp_path,
        road("in", 100.0, links=linked("successor", "j")),
        *[straight, bend][::order],
        road("east", 50.0, at=(120.0, 0.0, 0.0), links=linked("predecessor", "j")),
        road("north", 50.0, at=(110.0, 10.0, np.pi / 2), links=linked("predecessor", "j")),
        f'<junction id="j">{connections}</junction>',
    )
    path = roads.lane_path_from(0, -1, 0.0, True)
    assert path is not None
    assert (path.x[-1], path.y[-1]) == pytest.approx((170.0, -2.0))


def way(roads, road, s, along, goal, goal_s) -> float:
    (found,) = roads.driving_distance(*(np.array([one]) for one in (road, s, along, goal, goal_s)))
    return float(found)


def test_roads_that_lie_apart_are_not_bridged(tmp_path):
    gap = [road("1", 100.0, links=linked("successor", "2", "start")),
           road("2", 100.0, at=(140.0, 0.0, 0.0), links=linked("predecessor", "1", "end"))]  # fmt: skip
    roads = network(tmp_path, *gap)
    path = roads.lane_path_from(0, -1, 0.0, True)
    assert path is not None
    assert path.x[-1] == pytest.approx(100.0)
    assert path.has_end
    assert roads.unconnected_links() == [("1", "2", pytest.approx(40.0))]  # type: ignore[comparison-overlap]
    assert not np.isfinite(way(roads, 0, 50.0, True, 1, 50.0))


def test_43_13_gaps_are_looked_for_only_where_somebody_comes_to_one(tmp_path):
    gap = [road("1", 100.0, links=linked("successor", "2", "start")),
           road("2", 100.0, at=(140.0, 0.0, 0.0), links=linked("predecessor", "1", "end")),
           road("3", 100.0, at=(0.0, 50.0, 0.0))]  # fmt: skip
    roads = network(tmp_path, *gap)
    assert roads.lane_path_from(2, -1, 0.0, True) is not None
    assert roads.unconnected_links() == []
    assert roads.lane_path_from(0, -1, 0.0, True) is not None
    assert [names for *names, _ in roads.unconnected_links()] == [["1", "2"]]


def test_roads_that_nearly_meet_are_joined(tmp_path):
    roads = network(tmp_path, road("1", 100.0, links=linked("successor", "2", "start")),
                    road("2", 100.0, at=(100.3, 0.2, 0.0), links=linked("predecessor", "1", "end")))  # fmt: skip
    path = roads.lane_path_from(0, -1, 0.0, True)
    assert path is not None
    assert path.x[-1] == pytest.approx(200.3)
    assert roads.unconnected_links() == []


def test_a_road_passes_a_virtual_junction(tmp_path):
    roads = network(tmp_path, *virtual())
    path = roads.lane_path_from(roads.road_index("main"), -1, 0.0, True)
    assert path is not None
    assert (path.x[-1], path.distance[-1]) == (pytest.approx(100.0), pytest.approx(100.0))
    np.testing.assert_allclose(path.y, -2.0)


def test_a_route_leaves_a_road_at_a_virtual_junction_and_comes_back_where_it_says(tmp_path):
    roads = network(tmp_path, *virtual())
    main, aside = roads.road_index("main"), roads.road_index("aside")
    path = roads.lane_path_from(main, -1, 0.0, True, ((aside, -1, 5.0), (main, -1, 80.0)))
    assert path is not None
    assert np.interp(40.0, path.x, path.y) == pytest.approx(-3.0)
    assert (path.x[-1], path.y[-1]) == (pytest.approx(100.0), pytest.approx(-2.0))
    assert path.distance[-1] == pytest.approx(100.0 + 2 * 0.9, abs=0.3)
    onto = roads.lane_path_from(aside, -1, 10.0, True)
    assert onto is not None
    assert onto.x[-1] == pytest.approx(100.0)
    back = roads.lane_path_from(aside, -1, 10.0, False)
    assert back is not None
    assert back.x[-1] == pytest.approx(0.0)


def test_a_way_that_is_longer_than_a_path_is_cut_not_ended(tmp_path):
    roads = network(tmp_path, *chain(20, 600.0))
    path = roads.lane_path_from(0, -1, 0.0, True)
    assert path is not None
    assert not path.has_end
    assert path.has_start
    last = roads.lane_path_from(19, -1, 0.0, True)
    assert last is not None
    assert last.has_end
    assert not last.has_start


def test_the_way_along_roads_goes_through_all_that_connect(tmp_path):
    roads = network(tmp_path, *chain(20, 600.0), road("alone", 100.0, at=(0.0, 50.0, 0.0)))
    assert way(roads, 0, 100.0, True, 19, 100.0) == pytest.approx(19 * 600.0)
    assert way(roads, 19, 100.0, True, 0, 100.0) == pytest.approx(-19 * 600.0)
    assert way(roads, 19, 100.0, False, 0, 100.0) == pytest.approx(19 * 600.0)
    assert not np.isfinite(way(roads, 0, 100.0, True, roads.road_index("alone"), 50.0))


def test_a_lane_that_has_widths_takes_no_notice_of_borders(tmp_path):
    both = WIDTH + '<border sOffset="0" a="-9" b="0" c="0" d="0"/>'
    roads = network(tmp_path, road("1", 100.0, right=lane(-1, inside=both)))
    assert roads.lane_to_xy_heading(0, -1, np.array([10.0]), np.zeros(1))[1] == pytest.approx(-2.0)
    alone = network(tmp_path, road("1", 100.0, right=lane(-1, inside=both.replace(WIDTH, ""))))
    assert alone.lane_to_xy_heading(0, -1, np.array([10.0]), np.zeros(1))[1] == pytest.approx(-4.5)


@pytest.mark.parametrize(
    ("number", "words"),
    [("-1e7", "between -200 and 200"), ("-1.5", "not a whole number"), ("1e300", "between"), ("x", "not a finite")],
)
def test_a_lane_number_that_is_none_is_refused(tmp_path, number, words):
    with pytest.raises(InputError, match=words):
        network(tmp_path, road("1", 100.0, right=lane(-1).replace('id="-1"', f'id="{number}"')))


def test_lanes_far_out_cost_no_more_than_others(tmp_path):
    roads = network(tmp_path, road("1", 100.0, right=lane(-1) + lane(-200)))
    assert roads.lane_to_xy_heading(0, -200, np.array([10.0]), np.zeros(1))[1] == pytest.approx(-6.0)
    assert roads.locate(np.array([50.0]), np.array([-5.0])).lane.tolist() == [-200]


def test_a_network_of_thousands_of_kilometres_is_sampled_more_coarsely_and_found_all_the_same(tmp_path):
    roads = [road(str(k), 1e5, at=(0.0, 30.0 * k, 0.0), left=lane(1)) for k in range(40)]
    x, y = np.linspace(100.0, 99_900.0, 500), np.tile(np.arange(500) % 40 * 30.0, 1)
    wide = network(tmp_path, *roads)
    locator = RoadLocator(wide.roads, max_samples=200_000)
    right, left = locator.locate(x, y - 3.9), locator.locate(x, y + 0.1)
    assert right.road.tolist() == left.road.tolist() == (np.arange(500) % 40).tolist()
    assert set(right.lane) == {-1}
    assert set(left.lane) == {1}
    np.testing.assert_allclose(right.s, x, atol=1e-6)
    path = wide.lane_path_from(3, -1, 50_000.0, True)
    assert path is not None
    assert len(path.x) < 1e6
    assert path.lane_s == (50_000.0, 60_000.0)
    assert path.lane_span == (10_000.0, 20_000.0)


def test_a_section_for_one_side_leaves_the_other_as_it_was(tmp_path):
    center = '<center><lane id="0" type="none"/></center>'
    wider = '<width sOffset="0" a="4" b="0.1" c="0" d="0"/>'
    roads = network(
        tmp_path,
        road("1", 100.0, sections=f'<laneSection s="0"><left>{lane(1)}</left>{center}<right>{lane(-1, inside=wider)}'
             f'</right></laneSection><laneSection s="40" singleSide="true"><left>{lane(1)}{lane(2)}</left>{center}'
             "</laneSection>"),
    )  # fmt: skip
    y = roads.lane_to_xy_heading(0, -1, np.array([30.0, 60.0]), np.zeros(2))[1]
    assert y == pytest.approx([-3.5, -5.0])
    assert roads.lane_to_xy_heading(0, 2, np.array([60.0]), np.zeros(1))[1] == pytest.approx(6.0)
    path = roads.lane_path_from(0, -1, 0.0, True)
    assert path is not None
    assert path.x[-1] == pytest.approx(100.0)


def test_traffic_on_a_reversed_lane_runs_against_the_others(tmp_path):
    roads = network(tmp_path, road("1", 100.0, right=lane(-1) + lane(-2, more='direction="reversed"')))
    assert roads.lane_to_xy_heading(0, -1, np.array([10.0]), np.zeros(1))[2] == pytest.approx(0.0)
    assert roads.lane_to_xy_heading(0, -2, np.array([10.0]), np.zeros(1))[2] == pytest.approx(np.pi)
    assert not roads.is_traffic_forward(0, -2, 10.0)


def test_a_lane_that_splits_leads_onto_both(tmp_path):
    center = '<center><lane id="0" type="none"/></center>'
    split = lane(-1).replace("<link>", '<link><successor id="-2"/><successor id="-3"/>')
    roads = network(
        tmp_path,
        road("1", 100.0, sections=f'<laneSection s="0">{center}<right>{split}</right></laneSection>'
             f'<laneSection s="50">{center}<right>{lane(-1)}{lane(-2)}{lane(-3)}</right></laneSection>'),
    )  # fmt: skip
    path = roads.lane_path_from(0, -1, 0.0, True)
    assert path is not None
    assert path.lane[-1] == -2


def test_points_that_are_asked_for_one_by_one_get_the_neighbours_that_they_get_together():
    points = np.random.default_rng(0).uniform(0.0, 100.0, (5000, 2))
    queries = np.random.default_rng(1).uniform(0.0, 100.0, (600, 2))
    together = NearestPointIndex(points).find_nearest(queries, 24)
    index = NearestPointIndex(points)
    one_by_one = [index.find_nearest(query[None], 24)[0] for query in queries]
    np.testing.assert_array_equal(one_by_one, together)
