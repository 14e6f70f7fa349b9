"""Notices about runs: entities far from every road, runs that were cut off, and egos without a driver."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cornercase as cc
from conftest import EXAMPLES, car, event, ran, scenario_file, speed_action, story_of, teleport, time_trigger
from cornercase._common.errors import NoticeWarning
from cornercase.roads._network import RoadNetwork
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin
from cornercase.simulators._run_notices import find_entities_far_from_roads
from helpers.command_line import X, cornercase

ROAD = EXAMPLES / "t_intersection" / "t_intersection.xodr"


def told(path: Path, **options) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        cc.simulate(path, **options)
    said = [str(one.message) for one in caught if one.category is NoticeWarning]
    return [one for one in said if not re.match(r"without effect|\d+( more)? parts? of the files", one)]


def at(x: float, y: float) -> str:
    position = f'<WorldPosition x="{x}" y="{y}" h="0"/>'
    return f"<PrivateAction><TeleportAction><Position>{position}</Position></TeleportAction></PrivateAction>"


def body(name: str, kind: str) -> str:
    box = '<BoundingBox><Center x="0" y="0" z="0"/><Dimensions length="1" width="1" height="1"/></BoundingBox>'
    opened = {"Pedestrian": "", "MiscObject": "", "Vehicle": ' vehicleCategory="car"'}[kind]
    return f'<ScenarioObject name="{name}"><{kind} name="b"{opened}>{box}</{kind}></ScenarioObject>'


def placed(folder: Path, x: float, y: float, kind: str = "Vehicle", story: str = "") -> Path:
    init = f'<Private entityRef="Ego">{at(x, y)}</Private>'
    return scenario_file(folder, init=init, story=story, stop=time_trigger("3"), entities=body("Ego", kind))


def trajectory(*vertices: tuple[float, float, float], times: bool = False) -> str:
    corners = "".join(
        f'<Vertex time="{t}"><Position><WorldPosition x="{x}" y="{y}"/></Position></Vertex>' for t, x, y in vertices
    )
    timing = '<Timing domainAbsoluteRelative="relative" scale="1" offset="0"/>' if times else "<None/>"
    return (
        '<PrivateAction><RoutingAction><FollowTrajectoryAction><TrajectoryRef><Trajectory name="t" closed="false">'
        f"<ParameterDeclarations/><Shape><Polyline>{corners}</Polyline></Shape></Trajectory></TrajectoryRef>"
        f"<TimeReference>{timing}</TimeReference>"
        '<TrajectoryFollowingMode followingMode="position"/></FollowTrajectoryAction></RoutingAction></PrivateAction>'
    )


def test_43_5_a_vehicle_that_begins_far_from_every_road_is_named(tmp_path):
    # A position beyond the end of the road is moved to that end, with a notice.
    _, said = told(placed(tmp_path, 1000.0, 2000.0))
    assert said.startswith("far from every road: Ego is ")
    away = float(said.split(" is ")[1].split(" m ")[0])
    assert 1900.0 < away < 2300.0
    assert "from the nearest lane at 0.00 s; check that the road file" in said


def test_43_5_a_vehicle_that_gets_far_from_every_road_is_named_with_the_instant(tmp_path):
    away = trajectory((0.0, 0.0, 300.0), (1.0, 0.0, 330.0), times=True)
    path = placed(tmp_path, 0.0, 0.0, story=story_of(event("e", away, time_trigger("1.9"))))
    (said,) = told(path)
    assert " m from the nearest lane at 2.00 s; to find all that leave it, search with `critical_if` 'ego" in said


def test_the_first_of_many_scenarios_far_from_every_road_is_named_and_the_others_are_counted(tmp_path):
    away = trajectory((0.0, 0.0, 0.0), (1.0, 0.0, 330.0), times=True).replace('y="330.0"', 'y="$reach"')
    path = scenario_file(
        tmp_path, entities=body("Ego", "Vehicle") + body("B", "Pedestrian"),
        init=f'<Private entityRef="Ego">{at(0.0, 0.0)}</Private><Private entityRef="B">{at(250.0, 0.0)}</Private>',
        story=story_of(event("e", away, time_trigger("1.9"))), stop=time_trigger("3"),
        parameters='<ParameterDeclaration name="reach" parameterType="double" value="0"/>',
    )  # fmt: skip
    study = cornercase(
        "explore", path, "--ego", "Ego", "--other", "B", "--metric", "distance", "--range", "reach=0:400:100",
        "--optimizer", "grid", "--budget", 5, "-o", tmp_path / "s.db",
    )  # fmt: skip
    assert study.returncode == 0, study.stderr
    (said,) = (line for line in study.stderr.splitlines() if line.startswith("Far from every road: "))
    assert re.fullmatch(
        r"Far from every road: Ego is \d+ m from the nearest lane at \d\.00 s of scenario 2, and so in 3 more of 5 runs;"
        r" to find all that leave it, search with --critical-if 'ego leaves the road'\.",
        said,
    ), study.stderr


@pytest.mark.parametrize(
    ("kind", "far", "named"),
    [("Vehicle", 40.0, True), ("Vehicle", 5.0, False)]
    + [(kind, 40.0, False) for kind in ("Pedestrian", "MiscObject")]
    + [(kind, 90.0, True) for kind in ("Pedestrian", "MiscObject")],
)
def test_43_5_who_may_be_beside_a_road_is_far_at_50_m(tmp_path, kind, far, named):
    # The lanes of the road reach from -4 to 4.
    assert bool(told(placed(tmp_path, 250.0, 4.0 + far, kind))) == named


def test_43_5_without_roads_nobody_is_far_from_them(tmp_path):
    path = placed(tmp_path, 1000.0, 2000.0)
    text = path.read_text(encoding="utf-8")
    begin, end = text.index("<RoadNetwork>"), text.index("</RoadNetwork>")
    path.write_text(text[:begin] + "<RoadNetwork>" + text[end:], encoding="utf-8")
    assert told(path) == []


def cut(folder: Path, stop: str, story: str = "", init: str = "") -> list[str]:
    init = f'<Private entityRef="Ego">{teleport("10")}{speed_action("1")}{init}</Private>'
    return told(scenario_file(folder, init=init, story=story, stop=stop, entities=car("Ego")), duration=2.0)


CUT = (
    "cut off: the run was ended by the maximum duration, 2 s, before the scenario came to its end; use a longer"
    " `duration` to see the rest"
)


def test_43_5_a_run_whose_stop_trigger_has_not_come_is_cut_off(tmp_path):
    assert cut(tmp_path, time_trigger("2.1")) == [CUT]
    # It ends at the last time step, or before.
    assert cut(tmp_path, time_trigger("2")) == []
    assert cut(tmp_path, time_trigger("1")) == []


def test_43_5_a_scenario_without_an_end_is_not_cut_off(tmp_path):
    assert cut(tmp_path, "") == []
    never = (
        "<ByValueCondition><TimeOfDayCondition dateTime='2020-01-01T00:00:00' rule='greaterThan'/></ByValueCondition>"
    )
    condition = (
        f"<ConditionGroup><Condition name='c' delay='0' conditionEdge='none'>{never}</Condition></ConditionGroup>"
    )
    assert cut(tmp_path, condition) == []


def test_43_5_an_act_that_has_not_stopped_is_cut_off(tmp_path):
    act = story_of(event("e", speed_action("2"), time_trigger("5")))
    for value, said in (("9", [CUT]), ("1.5", [])):
        stopped = act.replace("</Act>", f"<StopTrigger>{time_trigger(value)}</StopTrigger></Act>")
        assert stopped != act
        assert cut(tmp_path, "", stopped) == said


def test_43_5_a_trajectory_with_times_that_goes_on_is_cut_off(tmp_path):
    for seconds, said in ((5.0, [CUT]), (1.5, [])):
        follow = trajectory((0.0, 10.0, 0.0), (seconds, 30.0, 0.0), times=True)
        assert cut(tmp_path, "", story_of(event("e", follow, time_trigger("0")))) == said


def test_43_5_each_command_counts_the_runs_that_are_cut_off_once(tmp_path):
    ranges = ["--range", "c_start_time=1:2", "--optimizer", "sobol", "--budget", 4, "--duration", 1]
    t = EXAMPLES / "t_intersection" / "t_intersection.xosc"
    done = cornercase(
        "explore", t, "--ego", "Ego", "--other", "C", "--metric", "distance", *ranges, "-o", tmp_path / "s.db"
    )
    said = [line for line in done.stderr.splitlines() if line.startswith("Cut off: ")]
    assert said == [
        "Cut off: 4 of 4 runs were ended by the maximum duration, 1 s, before the scenario came to its end; use a"
        " longer --duration to see the rest."
    ]
    many = cornercase("simulate", X, t, "--duration", 1, "-o", tmp_path / "recordings")
    assert "Cut off: 2 of 2 runs were ended by" in many.stderr


def test_43_5_a_recording_says_whether_it_was_cut_off_and_its_file_keeps_its_bytes(tmp_path):
    init = f'<Private entityRef="Ego">{teleport("10")}{speed_action("1")}</Private>'
    path = scenario_file(tmp_path, init=init, story="", stop=time_trigger("2.1"), entities=car("Ego"))
    run = cc.simulate(path, duration=2.0)
    assert run.is_truncated is True
    assert cc.simulate(path, duration=3.0).is_truncated is False
    run.to_csv(tmp_path / "r.csv")
    assert "cut" not in (tmp_path / "r.csv").read_text(encoding="utf-8")
    assert cc.recordings.read_recording(tmp_path / "r.csv").is_truncated is None


def test_43_5_a_study_in_which_nobody_drives_the_ego_says_so(tmp_path):
    undriven = tmp_path / "t.xosc"
    text = (EXAMPLES / "t_intersection" / "t_intersection.xosc").read_text(encoding="utf-8")
    text = text.replace('filepath="', f'filepath="{ROAD.parent}/').replace("cornercase.driver", "another.driver")
    undriven.write_text(text, encoding="utf-8")

    def said(scenario: Path, *options: object) -> str:
        return cornercase(
            "explore", scenario, "--ego", "Ego", "--other", "C", "--metric", "distance", "--range", "c_start_time=1:2",
            "--optimizer", "sobol", "--budget", 1, "--duration", 0.1, *options, "-o", tmp_path / f"{len(options)}.db",
        ).stderr  # fmt: skip

    nobody = "Nobody drives Ego: it follows the scenario and does not react; give it a driver with --driver, as in Ego=normal.\n"
    assert nobody in said(undriven)
    with cc.study.StudyFile.open(tmp_path / "0.db", readonly=True) as study:
        assert study.meta.roles_text == (
            "Under test: Ego, which follows the storyboard and does not react (--driver Ego=normal drives it),"
            f" against C. Simulator: builtin, cornercase {cc.__version__}."
        )
    assert "Nobody drives" not in said(undriven, "--driver", "Ego=simple")
    assert nobody in said(undriven, "--driver", "C=simple", "--seed", 1)
    assert "Nobody drives" not in said(EXAMPLES / "t_intersection" / "t_intersection.xosc", "--seed", 2, "--seed", 3)
    (tmp_path / "suite").mkdir()
    (tmp_path / "suite" / undriven.name).write_text(undriven.read_text(encoding="utf-8"), encoding="utf-8")
    test = ["test", tmp_path / "suite", "--ego", "Ego", "--other", "C", "--require", "no collision", "--duration", 1]
    assert nobody in cornercase(*test, "-o", tmp_path / "undriven.db").stderr
    assert "Nobody drives" not in cornercase(*test, "--driver", "Ego=normal", "-o", tmp_path / "driven.db").stderr
    # A single run is not a study.
    assert "Nobody drives" not in cornercase("simulate", undriven, "-o", tmp_path / "r.csv").stderr


@pytest.mark.parametrize(("x", "beyond"), [(540.0, True), (-20.0, True), (500.5, False), (250.0, False)])
def test_43_5_a_place_beyond_the_end_of_a_road_is_said_to_be_that_end(tmp_path, x, beyond):
    said = [one for one in told(placed(tmp_path, x, -1.5)) if "Ego lies beyond the end of the nearest road" in one]
    assert len(said) == beyond
    assert all(re.search(r"\(scenario.xosc, line \d+: <TeleportAction> of <Init>\)", one) for one in said)


def test_a_last_instant_just_below_a_whole_second_is_checked(tmp_path):
    scenario = ConcreteScenario(placed(tmp_path, 250.0, 44.0))
    (recording,) = ran(Builtin(time_step=0.1, duration=1.0), [scenario])
    rounded = replace(recording, time=np.concatenate([[0.0], np.cumsum(np.full(10, 0.1))]))
    assert rounded.time[-1] < 1.0
    network = RoadNetwork.read(tmp_path / "road.xodr")
    ((name, away, time),) = find_entities_far_from_roads(network, rounded)
    assert (name, time) == ("Ego", 0.0)
    assert away == pytest.approx(40.0, abs=0.1)
