"""Entities on routes that are longer than one lane path, and at ends of roads."""

from __future__ import annotations

import numpy as np
import pytest

from conftest import car, event, scenario_file, speed_action, story_of, time_trigger
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin
from helpers.road_networks import chain, lane, linked, road, virtual, write


def placed(road_id: str, s: float, speed: float, entity: str = "Ego", turned: bool = False) -> str:
    orientation = '<Orientation type="relative" h="3.141592653589793"/>' if turned else ""
    return f"""<Private entityRef="{entity}"><PrivateAction><TeleportAction><Position><LanePosition roadId="{road_id}"
laneId="-1" s="{s}">{orientation}</LanePosition></Position></TeleportAction></PrivateAction>
{speed_action(str(speed))}</Private>"""


def run(folder, init, *parts, duration=10.0, entities="", story="") -> Recording:
    scenario = scenario_file(folder, init=init, story=story, entities=entities or car("Ego"))
    write(folder, *parts)
    (result,) = Builtin(time_step=0.1, duration=duration).run([ConcreteScenario(scenario, {})])
    assert isinstance(result, Recording), result
    return result


def test_an_entity_drives_on_after_five_kilometres_of_road(tmp_path):
    recording = run(tmp_path, placed("0", 10.0, 60.0), *chain(16, 600.0), duration=140.0)
    np.testing.assert_allclose(recording.speed[0], 60.0)
    np.testing.assert_allclose(np.diff(recording.x[0][1:]), 6.0, atol=1e-6)
    np.testing.assert_allclose(recording.y[0], -2.0, atol=1e-9)


def test_an_entity_that_drives_backwards_drives_on_after_half_a_kilometre(tmp_path):
    recording = run(tmp_path, placed("3", 300.0, -40.0), *chain(4, 600.0), duration=45.0)
    np.testing.assert_allclose(recording.speed[0], -40.0)
    np.testing.assert_allclose(np.diff(recording.x[0][1:]), -4.0, atol=1e-6)


def test_an_entity_drives_around_a_ring_for_as_long_as_it_wants(tmp_path):
    # Two half circles, 1 km around.
    radius = 500.0 / np.pi
    ring = [
        road(str(k), 500.0, at=(0.0, -radius + 2 * radius * k, np.pi * k), shape=f'<arc curvature="{1 / radius}"/>',
             links=linked("predecessor", str(1 - k), "end") + linked("successor", str(1 - k), "start"))
        for k in range(2)
    ]  # fmt: skip
    recording = run(tmp_path, placed("0", 0.0, 50.0), *ring, duration=200.0)
    np.testing.assert_allclose(recording.speed[0], 50.0)
    np.testing.assert_allclose(np.hypot(recording.x[0], recording.y[0]), radius + 2.0, atol=1e-3)
    np.testing.assert_allclose(np.hypot(np.diff(recording.x[0]), np.diff(recording.y[0]))[1:], 5.0, atol=2e-3)


def test_an_entity_stops_where_its_road_ends_before_the_next_begins(tmp_path):
    recording = run(
        tmp_path,
        placed("1", 50.0, 20.0),
        road("1", 100.0, links=linked("successor", "2", "start")),
        road("2", 100.0, at=(140.0, 0.0, 0.0), links=linked("predecessor", "1", "end")),
    )
    assert recording.x[0].max() == pytest.approx(100.0)
    assert recording.speed[0][-1] == 0.0


def test_an_entity_comes_onto_a_road_where_the_road_that_it_leaves_says(tmp_path):
    recording = run(tmp_path, placed("aside", 10.0, 10.0), *virtual(), duration=5.0)
    assert recording.x[0][-1] == pytest.approx(80.0, abs=1.0)
    assert recording.y[0][-1] == pytest.approx(-2.0)


def test_an_entity_on_a_reversed_lane_drives_against_the_s_of_its_road(tmp_path):
    reversed_ = lane(-1, more='direction="reversed"')
    recording = run(tmp_path, placed("1", 80.0, 10.0), road("1", 100.0, right=reversed_), duration=5.0)
    assert recording.x[0][-1] == pytest.approx(30.0, abs=1.5)


def test_the_speed_is_that_over_ground_where_a_lane_runs_aslant(tmp_path):
    wider = lane(-1, inside='<width sOffset="0" a="4" b="0.5" c="0" d="0"/>')
    recording = run(tmp_path, placed("1", 10.0, 10.0), road("1", 100.0, right=wider), duration=5.0)
    np.testing.assert_allclose(recording.heading[0], -np.arctan(0.25), atol=1e-6)
    np.testing.assert_allclose(recording.x[0], 10.0 + 10.0 * np.cos(np.arctan(0.25)) * recording.time, atol=0.02)
    np.testing.assert_allclose(recording.y[0], -2.0 - 0.25 * recording.x[0], atol=1e-3)


@pytest.mark.parametrize(
    ("begin", "turned"),
    # Into the bend and out of it.
    [(("1", 90.75), False), (("2", 10.75), True)],
)
def test_a_step_is_as_long_over_ground_where_a_bend_begins_or_ends(tmp_path, begin, turned):
    # To the right of a bend to the left, a lane is longer than the reference line by 2 m times the curvature.
    ahead = placed(begin[0], begin[1], 10.0, turned=turned)
    onto, back = linked("successor", "2", "start"), linked("predecessor", "1", "end")
    bend = road("2", 100.0, at=(100.0, 0.0, 0.0), links=back, shape='<arc curvature="0.02"/>')
    recording = run(tmp_path, ahead, road("1", 100.0, links=onto), bend, duration=3.0)
    steps = np.hypot(np.diff(recording.x[0]), np.diff(recording.y[0]))
    np.testing.assert_allclose(steps, 1.0, atol=1e-3)


def condition(body: str) -> str:
    return f"""<ConditionGroup><Condition name="c" delay="0" conditionEdge="none"><ByEntityCondition>
<TriggeringEntities triggeringEntitiesRule="any"><EntityRef entityRef="Ego"/></TriggeringEntities><EntityCondition>{body}
</EntityCondition></ByEntityCondition></Condition></ConditionGroup>"""


ALONG = 'entityRef="Other" freespace="false" relativeDistanceType="longitudinal" coordinateSystem="road"'


@pytest.mark.parametrize(
    ("test", "holds"),
    [
        (f'<RelativeDistanceCondition {ALONG} rule="lessThan" value="1000"/>', False),
        (f'<RelativeDistanceCondition {ALONG} rule="greaterThan" value="1000"/>', True),
        (f'<TimeHeadwayCondition {ALONG} rule="lessThan" value="100"/>', False),
        (f'<RelativeDistanceCondition {ALONG.replace("longitudinal", "lateral")} rule="lessThan" value="1000"/>', False),
        ('<RelativeClearanceCondition freeSpace="false" oppositeLanes="false" distanceForward="100"'
         ' distanceBackward="100"><EntityRef entityRef="Other"/></RelativeClearanceCondition>', True),
    ],
)  # fmt: skip
def test_nothing_is_near_along_roads_that_do_not_connect(tmp_path, test, holds):
    # 30 m apart, on two roads that run side by side.
    recording = run(
        tmp_path,
        placed("1", 10.0, 10.0) + placed("2", 40.0, 10.0, "Other"),
        road("1", 1000.0),
        road("2", 1000.0, at=(0.0, 30.0, 0.0)),
        entities=car("Ego") + car("Other"),
        story=story_of(event("e", speed_action("0"), condition(test))),
    )
    assert (recording.speed[0][-1] == 0.0) == holds


def test_what_drives_on_a_road_that_connects_is_near_along_it(tmp_path):
    # The other is on the road that a route would take; the ego goes straight on.
    aside = road("aside", 200.0, at=(100.0, 0.0, np.pi / 4), junction="j", links=linked("predecessor", "in", "end"))
    ahead = road("ahead", 200.0, at=(100.0, 0.0, 0.0), junction="j", links=linked("predecessor", "in", "end"))
    recording = run(
        tmp_path,
        placed("in", 10.0, 10.0) + placed("aside", 150.0, 0.0, "Other"),
        road("in", 100.0, links=linked("successor", "j")), aside, ahead, '<junction id="j"/>',
        entities=car("Ego") + car("Other"),
        story=story_of(event("e", speed_action("0"), condition(
            f'<RelativeDistanceCondition {ALONG} rule="lessThan" value="200"/>'))),
    )  # fmt: skip
    # They are 240 m apart.
    assert recording.x[0][-1] == pytest.approx(50.0, abs=2.5)


TWO_SECTIONS = "".join(
    f'<laneSection s="{s}"><center><lane id="0" type="none"/></center><right>{"".join(map(lane, lanes))}</right>'
    "</laneSection>" for s, lanes in ((0, [-1]), (50, [-1, -2]))
)  # fmt: skip


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"Lane": -2, "S": 60.0}, None),
        ({"Lane": -2}, "road '1' has no lane -2 at s = 10 m"),
        ({"Lane": -5}, "road '1' has no lane -5 at s = 10 m"),
        ({"Road": "7"}, "has no road '7'"),
    ],
)
def test_a_place_on_a_lane_or_road_that_does_not_exist_is_the_error_of_its_scenario(tmp_path, values, words):
    place = '<LanePosition roadId="$Road" laneId="$Lane" s="$S"/>'
    declared = (("Road", "string", "1"), ("Lane", "integer", "-1"), ("S", "double", "10"))
    path = scenario_file(
        tmp_path,
        init=f'<Private entityRef="Ego"><PrivateAction><TeleportAction><Position>{place}</Position></TeleportAction>'
        "</PrivateAction></Private>",
        parameters="".join(
            f'<ParameterDeclaration name="{name}" parameterType="{kind}" value="{value}"/>'
            for name, kind, value in declared
        ),
    )
    write(tmp_path, road("1", 100.0, sections=TWO_SECTIONS))
    concretes = [ConcreteScenario(path, values), ConcreteScenario(path, {})]
    result, other = Builtin(duration=0.2).run(concretes)
    assert isinstance(other, Recording)
    if words is None:
        assert isinstance(result, Recording)
    else:
        assert words in str(result)


def test_who_changes_lanes_on_a_route_does_not_go_back_to_what_it_has_passed(tmp_path):
    # From "b" a road leads back to "a" as well as on to "c"; the route is a, b, c.
    two = lane(-1, -1, -1) + lane(-2, -2, -2)
    radius = 200.0 / np.pi
    back = [
        road("up", 200.0, at=(200.0, 0.0, 0.0), junction="j", shape=f'<arc curvature="{1 / radius}"/>', right=two,
             links=linked("predecessor", "b", "end") + linked("successor", "home", "start")),
        road("home", 200.0, at=(200.0, 2 * radius, np.pi), right=two,
             links=linked("predecessor", "up", "end") + linked("successor", "down", "start")),
        road("down", 200.0, at=(0.0, 2 * radius, np.pi), right=two, shape=f'<arc curvature="{1 / radius}"/>',
             links=linked("predecessor", "home", "end") + linked("successor", "a", "start")),
    ]  # fmt: skip
    parts = [
        road("a", 100.0, right=two, links=linked("successor", "b", "start") + linked("predecessor", "down", "end")),
        road("b", 100.0, at=(100.0, 0.0, 0.0), right=two,
             links=linked("predecessor", "a", "end") + linked("successor", "j")),
        *back,
        road("c", 300.0, at=(200.0, 0.0, 0.0), junction="j", right=two, links=linked("predecessor", "b", "end")),
        '<junction id="j"/>',
    ]  # fmt: skip
    waypoints = "".join(
        f'<Waypoint routeStrategy="shortest"><Position><LanePosition roadId="{name}" laneId="-1" s="{s}"/></Position>'
        "</Waypoint>" for name, s in (("a", 10), ("b", 50), ("c", 200))
    )  # fmt: skip
    route = f"""<PrivateAction><RoutingAction><AssignRouteAction><Route name="r" closed="false">{waypoints}</Route>
</AssignRouteAction></RoutingAction></PrivateAction>"""
    change = """<PrivateAction><LateralAction><LaneChangeAction><LaneChangeActionDynamics dynamicsShape="cubic" value="2"
dynamicsDimension="time"/><LaneChangeTarget><AbsoluteTargetLane value="-2"/></LaneChangeTarget></LaneChangeAction>
</LateralAction></PrivateAction>"""
    init = placed("a", 10.0, 20.0).replace("</Private>", route + "</Private>")
    recording = run(
        tmp_path, init, *parts, duration=15.0, story=story_of(event("e", change, time_trigger("6")))
    )  # fmt: skip
    assert recording.x[0][-1] == pytest.approx(310.0, abs=3.0)
    assert recording.y[0][-1] == pytest.approx(-6.0)


@pytest.mark.parametrize("limits", ["", '<DynamicConstraints maxAcceleration="3" maxDeceleration="5" maxSpeed="60"/>'])
def test_an_entity_keeps_no_distance_to_who_drives_on_a_road_that_does_not_connect(tmp_path, limits):
    action = f"""<PrivateAction><LongitudinalAction><LongitudinalDistanceAction entityRef="Other" distance="50"
freespace="false" continuous="true" coordinateSystem="road">{limits}</LongitudinalDistanceAction></LongitudinalAction>
</PrivateAction>"""
    recording = run(
        tmp_path,
        placed("1", 10.0, 10.0) + placed("2", 200.0, 15.0, "Other"),
        road("1", 1000.0),
        road("2", 1000.0, at=(0.0, 30.0, 0.0)),
        entities=car("Ego") + car("Other"),
        story=story_of(event("e", action, time_trigger("1"))),
    )
    np.testing.assert_allclose(recording.speed[0], 10.0)
    np.testing.assert_allclose(np.diff(recording.x[0][1:]), 1.0)


def test_who_stands_at_the_end_of_its_road_stands_in_a_lane_change_too(tmp_path):
    # It accelerates for the whole test.
    faster = speed_action("60", "linear", over="12")
    change = """<PrivateAction><LateralAction><LaneChangeAction><LaneChangeActionDynamics dynamicsShape="sinusoidal"
dynamicsDimension="distance" value="20"/><LaneChangeTarget><AbsoluteTargetLane value="-1"/></LaneChangeTarget></LaneChangeAction>
</LateralAction></PrivateAction>"""
    story = story_of(event("c", change, time_trigger("6")) + event("e", faster, time_trigger("0")))
    recording = run(tmp_path, placed("1", 50.0, 0.0), road("1", 100.0), story=story)
    assert recording.speed[0][50:].max() == 0.0
    assert recording.x[0][-1] == pytest.approx(100.0)


def test_a_target_beyond_the_end_of_its_road_is_that_end(tmp_path):
    target = '<Position><LanePosition roadId="1" laneId="-1" s="900"/></Position>'
    test = f'<DistanceCondition value="30" freespace="false" rule="lessThan">{target}</DistanceCondition>'
    story = story_of(event("e", speed_action("0"), condition(test)))
    recording = run(tmp_path, placed("1", 10.0, 10.0), road("1", 100.0), story=story)
    assert recording.x[0][-1] == pytest.approx(70.0, abs=1.5)


@pytest.mark.parametrize(("lane_id", "holds"), [("-1", True), ("1", False)])
def test_lanes_of_a_road_that_runs_the_other_way_count_by_where_they_lead(tmp_path, lane_id, holds):
    # Both roads end where they meet, so that the lane that leads on from -1 is 1.
    ways = [
        road(
            name, 200.0, at=at, links=linked("successor", other, "end"), right=lane(-1, after=1), left=lane(1, after=-1)
        )
        for name, other, at in (("1", "2", (0.0, 0.0, 0.0)), ("2", "1", (400.0, 0.0, np.pi)))
    ]
    test = (
        '<RelativeClearanceCondition freeSpace="false" oppositeLanes="false" distanceForward="100"'
        ' distanceBackward="30"><RelativeLaneRange from="0" to="0"/></RelativeClearanceCondition>'
    )
    story = story_of(event("e", speed_action("0"), condition(test)))
    other = placed("2", 160.0, 0.0, "Other").replace('laneId="-1"', f'laneId="{lane_id}"')
    init = placed("1", 150.0, 1.0) + other
    recording = run(tmp_path, init, *ways, entities=car("Ego") + car("Other"), story=story, duration=2.0)
    assert (recording.speed[0][-1] == 0.0) == holds
