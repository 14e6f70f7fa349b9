"""A scenario gives the same result alone and in a batch, and errors of one do not affect the others."""

from __future__ import annotations

import gc
import re
import weakref
from collections.abc import Generator

import numpy as np
import pytest

from conftest import at_night, car, event, ran, scenario_file, speed_action, story_of, teleport, time_trigger
from cornercase._common.errors import InputError
from cornercase.scenario import ConcreteScenario
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators import Builtin, simulate
from cornercase.simulators.builtin import _simulator as builtin_simulator
from cornercase.simulators.builtin._batch import Batch
from cornercase.simulators.builtin._prepared_file import PreparedScenario
from cornercase.simulators.builtin.tracks._clothoid_spline import ClothoidSpline
from cornercase.simulators.builtin.tracks._nurbs import evaluate_nurbs
from helpers.isolation import REFERENCE, ROOT, differing, outcome, scenario_files, varied


def declared(name: str, value: str, kind: str = "double", within: str = "") -> str:
    return f'<ParameterDeclaration name="{name}" parameterType="{kind}" value="{value}">{within}</ParameterDeclaration>'


def private(*actions: str, entity: str = "Ego") -> str:
    return f'<Private entityRef="{entity}">{"".join(actions)}</Private>'


def results(path, *values, duration=1.0):
    simulator = Builtin(duration=duration)
    return list(simulator.run([ConcreteScenario(path, one) for one in values]))


def words(path, *values, **options):
    """Error of each scenario; empty for one that ran."""
    return [str(one) if isinstance(one, Exception) else "" for one in results(path, *values, **options)]


ROUTE = """<Route name="r" closed="false">{}</Route>"""
WAYPOINT = """<Waypoint routeStrategy="shortest"><Position><LanePosition roadId="{road}" laneId="-1" s="{s}"/></Position>
</Waypoint>"""


def test_a_place_on_a_route_hangs_on_the_route_of_its_own_scenario(tmp_path):
    route = ROUTE.format(WAYPOINT.format(road="1", s="$begin") + WAYPOINT.format(road="1", s="400"))
    place = f"""<PrivateAction><TeleportAction><Position><RoutePosition><RouteRef>{route}</RouteRef><InRoutePosition>
<FromLaneCoordinates pathS="10" laneId="-1"/></InRoutePosition></RoutePosition></Position></TeleportAction></PrivateAction>"""
    path = scenario_file(tmp_path, init=private(place), parameters=declared("begin", "0"))
    values = [{"begin": begin} for begin in (0.0, 100.0, 200.0)]
    assert [float(one.x[0, 0]) for one in ran(Builtin(duration=1.0), [ConcreteScenario(path, v) for v in values])] == [
        pytest.approx(10.0), pytest.approx(110.0), pytest.approx(210.0),
    ]  # fmt: skip
    assert differing(path, values, 1.0) == []


def test_a_recording_holds_no_more_memory_than_its_own():
    base = ROOT / "examples" / "t_intersection" / "t_intersection.xosc"
    found = results(base, {}, {}, {}, duration=5.0)
    for one in found:
        arrays = [one.x, one.y, one.heading, one.speed, one.acceleration]
        held = {id(array if array.base is None else array.base): array for array in arrays}
        assert sum((array if array.base is None else array.base).nbytes for array in held.values()) == sum(
            array.nbytes for array in arrays
        )
        assert all(array.flags.c_contiguous and array.flags.writeable for array in arrays)
    found[0].x[:] = 0.0
    np.testing.assert_array_equal(found[1].x, found[2].x)
    assert (found[1].x != 0.0).any()


def test_the_memory_of_a_batch_is_free_again_without_garbage_collection(monkeypatch):
    pages = []

    def watched(*arguments):
        batch = Batch(*arguments)
        pages.append(weakref.ref(batch._stepper.scene.pages))
        return batch

    monkeypatch.setattr(builtin_simulator, "Batch", watched)
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        assert len(results(ROOT / "examples" / "t_intersection" / "t_intersection.xosc", {}, {})) == 2
        assert [page() for page in pages] == [None]
    finally:
        if was_enabled:
            gc.enable()


def test_a_nurbs_is_the_same_for_one_scenario_and_for_many():
    random = np.random.default_rng(0)
    x, y = (np.cumsum(random.uniform(0, 40 * (k + 1), (9, 5)), axis=1) for k in range(2))
    x[4], y[4] = np.nan, np.nan
    time = np.cumsum(random.uniform(0, 3, (9, 5)), axis=1)
    weights, knots = np.array([1.0, 2.0, 1.0, 0.5, 1.0]), np.array([0.0, 0, 0, 0, 1, 2, 2, 2, 2])
    together = evaluate_nurbs(x, y, time, weights, knots, 4)
    for i in range(9):
        alone = evaluate_nurbs(x[i : i + 1], y[i : i + 1], time[i : i + 1], weights, knots, 4)
        for many, one in zip(together, alone, strict=True):
            assert many[i, : one.shape[1]].tobytes() == one[0].tobytes()
            assert np.array_equal(np.unique(many[i, one.shape[1] - 1 :]), one[0, -1:], equal_nan=True)


def test_a_clothoid_is_the_same_for_one_scenario_and_for_many():
    length = np.array([[30.0], [123.4], [5000.0], [0.5]])
    start, end = np.full((4, 1), 0.001), np.full((4, 1), 0.002)
    still = np.zeros(4)
    together = ClothoidSpline(still, still, still, start, end, length)
    for i in range(4):
        alone = ClothoidSpline(still[:1], still[:1], still[:1], start[:1], end[:1], length[i : i + 1])
        for share in (0.0, 0.1, 0.77, 1.0, 1.2):
            place = np.array([share * length[i, 0]])
            found = (
                together.pose_at(place, np.zeros(1), np.array([i])),
                alone.pose_at(place, np.zeros(1), np.array([0])),
            )
            assert [a.tobytes() for a in found[0]] == [a.tobytes() for a in found[1]]


def test_a_delay_of_one_scenario_changes_no_other(tmp_path):
    later = """<ConditionGroup><Condition name="a" delay="0" conditionEdge="none"><ByValueCondition>
<SimulationTimeCondition value="1" rule="greaterThan"/></ByValueCondition></Condition>
<Condition name="b" delay="$delay" conditionEdge="rising"><ByValueCondition>
<SimulationTimeCondition value="0.5" rule="greaterThan"/></ByValueCondition></Condition></ConditionGroup>"""
    path = scenario_file(
        tmp_path,
        init=private(teleport("0"), speed_action("10")),
        story=story_of(event("e", speed_action("20"), later)),
        parameters=declared("delay", "0"),
    )
    assert differing(path, [{"delay": 0.0}, {"delay": 0.7}, {"delay": 0.0}], 3.0) == []


TIMED = """<PrivateAction><RoutingAction><FollowTrajectoryAction><TrajectoryRef><Trajectory name="t" closed="{closed}">
<Shape><Polyline><Vertex time="0"><Position><WorldPosition x="0" y="0"/></Position></Vertex>
<Vertex time="$end"><Position><WorldPosition x="40" y="0"/></Position></Vertex></Polyline></Shape></Trajectory>
</TrajectoryRef><TimeReference><Timing domainAbsoluteRelative="relative" scale="1" offset="0"/></TimeReference>
<TrajectoryFollowingMode followingMode="position"/></FollowTrajectoryAction></RoutingAction></PrivateAction>"""


def timed(folder, closed="false"):
    init = private(teleport("0"), speed_action("5"), TIMED.format(closed=closed))
    return scenario_file(folder, init=init, parameters=declared("end", "0"))


def test_times_that_pass_in_some_scenarios_only_make_none_of_the_others_keep_to_times(tmp_path):
    path = timed(tmp_path)
    values = [{"end": end} for end in (0.0, 4.0, 0.0, 8.0)]
    assert [one.speed[0, 10] for one in results(path, *values)] == pytest.approx([5.0, 10.0, 5.0, 5.0])
    assert [one.x[0, 10] for one in results(path, *values)] == pytest.approx([2.5, 5.0, 2.5, 2.5])
    assert differing(path, values, 3.0) == []


def test_a_closed_trajectory_with_times_in_one_scenario_costs_none_of_the_others(tmp_path):
    found = words(timed(tmp_path, closed="true"), {"end": 0.0}, {"end": 4.0}, {"end": 0.0})
    assert [bool(one) for one in found] == [False, True, False]
    assert "a closed <Trajectory> has no time for its return" in found[1]


def test_times_that_go_back_are_refused_in_their_own_scenario(tmp_path):
    good, bad = words(timed(tmp_path), {"end": 1.0}, {"end": -1.0})
    assert good == ""
    assert bad.endswith(
        ": <FollowTrajectoryAction> of <Init>: the times of a trajectory of Ego must not decrease at t = 0 s"
    )


def test_a_scenario_without_entities_is_refused(tmp_path):
    path = scenario_file(tmp_path, init="", entities="", parameters=declared("p", "0"))
    for others in ((), ({"p": 1.0},)):
        with pytest.raises(InputError, match="has no entities, so there is nothing to simulate"):
            results(path, {}, *others)


def test_an_entity_that_is_not_there_yet_is_no_target(tmp_path):
    """Its position is unknown, so no distance along the road is measured to it."""
    condition = """<ConditionGroup><Condition name="c" delay="0" conditionEdge="none"><ByEntityCondition>
<TriggeringEntities triggeringEntitiesRule="any"><EntityRef entityRef="Ego"/></TriggeringEntities><EntityCondition>
<RelativeDistanceCondition entityRef="Other" relativeDistanceType="longitudinal" coordinateSystem="road" value="20"
freespace="false" rule="lessThan"/></EntityCondition></ByEntityCondition></Condition></ConditionGroup>"""
    path = scenario_file(
        tmp_path,
        init=private(teleport("0"), speed_action("10")),
        story=story_of(event("e", speed_action("20"), condition)),
        entities=car("Ego") + car("Other"),
    )
    (recording,) = results(path, {}, duration=2.0)
    assert recording.speed[0, -1] == 10.0


LTAP = REFERENCE / "esmini" / "resources" / "xosc" / "ltap-od-relative-speed.xosc"


@pytest.mark.skipif(not LTAP.exists(), reason="needs ../shared/reference")
def test_ltap_od_relative_speed_runs():
    assert simulate(LTAP, duration=5.0).time[-1] == 5.0


@pytest.mark.parametrize(
    ("kind", "value", "init", "bad", "why"),
    [
        ("string", "1", f'{teleport("5").replace(chr(34) + "1" + chr(34), chr(34) + "$p" + chr(34), 1)}', "7",
         "has no road '7'"),
        ("string", "-1", teleport("5", "$p"), "x", "laneId of <LanePosition> is 'x', which is not a number"),
        ("double", "-1", teleport("5", "$p"), -1.6, "is -1.6, which is not a whole number"),
        ("integer", "-1", teleport("5", "$p"), -1.6, "the parameter p is '-1.6', which is not a whole number"),
        ("integer", "-1", teleport("5", "$p"), 4.33, "the parameter p is '4.33', which is not a whole number"),
        ("double", "5", teleport("${10/$p}"), 0.0, "has no finite value"),
        ("double", "5", teleport("$p"), "much", "the parameter p is 'much', which is not a number"),
        ("unsignedShort", "5", teleport("$p"), 70000, "not from 0 to 65535"),
        ("boolean", "true", teleport("5"), "maybe", "the parameter p is 'maybe', not true or false"),
    ],
)  # fmt: skip
def test_a_value_that_cannot_be_used_costs_its_scenario_alone(tmp_path, kind, value, init, bad, why):
    path = scenario_file(tmp_path, init=private(init), parameters=declared("p", value, kind))
    first, wrong, last = words(path, {"p": value}, {"p": bad}, {})
    assert first == last == ""
    assert why in wrong
    assert str(path) not in wrong
    # It has the same error alone.
    assert words(path, {"p": bad}) == [wrong]
    with pytest.raises(InputError, match=r"scenario\.xosc"):
        simulate(path, {"p": bad})


def test_batches_beside_each_other_give_the_same_and_each_its_errors(tmp_path, monkeypatch):
    init = private(teleport("$s").replace('roadId="1"', 'roadId="$road"'), speed_action("$v"))
    declarations = declared("s", "5") + declared("v", "10") + declared("road", "1", "string")
    path = scenario_file(tmp_path, init=init, parameters=declarations)
    # The last third name a road that does not exist; another one starts off the road.
    values = [
        {"s": 5000.0 if k == 4 else 5.0, "v": float(k % 40), "road": "1" if k < 1024 else "9"} for k in range(1536)
    ]
    monkeypatch.setattr(builtin_simulator, "count_available_cpus", lambda: 1)
    one_batch = [outcome(one) for one in results(path, *values)]
    monkeypatch.setattr(builtin_simulator, "count_available_cpus", lambda: 3)
    assert [outcome(one) for one in results(path, *values)] == one_batch
    assert [one == "" for one in words(path, *values)] == [k != 4 and k < 1024 for k in range(1536)]


def test_batches_that_run_already_are_formed_anew_where_a_later_one_has_to_be_split(tmp_path, monkeypatch):
    init = private(teleport("0"), speed_action("1"))
    story = story_of(event("e", speed_action("$v", "$shape", over="2"), time_trigger("1")))
    path = scenario_file(
        tmp_path, init=init, story=story, parameters=declared("v", "10") + declared("shape", "linear", "string")
    )
    values = [{"v": 5.0 + k % 31, "shape": "step" if k >= 1280 else "linear"} for k in range(1536)]
    chosen = [0, 511, 512, 1023, 1024, 1279, 1280, 1535]
    apart = [outcome(results(path, values[k])[0]) for k in chosen]
    monkeypatch.setattr(builtin_simulator, "count_available_cpus", lambda: 3)
    formed = []

    def counted(prepared, values, *rest):
        formed.append(len(values))
        return Batch(prepared, values, *rest)

    monkeypatch.setattr(builtin_simulator, "Batch", counted)
    together = results(path, *values)
    assert [outcome(together[k]) for k in chosen] == apart
    assert formed[:3] == [512, 512, 512]
    assert sorted(formed[3:]) == [256, 640, 640]


def test_who_stops_asking_can_ask_again(tmp_path, monkeypatch):
    path = scenario_file(
        tmp_path, init=private(teleport("0"), speed_action("$v")), parameters=declared("v", "10"), entities=car("Ego")
    )
    monkeypatch.setattr(builtin_simulator, "count_available_cpus", lambda: 2)
    simulator = Builtin(duration=1.0)
    concretes = [ConcreteScenario(path, {"v": k / 32.0}) for k in range(1024)]
    whole = [outcome(one) for one in simulator.run(concretes)]
    asked = simulator.run(concretes)
    assert outcome(next(asked)) == whole[0]
    assert isinstance(asked, Generator)
    asked.close()
    assert [outcome(one) for one in simulator.run(concretes)] == whole


def test_a_trajectory_is_read_anew_only_where_a_parameter_changes_it(tmp_path):
    line = "".join(
        f'<Vertex time="0"><Position><WorldPosition x="{x}" y="{y}"/></Position></Vertex>'
        for x, y in (("0", "0"), ("$far", "0"), ("80", "40"))
    )
    for folder, text in (("varied", line), ("fixed", line.replace("$far", "40"))):
        (tmp_path / folder).mkdir()
        path = scenario_file(
            tmp_path / folder,
            init=private(teleport("0"), speed_action("$v"), following(f"<Polyline>{text}</Polyline>")),
            parameters=declared("far", "40") + declared("v", "10"),
        )
        scenario = ScenarioFile.read(path)
        simulator = Builtin(duration=8.0)
        values = [{"far": 40.0, "v": 10.0}, {"far": 60.0, "v": 10.0}, {"far": 40.0, "v": 12.0}]
        at_once = [outcome(one) for one in ran(simulator, [ConcreteScenario(path, one, scenario) for one in values])]
        for one, expected in zip(values, at_once, strict=True):
            assert outcome(ran(simulator, [ConcreteScenario(path, one, scenario)])[0]) == expected
        assert (at_once[0] == at_once[1]) == (folder == "fixed")
        assert at_once[0] != at_once[2]


def test_what_is_wrong_whatever_is_varied_is_said_once(tmp_path):
    """No parameter value can mend an unknown road in the file itself."""
    init = private(teleport("$s").replace('roadId="1"', 'roadId="9"'))
    path = scenario_file(tmp_path, init=init, parameters=declared("s", "0") + declared("road", "1", "string"))
    for values in ([{"s": 5.0}], [{"s": 5.0}, {"s": 6.0}], [{"road": "1"}, {"road": "2"}], [{"s": 0.0}]):
        with pytest.raises(InputError, match="has no road '9'"):
            results(path, *values)


def test_the_value_of_the_file_may_be_unusable_and_others_not(tmp_path):
    init = private(teleport("5").replace('roadId="1"', 'roadId="$road"'))
    path = scenario_file(tmp_path, init=init, parameters=declared("road", "9", "string"))
    assert ["has no road '9'" in one for one in words(path, {"road": "9"}, {"road": "1"})] == [True, False]
    with pytest.raises(InputError, match="has no road '9'"):
        results(path, {})


def test_a_length_that_is_not_above_0_costs_its_scenario_alone(tmp_path):
    follow = """<PrivateAction><RoutingAction><FollowTrajectoryAction><TrajectoryRef><Trajectory name="t" closed="false">
<ParameterDeclarations/><Shape><Clothoid curvature="0" curvaturePrime="0" length="$length"><Position>
<WorldPosition x="0" y="0" h="0"/></Position></Clothoid></Shape></Trajectory></TrajectoryRef><TimeReference><None/></TimeReference>
<TrajectoryFollowingMode followingMode="position"/></FollowTrajectoryAction></RoutingAction></PrivateAction>"""
    path = scenario_file(
        tmp_path,
        init=private(teleport("0"), speed_action("5")),
        story=story_of(event("e", follow, time_trigger("0.2"))),
        parameters=declared("length", "30"),
    )
    assert ["not above 0" in one for one in words(path, {"length": 30.0}, {"length": -1.0}, {"length": 0.0})] == [
        False, True, True,
    ]  # fmt: skip
    path.write_text(path.read_text().replace("$length", "-2"))
    with pytest.raises(InputError, match="not above 0"):
        results(path, {"length": 30.0})


@pytest.mark.parametrize(
    ("condition", "why"),
    [
        ('<StoryboardElementStateCondition storyboardElementType="event" storyboardElementRef="none" state="completeState"/>',
         "there is no event 'none'"),
        ('<StoryboardElementStateCondition storyboardElementType="event" storyboardElementRef="e" state="done"/>',
         "'done'"),
        ('<ParameterCondition parameterRef="word" value="a" rule="alike"/>', "rule 'alike'"),
        ('<ParameterCondition parameterRef="number" value="1" rule="alike"/>', "rule 'alike'"),
    ],
)  # fmt: skip
def test_a_condition_that_cannot_be_is_refused_before_it_is_asked(tmp_path, condition, why):
    trigger = f"""<ConditionGroup><Condition name="c" delay="0" conditionEdge="none"><ByValueCondition>{condition}
</ByValueCondition></Condition></ConditionGroup>"""
    story = story_of(event("first", speed_action("1"), time_trigger("100")) + event("e", speed_action("20"), trigger))
    path = scenario_file(
        tmp_path, init=private(teleport("0")), story=story, parameters=declared("word", "a", "string") + declared("number", "1")
    )  # fmt: skip
    with pytest.raises(InputError, match=why):
        results(path, {})


def test_batches_are_cut_by_what_they_may_hold_and_give_the_same(tmp_path, monkeypatch):
    path = scenario_file(
        tmp_path,
        init=private(teleport("0"), speed_action("$v")),
        parameters=declared("v", "10"),
        entities=car("Ego"),
        stop=time_trigger("0.2"),
    )
    concretes = [ConcreteScenario(path, {"v": float(v)}) for v in range(1, 13)]
    whole = [outcome(one) for one in Builtin(time_step=0.001, duration=1.0).run(concretes)]
    sizes = []

    def counted(prepared, values, *rest):
        sizes.append(len(values))
        return Batch(prepared, values, *rest)

    monkeypatch.setattr(builtin_simulator, "Batch", counted)
    # The longest recordings that can be asked for, of 144 MB each.
    simulator = Builtin(time_step=0.001, duration=3600.0)
    assert [outcome(one) for one in simulator.run(concretes)] == whole
    assert sizes == [5, 5, 2]
    # However small the limit is, one scenario runs.
    assert [len(portion) for portion in simulator._split_by_memory(concretes, max_bytes=1)] == [1] * 12


def following(shape: str) -> str:
    return f"""<PrivateAction><RoutingAction><FollowTrajectoryAction><TrajectoryRef><Trajectory name="t" closed="false"><ParameterDeclarations/>
<Shape>{shape}</Shape></Trajectory></TrajectoryRef><TimeReference><None/></TimeReference>
<TrajectoryFollowingMode followingMode="follow"/></FollowTrajectoryAction></RoutingAction></PrivateAction>"""


def test_the_vertices_of_trajectories_count_for_what_a_batch_holds(tmp_path):
    def needed(vertices: int) -> int:
        shape = "".join(
            f'<Vertex time="{k}"><Position><WorldPosition x="{k}" y="0"/></Position></Vertex>' for k in range(vertices)
        )
        path = scenario_file(tmp_path, init=private(teleport("0"), following(f"<Polyline>{shape}</Polyline>")))
        return PreparedScenario(ScenarioFile.read(path)).estimate_bytes(22, False)

    # About a dozen arrays, and twice as many while they are built.
    assert needed(3002) - needed(2) >= 3000 * 8 * 24
    # The storyboard, too.
    few, many = (
        PreparedScenario(ScenarioFile.read(scenario_file(tmp_path, init=private(teleport("0")), story=story_of(
            "".join(event(f"e{k}", speed_action("1"), time_trigger("1")) for k in range(count)))))).estimate_bytes(22, False)
        for count in (1, 1001)
    )  # fmt: skip
    assert many - few >= 1000 * 200


def test_a_catalog_trajectory_counts_as_the_longest_of_all(tmp_path):
    vertices = "".join(
        f'<Vertex time="{k}"><Position><WorldPosition x="{k}" y="0"/></Position></Vertex>' for k in range(1000)
    )
    (tmp_path / "catalog.xosc").write_text(
        f"""<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="2026-01-01T00:00:00" author="a" description="d"/>
<Catalog name="C"><Trajectory name="T" closed="false"><ParameterDeclarations/><Shape><Polyline>{vertices}</Polyline></Shape>
</Trajectory></Catalog></OpenSCENARIO>"""
    )
    before, _, rest = following("").partition("<Trajectory ")
    follow = f'{before}<CatalogReference catalogName="C" entryName="T"/></TrajectoryRef>{rest.partition("</TrajectoryRef>")[2]}'
    path = scenario_file(tmp_path, init=private(teleport("0"), follow))
    path.write_text(
        path.read_text().replace(
            "<CatalogLocations/>",
            '<CatalogLocations><TrajectoryCatalog><Directory path="."/></TrajectoryCatalog></CatalogLocations>',
        )
    )
    assert PreparedScenario(ScenarioFile.read(path)).estimate_bytes(22, False) >= 1000 * 8 * 24


def test_a_nurbs_has_no_more_samples_than_can_be_held():
    for controls, reach in ((4, 1e9), (2000, 1e6)):
        x = np.linspace(0.0, reach, controls)[None]
        knots = np.concatenate([[0.0, 0.0], np.arange(controls - 1.0), np.full(2, controls - 2.0)])
        found = evaluate_nurbs(x, 0.0 * x, 0.0 * x, np.ones(controls), knots, 3)
        assert found[0].shape[1] <= 40_000
        assert found[0].shape[1] * controls <= 20_000_000
        assert found[0][0, -1] == pytest.approx(reach)


@pytest.mark.parametrize(
    ("time_step", "duration", "rows"), [(0.05, 1.0, 21), (0.3, 1.0, 4), (0.1, 0.3, 4), (0.05, 0.05, 2)]
)
def test_a_run_ends_with_its_duration(tmp_path, time_step, duration, rows):
    path = scenario_file(tmp_path, init=private(teleport("0")))
    time = simulate(path, time_step=time_step, duration=duration).time
    assert len(time) == rows
    assert time[-1] <= duration + 1e-9


# Together, these files use everything that is read once per batch: routes, trajectories, drivers, parametrized names.
FAST = (
    "esmini/EnvironmentSimulator/Unittest/xosc/brake_by_trajectory_100-0.xosc",
    "esmini/EnvironmentSimulator/Unittest/xosc/traj_use_cases.xosc",
    "esmini/EnvironmentSimulator/Unittest/xosc/direct_junction.xosc",
    "esmini/EnvironmentSimulator/Unittest/xosc/parameter_overwrite.xosc",
    "esmini/EnvironmentSimulator/Unittest/xosc/emergency_vehicle.xosc",
    "esmini/resources/xosc/lane-change_clothoid_spline_based_trajectory.xosc",
    "esmini/resources/xosc/pedestrian_traj_synch.xosc",
    "esmini/resources/xosc/synchronize.xosc",
    "esmini/resources/xosc/cut-in_cr.xosc",
    "ncap/OpenSCENARIO/NCAP/CA-FC_2026/CPNCO.xosc",
    "alks/logical_scenarios/concrete_scenarios/alks_scenario_4_4_1_cut_in_no_collision_template.xosc",
)


# Number of variations of a file, and the duration of a run.
FEW = (2, 4.0)


@pytest.mark.parametrize(("most", "duration"), [FEW, pytest.param(8, 8.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", at_night(FAST, FAST[1::2]))
def test_reference_scenarios_give_the_same_alone_and_among_others(name, most, duration):
    path = REFERENCE / name
    if not path.exists():
        pytest.skip("needs ../shared/reference")
    values = varied(ScenarioFile.read(path), most=most)
    assert [values[k] for k in differing(path, values, duration)] == []


EXAMPLES = scenario_files(ROOT / "examples")
# Another motorway file, and the files of a suite reduced from it.
ALIKE = [path for path in EXAMPLES if "suite" in path.parts or path.stem == "cut_out"]


@pytest.mark.parametrize("path", at_night(EXAMPLES, ALIKE), ids=lambda path: path.stem)
@pytest.mark.parametrize("driver", at_night([None, "normal"], {None}))
@pytest.mark.parametrize(("most", "duration"), [FEW, pytest.param(8, 12.0, marks=pytest.mark.slow)])
def test_examples_give_the_same_alone_and_among_others(path, driver, most, duration):
    values = varied(ScenarioFile.read(path), most=most)
    assert differing(path, values, duration, drivers={"Ego": driver} if driver else {}) == []


@pytest.mark.parametrize("attribute", ["maxSpeed", "maxAcceleration", "maxDeceleration"])
def test_a_limit_of_a_vehicle_below_0_is_refused(tmp_path, attribute):
    entity = re.sub(f'{attribute}="[0-9]+"', f'{attribute}="$p"', car("Ego"))
    path = scenario_file(tmp_path, init=private(teleport("5")), entities=entity, parameters=declared("p", "50"))
    assert [f"{attribute} of 'Ego' is -3; it must not be below 0" in one for one in words(path, {"p": -3.0}, {})] == [
        True,
        False,
    ]


@pytest.mark.parametrize(("old", "new"), [('length="4"', 'length="1e308"'), ('Center x="1.4"', 'Center x="-1e9"')])
def test_a_box_that_is_larger_than_anything_is_refused(tmp_path, old, new):
    path = scenario_file(tmp_path, init=private(teleport("5")), entities=car("Ego").replace(old, new))
    with pytest.raises(InputError, match="the bounding box of 'Ego' is larger than 10000 m"):
        results(path, {})


LANE_CHANGE = """<PrivateAction><LateralAction><LaneChangeAction><LaneChangeActionDynamics dynamicsShape="cubic" dynamicsDimension="distance"
value="$p"/><LaneChangeTarget><AbsoluteTargetLane value="1"/></LaneChangeTarget></LaneChangeAction></LateralAction></PrivateAction>"""
LANE_OFFSET = """<PrivateAction><LateralAction><LaneOffsetAction continuous="false"><LaneOffsetActionDynamics dynamicsShape="cubic"
maxLateralAcc="$p"/><LaneOffsetTarget><AbsoluteTargetLaneOffset value="1"/></LaneOffsetTarget></LaneOffsetAction></LateralAction></PrivateAction>"""


@pytest.mark.parametrize("action", [speed_action("20", "linear", "time", "$p"), LANE_CHANGE, LANE_OFFSET])
def test_a_change_that_takes_less_than_nothing_costs_its_scenario(tmp_path, action):
    path = scenario_file(
        tmp_path, init=private(teleport("5"), speed_action("10")), parameters=declared("p", "3"),
        story=story_of(event("e", action, time_trigger("0.1"))),
    )  # fmt: skip
    assert ["is below 0" in one for one in words(path, {"p": -1.0}, {"p": 3.0})] == [True, False]


LIMITS = """<DynamicConstraints maxSpeed="20" maxAcceleration="3" maxDeceleration="3" maxAccelerationRate="3"
maxDecelerationRate="3"/>"""
LIMITED = {
    "speed profile": f"""<LongitudinalAction><SpeedProfileAction followingMode="follow">{LIMITS}
<SpeedProfileEntry time="4" speed="20"/></SpeedProfileAction></LongitudinalAction>""",
    "distance ahead": f"""<LongitudinalAction><LongitudinalDistanceAction entityRef="Lead" distance="20" continuous="true"
freespace="false">{LIMITS}</LongitudinalDistanceAction></LongitudinalAction>""",
    "distance beside": f"""<LateralAction><LateralDistanceAction entityRef="Lead" distance="1" continuous="true"
freespace="false">{LIMITS}</LateralDistanceAction></LateralAction>""",
}


@pytest.mark.parametrize("action", LIMITED)
@pytest.mark.parametrize("attribute", ["maxAcceleration", "maxAccelerationRate", "maxSpeed"])
def test_a_limit_of_an_action_below_0_costs_its_scenario(tmp_path, action, attribute):
    limited = re.sub(rf'{attribute}="\d+"', f'{attribute}="$p"', LIMITED[action])
    path = scenario_file(
        tmp_path, parameters=declared("p", "3"), entities=car("Ego") + car("Lead"),
        init=private(teleport("5"), speed_action("10")) + private(teleport("60"), speed_action("10"), entity="Lead"),
        story=story_of(event("e", f"<PrivateAction>{limited}</PrivateAction>", time_trigger("0.1"))),
    )  # fmt: skip
    below, *others = words(path, {"p": -1.0}, {"p": 0.0}, {"p": 3.0})
    assert f"{attribute} of <DynamicConstraints> is below 0" in below
    assert others == ["", ""]


def test_a_rate_may_have_the_sign_of_the_change(tmp_path):
    action = speed_action("5", "linear", "rate", "-2")
    path = scenario_file(
        tmp_path, init=private(teleport("5"), speed_action("10")), story=story_of(event("e", action, time_trigger("0")))
    )
    assert words(path, {}) == [""]
