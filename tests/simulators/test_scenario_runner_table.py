"""Handling of OpenSCENARIO for ScenarioRunner, according to the support table."""

from __future__ import annotations

import ast
import importlib.util
import json
import os
import re
import sys
from dataclasses import replace
from importlib import resources
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from conftest import AXLES, at_night
from cornercase._common.errors import InputError
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._xml import read_xml
from cornercase.simulators import Carla, convert, simulate
from cornercase.simulators.carla._controller_assignment import TRAJECTORY_FILE, DrivingAgents
from cornercase.simulators.carla._openscenario_1_0 import ConversionOptions, write_openscenario_1_0
from cornercase.simulators.carla._run_scenario_file import write_run_scenario
from cornercase.simulators.carla._runner_environment import RunnerEnvironment
from cornercase.simulators.carla._support_table import VERSIONS, HandlingStatus, find_support_row, load_support_table
from helpers.xml_schemas import Schema

pytest.importorskip("qc_openscenario", reason="the schema comes with the extra 'validate'")

REFERENCE = Path(__file__).parents[3] / "shared" / "reference"
ROAD = Path(__file__).parents[2] / "examples" / "t_intersection" / "t_intersection.xodr"
LIMITS = (0.25, 0.05, 0.25, 0.15)


def test_the_table_knows_every_element_and_attribute_of_the_schema():
    def ends(path):
        row = find_support_row(path)
        return row is not None and row.status not in (HandlingStatus.EXECUTED, HandlingStatus.APPROXIMATE)

    with resources.as_file(resources.files("qc_openscenario") / "schema" / "1.3.0" / "OpenSCENARIO.xsd") as schema:
        places = Schema(schema).places("OpenSCENARIO", ends=ends)
    gaps = [path for path in places if find_support_row(path) is None]
    gaps += [
        (*path, name)
        for path, attributes in places.items()
        for name in attributes
        if not ends(path) and find_support_row(path, name, "any other value") is None
    ]
    assert gaps == []
    assert len(places) > 200


def test_the_table_says_why():
    rows = [row for of in load_support_table().values() for row in of]
    assert len(rows) > 200
    assert [row for row in rows if not row.note and row.status is not HandlingStatus.EXECUTED] == []


FOLDER = os.environ.get("CORNERCASE_SCENARIO_RUNNER", "")
SOURCES = (
    "srunner/tools/openscenario_parser.py",
    "srunner/scenarioconfigs/openscenario_configuration.py",
    "srunner/scenarios/open_scenario.py",
)
# What the source names, but only to stop at it or without looking at it.
STOPS_AT = {
    "RoutePosition": VERSIONS, "UserDefinedValueCondition": VERSIONS, "VisibilityAction": VERSIONS,
    "AssignRouteAction": VERSIONS, "AcquirePositionAction": VERSIONS, "FollowTrajectoryAction": ("0.9.13",),
    "TrafficSignalControllerCondition": ("0.9.13",),
}  # fmt: skip


def names_in(source):
    """Names of elements and attributes that a source asks for."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        parts = []
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            parts = node.args if node.func.attr in ("find", "findall", "iterfind", "iter", "get") else []
        elif isinstance(node, ast.Compare):
            parts = [node.left, *node.comparators]
        elif isinstance(node, ast.Subscript):
            parts = [node.slice]
        texts = (one.value for part in parts for one in ast.walk(part) if isinstance(one, ast.Constant))
        names |= {name for text in texts if isinstance(text, str) for name in re.split(r"[./]+", text)}
    return names


@pytest.mark.skipif(not FOLDER, reason="CORNERCASE_SCENARIO_RUNNER is not set")
def test_the_columns_of_versions_are_what_the_sources_say():
    version = RunnerEnvironment.find(FOLDER, "", "").version
    assert version in VERSIONS
    names = set().union(*(names_in((Path(FOLDER) / source).read_text()) for source in SOURCES))
    rows = [row for of in load_support_table().values() for row in of if not row.attribute]
    wrong = []
    for row in rows:
        name = row.element.rpartition("/")[2]
        stops = version in STOPS_AT.get(name, ())
        if name != "OpenSCENARIO" and (version in row.versions) != (name in names and not stops):
            wrong.append(row.element)
    assert wrong == []


def test_what_a_version_lacks_is_named_before_the_run(write, tmp_path, monkeypatch):
    path = write()
    late = find_support_row(("SpeedAction",))
    assert late is not None
    newer = replace(late, versions=("0.9.15", "0.9.16"))
    monkeypatch.setitem(load_support_table(), ("SpeedAction", ""), (newer,))
    scenario, run = ScenarioFile.read(path), ConversionOptions(is_run=True)
    for version in ("0.9.15", ""):
        write_run_scenario(scenario, {}, tmp_path / "one.xosc", ego="Ego", options=run, version=version)
    needs = r"ScenarioRunner 0\.9\.13 has no <SpeedAction>; use 0\.9\.15 or 0\.9\.16\."
    with pytest.raises(InputError, match=needs):
        write_run_scenario(scenario, {}, tmp_path / "one.xosc", ego="Ego", options=run, version="0.9.13")


def test_a_converted_file_says_which_version_it_needs(write, tmp_path):
    needs = "ScenarioRunner 0.9.13 has no <FollowTrajectoryAction>; use 0.9.15 or 0.9.16."
    assert needs in convert(write(action=OFFSET), tmp_path / "one.xosc", ego="Ego").notes
    assert needs not in convert(write(), tmp_path / "two.xosc", ego="Ego").notes
    # In a run, the controller has the trajectory.
    scenario, run = ScenarioFile.read(write(action=OFFSET)), ConversionOptions(is_run=True)
    write_run_scenario(scenario, {}, tmp_path / "three.xosc", ego="Ego", options=run, version="0.9.13")


@pytest.mark.parametrize(
    ("number", "written"), [("1e1", "10"), ("8E-1", "0.8"), ("+7", "7"), (".5", "0.5"), ("8.", "8.")]
)
def test_numbers_are_written_as_every_version_reads_them(write, tmp_path, number, written):
    found = convert(write(action=speed(target=number)), tmp_path / "one.xosc", ego="Ego")
    assert written in [one.get("value") for one in read_xml(found.path).iter("AbsoluteTargetSpeed")]


def car(name):
    return f"""<ScenarioObject name="{name}"><Vehicle name="car" vehicleCategory="car"><ParameterDeclarations/>
<Performance maxSpeed="60" maxAcceleration="9" maxDeceleration="9"/><BoundingBox><Center x="1.4" y="0" z="0.7"/>
<Dimensions length="4" width="2" height="1.5"/></BoundingBox><Axles>{AXLES}</Axles><Properties/></Vehicle>
</ScenarioObject>"""


def start(name, s, speed, more=""):
    return f"""<Private entityRef="{name}"><PrivateAction><TeleportAction><Position><LanePosition roadId="1" laneId="-1"
s="{s}"/></Position></TeleportAction></PrivateAction><PrivateAction><LongitudinalAction><SpeedAction><SpeedActionDynamics
dynamicsShape="step" dynamicsDimension="time" value="0"/><SpeedActionTarget><AbsoluteTargetSpeed value="{speed}"/>
</SpeedActionTarget></SpeedAction></LongitudinalAction></PrivateAction>{more}</Private>"""


def speed(shape="step", dimension="time", value=0, target=6):
    return f"""<LongitudinalAction><SpeedAction><SpeedActionDynamics dynamicsShape="{shape}" dynamicsDimension="{dimension}"
value="{value}"/><SpeedActionTarget><AbsoluteTargetSpeed value="{target}"/></SpeedActionTarget></SpeedAction>
</LongitudinalAction>"""


def when(inner='<SimulationTimeCondition value="1" rule="greaterThan"/>', edge="none", delay=0):
    return f"""<Condition name="when" delay="{delay}" conditionEdge="{edge}"><ByValueCondition>{inner}</ByValueCondition>
</Condition>"""


def by_entity(inner, entities=("Ego",), rule="any"):
    members = "".join(f'<EntityRef entityRef="{name}"/>' for name in entities)
    return f"""<Condition name="when" delay="0" conditionEdge="none"><ByEntityCondition><TriggeringEntities
triggeringEntitiesRule="{rule}">{members}</TriggeringEntities><EntityCondition>{inner}</EntityCondition></ByEntityCondition>
</Condition>"""


@pytest.fixture
def write(tmp_path):
    """Write a scenario in which the car Other acts ahead of the car Ego."""

    def written(action=speed(), condition=when(), event="", group="", init="", drivers=""):  # noqa: B008 - texts
        path = tmp_path / "scenario.xosc"
        path.write_text(f"""<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="2026-11-21T00:00:00" author=""
description=""/><CatalogLocations/><RoadNetwork><LogicFile filepath="road.xodr"/></RoadNetwork><Entities>
{car("Ego").replace("</ScenarioObject>", drivers + "</ScenarioObject>")}{
            car("Other")
        }</Entities><Storyboard><Init><Actions>
{start("Ego", 5, 8)}{start("Other", 30, 8, init)}</Actions></Init><Story name="s"><Act name="a"><ManeuverGroup name="g"
maximumExecutionCount="1" {group}><Actors selectTriggeringEntities="false"><EntityRef entityRef="Other"/></Actors>
<Maneuver name="m"><Event name="e" priority="overwrite" {event}><Action name="does"><PrivateAction>{
            action
        }</PrivateAction>
</Action><StartTrigger><ConditionGroup>{condition}</ConditionGroup></StartTrigger></Event></Maneuver></ManeuverGroup>
<StartTrigger/></Act></Story><StopTrigger><ConditionGroup>{
            when('<SimulationTimeCondition value="4" rule="greaterThan"/>')
        }</ConditionGroup></StopTrigger></Storyboard></OpenSCENARIO>""")
        text = path.read_text()
        for twice in ("maximumExecutionCount", "priority"):
            for before in ('maximumExecutionCount="1" ', 'priority="overwrite" '):
                if f"{before}{twice}=" in text:
                    text = text.replace(f"{before}{twice}=", f"{twice}=")
        path.write_text(text)
        (tmp_path / "road.xodr").write_bytes(ROAD.read_bytes())
        return path

    return written


def apart(one, other):
    """Largest differences of two recordings in position, heading and speed, and of their ends."""
    spec = importlib.util.spec_from_file_location("compare_recordings", REFERENCE / "compare_recordings.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)

    def tracks(recording):
        found = {}
        for k, name in enumerate(recording.names):
            values = (recording.x[k], recording.y[k], recording.heading[k], recording.speed[k])
            rows = np.stack([recording.time, *values], axis=1)
            found[name] = [list(row) for row in rows if np.isfinite(row[1])]
        return {name: track for name, track in found.items() if track}

    return dict(module.compare(tracks(one), tracks(other)))


def test_what_scenario_runner_does_stays_as_it_is(write, tmp_path):
    found = convert(write(), tmp_path / "out" / "one.xosc", ego="Ego")
    assert not [note for note in found.notes if "trajectory" in note]
    assert read_xml(found.path).find(".//FollowTrajectoryAction") is None
    before, after = simulate(write()), simulate(found.path)
    np.testing.assert_allclose(after.x, before.x, atol=1e-3)


VERTICES = """<RoutingAction><FollowTrajectoryAction><Trajectory name="t" closed="false"><Shape><Polyline><Vertex time="0">
<Position><LanePosition roadId="1" laneId="-1" s="30"/></Position></Vertex><Vertex time="0"><Position><LanePosition
roadId="1" laneId="-1" s="70"/></Position></Vertex></Polyline></Shape></Trajectory><TimeReference><None/></TimeReference>
<TrajectoryFollowingMode followingMode="position"/></FollowTrajectoryAction></RoutingAction>"""
POSITION = '<Position><LanePosition roadId="1" laneId="-1" s="80"/></Position>'
ROUTE = f"""<RoutingAction><AssignRouteAction><Route name="r" closed="false"><Waypoint routeStrategy="shortest">{POSITION}
</Waypoint><Waypoint routeStrategy="shortest">{POSITION.replace("80", "90")}</Waypoint></Route></AssignRouteAction>
</RoutingAction>"""
ACQUIRE = f"<RoutingAction><AcquirePositionAction>{POSITION}</AcquirePositionAction></RoutingAction>"
LANE = """<LateralAction><LaneChangeAction><LaneChangeActionDynamics dynamicsShape="sinusoidal" dynamicsDimension="time"
value="2"/><LaneChangeTarget>{}</LaneChangeTarget></LaneChangeAction></LateralAction>"""
OFFSET = """<LateralAction><LaneOffsetAction continuous="false"><LaneOffsetActionDynamics dynamicsShape="sinusoidal"
maxLateralAcc="1"/><LaneOffsetTarget><AbsoluteTargetLaneOffset value="0.5"/></LaneOffsetTarget></LaneOffsetAction>
</LateralAction>"""
NEAR = (
    '<RelativeDistanceCondition entityRef="Ego" relativeDistanceType="{}" value="27" freespace="{}" rule="lessThan"/>'
)
REACHED = f'<ReachPositionCondition tolerance="1">{POSITION.replace("80", "40")}</ReachPositionCondition>'
TURNED = REACHED.replace('"/></P', '"><Orientation type="relative" h="3.14"/></LanePosition></P')
FLAGS = 'freespace="false" alongRoute="false"'


def relative_speed(value, kind="delta"):
    relative = f'RelativeTargetSpeed entityRef="Ego" speedTargetValueType="{kind}" continuous="false"'
    return speed(target=value).replace("AbsoluteTargetSpeed", relative)


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"condition": when(edge="falling")}, "conditionEdge 'falling'"),
        ({"condition": when(edge="rising")}, "conditionEdge 'rising'"),
        ({"condition": when(delay=0.5)}, "delay '0.5'"),
        ({"event": 'priority="skip"'}, "priority 'skip'"),
        ({"event": 'priority="override" maximumExecutionCount="2"'}, "maximumExecutionCount '2' of <Event>"),
        ({"group": 'maximumExecutionCount="2"'}, "maximumExecutionCount '2' of <ManeuverGroup>"),
        (
            {"condition": by_entity('<SpeedCondition value="5" rule="greaterThan"/>', ("Ego", "Other"), "all")},
            "last entity only",
        ),
        ({"action": speed("linear", "rate", 2)}, "dynamicsShape 'linear'"),
        ({"action": speed("sinusoidal", "time", 2)}, "dynamicsShape 'sinusoidal'"),
        ({"action": LANE.format('<RelativeTargetLane entityRef="Other" value="1"/>')}, "<LaneChangeAction>"),
        ({"action": LANE.format('<AbsoluteTargetLane value="1"/>')}, "<LaneChangeAction>"),
        ({"action": OFFSET}, "mirrored on right lanes"),
        ({"action": VERTICES}, "<FollowTrajectoryAction>"),
        ({"action": ROUTE}, "<AssignRouteAction>"),
        ({"action": ACQUIRE}, "<AcquirePositionAction>"),
        ({"init": f"<PrivateAction>{ROUTE}</PrivateAction>"}, "<AssignRouteAction>"),
        ({"init": f"<PrivateAction>{ACQUIRE}</PrivateAction>"}, "<AcquirePositionAction>"),
        ({"condition": by_entity(NEAR.format("longitudinal", "false"))}, "relativeDistanceType 'longitudinal'"),
        ({"condition": by_entity(NEAR.format("cartesianDistance", "true"))}, "freespace 'true'"),
        ({"condition": when() + by_entity('<SpeedCondition value="5" rule="greaterThan"/>')}, "at some time"),
        (
            {"condition": by_entity('<TimeHeadwayCondition entityRef="Other" value="3.2" freespace="false" '
                                    'alongRoute="false" rule="lessThan"/>')},
            "<TimeHeadwayCondition>",
        ),
        ({"condition": by_entity(REACHED, ("Other",))}, "<ReachPositionCondition>: ScenarioRunner measures from the"),
        ({"condition": by_entity(TURNED, ("Other",))}, "<Orientation>: ScenarioRunner compares distances only"),
        *(
            ({"condition": by_entity(f'<{condition} rule="{rule}"/>')}, f"rule '{rule}' of <{condition.split()[0]}>")
            for rule in ("equalTo", "notEqualTo")
            for condition in (
                'SpeedCondition value="8"',
                'RelativeSpeedCondition entityRef="Other" value="0"',
                'AccelerationCondition value="0"',
                'RelativeDistanceCondition entityRef="Other" relativeDistanceType="cartesianDistance" value="25" '
                'freespace="false"',
            )
        ),
        (
            {"condition": by_entity(f'<DistanceCondition value="35" {FLAGS} rule="equalTo">{POSITION}'
                                    "</DistanceCondition>")},
            "rule 'equalTo' of <DistanceCondition>",
        ),
        (
            {"condition": by_entity(f'<TimeToCollisionCondition value="3" {FLAGS} rule="equalTo">'
                                    '<TimeToCollisionConditionTarget><EntityRef entityRef="Other"/>'
                                    "</TimeToCollisionConditionTarget></TimeToCollisionCondition>")},
            "rule 'equalTo' of <TimeToCollisionCondition>",
        ),
    ],
)  # fmt: skip
def test_what_it_does_otherwise_becomes_a_trajectory_with_times(write, tmp_path, given, why):
    path = write(**given)
    found = convert(path, tmp_path / "out" / "one.xosc", ego="Ego")
    (note,) = (note for note in found.notes if note.startswith("Other moves along a trajectory"))
    assert why in note
    root = read_xml(found.path)
    # One trajectory, and another one after a jump.
    trajectories = root.findall(".//FollowTrajectoryAction")
    times = [[float(one.get("time", "nan")) for one in way.iter("Vertex")] for way in trajectories]
    assert times[0][0] == 0.0
    assert 3.9 < times[-1][-1] < 4.2
    assert all((np.diff(of) > 0).all() for of in times)
    # The ego follows the storyboard, and our own controller keeps the times.
    assert [one.get("value") for one in root.findall(".//Property[@name='module']")] == ["cornercase_trajectory.py"]
    assert (tmp_path / "out" / "cornercase_trajectory.py").exists()
    before, after = simulate(path), simulate(found.path)
    shared = slice(0, min(before.time.size, after.time.size))
    assert before.time.size == after.time.size
    np.testing.assert_allclose(after.x[:, shared], before.x[:, shared], atol=0.02)
    np.testing.assert_allclose(after.y[:, shared], before.y[:, shared], atol=0.02)
    np.testing.assert_allclose(after.speed[:, shared], before.speed[:, shared], atol=LIMITS[2])


@pytest.mark.parametrize(
    ("action", "tag"),
    [
        (speed(target=-3), "AbsoluteTargetSpeed"),
        (speed(target=" -3 "), "AbsoluteTargetSpeed"),
        (relative_speed(-10), "RelativeTargetSpeed"),
        (relative_speed(-0.5, "factor"), "RelativeTargetSpeed"),
    ],
)
def test_speeds_below_0_become_a_trajectory(write, tmp_path, action, tag):
    path = write(action=action)
    found = convert(path, tmp_path / "out" / "one.xosc", ego="Ego")
    (note,) = (note for note in found.notes if note.startswith("Other moves along a trajectory"))
    assert f"<{tag}>: ScenarioRunner stops at speeds below 0" in note
    before, after = simulate(path), simulate(found.path)
    assert before.speed.min() < 0.0
    np.testing.assert_allclose(after.x, before.x, atol=0.02)
    # When it reverses, the trajectory only has the absolute speed.
    assert (np.abs(after.speed - before.speed) > LIMITS[2]).sum() <= 1


def test_a_relative_speed_that_stays_above_0_is_kept(write, tmp_path):
    found = convert(write(action=relative_speed(-2)), tmp_path / "one.xosc", ego="Ego")
    assert not [note for note in found.notes if "trajectory" in note]


def test_a_relative_speed_to_who_is_driven_is_kept_with_a_warning(write, tmp_path):
    found = convert(write(action=relative_speed(-0.5), drivers=DRIVEN), tmp_path / "one.xosc", ego="Ego")
    assert any(note.startswith("Other: <RelativeTargetSpeed>: ScenarioRunner stops if") for note in found.notes)
    assert read_xml(found.path).find(".//RelativeTargetSpeed") is not None


def test_an_event_without_a_condition_gets_one_that_is_always_true(write, tmp_path):
    path = write()
    path.write_text(re.sub(r"<StartTrigger>.*?</StartTrigger>(?=</Event>)", "<StartTrigger/>", path.read_text(),
                           flags=re.DOTALL))  # fmt: skip
    found = convert(path, tmp_path / "out" / "one.xosc", ego="Ego")
    (event,) = (one for one in read_xml(found.path).iter("Event") if one.get("name") == "e")
    (time,) = event.findall("StartTrigger/ConditionGroup/Condition//SimulationTimeCondition")
    assert (time.get("rule"), time.get("value")) == ("greaterThan", "-1")
    np.testing.assert_allclose(simulate(found.path).x, simulate(path).x, atol=1e-3)


def test_numbers_are_written_without_blanks_around_them(write, tmp_path):
    path = write(action=speed(target=" 8 "), condition=when(delay=" 0 "))
    text = path.read_text()
    path.write_text(text.replace('s="30"', 's="\t30 "'))
    found = convert(path, tmp_path / "one.xosc", ego="Ego")
    assert not [note for note in found.notes if "trajectory" in note]
    values = [value for one in read_xml(found.path).iter("*") for value in one.attrib.values()]
    assert [value for value in values if value != value.strip()] == []


DRIVEN = """<ObjectController><Controller name="d"><ParameterDeclarations/><Properties><Property name="cornercase.driver"
value="normal"/></Properties></Controller></ObjectController>"""


def test_who_reacts_to_the_ego_keeps_the_storyboard_where_scenario_runner_does_something_near(write, tmp_path):
    near = by_entity(NEAR.format("cartesianDistance", "false"))
    path = write(action=speed("linear", "rate", 2), condition=near, drivers=DRIVEN)
    found = convert(path, tmp_path / "out" / "one.xosc", ego="Ego")
    assert any(note.startswith("Other: dynamicsShape 'linear'") for note in found.notes)
    assert read_xml(found.path).find(".//RelativeDistanceCondition") is not None
    assert read_xml(found.path).find(".//FollowTrajectoryAction") is None


def test_in_a_run_the_origin_of_an_actor_is_put_where_the_middle_of_the_box_begins(write, tmp_path):
    """ScenarioRunner takes a position for that of the actor's origin, which CARLA has in the middle of a vehicle."""
    path, expected = write(), simulate(write())
    for is_run, ahead in ((True, 1.4), (False, 0.0)):
        target = tmp_path / f"{is_run}.xosc"
        run = ConversionOptions(is_run=is_run)
        write_openscenario_1_0(ScenarioFile.read(path), {}, target, ego="Ego", options=run)
        places = read_xml(target).findall("Storyboard/Init//TeleportAction/Position/WorldPosition")
        x, y, heading = (np.array([float(place.get(name, "0")) for place in places]) for name in ("x", "y", "h"))
        np.testing.assert_allclose(x - ahead * np.cos(heading), expected.x[:, 0], atol=1e-5)
        np.testing.assert_allclose(y - ahead * np.sin(heading), expected.y[:, 0], atol=1e-5)


def test_who_no_longer_reacts_is_named(write, tmp_path):
    near = by_entity(NEAR.format("cartesianDistance", "false"))
    found = convert(write(action=OFFSET, condition=near, drivers=DRIVEN), tmp_path / "one.xosc", ego="Ego")
    assert "Other should react to Ego, but no longer does." in found.notes


def test_who_would_have_to_react_to_an_agent_and_cannot_is_refused_before_the_run(write, tmp_path):
    init = f"<PrivateAction>{ROUTE}</PrivateAction>"
    path = write(action=OFFSET, condition=by_entity(NEAR.format("cartesianDistance", "false")))
    path.write_text(path.read_text().replace("</Private>", f"{init}</Private>", 1))
    closed, open_loop = (
        ConversionOptions(DrivingAgents({"Ego": "normal"}), open_loop=given) for given in (False, True)
    )
    with pytest.raises(InputError, match=r"'Other' has to react to Ego.*carla:open_loop=true"):
        write_openscenario_1_0(ScenarioFile.read(path), {}, tmp_path / "one.xosc", ego="Ego", options=closed)
    write_openscenario_1_0(ScenarioFile.read(path), {}, tmp_path / "one.xosc", ego="Ego", options=open_loop)
    modules = [one.get("value") for one in read_xml(tmp_path / "one.xosc").findall(".//Property[@name='module']")]
    assert modules == ["cornercase_driver.py", "cornercase_trajectory.py"]


def test_on_a_map_of_carla_what_needs_a_trajectory_is_refused(write, tmp_path):
    path = write(action=OFFSET)
    path.write_text(path.read_text().replace('filepath="road.xodr"', 'filepath="Town01"'))
    with pytest.raises(InputError, match=r"cannot execute the motion of 'Other' \(<LaneOffsetAction>.*Town01"):
        convert(path, tmp_path / "one.xosc", ego="Ego")


def test_on_a_map_of_carla_who_waits_for_what_is_left_out_is_refused(write, tmp_path):
    waits = when(
        '<StoryboardElementStateCondition storyboardElementType="event" storyboardElementRef="of ego"'
        ' state="completeState"/>'
    )
    path = write(condition=waits, drivers=DRIVEN)
    text = path.read_text().replace('filepath="road.xodr"', 'filepath="Town01"')
    group = re.search("<ManeuverGroup.*</ManeuverGroup>", text, re.DOTALL)
    assert group is not None
    of_ego = group[0].replace('"Other"', '"Ego"').replace('name="e"', 'name="of ego"')
    of_ego = of_ego.replace(speed(), OFFSET).replace(waits, when())
    path.write_text(text.replace(group[0], of_ego + group[0]))
    with pytest.raises(InputError, match=r"the motion of 'Other' \(it waits for events that are left out.*Town01"):
        convert(path, tmp_path / "one.xosc", ego="Ego")


@pytest.mark.parametrize(
    ("action", "name"),
    [
        ('<VisibilityAction graphics="true" traffic="true" sensors="true"/>', "<VisibilityAction>"),
        ('<ActivateControllerAction lateral="true" longitudinal="true"/>', "<ActivateControllerAction>"),
    ],
)
def test_what_has_no_effect_is_left_out_and_named(write, tmp_path, action, name):
    found = convert(write(init=f"<PrivateAction>{action}</PrivateAction>"), tmp_path / "one.xosc", ego="Ego")
    assert any(name in note and "without effect" in note for note in found.notes)
    assert name[1:-1] not in found.path.read_text()


def test_acts_end_with_the_storyboard_and_names_are_unique(write, tmp_path):
    root = read_xml(convert(write(), tmp_path / "one.xosc", ego="Ego").path)
    for act in root.iter("Act"):
        (value,) = (one.get("value") for one in act.findall("StopTrigger//SimulationTimeCondition"))
        assert value == root.findall("Storyboard/StopTrigger//SimulationTimeCondition")[0].get("value")
    names = [one.get("name") for one in root.iterfind("Storyboard/Story//*[@name]")]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ('s="30"/>', 's="30"><Orientation type="relative" h="3.14159"/></LanePosition>', "direction of the lane"),
        ('s="30"/>', 's="30" offset="0.6"/>', "middle of the lane"),
    ],
)
def test_who_does_not_follow_a_lane_moves_along_a_trajectory(write, tmp_path, old, new, why):
    path = write()
    path.write_text(path.read_text().replace(old, new))
    notes = convert(path, tmp_path / "one.xosc", ego="Ego").notes
    assert any(note.startswith("Other moves along a trajectory") and why in note for note in notes)


def test_entities_begin_at_the_height_of_their_road(write, tmp_path):
    path = write()
    road = path.with_name("road.xodr")
    text = road.read_text()
    text = re.sub(r"<elevationProfile\s*/>|<elevationProfile>.*?</elevationProfile>", "", text, flags=re.DOTALL)
    climb = '<elevationProfile><elevation s="0" a="5" b="0.1" c="0" d="0"/></elevationProfile>'
    road.write_text(re.sub(r"(</planView>)", rf"\1{climb}", text))
    root = read_xml(convert(path, tmp_path / "one.xosc", ego="Ego").path)
    heights = [float(one.get("z", "0")) for one in root.iterfind("Storyboard/Init//WorldPosition")]
    assert heights == pytest.approx([5.5, 8.0], abs=0.01)


def test_the_simulator_names_what_is_done_otherwise(write):
    names = {
        what: notice.reason
        for notice in Carla.notices(ScenarioFile.read(write(action=OFFSET)))
        for what in notice.parts
    }
    assert "moves along a trajectory" in names["<LaneOffsetAction>"]
    assert "models" in names["<Axles>"]


def test_code_of_ours_runs_where_scenario_runner_does(monkeypatch):
    """The trajectory controller, with all of its imports replaced; it needs no times of ScenarioRunner's."""
    clock = SimpleNamespace(now=0.0)
    made = control_of(monkeypatch, clock)
    actor = Body()
    parts = [[[0.0, 10.0, 0.0, 0.0], [1.0, 20.0, 0.0, 0.0], [2.0, 20.0, -10.0, -0.5 * np.pi]]]
    control = made(actor, {"center_x": "1.4", "parts": json.dumps(parts), "starts": "[-1.0]"})
    control.run_step()
    actor.move(0.05)
    for _ in range(39):
        clock.now += 0.05
        control.run_step()
        actor.move(0.05)
        if clock.now == pytest.approx(0.5):
            # A step ahead, and ahead of the reference point by the offset of the box.
            assert (actor.x, actor.y) == pytest.approx((10.0 + 5.5 + 1.4, 0.0))
    assert not control.check_reached_waypoint_goal()
    for _ in range(2):
        clock.now += 0.05
        control.run_step()
        actor.move(0.05)
    assert control.check_reached_waypoint_goal()
    assert (actor.x, actor.y, actor.yaw) == pytest.approx((20.0, 11.4, 90.0), abs=1e-6)
    # An entity that is far away is placed there.
    assert actor.put == 1


def test_an_entity_jumps_and_vanishes_when_its_trajectory_does(monkeypatch):
    clock = SimpleNamespace(now=0.0)
    made = control_of(monkeypatch, clock)
    actor = Body()
    parts = [[[0.0, 0.0, 0.0, 0.0], [0.25, 1.0, 0.0, 0.0]], [[0.15, 50.0, 2.0, 0.0], [0.4, 51.0, 2.0, 0.0]]]
    control = made(actor, {"parts": json.dumps(parts), "starts": "[-1.0, 0.125]", "end": "0.275"})
    seen = []
    for _ in range(6):
        control.run_step()
        actor.move(0.05)
        seen.append((round(actor.x, 6), round(actor.y, 6)))
        clock.now += 0.05
    assert seen == [(0.2, 0.0), (0.4, 0.0), (0.6, 0.0), (50.2, -2.0), (50.4, -2.0), (50.6, -2.0)]
    assert actor.is_alive
    control.run_step()
    assert not actor.is_alive
    control.run_step()


def test_a_walker_stays_where_it_is_put(monkeypatch):
    clock = SimpleNamespace(now=0.0)
    made = control_of(monkeypatch, clock)
    walker = Walking()
    parts = [[[0.0, 0.0, 0.0, 0.0], [0.1, 0.1, 0.0, 0.0]], [[0.1, 50.0, 0.0, 0.0], [0.4, 50.3, 0.0, 0.0]]]
    control = made(walker, {"parts": json.dumps(parts), "starts": "[-1.0, 0.075]"})
    seen = []
    for _ in range(4):
        control.run_step()
        walker.move(0.05)
        seen.append(round(walker.x, 6))
        clock.now += 0.05
    assert seen == [0.05, 0.1, 50.05, 50.1]


class Body:
    """A vehicle that moves with the velocities it is given."""

    is_alive, id = True, 7

    def __init__(self):
        self.x = self.y = self.yaw = 0.0
        self.put = 0
        self.velocity, self.turning = (0.0, 0.0), 0.0
        self.bounding_box = SimpleNamespace(location=SimpleNamespace(x=0.0))

    def get_transform(self):
        return place(self.x, self.y, self.yaw)

    def set_transform(self, there):
        self.put += 1
        self.x, self.y, self.yaw = there.location.x, there.location.y, there.rotation.yaw
        self.velocity, self.turning = (0.0, 0.0), 0.0

    def get_velocity(self):
        return SimpleNamespace(z=0.0)

    def set_target_velocity(self, velocity):
        self.velocity = (velocity.x, velocity.y)

    def set_target_angular_velocity(self, velocity):
        self.turning = velocity.z

    def move(self, step):
        self.x, self.y = self.x + step * self.velocity[0], self.y + step * self.velocity[1]
        self.yaw += step * self.turning


class Walking(Body):
    """A walker, which walks on in the direction and with the speed that it was told last."""

    def set_transform(self, there):
        self.x, self.y = there.location.x, there.location.y

    def apply_control(self, control):
        self.velocity = (control.direction.x * control.speed, control.direction.y * control.speed)


class Vector(SimpleNamespace):
    def __init__(self, x=0.0, y=0.0, z=0.0):
        super().__init__(x=x, y=y, z=z)


def place(x, y, yaw):
    return SimpleNamespace(location=Vector(x, y), rotation=SimpleNamespace(pitch=0.0, yaw=yaw, roll=0.0))


def control_of(monkeypatch, clock):
    def module(name, **content):
        made = ModuleType(name)
        vars(made).update(content)
        monkeypatch.setitem(sys.modules, name, made)

    class Basic:
        def __init__(self, actor):
            self._actor, self._reached_goal = actor, False

        def check_reached_waypoint_goal(self):
            return self._reached_goal

    class Provider:
        @staticmethod
        def remove_actor_by_id(number):
            assert number == Body.id
            Body.is_alive = False

    monkeypatch.setattr(Body, "is_alive", True)
    for package in ("srunner", "srunner.scenariomanager", "srunner.scenariomanager.actorcontrols"):
        module(package)
    module(
        "carla", Vehicle=Body, Walker=Walking, Vector3D=Vector, Location=Vector,
        Transform=lambda location, rotation: SimpleNamespace(location=location, rotation=rotation),
        Rotation=lambda pitch, yaw, roll: SimpleNamespace(pitch=pitch, yaw=yaw, roll=roll),
        WalkerControl=lambda direction, speed, jump: SimpleNamespace(direction=direction, speed=speed, jump=jump),
    )  # fmt: skip
    module("srunner.scenariomanager.actorcontrols.basic_control", BasicControl=Basic)
    module("srunner.scenariomanager.carla_data_provider", CarlaDataProvider=Provider)
    module("srunner.scenariomanager.timer", GameTime=SimpleNamespace(get_time=lambda: clock.now))
    spec = importlib.util.spec_from_file_location("cornercase_trajectory", TRAJECTORY_FILE)
    assert spec is not None
    assert spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded.CornercaseTrajectory


def scenarios(folder):
    """Scenario files of a folder, without catalogs and distribution files."""
    files = sorted((REFERENCE / "openscenario" / folder).rglob("*.xosc"))
    return [one for one in files if "<Storyboard" in one.read_text(errors="replace")]


@pytest.mark.skipif(not REFERENCE.is_dir(), reason="the reference scenarios are not here")
@pytest.mark.parametrize("each", at_night([9, 1], {1}))
@pytest.mark.parametrize(("folder", "count"), [pytest.param("ncap", 23, marks=pytest.mark.slow), ("alks", 15)])
def test_all_protocols_become_files_that_say_the_same(tmp_path, folder, count, each):
    files = scenarios(folder)
    assert len(files) == count
    off = {}
    for file in files[::each]:
        ego = "Ego"
        # Invalid files by the schema of 1.0 are not written.
        found = convert(file, tmp_path / f"{file.stem}.xosc", ego=ego)
        worst = apart(simulate(file), simulate(found.path))
        wrong = {n: w for n, w in worst.items() if not all(a <= b for a, b in zip(w, LIMITS, strict=True))}
        if wrong:
            off[file.stem] = wrong
    assert off == {}
