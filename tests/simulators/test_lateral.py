"""Offsets and distances across the road, and entities that come and go."""

from __future__ import annotations

import numpy as np
import pytest

from conftest import car, event, ran, scenario_file, speed_action, story_of, teleport, time_trigger
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import BuiltinSimulator

DT = 0.05


def private(entity, *actions):
    return f'<Private entityRef="{entity}">{"".join(actions)}</Private>'


def run(folder, action, *, other_lane="-1", duration=8.0, actor="Ego", at="1"):
    init = private("Ego", teleport("50"), speed_action("10"))
    init += private("Other", teleport("150", other_lane), speed_action("10"))
    story = story_of(event("e", action, time_trigger(at)), actor)
    path = scenario_file(folder, init=init, story=story, entities=car("Ego") + car("Other"))
    (recording,) = ran(BuiltinSimulator(time_step=DT, duration=duration), [ConcreteScenario(path)])
    return recording


def relative_offset(value):
    return f"""<PrivateAction><LateralAction><LaneOffsetAction continuous="false"><LaneOffsetActionDynamics dynamicsShape="cubic"
maxLateralAcc="3"/><LaneOffsetTarget><RelativeTargetLaneOffset entityRef="Other" value="{value}"/></LaneOffsetTarget>
</LaneOffsetAction></LateralAction></PrivateAction>"""


@pytest.mark.parametrize(("lane", "end"), [("-1", -1.5), ("1", 1.5)])
def test_a_relative_lane_offset_is_to_the_left_of_whom_it_refers_to(tmp_path, lane, end):
    recording = run(tmp_path, relative_offset(0.5), other_lane=lane)
    assert recording.y[0][-1] == pytest.approx(end)


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
    (recording,) = ran(BuiltinSimulator(time_step=DT, duration=3.0), [ConcreteScenario(path)])
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
    (recording,) = ran(BuiltinSimulator(time_step=DT, duration=4.0), [ConcreteScenario(path)])
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
    (recording,) = ran(BuiltinSimulator(time_step=DT, duration=3.0), [ConcreteScenario(path)])
    assert (recording.time[-1] < 1.0) == off
