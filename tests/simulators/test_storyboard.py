"""What happens when, in a storyboard: states of elements, priorities, delays, and actions that take over.

Each expected time and speed follows from the rule that the test names; esmini 3.6.0 gives the same.
"""

from __future__ import annotations

import numpy as np
import pytest

import cornercase as cc
from conftest import car, event, scenario_file, speed_action, story_of, teleport, time_trigger
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin
from helpers.random_storyboards import write_roads

DT = 0.05


def run(path, duration=10.0):
    (result,) = Builtin(time_step=DT, duration=duration).run([ConcreteScenario(path, {})])
    assert not isinstance(result, Exception), result
    return result


def placed(entity="Ego", s="50", speed="10", lane="-1"):
    return f'<Private entityRef="{entity}">{teleport(s, lane)}{speed_action(speed)}</Private>'


def of_speed(recording, time, entity=0):
    """Speed at an instant."""
    return recording.speed[entity][round(time / DT)]


def file(folder, *events, init=None, entities=None):
    return scenario_file(
        folder, init=init or placed(), story=story_of("".join(events)), entities=entities or car("Ego")
    )


def repeated(name, action, trigger, priority="parallel", times="2"):
    once = event(name, action, trigger, priority)
    return once.replace('maximumExecutionCount="1"', f'maximumExecutionCount="{times}"')


def group(*conditions):
    """One condition group of the conditions of several."""
    return "".join(conditions).replace("</ConditionGroup><ConditionGroup>", "")


def state(name, value, edge="none", kind="event"):
    return f"""<ConditionGroup><Condition name="c" delay="0" conditionEdge="{edge}"><ByValueCondition>
<StoryboardElementStateCondition storyboardElementType="{kind}" storyboardElementRef="{name}" state="{value}"/>
</ByValueCondition></Condition></ConditionGroup>"""


def of_entity(condition, entity="Ego"):
    return f"""<ConditionGroup><Condition name="c" delay="0" conditionEdge="none"><ByEntityCondition><TriggeringEntities
triggeringEntitiesRule="any"><EntityRef entityRef="{entity}"/></TriggeringEntities><EntityCondition>{condition}
</EntityCondition></ByEntityCondition></Condition></ConditionGroup>"""


def relative_speed(value, other="Ego", shape="step", dimension="time", over="0"):
    return f"""<PrivateAction><LongitudinalAction><SpeedAction>
<SpeedActionDynamics dynamicsShape="{shape}" dynamicsDimension="{dimension}" value="{over}"/>
<SpeedActionTarget><RelativeTargetSpeed entityRef="{other}" value="{value}" speedTargetValueType="delta"
continuous="false"/></SpeedActionTarget></SpeedAction></LongitudinalAction></PrivateAction>"""


def keep_distance(limits, other="Lead", more='continuous="true"'):
    return f"""<PrivateAction><LongitudinalAction><LongitudinalDistanceAction entityRef="{other}" distance="20"
freespace="false" {more}><DynamicConstraints {limits}/></LongitudinalDistanceAction></LongitudinalAction></PrivateAction>"""


@pytest.fixture
def curve(tmp_path):
    """Put a curved road where `file` looks for the road."""

    def write(*arguments, **options):
        path = file(tmp_path, *arguments, **options)
        write_roads(tmp_path)
        (tmp_path / "curve.xodr").replace(tmp_path / "road.xodr")
        return path

    return write


def lane_change(lane="1", dimension="distance", value="30", shape="linear"):
    return f"""<PrivateAction><LateralAction><LaneChangeAction><LaneChangeActionDynamics dynamicsShape="{shape}"
dynamicsDimension="{dimension}" value="{value}"/><LaneChangeTarget><AbsoluteTargetLane value="{lane}"/></LaneChangeTarget>
</LaneChangeAction></LateralAction></PrivateAction>"""


def trajectory(*places, lane="-1"):
    vertices = "".join(
        f'<Vertex time="0"><Position><LanePosition roadId="1" laneId="{lane}" s="{s}" offset="0"/></Position></Vertex>'
        for s in places
    )
    return f"""<PrivateAction><RoutingAction><FollowTrajectoryAction><TrajectoryRef><Trajectory name="t" closed="false"><Shape>
<Polyline>{vertices}</Polyline></Shape></Trajectory></TrajectoryRef><TimeReference><None/></TimeReference>
<TrajectoryFollowingMode followingMode="position"/></FollowTrajectoryAction></RoutingAction></PrivateAction>"""


SLOWLY = speed_action("20", "linear", "time", "2")


def test_an_event_that_is_skipped_waits_on(tmp_path):
    # The first runs from 1 s to 3 s; skipped until then, the second starts one frame later.
    first = event("first", SLOWLY, time_trigger("1"))
    second = event("second", speed_action("5"), time_trigger("1.5"), "skip")
    recording = run(file(tmp_path, first, second))
    assert of_speed(recording, 3.0) == pytest.approx(20.0)
    assert of_speed(recording, 3.05) == pytest.approx(5.0)


def test_an_event_that_is_overwritten_may_run_again(tmp_path):
    # It is to run twice. Overwritten at 2 s it has run once, and its condition still holds.
    first = repeated("first", speed_action("20", "linear", "time", "4"), time_trigger("1"))
    second = event("second", speed_action("5"), time_trigger("2"), "overwrite")
    recording = run(file(tmp_path, first, second))
    assert of_speed(recording, 2.05) == pytest.approx(5.0)
    # From the next frame on it takes its 4 s again.
    assert of_speed(recording, 6.0) == pytest.approx(20.0 - 15.0 / 80)
    assert of_speed(recording, 6.05) == pytest.approx(20.0)


def test_a_delay_begins_anew_with_each_repetition(tmp_path):
    # Fires a second after 1 s, and again a second after the first run has ended and been evaluated anew.
    path = file(tmp_path, repeated("e", relative_speed("5"), time_trigger("1", delay="1")))
    recording = run(path)
    changes = recording.time[1:][np.diff(recording.speed[0]) > 1.0]
    np.testing.assert_allclose(changes, [2.05, 3.1], atol=1e-9)


def test_an_action_that_takes_over_ends_the_other_in_the_same_frame(tmp_path):
    first = event("first", SLOWLY, time_trigger("1"))
    second = event("second", speed_action("5"), time_trigger("2"))
    third = event("third", speed_action("8"), state("first", "endTransition"))
    recording = run(file(tmp_path, first, second, third))
    assert of_speed(recording, 2.0) == pytest.approx(15.0)
    assert of_speed(recording, 2.05) == pytest.approx(8.0)


@pytest.mark.parametrize("value", ["startTransition", "endTransition", "runningState"])
def test_what_became_of_an_element_is_seen_at_the_next_evaluation(tmp_path, value):
    # The second condition is not evaluated before the first holds, and then sees all that was since the last time.
    first = event("first", speed_action("20"), time_trigger("1"))
    second = event("second", speed_action("5"), group(time_trigger("3"), state("first", value)))
    recording = run(file(tmp_path, first, second))
    assert of_speed(recording, 3.0) == pytest.approx(20.0)
    assert of_speed(recording, 3.05) == pytest.approx(5.0)


def test_what_became_of_an_element_before_an_event_is_to_run_again_is_not_seen(tmp_path):
    # The second sees the first run at 1 s, and not that it has ended, before it is to run again.
    first = event("first", speed_action("20"), time_trigger("1"))
    again = repeated("again", speed_action("25"), state("first", "runningState"))
    then = event("then", speed_action("8"), state("again", "completeState"))
    recording = run(file(tmp_path, first, again, then))
    assert list(dict.fromkeys(recording.speed[0])) == [10.0, 25.0, 8.0]


def test_a_state_is_seen_while_it_lasts(tmp_path):
    first = event("first", SLOWLY, time_trigger("1"))
    late = event("late", speed_action("5"), group(time_trigger("5"), state("first", "completeState")))
    recording = run(file(tmp_path, first, late))
    assert of_speed(recording, 5.05) == pytest.approx(5.0)


def test_an_event_ends_with_the_last_of_its_actions(tmp_path):
    # An action of another event takes over the speed, so that only the lane offset runs on.
    offset = """<PrivateAction><LateralAction><LaneOffsetAction continuous="false"><LaneOffsetActionDynamics
dynamicsShape="cubic" maxLateralAcc="1.5"/><LaneOffsetTarget><AbsoluteTargetLaneOffset value="1"/></LaneOffsetTarget>
</LaneOffsetAction></LateralAction></PrivateAction>"""
    first = event("first", SLOWLY, time_trigger("1"))
    first = first.replace("</Action>", f'</Action><Action name="across">{offset}</Action>')
    second = event("second", speed_action("5"), time_trigger("1.5"))
    third = event("third", speed_action("8"), state("first", "completeState"))
    recording = run(file(tmp_path, first, second, third))
    # The offset takes sqrt(6 * 1 / 1.5) = 2 s from the frame after 1 s on, is set then, and is seen a frame later.
    assert of_speed(recording, 3.05) == pytest.approx(5.0)
    assert of_speed(recording, 3.1) == pytest.approx(8.0)


def test_a_teleport_ends_what_changes_the_speed(tmp_path):
    first = event("first", SLOWLY, time_trigger("1"))
    second = event("second", teleport("150"), time_trigger("2"))
    recording = run(file(tmp_path, first, second))
    np.testing.assert_allclose(recording.speed[0][recording.time > 2.01], 15.0)


def test_a_lane_change_moves_in_the_frame_of_a_teleport(tmp_path):
    change = """<PrivateAction><LateralAction><LaneChangeAction><LaneChangeActionDynamics dynamicsShape="cubic"
dynamicsDimension="time" value="2"/><LaneChangeTarget><AbsoluteTargetLane value="1"/></LaneChangeTarget>
</LaneChangeAction></LateralAction></PrivateAction>"""
    both = event("e", teleport("150"), time_trigger("1"))
    both = both.replace("</Action>", f'</Action><Action name="change">{change}</Action>')
    recording = run(file(tmp_path, both))
    assert recording.x[0][round(1.05 / DT)] == pytest.approx(150.5)


def test_a_teleport_in_the_second_frame_stays_there_for_it(tmp_path):
    # The first frame takes no time: the second begins at 0 s too, and is as long as all others.
    again = repeated("e", teleport("150"), time_trigger("5", "lessThan"))
    recording = run(file(tmp_path, again))
    np.testing.assert_allclose(recording.x[0][:3], [150.0, 150.0, 150.5])


def test_a_lane_change_over_a_distance_is_steered_alike_backwards(tmp_path):
    change = event("e", lane_change(), time_trigger("1"))
    ahead = run(file(tmp_path, change))
    back = run(file(tmp_path, change, init=placed(s="200", speed="-10")))
    at = round(2.0 / DT)
    assert ahead.heading[0][at] > 0.05
    assert back.heading[0][at] == pytest.approx(ahead.heading[0][at])
    assert back.x[0][at] < 200.0


def test_after_a_trajectory_an_entity_keeps_its_angle_to_the_road(curve):
    # It ends on the bend, where its last leg is a chord.
    recording = run(curve(event("e", trajectory(100, 150, 200), time_trigger("0"))), 20.0)
    gone = np.arctan2(np.diff(recording.y[0]), np.diff(recording.x[0]))
    after = recording.time[1:] > 11.0
    apart = (recording.heading[0][1:] - gone)[after]
    assert np.ptp(gone[after]) > 0.5
    assert np.ptp(apart) < 0.01


def test_a_meeting_is_planned_along_the_reference_line(curve):
    # On the bend of radius 100 m the master drives 1.75 m further out, but the way to its place is that of the road.
    master = 200.0 + 10.0 / 1.0175
    mine = 16.0 + 6.0 * (300.0 - master) / 10.0
    meet = f"""<PrivateAction><SynchronizeAction masterEntityRef="Lead"><TargetPositionMaster><LanePosition roadId="1"
laneId="-1" s="300" offset="0"/></TargetPositionMaster><TargetPosition><LanePosition roadId="1" laneId="-1" s="{mine}"
offset="0"/></TargetPosition></SynchronizeAction></PrivateAction>"""
    init = placed("Ego", "10", "6") + placed("Lead", "200", "10")
    recording = run(curve(event("e", meet, time_trigger("1")), init=init, entities=car("Ego") + car("Lead")), 2.0)
    assert of_speed(recording, 1.05) == pytest.approx(6.0, abs=1e-4)


def test_nobody_stands_before_the_first_frame_that_takes_time(tmp_path):
    go = event("e", speed_action("5"), of_entity('<StandStillCondition duration="0.3"/>'))
    recording = run(file(tmp_path, go, init=placed(speed="0")))
    assert of_speed(recording, 0.4) == 0.0
    assert of_speed(recording, 0.45) == pytest.approx(5.0)


def test_a_rate_holds_while_the_speed_to_reach_changes(tmp_path):
    # 2 m/s² from 10 m/s on, wherever the other one's speed, which grows to 25 m/s, has got to.
    faster = speed_action("25", "linear", "time", "4")
    lead = placed("Lead", "90", "15").replace("</Private>", f"{faster}</Private>")
    follow = event("e", relative_speed("0", "Lead", "linear", "rate", "2"), time_trigger("1"))
    path = file(tmp_path, follow, init=placed() + lead, entities=car("Ego") + car("Lead"))
    recording = run(path)
    for time in (2.0, 4.0, 8.0):
        assert of_speed(recording, time) == pytest.approx(10.0 + 2.0 * (time - 1.0), abs=1e-6)
    assert of_speed(recording, 9.5) == pytest.approx(25.0)


def test_a_distance_is_kept_behind_unless_the_file_says_otherwise(tmp_path):
    # It starts ahead of the other, and falls behind.
    init = placed("Ego", "100") + placed("Lead", "80")
    keep = event("e", keep_distance('maxAcceleration="3" maxDeceleration="3" maxSpeed="30"'), time_trigger("1"))
    recording = run(file(tmp_path, keep, init=init, entities=car("Ego") + car("Lead")), 30.0)
    assert recording.x[1][-1] - recording.x[0][-1] == pytest.approx(20.0, abs=0.1)


@pytest.mark.parametrize("limits", ['maxAcceleration="3"', 'maxDeceleration="3"', 'maxSpeed="30"', ""])
def test_a_limit_that_is_missing_is_the_vehicles_own(tmp_path, limits):
    given = {name.split("=")[0]: name for name in limits.split()}
    own = {"maxAcceleration": "200", "maxDeceleration": "200", "maxSpeed": "60"}
    spelt = " ".join(given.get(name, f'{name}="{value}"') for name, value in own.items())
    init = placed() + placed("Lead", "100")
    recordings = []
    for k, text in enumerate((limits, spelt)):
        keep = event("e", keep_distance(text), time_trigger("1"))
        (tmp_path / str(k)).mkdir()
        recordings.append(run(file(tmp_path / str(k), keep, init=init, entities=car("Ego") + car("Lead"))))
    assert np.isfinite(recordings[0].x).all()
    np.testing.assert_allclose(recordings[0].speed[0], recordings[1].speed[0], atol=1e-9)
    assert recordings[0].x[1][-1] - recordings[0].x[0][-1] == pytest.approx(20.0, abs=1.0)


def test_a_limit_above_the_vehicles_own_does_not_count(tmp_path):
    slow = car("Ego").replace('maxAcceleration="200"', 'maxAcceleration="2"')
    keep = event("e", keep_distance('maxAcceleration="6" maxDeceleration="6"'), time_trigger("1"))
    recording = run(file(tmp_path, keep, init=placed() + placed("Lead", "150"), entities=slow + car("Lead")))
    assert np.diff(recording.speed[0]).max() == pytest.approx(2.0 * DT)


@pytest.mark.parametrize("free", ["true", "false"])
def test_there_is_no_headway_to_what_is_behind(tmp_path, free):
    headway = f'<TimeHeadwayCondition entityRef="Lead" value="9" rule="lessThan" freespace="{free}"/>'
    trigger = group(time_trigger("1"), of_entity(headway))
    for s, speed in (("80", 20.0), ("20", 10.0)):
        path = file(
            tmp_path,
            event("e", speed_action("20"), trigger),
            init=placed() + placed("Lead", s),
            entities=car("Ego") + car("Lead"),
        )
        assert of_speed(run(path), 2.0) == pytest.approx(speed)


@pytest.mark.parametrize(("value", "speed"), [("1.4", 10.0), ("1.6", 20.0)])
def test_what_comes_from_behind_collides_too(tmp_path, value, speed):
    # 25 m behind when the condition is first asked at 1 s, and 16 m/s faster.
    collides = f"""<TimeToCollisionCondition value="{value}" rule="lessThan" freespace="false">
<TimeToCollisionConditionTarget><EntityRef entityRef="Lead"/></TimeToCollisionConditionTarget></TimeToCollisionCondition>"""
    trigger = group(time_trigger("1"), time_trigger("1.01", "lessThan"), of_entity(collides))
    path = file(
        tmp_path,
        event("e", speed_action("20"), trigger),
        init=placed("Ego", "100") + placed("Lead", "59", "26"),
        entities=car("Ego") + car("Lead"),
    )
    assert of_speed(run(path, 2.0), 1.5) == pytest.approx(speed)


def test_time_to_collision_is_of_the_motion_before_the_frame(tmp_path):
    # The first event sets a speed at 1 s that the second sees in the next frame.
    collides = """<TimeToCollisionCondition value="3" rule="lessThan" freespace="false">
<TimeToCollisionConditionTarget><EntityRef entityRef="Lead"/></TimeToCollisionConditionTarget></TimeToCollisionCondition>"""
    first = event("first", speed_action("30"), time_trigger("1"))
    second = event("second", speed_action("15"), of_entity(collides))
    path = file(
        tmp_path, first, second, init=placed() + placed("Lead", "90", "10.5"), entities=car("Ego") + car("Lead")
    )
    recording = run(path)
    assert of_speed(recording, 1.05) == pytest.approx(30.0)
    assert of_speed(recording, 1.1) == pytest.approx(15.0)


def test_who_overlaps_from_the_start_collides_in_the_first_frame(tmp_path):
    collides = '<CollisionCondition><EntityRef entityRef="Lead"/></CollisionCondition>'
    then = event("then", speed_action("20"), of_entity(collides))
    path = file(tmp_path, then, init=placed() + placed("Lead", "52"), entities=car("Ego") + car("Lead"))
    recording = run(path)
    assert recording.speed[0][0] == 20.0
    assert [collision.time for collision in recording.collisions] == [0.0]


@pytest.mark.parametrize(("rule", "speed"), [("greaterThan", 4.0), ("lessThan", 20.0)])
def test_braking_is_a_negative_acceleration(tmp_path, rule, speed):
    brake = event("brake", speed_action("4", "linear", "rate", "3"), time_trigger("1"))
    condition = f'<AccelerationCondition value="{"2" if rule == "greaterThan" else "-2"}" rule="{rule}"/>'
    then = event("then", speed_action("20"), of_entity(condition))
    assert of_speed(run(file(tmp_path, brake, then)), 5.0) == pytest.approx(speed)


def test_a_storyboard_that_stops_in_the_first_frame_does_nothing(tmp_path):
    story = story_of(event("e", teleport("150"), time_trigger("0")))
    path = scenario_file(tmp_path, init=placed(), story=story, stop=time_trigger("0"))
    recording = run(path)
    np.testing.assert_allclose(recording.x[0], [50.0])


def test_an_offset_from_another_lies_to_the_left_as_that_one_looks(tmp_path):
    # The other one comes towards it in the lane to the left, 4 m away; its left is the right here.
    offset = """<PrivateAction><LateralAction><LaneOffsetAction continuous="false"><LaneOffsetActionDynamics
dynamicsShape="step"/><LaneOffsetTarget><RelativeTargetLaneOffset entityRef="Lead" value="1"/></LaneOffsetTarget>
</LaneOffsetAction></LateralAction></PrivateAction>"""
    init = placed() + placed("Lead", "300", "10", "1")
    path = file(tmp_path, event("e", offset, time_trigger("1")), init=init, entities=car("Ego") + car("Lead"))
    recording = run(path, 2.0)
    assert recording.y[0][-1] == pytest.approx(2.0 - 1.0)


@pytest.mark.parametrize("system", ["road", "lane"])
@pytest.mark.parametrize(("value", "speed"), [("49", 0.0), ("50.5", 5.0)])
def test_a_distance_along_a_road_is_that_of_its_reference_line(tmp_path, system, value, speed):
    # On the bend to the left, the way along the right lane is 50.9 m.
    distance = f"""<RelativeDistanceCondition entityRef="Lead" value="{value}" rule="lessThan" freespace="false"
coordinateSystem="{system}" relativeDistanceType="longitudinal"/>"""
    path = file(
        tmp_path,
        event("e", speed_action("5"), group(time_trigger("1"), of_entity(distance))),
        init=placed("Ego", "200", "0") + placed("Lead", "250", "0"),
        entities=car("Ego") + car("Lead"),
    )
    write_roads(tmp_path)
    (tmp_path / "curve.xodr").replace(tmp_path / "road.xodr")
    assert of_speed(run(path, 2.0), 1.5) == pytest.approx(speed)


def test_standing_as_long_as_asked_for_counts_by_the_clocks_rounding(tmp_path):
    # Ten steps after 0.65 s, the sum of steps of 0.05 s is a little more than 0.5 s later.
    stop = event("stop", speed_action("0"), time_trigger("0.6"))
    again = event("again", speed_action("5"), of_entity('<StandStillCondition duration="0.5"/>'))
    recording = run(file(tmp_path, stop, again), 3.0)
    assert of_speed(recording, 1.15) == 0.0
    assert of_speed(recording, 1.2) == pytest.approx(5.0)


def test_a_lane_change_of_who_stands_lets_it_stand_for_the_frame(tmp_path):
    # The lane change comes first in the frame, and moves the car with the speed that it has then.
    change = """<PrivateAction><LateralAction><LaneChangeAction><LaneChangeActionDynamics dynamicsShape="cubic"
dynamicsDimension="time" value="5"/><LaneChangeTarget><AbsoluteTargetLane value="1"/></LaneChangeTarget>
</LaneChangeAction></LateralAction></PrivateAction>"""
    both = event("e", change, time_trigger("1"))
    both = both.replace("</Action>", f'</Action><Action name="go">{SLOWLY}</Action>')
    recording = run(file(tmp_path, both, init=placed(speed="0")))
    assert of_speed(recording, 1.05) > 0.0
    assert recording.x[0][round(1.05 / DT)] == pytest.approx(50.0)
    assert recording.x[0][round(1.1 / DT)] > 50.0


@pytest.mark.parametrize("times", ["0", "-3"])
def test_an_event_that_may_never_run_is_refused(tmp_path, times):
    path = file(tmp_path, repeated("e", speed_action("5"), time_trigger("1"), times=times))
    with pytest.raises(cc.InputError, match=rf"maximumExecutionCount .*is {times}; it has to be at least 1"):
        run(path)


def test_a_delay_below_0_costs_the_scenario(tmp_path):
    path = file(tmp_path, event("e", speed_action("5"), time_trigger("1", delay="-2")))
    (result,) = Builtin(time_step=DT, duration=2.0).run([ConcreteScenario(path, {})])
    assert isinstance(result, cc.SimulationError)
    assert "delay of <Condition> is below 0" in str(result)
