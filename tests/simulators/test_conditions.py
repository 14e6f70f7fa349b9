"""When conditions on entities become true, to the frame; esmini gives the same."""

from __future__ import annotations

import numpy as np
import pytest

from conftest import car, event, scenario_file, speed_action, story_of, teleport, time_trigger
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin

DT = 0.05


def run(path, duration=2.0):
    (result,) = Builtin(time_step=DT, duration=duration).run([ConcreteScenario(path, {})])
    assert not isinstance(result, Exception), result
    return result


def placed(entity="Ego", s="50", speed="10", lane="-1"):
    return f'<Private entityRef="{entity}">{teleport(s, lane)}{speed_action(speed)}</Private>'


def of_entity(condition, entity="Ego"):
    return f"""<ConditionGroup><Condition name="c" delay="0" conditionEdge="none"><ByEntityCondition><TriggeringEntities
triggeringEntitiesRule="any"><EntityRef entityRef="{entity}"/></TriggeringEntities><EntityCondition>{condition}
</EntityCondition></ByEntityCondition></Condition></ConditionGroup>"""


@pytest.mark.parametrize("lane", ["-1", "1"])
@pytest.mark.parametrize(
    ("kind", "nearest"),
    [
        # Of the lane to the left, the box looks this way: its front, not its rear, is 43.2 m ahead.
        ("longitudinal", {"-1": 46.0, "1": 43.2}),
        ("lateral", {"-1": 0.0, "1": 2.0}),
    ],
)
def test_free_space_along_a_road_is_between_the_boxes_as_they_stand(tmp_path, lane, kind, nearest):
    for more, speed in ((0.05, 5.0), (-0.05, 0.0)):
        value = nearest[lane] + more
        distance = f"""<RelativeDistanceCondition entityRef="Lead" value="{value}" rule="lessThan" freespace="true"
coordinateSystem="road" relativeDistanceType="{kind}"/>"""
        path = scenario_file(
            tmp_path,
            init=placed(speed="0") + placed("Lead", "100", "0", lane),
            story=story_of(event("e", speed_action("5"), of_entity(distance))),
            entities=car("Ego") + car("Lead"),
        )
        assert run(path).speed[0][-1] == pytest.approx(speed)


@pytest.mark.parametrize(("jump", "condition"), [
    ("250", '<RelativeDistanceCondition entityRef="Lead" value="20" rule="greaterThan" freespace="true" '
            'coordinateSystem="entity" relativeDistanceType="euclidianDistance"/>'),
    ("102", '<CollisionCondition><EntityRef entityRef="Lead"/></CollisionCondition>'),
])  # fmt: skip
def test_boxes_overlap_as_they_stand_where_one_was_moved_earlier_in_the_step(tmp_path, jump, condition):
    path = scenario_file(
        tmp_path,
        init=placed(speed="0", s="102" if jump == "250" else "50") + placed("Lead", "100", "0"),
        story=story_of(
            event("e", teleport(jump), time_trigger("1")) + event("f", speed_action("5"), of_entity(condition))
        ),
        entities=car("Ego") + car("Lead"),
    )
    recording = run(path)
    moved = int(np.argmax(np.abs(np.diff(recording.x[0])) > 1.0)) + 1
    assert recording.speed[0][moved - 1 : moved + 1] == pytest.approx([0.0, 5.0])


def test_there_is_no_free_space_along_a_road_to_what_is_abreast(tmp_path):
    distance = """<RelativeDistanceCondition entityRef="Lead" value="0" rule="equalTo" freespace="true"
coordinateSystem="road" relativeDistanceType="longitudinal"/>"""
    path = scenario_file(
        tmp_path,
        init=placed(speed="0") + placed("Lead", "53", "0", "1"),
        story=story_of(event("e", speed_action("5"), of_entity(distance))),
        entities=car("Ego") + car("Lead"),
    )
    assert run(path).speed[0][-1] == pytest.approx(5.0)


@pytest.mark.parametrize(("value", "speed"), [("19.5", 0.0), ("19.7", 5.0)])
def test_free_space_to_a_place_begins_at_the_box_as_it_stands(tmp_path, value, speed):
    # The car drives down the road: its front is 3.4 m further down than its reference point.
    distance = f"""<DistanceCondition value="{value}" rule="lessThan" freespace="true" coordinateSystem="road"
relativeDistanceType="longitudinal"><Position><LanePosition roadId="1" laneId="1" s="77"/></Position></DistanceCondition>"""
    path = scenario_file(
        tmp_path,
        init=placed(s="100", speed="0", lane="1"),
        story=story_of(event("e", speed_action("5"), of_entity(distance))),
    )
    assert run(path).speed[0][-1] == pytest.approx(speed)


def test_a_teleport_in_the_first_step_stays_where_it_leads_for_the_step(tmp_path):
    # The event runs in the first frame, in which nothing moves, and again in the next.
    again = event("e", teleport("100"), time_trigger("0")).replace(
        'maximumExecutionCount="1"', 'maximumExecutionCount="2"'
    )
    recording = run(scenario_file(tmp_path, init=placed(), story=story_of(again)))
    np.testing.assert_allclose(recording.x[0][:4], [100.0, 100.0, 100.5, 101.0])


def test_a_road_has_ended_since_the_row_in_which_the_entity_is_at_its_end(tmp_path):
    # From 1.2 m before it, it is there after the third step, at 0.15 s; the next row shows what that starts.
    ended = of_entity('<EndOfRoadCondition duration="0.1"/>')
    path = scenario_file(tmp_path, init=placed(s="498.8"), story=story_of(event("e", teleport("50"), ended)))
    recording = run(path)
    assert recording.x[0][round(0.25 / DT)] == pytest.approx(500.0)
    assert recording.x[0][round(0.3 / DT)] == pytest.approx(50.0)


def test_who_stands_from_the_start_stands_since_the_first_step(tmp_path):
    # At 0.3 s it has stood for 0.25 s, and the next row shows what that starts.
    stands = of_entity('<StandStillCondition duration="0.22"/>')
    path = scenario_file(tmp_path, init=placed(speed="0"), story=story_of(event("e", teleport("100"), stands)))
    recording = run(path)
    assert recording.x[0][round(0.3 / DT)] == pytest.approx(50.0)
    assert recording.x[0][round(0.35 / DT)] == pytest.approx(100.0)


def test_a_lateral_distance_on_a_road_is_across_the_road_for_who_follows_a_trajectory(tmp_path):
    # From the middle of lane -1 at 50 m straight to the middle of lane 1 at 90 m: 3 m across after 30 m and 3 s.
    vertices = "".join(
        f'<Vertex time="0"><Position><LanePosition roadId="1" laneId="{lane}" s="{s}"/></Position></Vertex>'
        for lane, s in (("-1", "50"), ("1", "90"))
    )
    follow = f"""<PrivateAction><RoutingAction><FollowTrajectoryAction><TrajectoryRef><Trajectory name="t" closed="false">
<Shape><Polyline>{vertices}</Polyline></Shape></Trajectory></TrajectoryRef><TimeReference><None/></TimeReference>
<TrajectoryFollowingMode followingMode="follow"/></FollowTrajectoryAction></RoutingAction></PrivateAction>"""
    distance = """<RelativeDistanceCondition entityRef="Lead" value="3" rule="greaterThan" freespace="false"
coordinateSystem="lane" relativeDistanceType="lateral"/>"""
    events = event("follow", follow, time_trigger("0")) + event("e", speed_action("5"), of_entity(distance))
    path = scenario_file(
        tmp_path,
        init=placed() + placed("Lead", "150", "10"),
        story=story_of(events),
        entities=car("Ego") + car("Lead"),
    )
    recording = run(path, 4.0)
    assert recording.time[np.argmax(recording.speed[0] < 10)] == pytest.approx(3.05, abs=0.06)
