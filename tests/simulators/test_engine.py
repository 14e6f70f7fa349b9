"""Actions, conditions and positions of the builtin simulator, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from conftest import (
    car,
    event,
    moving,
    place,
    private,
    ran,
    run,
    scenario_file,
    speed_action,
    story_of,
    teleport,
    time_trigger,
    trajectory,
)  # fmt: skip
from cornercase._common.errors import InputError
from cornercase.optimizers import Grid, Sobol
from cornercase.scenario import ConcreteScenario, LogicalScenario
from cornercase.simulators import Builtin, convert

DT = 0.05


def one_event(folder, action, *, at="1", init=None, entities=None, **more):
    return scenario_file(
        folder,
        init=init or moving(),
        story=story_of(event("e", action, time_trigger(at))),
        entities=entities or car("Ego"),
        **more,
    )


def lane_change(target, shape="cubic", value="2", dimension="time"):
    return f"""<PrivateAction><LateralAction><LaneChangeAction><LaneChangeActionDynamics dynamicsShape="{shape}"
dynamicsDimension="{dimension}" value="{value}"/><LaneChangeTarget>{target}</LaneChangeTarget></LaneChangeAction>
</LateralAction></PrivateAction>"""


@pytest.mark.parametrize("shape", ["linear", "cubic", "sinusoidal"])
def test_a_lane_change_takes_its_time_and_costs_way_ahead(tmp_path, shape):
    target = '<RelativeTargetLane entityRef="Ego" value="1"/>'
    recording = run(one_event(tmp_path, lane_change(target, shape)))
    y, way = recording.y[0], np.hypot(np.diff(recording.x[0]), np.diff(recording.y[0]))
    np.testing.assert_allclose(y[recording.time < 1.01], -2.0)
    np.testing.assert_allclose(y[recording.time > 3.06], 2.0, atol=1e-9)
    halfway = np.argmin(np.abs(recording.time - 2.05))
    assert y[halfway] == pytest.approx(0.0, abs=0.2)
    # The speed is that along the path, whichever way it leads.
    np.testing.assert_allclose(way, 10 * DT, rtol=2e-3)
    np.testing.assert_allclose(recording.heading[0][-1], 0.0, atol=1e-9)


def test_actions_after_a_lane_change_see_its_entity_where_it_has_come_to(tmp_path):
    # The distance is 20 m while the other one has not yet moved, which goes 0.5 m in a step.
    change = lane_change('<AbsoluteTargetLane value="1"/>', "linear", "30")
    events = event("change", change, time_trigger("1")) + event("keep", KEPT, time_trigger("1"))
    init = moving("70") + moving("100", "10", "Lead")
    path = scenario_file(tmp_path, init=init, story=story_of(events), entities=car("Ego") + car("Lead"))
    recording = run(path, 15.0)
    assert recording.x[1][-1] - recording.x[0][-1] == pytest.approx(20.5, abs=0.05)


def test_who_stands_looks_along_its_lane_once_it_is_to_change_lanes(tmp_path):
    change = lane_change('<AbsoluteTargetLane value="1"/>')
    aslant = '<LanePosition roadId="1" laneId="-1" s="50"><Orientation type="relative" h="0.3"/></LanePosition>'
    init = moving("50", "0").replace('<LanePosition roadId="1" laneId="-1" s="50"/>', aslant)
    recording = run(one_event(tmp_path, change, init=init), 2.0)
    assert recording.heading[0][0] == pytest.approx(0.3)
    assert recording.heading[0][-1] == pytest.approx(0.0)


def test_a_lane_change_at_the_end_of_the_road_stays_there(tmp_path):
    change = lane_change('<AbsoluteTargetLane value="1"/>', "step", "0")
    recording = run(one_event(tmp_path, change, init=moving("500", "0")), 2.0)
    assert recording.x[0] == pytest.approx(np.full(recording.x[0].size, 500.0))


def test_a_lane_change_over_a_distance_ends_after_it(tmp_path):
    target = '<AbsoluteTargetLane value="1"/>'
    recording = run(one_event(tmp_path, lane_change(target, "linear", "20", "distance")))
    begin = recording.x[0][np.argmax(recording.y[0] > -2 + 1e-6) - 1]
    end = recording.x[0][np.argmax(recording.y[0] > 2 - 1e-6)]
    assert end - begin == pytest.approx(20.0, abs=0.6)


def test_a_lane_offset_has_the_acceleration_that_it_is_allowed(tmp_path):
    # A sinusoidal change by d with the largest acceleration a takes pi * sqrt(d / 2a).
    action = """<PrivateAction><LateralAction><LaneOffsetAction continuous="false"><LaneOffsetActionDynamics
dynamicsShape="sinusoidal" maxLateralAcc="0.5"/><LaneOffsetTarget><AbsoluteTargetLaneOffset value="1"/>
</LaneOffsetTarget></LaneOffsetAction></LateralAction></PrivateAction>"""
    recording = run(one_event(tmp_path, action))
    moving_ = (recording.y[0] > -2 + 1e-6) & (recording.y[0] < -1 - 1e-6)
    assert moving_.sum() * DT == pytest.approx(np.pi * np.sqrt(1.0), abs=2 * DT)
    across = np.diff(recording.y[0], 2) / DT**2
    assert np.abs(across).max() == pytest.approx(0.5, rel=0.05)
    assert recording.y[0][-1] == pytest.approx(-1.0)


KEPT = """<PrivateAction><LongitudinalAction><LongitudinalDistanceAction entityRef="Lead" freespace="false"
continuous="true" distance="20" coordinateSystem="entity" displacement="trailingReferencedEntity"><DynamicConstraints
maxAcceleration="3" maxDeceleration="3" maxSpeed="30"/></LongitudinalDistanceAction></LongitudinalAction></PrivateAction>"""


def test_a_kept_distance_is_reached_without_overshoot(tmp_path):
    init = moving() + moving("100", "10", "Lead")
    recording = run(one_event(tmp_path, KEPT, init=init, entities=car("Ego") + car("Lead")), 25.0)
    gap = recording.x[1] - recording.x[0]
    assert gap[-1] == pytest.approx(20.0, abs=0.05)
    assert gap.min() > 19.9
    assert recording.speed[0][-1] == pytest.approx(10.0, abs=0.02)
    assert np.abs(np.diff(recording.speed[0])).max() <= 3 * DT + 1e-9


def test_a_distance_that_is_kept_rigidly_counts_in_the_step_in_which_its_entity_is_put_somewhere(tmp_path):
    keeps = """<PrivateAction><LongitudinalAction><LongitudinalDistanceAction entityRef="Lead" freespace="false"
continuous="true" distance="20" coordinateSystem="road"/></LongitudinalAction></PrivateAction>"""
    jumps = event("jump", teleport("50"), time_trigger("1")) + event("keep", keeps, time_trigger("1"))
    init = moving("20", "10") + moving("100", "10", "Lead")
    path = scenario_file(tmp_path, init=init, story=story_of(jumps), entities=car("Ego") + car("Lead"))
    recording = run(path, 2.0)
    first = int(np.argmax(recording.x[0] > 60.0))
    assert recording.x[0][first] == pytest.approx(recording.x[1][first - 1] - 20.0)
    assert recording.x[1][first + 1 :] - recording.x[0][first + 1 :] == pytest.approx(20.0)


def profile(entries, mode, jerk="2"):
    points = "".join(f'<SpeedProfileEntry speed="{v}" time="{t}"/>' for v, t in entries)
    return f"""<PrivateAction><LongitudinalAction><SpeedProfileAction followingMode="{mode}"><DynamicConstraints
maxAcceleration="8" maxDeceleration="8" maxAccelerationRate="{jerk}" maxDecelerationRate="{jerk}"/>{points}
</SpeedProfileAction></LongitudinalAction></PrivateAction>"""


def test_a_speed_profile_passes_through_its_points(tmp_path):
    recording = run(one_event(tmp_path, profile([(14, 2), (14, 1), (8, 3)], "position")))
    for time, speed in ((2.0, 12.0), (3.0, 14.0), (4.0, 14.0), (5.5, 11.0), (7.0, 8.0), (9.0, 8.0)):
        assert np.interp(time, recording.time, recording.speed[0]) == pytest.approx(speed, abs=1e-6)


@pytest.mark.parametrize("entries", [[(16, 6)], [(14, 3), (14, 3), (9, 4)]])
def test_a_smooth_speed_profile_keeps_to_its_jerk(tmp_path, entries):
    recording = run(one_event(tmp_path, profile(entries, "follow")), 20.0)
    jerk = np.diff(recording.speed[0], 2) / DT**2
    assert np.abs(jerk).max() <= 2.0 + 1e-6
    assert recording.speed[0][-1] == pytest.approx(entries[-1][0])


def test_a_smooth_speed_profile_goes_along_lines_where_its_jerk_has_no_room(tmp_path):
    # From 4 m/s² to -4 m/s² the jerk takes 4 s, twice as long as there is.
    recording = run(one_event(tmp_path, profile([(14, 1), (10, 1)], "follow")), 8.0)
    assert recording.speed[0][-1] == pytest.approx(10.0)
    assert recording.speed[0].max() == pytest.approx(14.0, abs=0.3)


def test_a_speed_profile_to_the_present_speed_ends_at_once(tmp_path):
    ended = """<ConditionGroup><Condition name="c" delay="0" conditionEdge="none"><ByValueCondition>
<StoryboardElementStateCondition storyboardElementType="event" storyboardElementRef="e" state="completeState"/>
</ByValueCondition></Condition></ConditionGroup>"""
    events = event("e", profile([(10, 5)], "position"), time_trigger("1")) + event("next", speed_action("20"), ended)
    recording = run(scenario_file(tmp_path, init=moving(), story=story_of(events)), 3.0)
    assert recording.speed[0][-1] == 20.0


def synchronise(final):
    return f"""<PrivateAction><SynchronizeAction masterEntityRef="Lead"><TargetPositionMaster><LanePosition roadId="1"
laneId="-1" s="300"/></TargetPositionMaster><TargetPosition><LanePosition roadId="1" laneId="1" s="250"/></TargetPosition>
{final}</SynchronizeAction></PrivateAction>"""


@pytest.mark.parametrize("steady", ['<TargetDistanceSteadyState distance="30"/>', '<TargetTimeSteadyState time="3"/>'])
@pytest.mark.parametrize("start", ["10", "2", "18"])
def test_synchronised_with_a_steady_state(tmp_path, steady, start):
    # The master has 200 m at 20 m/s, so both arrive after 10 s; the other drives against the road, from 400 to 250 m.
    final = f'<FinalSpeed><AbsoluteSpeed value="10">{steady}</AbsoluteSpeed></FinalSpeed>'
    init = moving("400", start, lane="1") + moving("100", "20", "Lead")
    path = one_event(tmp_path, synchronise(final), at="0", init=init, entities=car("Ego") + car("Lead"))
    recording = run(path, 12.0)
    there = np.argmin(np.abs(recording.time - 10.0))
    assert recording.x[0][there] == pytest.approx(250.0, abs=1.0)
    steadily = (recording.time > 7.3) & (recording.time < 11)
    np.testing.assert_allclose(recording.speed[0][steadily], 10.0, atol=0.05)


def test_who_waited_for_its_master_sets_off_with_an_even_acceleration(tmp_path):
    # From 2 s on the master has 200 m at 20 m/s; the other has 150 m, and stands until then.
    sync = event("e", synchronise('<FinalSpeed><AbsoluteSpeed value="10"/></FinalSpeed>'), time_trigger("0"))
    starts = story_of(event("go", speed_action("20"), time_trigger("2")), "Lead").replace('"s"', '"t"', 1)
    init = moving("400", "0", lane="1") + moving("100", "0", "Lead")
    path = scenario_file(tmp_path, init=init, story=story_of(sync) + starts, entities=car("Ego") + car("Lead"))
    recording = run(path, 12.0)
    assert not recording.speed[0][recording.time < 2].any()
    assert np.abs(np.diff(recording.speed[0])).max() < 10 * DT
    assert recording.x[0][np.argmin(np.abs(recording.time - 12.0))] == pytest.approx(250.0, abs=1.0)


def test_who_is_to_meet_a_master_that_is_put_beyond_its_place_stops(tmp_path):
    jumps = story_of(event("jump", teleport("480"), time_trigger("2")), "Lead").replace('"s"', '"t"', 1)
    sync = story_of(event("e", synchronise(""), time_trigger("0")))
    init = moving("400", "10", lane="1") + moving("100", "20", "Lead")
    path = scenario_file(tmp_path, init=init, story=jumps + sync, entities=car("Ego") + car("Lead"))
    recording = run(path, 4.0)
    put = int(np.argmax(recording.x[1] == 480.0))
    assert recording.speed[0][put - 1] > 5.0
    assert not recording.speed[0][put:].any()


def test_a_meeting_is_planned_with_what_the_master_drove_in_the_last_step(tmp_path):
    # The master is stopped in a frame in which it still counts as moving; with the next one, the other waits.
    stops = story_of(event("stop", speed_action("0"), time_trigger("2")), "Lead").replace('"s"', '"t"', 1)
    sync = story_of(event("e", synchronise(""), time_trigger("0")))
    init = moving("400", "10", lane="1") + moving("100", "20", "Lead")
    path = scenario_file(tmp_path, init=init, story=stops + sync, entities=car("Ego") + car("Lead"))
    recording = run(path, 4.0)
    first = int(np.argmax(recording.speed[1] == 0.0))
    assert recording.speed[0][first] > 5.0
    assert not recording.speed[0][first + 1 :].any()


def test_who_follows_a_trajectory_meets_its_master_where_that_comes_nearest_to_its_place(tmp_path):
    # The place is at 250 m, the end of the trajectory at 200 m; the master has 200 m at 20 m/s.
    line = f"<Polyline><Vertex>{place(100, -2)}</Vertex><Vertex>{place(200, -2)}</Vertex></Polyline>"
    events = event("follow", trajectory(line), time_trigger("0")) + event("e", synchronise(""), time_trigger("0"))
    init = moving("100", "10") + moving("100", "20", "Lead")
    path = scenario_file(tmp_path, init=init, story=story_of(events), entities=car("Ego") + car("Lead"))
    recording = run(path, 12.0)
    assert recording.x[0][np.argmin(np.abs(recording.time - 9.5))] == pytest.approx(195.0, abs=8.0)


def test_a_clothoid_spline_ends_where_its_arcs_lead(tmp_path):
    # 20 m straight on, then a quarter of a circle with a radius of 30 m to the left.
    quarter = 0.5 * np.pi * 30
    shape = f"""<ClothoidSpline><ClothoidSplineSegment curvatureStart="0" curvatureEnd="0" length="20"><PositionStart>
<WorldPosition x="50" y="-2" h="0"/></PositionStart></ClothoidSplineSegment><ClothoidSplineSegment
curvatureStart="{1 / 30}" curvatureEnd="{1 / 30}" length="{quarter}"/></ClothoidSpline>"""
    recording = run(one_event(tmp_path, trajectory(shape), at="0"), 8.0)
    k = np.argmin(np.abs(recording.time - (20 + quarter) / 10))
    missing = 20 + quarter - 10 * recording.time[k]
    assert recording.x[0][k] == pytest.approx(100.0, abs=0.1)
    assert recording.y[0][k] == pytest.approx(28.0 - missing, abs=0.1)
    assert recording.heading[0][k] == pytest.approx(0.5 * np.pi, abs=0.02)


def spline(*segments, more=""):
    """A spline whose segments are given by curvature, length, more attributes and where they begin."""
    parts = (
        f'<ClothoidSplineSegment curvatureStart="{bend}" curvatureEnd="{bend}" length="{length}" {own}>'
        + (f'<PositionStart><WorldPosition x="{at[0]}" y="{at[1]}" h="0"/></PositionStart>' if at else "")
        + "</ClothoidSplineSegment>"
        for bend, length, own, at in segments
    )
    return f"<ClothoidSpline {more}>{''.join(parts)}</ClothoidSpline>"


def test_the_segments_of_a_spline_are_travelled_at_their_times(tmp_path):
    # 20 m in 2 s, and 40 m in 8 s; the last 20 m in the 4 s that are left, as no time is said for them.
    shape = spline(
        (0, 20, 'timeStart="0"', (50, -2)), (0, 40, 'timeStart="2"', None), (0, 20, "", None), more='timeEnd="14"'
    )
    reference = '<Timing domainAbsoluteRelative="relative" scale="1" offset="0"/>'
    recording = run(one_event(tmp_path, trajectory(shape, reference), at="0"), 12.0)
    way = np.interp([1.0, 2.0, 6.0, 10.0, 11.0], recording.time, recording.x[0]) - 50.0
    np.testing.assert_allclose(way, [10.0, 20.0, 40.0, 60.0, 65.0], atol=0.5)
    np.testing.assert_allclose(np.interp([1.0, 6.0], recording.time, recording.speed[0]), [10.0, 5.0], atol=1e-6)


def test_a_segment_of_a_spline_turns_by_its_offset(tmp_path):
    shape = spline((0, 20, 'hOffset="0.1"', (50, -2)), (0, 40, 'hOffset="0.3"', None))
    recording = run(one_event(tmp_path, trajectory(shape), at="0"), 5.0)
    x, y = 50 + 20 * np.cos(0.1) + 20 * np.cos(0.4), -2 + 20 * np.sin(0.1) + 20 * np.sin(0.4)
    assert np.interp(4.0, recording.time, recording.x[0]) == pytest.approx(x, abs=1e-6)
    assert np.interp(4.0, recording.time, recording.y[0]) == pytest.approx(y, abs=1e-6)
    assert np.interp(1.0, recording.time, recording.heading[0]) == pytest.approx(0.1)
    assert np.interp(4.0, recording.time, recording.heading[0]) == pytest.approx(0.4)


def test_a_segment_of_a_spline_may_begin_elsewhere(tmp_path):
    shape = spline((0, 20, "", (50, -2)), (0, 40, "", (90, 1)))
    recording = run(one_event(tmp_path, trajectory(shape), at="0"), 5.0)
    assert np.interp(1.5, recording.time, recording.y[0]) == pytest.approx(-2.0)
    assert np.interp(4.0, recording.time, recording.x[0]) == pytest.approx(110.0, abs=1e-6)
    assert np.interp(4.0, recording.time, recording.y[0]) == pytest.approx(1.0, abs=1e-6)


def test_a_clothoid_is_the_fresnel_integral(tmp_path):
    from scipy.integrate import quad

    shape = f'<Clothoid curvature="0" curvatureDot="0.001" length="60">{place(50, -2, "h=" + chr(34) + "0" + chr(34))}</Clothoid>'
    recording = run(one_event(tmp_path, trajectory(shape), at="0"), 5.0)
    x = 50 + quad(lambda s: np.cos(0.0005 * s**2), 0, 40)[0]
    y = -2 + quad(lambda s: np.sin(0.0005 * s**2), 0, 40)[0]
    assert np.interp(4.0, recording.time, recording.x[0]) == pytest.approx(x, abs=1e-3)
    assert np.interp(4.0, recording.time, recording.y[0]) == pytest.approx(y, abs=1e-3)


def test_a_rational_spline_makes_a_circle(tmp_path):
    # Three control points with weights 1, 1/sqrt(2), 1 are a quarter of a circle exactly.
    points = ((90, 0, 1), (90, 40, np.sqrt(0.5)), (50, 40, 1))
    controls = "".join(f'<ControlPoint weight="{w}" time="0">{place(x, y)}</ControlPoint>' for x, y, w in points)
    knots = "".join(f'<Knot value="{k}"/>' for k in (0, 0, 0, 1, 1, 1))
    recording = run(one_event(tmp_path, trajectory(f'<Nurbs order="3">{controls}{knots}</Nurbs>'), at="0"), 5.0)
    radius = np.hypot(recording.x[0] - 50, recording.y[0])[2:]
    np.testing.assert_allclose(radius, 40.0, atol=1e-3)


@pytest.mark.parametrize(("mode", "half"), [("position", 20.0), ("follow", 20.0)])
def test_a_timed_polyline_is_at_its_vertices_in_time(tmp_path, mode, half):
    vertices = "".join(f'<Vertex time="{t}">{place(x, -2)}</Vertex>' for t, x in ((0, 50), (2, 70), (4, 110)))
    timing = '<Timing domainAbsoluteRelative="relative" scale="1" offset="0"/>'
    recording = run(one_event(tmp_path, trajectory(f"<Polyline>{vertices}</Polyline>", timing, mode), at="0"), 5.0)
    for t, x in ((2, 70), (4, 110)):
        assert np.interp(t, recording.time, recording.x[0]) == pytest.approx(x, abs=1e-6)
    assert np.interp(3.9, recording.time, recording.speed[0]) == pytest.approx(
        20.0 if mode == "position" else 30, abs=1.6
    )


def test_a_closed_polyline_goes_round(tmp_path):
    corners = "".join(f"<Vertex>{place(x, y)}</Vertex>" for x, y in ((50, 0), (60, 0), (60, 10), (50, 10)))
    recording = run(one_event(tmp_path, trajectory(f"<Polyline>{corners}</Polyline>", closed="true"), at="0"), 9.0)
    again = np.interp(8.0, recording.time, recording.x[0]), np.interp(8.0, recording.time, recording.y[0])
    assert again == pytest.approx((50.0, 0.0), abs=1e-6)


def variable_action(inner):
    return f'<GlobalAction><VariableAction variableRef="v">{inner}</VariableAction></GlobalAction>'


def variable_trigger(value, rule="equalTo"):
    return f"""<ConditionGroup><Condition name="c" delay="0" conditionEdge="none"><ByValueCondition><VariableCondition
variableRef="v" value="{value}" rule="{rule}"/></ByValueCondition></Condition></ConditionGroup>"""


def test_variables_are_set_and_modified(tmp_path):
    events = (
        event("set", variable_action('<SetAction value="3"/>'), time_trigger("1"))
        + event(
            "double",
            variable_action('<ModifyAction><Rule><MultiplyByValue value="2"/></Rule></ModifyAction>'),
            time_trigger("2"),
        )
        + event("go", speed_action("20"), variable_trigger("6"))
    )
    path = scenario_file(tmp_path, init=moving(), story=story_of(events))
    text = path.read_text().replace(
        "<CatalogLocations/>",
        '<VariableDeclarations><VariableDeclaration name="v" variableType="double" value="0"/></VariableDeclarations><CatalogLocations/>',
    )
    path.write_text(text)
    recording = run(path, 4.0)
    first = recording.time[np.argmax(recording.speed[0] > 15)]
    assert 2.0 < first <= 2.2


def test_catalogs_hold_vehicles_and_maneuvers_with_parameters(tmp_path):
    (tmp_path / "catalogs").mkdir()
    head = '<FileHeader revMajor="1" revMinor="2" date="2026-01-01T00:00:00" author="a" description="d"/>'
    vehicle = (
        car("x")
        .split("<Vehicle", 1)[1]
        .split("</Vehicle>")[0]
        .replace('name="car"', 'name="long"', 1)
        .replace('length="4"', 'length="12"')
    )
    maneuver = f"""<Maneuver name="faster"><ParameterDeclarations><ParameterDeclaration name="to" parameterType="double"
value="1"/></ParameterDeclarations>{event("f", speed_action("$to"), time_trigger("1"))}</Maneuver>"""
    for name, body in (("V", f"<Vehicle{vehicle}</Vehicle>"), ("M", maneuver)):
        (tmp_path / "catalogs" / f"{name}.xosc").write_text(
            f'<OpenSCENARIO>{head}<Catalog name="{name}">{body}</Catalog></OpenSCENARIO>'
        )
    entity = '<ScenarioObject name="Ego"><CatalogReference catalogName="V" entryName="long"/></ScenarioObject>'
    reference = """<CatalogReference catalogName="M" entryName="faster"><ParameterAssignments><ParameterAssignment
parameterRef="to" value="${5*5}"/></ParameterAssignments></CatalogReference>"""
    story = story_of("").replace('<Maneuver name="m"></Maneuver>', reference)
    path = scenario_file(tmp_path, init=moving(), story=story, entities=entity)
    path.write_text(
        path.read_text().replace(
            "<CatalogLocations/>",
            '<CatalogLocations><VehicleCatalog><Directory path="catalogs"/></VehicleCatalog></CatalogLocations>',
        )
    )
    recording = run(path, 3.0)
    assert recording.length[0] == 12
    assert recording.speed[0][-1] == 25
    # As OpenSCENARIO 1.0 it all stands in one file, which may lie anywhere.
    convert(path, tmp_path / "elsewhere" / "one.xosc", ego="Ego")
    again = run(tmp_path / "elsewhere" / "one.xosc", 3.0)
    assert again.length[0] == 12
    np.testing.assert_allclose(again.x[0], recording.x[0], atol=25 * 0.1)


def test_a_deleted_entity_is_gone(tmp_path):
    action = '<GlobalAction><EntityAction entityRef="Lead"><DeleteEntityAction/></EntityAction></GlobalAction>'
    init = moving() + moving("100", "10", "Lead")
    recording = run(one_event(tmp_path, action, init=init, entities=car("Ego") + car("Lead")), 3.0)
    assert np.isfinite(recording.x[1][recording.time < 1]).all()
    assert np.isnan(recording.x[1][recording.time > 1.2]).all()


def by_entity(condition, entity="Ego"):
    return f"""<ConditionGroup><Condition name="c" delay="0" conditionEdge="none"><ByEntityCondition><TriggeringEntities
triggeringEntitiesRule="any"><EntityRef entityRef="{entity}"/></TriggeringEntities><EntityCondition>{condition}
</EntityCondition></ByEntityCondition></Condition></ConditionGroup>"""


# Ego at 50 m with 10 m/s and 4 m long, 1.4 m of its box's centre ahead of the reference point; Lead at 150 m with 5 m/s.
CONDITIONS = {
    "headway": ('<TimeHeadwayCondition entityRef="Lead" value="5" freespace="false" rule="lessThan"/>', (100 - 50) / 5),
    "headway between boxes": (
        '<TimeHeadwayCondition entityRef="Lead" value="5" freespace="true" coordinateSystem="entity" relativeDistanceType="longitudinal" rule="lessThan"/>',
        (100 - 4 - 50) / 5,
    ),
    "time to collision": (
        """<TimeToCollisionCondition value="10" freespace="true" coordinateSystem="entity" relativeDistanceType="longitudinal"
rule="lessThan"><TimeToCollisionConditionTarget><EntityRef entityRef="Lead"/></TimeToCollisionConditionTarget></TimeToCollisionCondition>""",
        (100 - 4) / 5 - 10,
    ),
    "distance along the road": (
        '<RelativeDistanceCondition entityRef="Lead" value="60" freespace="false" coordinateSystem="road" relativeDistanceType="longitudinal" rule="lessThan"/>',
        (100 - 60) / 5,
    ),
    "distance to a place": (
        """<DistanceCondition value="30" freespace="false" rule="lessThan"><Position><LanePosition roadId="1" laneId="-1"
s="160"/></Position></DistanceCondition>""",
        (110 - 30) / 10,
    ),
    "relative clearance": (
        """<RelativeClearanceCondition distanceForward="200" distanceBackward="30" freeSpace="false" oppositeLanes="false">
<RelativeLaneRange from="0" to="0"/></RelativeClearanceCondition>""",
        None,
    ),
    "travelled": ('<TraveledDistanceCondition value="35"/>', 3.5),
    "angle": ('<AngleCondition angleType="heading" angle="0" angleTolerance="0.01"/>', 0.0),
}


@pytest.mark.parametrize("name", CONDITIONS)
def test_conditions_between_entities(tmp_path, name):
    condition, expected = CONDITIONS[name]
    story = story_of(event("e", speed_action("33"), by_entity(condition)))
    init = moving() + moving("150", "5", "Lead")
    recording = run(scenario_file(tmp_path, init=init, story=story, entities=car("Ego") + car("Lead")), 15.0)
    fast = recording.speed[0] > 30
    if expected is None:
        assert not fast.any()
    else:
        # Seen in the frame after the instant at which it holds.
        assert recording.time[np.argmax(fast)] == pytest.approx(expected + DT, abs=DT + 1e-9)


@pytest.mark.parametrize(("system", "beside"), [("road", True), ("entity", False)])
def test_a_place_further_along_the_road_lies_beside_who_stands_across_it(tmp_path, system, beside):
    across = """<PrivateAction><TeleportAction><Position><LanePosition roadId="1" laneId="-1" s="100"><Orientation type="relative"
h="1.5"/></LanePosition></Position></TeleportAction></PrivateAction>"""
    condition = f"""<DistanceCondition value="1" freespace="false" rule="lessThan" relativeDistanceType="lateral"
coordinateSystem="{system}"><Position><LanePosition roadId="1" laneId="-1" s="160"/></Position></DistanceCondition>"""
    story = story_of(event("e", speed_action("33"), by_entity(condition, "Lead")))
    init = moving() + private("Lead", across)
    recording = run(scenario_file(tmp_path, init=init, story=story, entities=car("Ego") + car("Lead")), 1.0)
    assert (recording.speed[0][-1] > 30) == beside


@pytest.mark.parametrize("system", ["trajectory", "world"])
def test_a_distance_along_what_is_not_measured_is_refused(tmp_path, system):
    condition = f"""<RelativeDistanceCondition entityRef="Lead" value="60" freespace="false" coordinateSystem="{system}"
relativeDistanceType="longitudinal" rule="lessThan"/>"""
    story = story_of(event("e", speed_action("33"), by_entity(condition)))
    init = moving() + moving("150", "5", "Lead")
    with pytest.raises(InputError, match=f"longitudinal distance in the system '{system}' cannot be measured"):
        run(scenario_file(tmp_path, init=init, story=story, entities=car("Ego") + car("Lead")), 1.0)


def test_a_group_runs_as_often_as_it_says(tmp_path):
    add = variable_action('<ModifyAction><Rule><AddValue value="1"/></Rule></ModifyAction>')
    story = story_of(f'<Event name="e" priority="parallel"><Action name="a">{add}</Action></Event>')
    story = story.replace(
        '<ManeuverGroup name="g" maximumExecutionCount="1">', '<ManeuverGroup name="g" maximumExecutionCount="3">'
    )
    story += story_of(event("go", speed_action("20"), variable_trigger("3"))).replace('name="s"', 'name="t"')
    story += story_of(event("too far", speed_action("30"), variable_trigger("4"))).replace('name="s"', 'name="u"')
    path = scenario_file(tmp_path, init=moving(), story=story)
    declared = (
        '<VariableDeclarations><VariableDeclaration name="v" variableType="double" value="0"/></VariableDeclarations>'
    )
    path.write_text(path.read_text().replace("<CatalogLocations/>", f"{declared}<CatalogLocations/>"))
    recording = run(path, 2.0)
    assert recording.speed[0][-1] == 20


CONSTRAINT = """<ParameterDeclaration name="v" parameterType="double" value="10"><ConstraintGroup><ValueConstraint
rule="lessThan" value="12"/></ConstraintGroup><ConstraintGroup><ValueConstraint rule="greaterThan" value="18"/>
<ValueConstraint rule="lessOrEqual" value="20"/></ConstraintGroup></ParameterDeclaration>"""


def test_constraints_are_kept_by_searches_and_by_the_simulator(tmp_path):
    path = scenario_file(tmp_path, init=moving(speed="$v"), parameters=CONSTRAINT)
    logical = LogicalScenario.read(path, ranges=["v=5:25"])
    for optimizer in (Sobol().start(logical.space, 0), Grid().start(logical.space, 0, budget=60)):
        found = np.array([one["v"] for one in logical.space.values(optimizer.ask(40))])
        assert len(found) > 10
        assert ((found < 12) | ((found > 18) & (found <= 20))).all()
        assert (found > 18).any()
    (result,) = Builtin().run([logical.concrete_scenario({"v": 15.0})])
    assert "v breaks a constraint" in str(result)
    with pytest.raises(InputError, match="constraints"):
        LogicalScenario.read(path, ranges=["v=21:25"])


VALUE_SETS = """<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="2026-01-01T00:00:00" author="a" description="d"/>
<ParameterValueDistribution><ScenarioFile filepath="scenario.xosc"/><Deterministic><DeterministicMultiParameterDistribution>
<ValueSetDistribution><ParameterValueSet><ParameterAssignment parameterRef="v" value="5"/><ParameterAssignment
parameterRef="w" value="${2*3}"/></ParameterValueSet><ParameterValueSet><ParameterAssignment parameterRef="w" value="9"/>
<ParameterAssignment parameterRef="v" value="8"/></ParameterValueSet></ValueSetDistribution>
</DeterministicMultiParameterDistribution></Deterministic></ParameterValueDistribution></OpenSCENARIO>"""


def test_values_of_a_set_stay_together(tmp_path):
    declared = "".join(f'<ParameterDeclaration name="{n}" parameterType="double" value="1"/>' for n in "vw")
    story = story_of(event("e", speed_action("$w"), time_trigger("1")))
    scenario_file(tmp_path, init=moving(speed="$v"), story=story, parameters=declared)
    (tmp_path / "space.xosc").write_text(VALUE_SETS)
    logical = LogicalScenario.read(None, tmp_path / "space.xosc")
    assert logical.space.size == 2
    recordings = ran(
        Builtin(duration=2.0),
        [logical.concrete_scenario(v) for v in logical.space.values(logical.space.full_factorial())],
    )
    assert {(r.speed[0][1], r.speed[0][-1]) for r in recordings} == {(5.0, 6.0), (8.0, 9.0)}
    again = type(logical.space).from_json(logical.space.to_json())
    assert again.values(again.full_factorial()) == logical.space.values(logical.space.full_factorial())
    ranged = LogicalScenario.read(None, tmp_path / "space.xosc", ["v=1:2"])
    assert sorted(ranged.space.assigned_names) == ["v", "w"]
    assert all(1 <= float(one["v"]) <= 2 for one in ranged.space.values(Sobol().start(ranged.space, 0).ask(5)))


@pytest.mark.parametrize("batch", [1, 7])
def test_many_scenarios_at_once_are_what_each_is_alone(tmp_path, batch):
    declared = '<ParameterDeclaration name="v" parameterType="double" value="1"/>'
    target = '<RelativeTargetLane entityRef="Ego" value="1"/>'
    events = event("change", lane_change(target, value="${20/$v}"), time_trigger("${$v/10}")) + event(
        "follow",
        trajectory(f"<Polyline><Vertex>{place('${200+$v}', 2)}</Vertex><Vertex>{place(260, 9)}</Vertex></Polyline>"),
        time_trigger("8"),
    )
    path = scenario_file(tmp_path, init=moving(speed="$v"), story=story_of(events), parameters=declared)
    concretes = [ConcreteScenario(path, {"v": float(v)}) for v in np.linspace(5, 20, 7)]
    whole = ran(Builtin(duration=12.0), concretes)
    for k in range(0, 7, batch):
        for one, alone in zip(whole[k : k + batch], ran(Builtin(duration=12.0), concretes[k : k + batch]), strict=True):
            np.testing.assert_array_equal(one.x, alone.x)
            np.testing.assert_array_equal(one.y, alone.y)
            np.testing.assert_array_equal(one.heading, alone.heading)


def test_who_triggers_an_event_can_be_its_actor(tmp_path):
    """A is the first to have gone 20 m, so it speeds up; B and C do not, D does because it is named."""
    who = "".join(f'<EntityRef entityRef="{name}"/>' for name in "ABC")
    past = f"""<ConditionGroup><Condition name="c" delay="0" conditionEdge="none"><ByEntityCondition>
<TriggeringEntities triggeringEntitiesRule="any">{who}</TriggeringEntities><EntityCondition>
<TraveledDistanceCondition value="20"/></EntityCondition></ByEntityCondition></Condition></ConditionGroup>"""
    starts = "".join(
        f'<Private entityRef="{name}">{teleport(str(10 + 60 * k))}{speed_action(speed)}</Private>'
        for k, (name, speed) in enumerate({"A": "10", "B": "9.9", "C": "1", "D": "5"}.items())
    )
    story = story_of(event("e", speed_action("15"), past), actor="D").replace(
        'selectTriggeringEntities="false"', 'selectTriggeringEntities="true"'
    )
    path = scenario_file(
        tmp_path, init=starts, story=story, stop=time_trigger("4"), entities="".join(car(name) for name in "ABCD")
    )
    (recording,) = ran(Builtin(), [ConcreteScenario(path)])
    speeds = dict(zip(recording.names, recording.speed[:, -1], strict=True))
    assert speeds == {"A": 15.0, "B": 9.9, "C": 1.0, "D": 15.0}


@pytest.mark.parametrize("others", ["", by_entity('<TraveledDistanceCondition value="1"/>', "Lead")])
def test_nobody_triggers_an_event_by_a_condition_that_was_never_evaluated(tmp_path, others):
    """Of the first group, only the time is evaluated; the second one starts the event for `Lead`, if at all."""
    never = time_trigger("100") + by_entity('<TraveledDistanceCondition value="1"/>', "Lead")
    soon = time_trigger("0.5") + others
    trigger = "".join(group.replace("</ConditionGroup><ConditionGroup>", "") for group in (never, soon))
    story = story_of(event("e", speed_action("5"), trigger)).replace(
        'selectTriggeringEntities="false"', 'selectTriggeringEntities="true"'
    )
    init = moving() + moving("100", entity="Lead")
    path = scenario_file(tmp_path, init=init, story=story, entities=car("Ego") + car("Lead"))
    for recording in ran(Builtin(duration=1.0), [ConcreteScenario(path), ConcreteScenario(path)]):
        assert recording.speed[:, -1].tolist() == [5.0, 5.0 if others else 10.0]


@pytest.mark.parametrize("outer_first", [True, False])
def test_a_selection_may_contain_another_one(tmp_path, outer_first):
    selections = [
        f'<EntitySelection name="{name}"><Members>{members}</Members></EntitySelection>'
        for name, members in (
            ("outer", '<EntityRef entityRef="inner"/>'),
            ("inner", '<EntityRef entityRef="A"/><EntityRef entityRef="B"/>'),
        )
    ]
    entities = "".join([car("A"), car("B"), car("C"), *(selections if outer_first else selections[::-1])])
    init = "".join(moving(str(10 + 60 * k), entity=name) for k, name in enumerate("ABC"))
    story = story_of(event("e", speed_action("15"), time_trigger("0.5")), actor="outer")
    recording = run(scenario_file(tmp_path, init=init, story=story, entities=entities), 1.0)
    assert recording.speed[:, -1].tolist() == [15.0, 15.0, 10.0]


def test_a_selection_that_contains_itself_is_refused(tmp_path):
    selections = "".join(
        f'<EntitySelection name="{name}"><Members><EntityRef entityRef="{member}"/></Members></EntitySelection>'
        for name, member in (("near", "far"), ("far", "near"))
    )
    path = scenario_file(tmp_path, init=moving(), entities=car("Ego") + selections)
    with pytest.raises(InputError, match=r"scenario\.xosc, line \d+: <EntitySelection>: 'near' contains itself, or"):
        run(path)
