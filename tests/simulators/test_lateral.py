"""Offsets and distances across the road, and entities that come and go."""

from __future__ import annotations

import numpy as np
import pytest

from conftest import car, event, private, ran, scenario_file, speed_action, story_of, teleport, time_trigger
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin
from helpers.random_storyboards import write_roads

DT = 0.05


def run(folder, action, *, other_lane="-1", duration=8.0, actor="Ego", at="1"):
    init = private("Ego", teleport("50"), speed_action("10"))
    init += private("Other", teleport("150", other_lane), speed_action("10"))
    story = story_of(event("e", action, time_trigger(at)), actor)
    path = scenario_file(folder, init=init, story=story, entities=car("Ego") + car("Other"))
    (recording,) = ran(Builtin(time_step=DT, duration=duration), [ConcreteScenario(path)])
    return recording


def relative_offset(value):
    return f"""<PrivateAction><LateralAction><LaneOffsetAction continuous="false"><LaneOffsetActionDynamics dynamicsShape="cubic"
maxLateralAcc="3"/><LaneOffsetTarget><RelativeTargetLaneOffset entityRef="Other" value="{value}"/></LaneOffsetTarget>
</LaneOffsetAction></LateralAction></PrivateAction>"""


@pytest.mark.parametrize(("lane", "end"), [("-1", -1.5), ("1", 1.5)])
def test_a_relative_lane_offset_is_to_the_left_of_whom_it_refers_to(tmp_path, lane, end):
    recording = run(tmp_path, relative_offset(0.5), other_lane=lane)
    assert recording.y[0][-1] == pytest.approx(end)


def change_to(lane, dynamics):
    return f"""<PrivateAction><LateralAction><LaneChangeAction><LaneChangeActionDynamics dynamicsShape="linear" {dynamics}/>
<LaneChangeTarget><AbsoluteTargetLane value="{lane}"/></LaneChangeTarget></LaneChangeAction></LateralAction></PrivateAction>"""


def test_who_moves_only_sideways_goes_on_the_way_that_it_came(tmp_path):
    init = private("Ego", teleport("150", "1"), speed_action("1"))
    events = event("e", change_to(-1, 'dynamicsDimension="time" value="1"'), time_trigger("1"))
    events += event("f", change_to(-1, 'dynamicsDimension="distance" value="5"'), time_trigger("2"))
    path = scenario_file(tmp_path, init=init, story=story_of(events))
    (recording,) = ran(Builtin(time_step=DT, duration=8.0), [ConcreteScenario(path)])
    assert abs(np.sin(recording.heading[0][30])) == pytest.approx(1.0)
    assert recording.x[0][-1] < recording.x[0][30] - 2.0


def test_who_moves_only_sideways_in_a_bend_knows_who_is_ahead(tmp_path):
    keeps = """<PrivateAction><LongitudinalAction><LongitudinalDistanceAction entityRef="Other" freespace="false" distance="10"
continuous="true" coordinateSystem="road"><DynamicConstraints maxAcceleration="0.1" maxDeceleration="0.1"/>
</LongitudinalDistanceAction></LongitudinalAction></PrivateAction>"""
    change = change_to(1, 'dynamicsDimension="time" value="1"')
    init = private("Ego", teleport("133"), speed_action("0.5")) + private("Other", teleport("233"), speed_action("0"))
    story = story_of(event("e", change, time_trigger("1")) + event("f", keeps, time_trigger("1")))
    path = scenario_file(tmp_path, init=init, story=story, entities=car("Ego") + car("Other"))
    write_roads(tmp_path)
    path.write_text(path.read_text().replace("road.xodr", "curve.xodr"))
    (recording,) = ran(Builtin(time_step=DT, duration=8.0), [ConcreteScenario(path)])
    assert np.diff(recording.speed[0]).min() >= 0.0


def test_a_relative_lane_offset_is_to_the_left_along_the_others_own_road_whatever_bend_lies_between(tmp_path):
    init = private("Ego", teleport("75", "1"), speed_action("5")) + private("Other", teleport("330"), speed_action("0"))
    story = story_of(event("e", relative_offset(0.5), time_trigger("1")))
    path = scenario_file(tmp_path, init=init, story=story, entities=car("Ego") + car("Other"))
    write_roads(tmp_path)
    path.write_text(path.read_text().replace("road.xodr", "curve.xodr"))
    (recording,) = ran(Builtin(time_step=DT, duration=10.0), [ConcreteScenario(path)])
    # The road begins at the origin along 0.3 rad; the other one is in the middle of a lane of 3.5 m to its right.
    across = recording.y[0][-1] * np.cos(0.3) - recording.x[0][-1] * np.sin(0.3)
    assert across == pytest.approx(-1.75 + 0.5, abs=1e-3)


def test_a_lateral_distance_springs_back_without_the_other_ones_lane_change(tmp_path):
    # The gap is what a spring of 0.4 times the largest acceleration closes, critically damped, whoever drives beside.
    action = """<PrivateAction><LateralAction><LateralDistanceAction entityRef="Other" distance="2" freespace="false"
continuous="true" coordinateSystem="road" displacement="leftToReferencedEntity"><DynamicConstraints maxAcceleration="5"/>
</LateralDistanceAction></LateralAction></PrivateAction>"""
    recording = run(tmp_path, action)
    assert recording.y[0][-1] == pytest.approx(0.0, abs=0.02)
    assert recording.y[0].max() < 0.05
    assert np.hypot(np.diff(recording.x[0]), np.diff(recording.y[0])) == pytest.approx(10 * DT, rel=1e-3)


def test_an_added_entity_moves_at_once(tmp_path):
    place = '<Position><LanePosition roadId="1" laneId="-1" s="200"/></Position>'
    gone = '<GlobalAction><EntityAction entityRef="Other"><DeleteEntityAction/></EntityAction></GlobalAction>'
    back = f'<GlobalAction><EntityAction entityRef="Other"><AddEntityAction>{place}</AddEntityAction></EntityAction></GlobalAction>'
    events = event("gone", gone, time_trigger("0.975")) + event("back", back, time_trigger("1.975"))
    init = private("Ego", teleport("50"), speed_action("10")) + private("Other", teleport("150"), speed_action("10"))
    path = scenario_file(tmp_path, init=init, story=story_of(events), entities=car("Ego") + car("Other"))
    (recording,) = ran(Builtin(time_step=DT, duration=3.0), [ConcreteScenario(path)])
    there = np.isfinite(recording.x[1])
    assert not there[(recording.time > 1.06) & (recording.time < 1.99)].any()
    first = int(np.argmax(there & (recording.time > 1.5)))
    assert recording.x[1][first] == pytest.approx(200.0 + 10 * DT)


@pytest.mark.parametrize(("heading", "reached"), [(None, True), ("0.04", True), ("0.1", False)])
def test_a_position_with_an_orientation_is_reached_with_that_heading(tmp_path, heading, reached):
    inside = "" if heading is None else f'<Orientation type="relative" h="{heading}"/>'
    stop = f"""<ConditionGroup><Condition name="c" delay="0" conditionEdge="none"><ByEntityCondition>
<TriggeringEntities triggeringEntitiesRule="any"><EntityRef entityRef="Ego"/></TriggeringEntities><EntityCondition>
<ReachPositionCondition tolerance="1"><Position><LanePosition roadId="1" laneId="-1" s="70">{inside}</LanePosition></Position>
</ReachPositionCondition></EntityCondition></ByEntityCondition></Condition></ConditionGroup>"""
    path = scenario_file(tmp_path, init=private("Ego", teleport("50"), speed_action("10")), stop=stop)
    (recording,) = ran(Builtin(time_step=DT, duration=4.0), [ConcreteScenario(path)])
    assert (recording.time[-1] < 3.0) == reached


@pytest.mark.parametrize(("kind", "off"), [("none", True), ("border", False)])
def test_a_lane_of_no_type_is_beside_the_road(tmp_path, kind, off):
    stop = """<ConditionGroup><Condition name="c" delay="0" conditionEdge="none"><ByEntityCondition>
<TriggeringEntities triggeringEntitiesRule="any"><EntityRef entityRef="Ego"/></TriggeringEntities><EntityCondition>
<OffroadCondition duration="0.5"/></EntityCondition></ByEntityCondition></Condition></ConditionGroup>"""
    path = scenario_file(tmp_path, init=private("Ego", teleport("50", "-2"), speed_action("10")), stop=stop)
    lane = f'<lane id="-2" type="{kind}"><width sOffset="0" a="4" b="0" c="0" d="0"/></lane></right>'
    road = path.with_name("road.xodr")
    road.write_text(road.read_text().replace("</right>", lane))
    (recording,) = ran(Builtin(time_step=DT, duration=3.0), [ConcreteScenario(path)])
    assert (recording.time[-1] < 1.0) == off


def lane_offset(value, shape="cubic", most="3"):
    return f"""<PrivateAction><LateralAction><LaneOffsetAction continuous="false"><LaneOffsetActionDynamics
dynamicsShape="{shape}" maxLateralAcc="{most}"/><LaneOffsetTarget><AbsoluteTargetLaneOffset value="{value}"/>
</LaneOffsetTarget></LaneOffsetAction></LateralAction></PrivateAction>"""


def lane_change(lane, time="2", shape="linear"):
    return f"""<PrivateAction><LateralAction><LaneChangeAction><LaneChangeActionDynamics dynamicsShape="{shape}"
dynamicsDimension="time" value="{time}"/><LaneChangeTarget><AbsoluteTargetLane value="{lane}"/></LaneChangeTarget>
</LaneChangeAction></LateralAction></PrivateAction>"""


def alone(folder, *events, s="50", speed="10", duration=8.0):
    path = scenario_file(folder, init=private("Ego", teleport(s), speed_action(speed)), story=story_of("".join(events)))
    (recording,) = ran(Builtin(time_step=DT, duration=duration), [ConcreteScenario(path)])
    return recording


def test_who_stands_and_shifts_goes_on_with_the_speed_of_the_first_shift(tmp_path):
    recording = alone(tmp_path, event("e", lane_offset("1"), time_trigger("1")), speed="0")
    first = int(np.argmax(np.abs(np.diff(recording.y[0])) > 0.0)) + 1
    gone = np.abs(recording.y[0][first] - recording.y[0][first - 1]) / DT
    assert recording.speed[0][first - 1] == 0.0
    assert recording.speed[0][first:] == pytest.approx(gone)
    assert recording.y[0][-1] == pytest.approx(-1.0)
    assert recording.x[0][-1] == pytest.approx(50.0 + gone * DT * (recording.time.size - first - 1))


def test_who_shifts_at_the_end_of_the_road_stops_once_it_is_over(tmp_path):
    recording = alone(tmp_path, event("e", lane_offset("1", most="1"), time_trigger("1")), s="480")
    shifting = np.abs(np.diff(recording.y[0])) > 1e-6
    last = recording.time[1:][shifting][-1]
    assert recording.x[0][-1] == pytest.approx(500.0)
    assert (recording.speed[0][recording.time < last + 0.5 * DT] == 10.0).all()
    assert (recording.speed[0][recording.time > last + 1.5 * DT] == 0.0).all()


@pytest.mark.parametrize(("cut", "end"), [("1.5", -1.5), ("2.5", 2.5)])
def test_a_lane_change_that_is_cut_leaves_the_entity_in_the_lane_where_it_is(tmp_path, cut, end):
    change = event("change", lane_change("1"), time_trigger("1"))
    recording = alone(tmp_path, change, event("cut", lane_offset("0.5"), time_trigger(cut)))
    assert recording.y[0][-1] == pytest.approx(end)


def test_an_offset_into_the_next_lane_leaves_an_entity_on_its_own(tmp_path):
    # The other one drives beside its lane -1, within lane 1; the lane to which one changes is still its own.
    change = """<PrivateAction><LateralAction><LaneChangeAction><LaneChangeActionDynamics dynamicsShape="linear"
dynamicsDimension="time" value="1"/><LaneChangeTarget><RelativeTargetLane entityRef="Other" value="0"/></LaneChangeTarget>
</LaneChangeAction></LateralAction></PrivateAction>"""
    init = private("Ego", teleport("150", "1"), speed_action("10"))
    init += private("Other", teleport("150", "-1"), speed_action("10"))
    story = story_of(event("aside", lane_offset("3.5"), time_trigger("1")), "Other")
    story += story_of(event("change", change, time_trigger("6"))).replace('"s"', '"s2"')
    path = scenario_file(tmp_path, init=init, story=story, entities=car("Ego") + car("Other"))
    (recording,) = ran(Builtin(time_step=DT, duration=8.0), [ConcreteScenario(path)])
    assert recording.y[1][-1] == pytest.approx(1.5)
    assert recording.y[0][-1] == pytest.approx(-2.0)


def test_an_offset_that_is_there_but_for_rounding_takes_no_time(tmp_path):
    def ends(offset):
        done = """<ConditionGroup><Condition name="done" delay="0" conditionEdge="none"><ByValueCondition>
<StoryboardElementStateCondition storyboardElementType="event" storyboardElementRef="e" state="completeState"/>
</ByValueCondition></Condition></ConditionGroup>"""
        story = story_of(event("e", lane_offset(offset), time_trigger("1")))
        path = scenario_file(tmp_path, init=private("Ego", teleport("50"), speed_action("10")), story=story, stop=done)
        (recording,) = ran(Builtin(time_step=DT, duration=20.0), [ConcreteScenario(path)])
        return recording.time[-1]

    assert ends("0.0000001") == ends("0")


def test_a_lane_offset_counts_in_the_step_in_which_its_entity_is_put_somewhere(tmp_path):
    step = lane_offset("0.9", "step")
    recording = alone(tmp_path, event("jump", teleport("100"), time_trigger("1")), event("e", step, time_trigger("1")))
    first = int(np.argmax(recording.x[0] > 90.0))
    assert recording.x[0][first] == pytest.approx(100.0)
    assert recording.y[0][first] == pytest.approx(-1.1)


def test_a_lane_change_ends_where_the_road_does(tmp_path):
    recording = alone(tmp_path, event("e", lane_change("1", time="4"), time_trigger("1")), s="470")
    at_end = recording.x[0] >= 500.0 - 1e-6
    assert recording.y[0][at_end] == pytest.approx(0.0, abs=0.06)
    assert recording.heading[0][at_end] == pytest.approx(np.arcsin(0.1))
    assert recording.speed[0][-1] == 0.0


@pytest.mark.parametrize("curvature", [0.01, -0.01])
@pytest.mark.parametrize("own", ["-1", "1"])
def test_who_is_turned_straight_across_goes_on_the_way_that_it_came(tmp_path, own, curvature):
    # Too slow for the change, it moves only sideways until a lane offset ends that.
    events = event("change", lane_change("1" if own == "-1" else "-1", "1"), time_trigger("1"))
    events += event("cut", lane_offset("0"), time_trigger("2"))
    init = private("Ego", teleport("250", own), speed_action("0.5"))
    path = scenario_file(tmp_path, init=init, story=story_of(events))
    bend = f'<arc curvature="{curvature}"/>'
    (road := tmp_path / "road.xodr").write_text(road.read_text().replace("<line/>", bend))
    (recording,) = ran(Builtin(time_step=DT, duration=8.0), [ConcreteScenario(path)])
    assert np.cos(recording.heading[0][-1] - recording.heading[0][0]) > 0.9
