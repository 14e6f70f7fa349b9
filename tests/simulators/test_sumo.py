"""SUMO as a simulator; these run the real one."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import psutil
import pytest

import cornercase as cc
from conftest import ran, same_recording
from cornercase._common.errors import InputError
from cornercase.drivers import EquippedDriver
from cornercase.drivers._system_under_test import PerScenarioDriver
from cornercase.drivers.vehicles._vehicle_model import VEHICLES
from cornercase.exploration._paper_examples import paper_experiment_config
from cornercase.recordings import read_recording
from cornercase.report._rerun import rerun_payload
from cornercase.scenario import ConcreteScenario
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators import SIMULATORS, Builtin, Sumo, list_simulators
from cornercase.simulators._create import create_simulator
from cornercase.simulators.sumo._network import find_or_convert_network
from cornercase.study import StudyFile
from helpers.command_line import cornercase
from helpers.waiting import until

pytest.importorskip("libsumo", reason="SUMO comes with the extra 'sumo'")

EXAMPLES = Path(__file__).parents[2] / "examples"
X = EXAMPLES / "x_intersection" / "x_intersection.xosc"
T = EXAMPLES / "t_intersection" / "t_intersection.xosc"


def run(path, values, kind=Sumo, **options):
    (found,) = kind(**options).run([ConcreteScenario(path, values)])
    assert not isinstance(found, Exception), found
    return found


def of(recording, entity):
    k = recording.names.index(entity)
    return {name: getattr(recording, name)[k] for name in ("x", "y", "heading", "speed", "acceleration")}


def t_intersection_with_ego_at(tmp_path, start, routing=r"\g<0>"):
    """Copy the T-intersection without an end, and with another place and route for the ego."""
    before, _, story = T.read_text().partition('<Private entityRef="Ego">')
    ego, _, rest = story.partition("</Private>")
    ego = re.sub("<LanePosition .*?/>", start, ego, count=1)
    ego = re.sub("<RoutingAction>.*</RoutingAction>", routing, ego, flags=re.DOTALL)
    rest = rest[: rest.rindex("<StopTrigger>")] + "<StopTrigger/></Storyboard></OpenSCENARIO>"
    path = tmp_path / T.name
    path.write_text(f'{before}<Private entityRef="Ego">{ego}</Private>{rest}')
    (tmp_path / "t_intersection.xodr").write_bytes(T.with_suffix(".xodr").read_bytes())
    return path


@pytest.mark.parametrize("kind", ["cautious", "normal", "aggressive"])
def test_the_ego_drives_its_way_as_fast_as_it_is_asked_to(kind):
    recording = run(T, {"c_start_time": 5.0}, drivers={"Ego": kind}, on_collision="stop")
    ego = of(recording, "Ego")
    assert (ego["x"][0], ego["y"][0]) == pytest.approx((1.75, -92.0), abs=0.05)
    assert ego["speed"].max() <= 10.0 + 1e-6
    steps = np.hypot(np.diff(ego["x"]), np.diff(ego["y"])) / 0.05
    # Positions and speeds are consistent, also in bends where the rear axle cuts the corner.
    assert np.abs(steps - 0.5 * (ego["speed"][1:] + ego["speed"][:-1])).max() < 1.0
    assert np.abs(np.diff(np.unwrap(ego["heading"]))).max() < 0.1
    if not recording.collisions:
        # It has turned right and arrived.
        assert ego["heading"][-1] == pytest.approx(0.0, abs=0.05)
        assert ego["y"][-1] == pytest.approx(-1.75, abs=0.1)


def test_a_vehicle_stays_at_the_end_of_its_way(tmp_path):
    path = t_intersection_with_ego_at(tmp_path, '<LanePosition roadId="2" laneId="1" s="10"/>')
    ego = of(run(path, {}, drivers={"Ego": "normal"}, duration=4.0), "Ego")
    assert ego["x"][0] == pytest.approx(152.0, abs=0.05)
    assert 156.0 < ego["x"][-1] < 162.0
    assert (ego["x"][-20:] == ego["x"][-1]).all()
    assert ego["speed"][-1] == 0.0


# On the way to the right, and where the ways to the right and to the left begin on top of each other.
@pytest.mark.parametrize(("road", "s", "way"), [(206, 8.0, 1.0), (205, 0.5, -1.0)])
def test_a_vehicle_may_start_on_a_junction(tmp_path, road, s, way):
    path = t_intersection_with_ego_at(tmp_path, f'<LanePosition roadId="{road}" laneId="-1" s="{s}"/>')
    ego = of(run(path, {}, drivers={"Ego": "normal"}, duration=4.0), "Ego")
    assert np.hypot(np.diff(ego["x"]), np.diff(ego["y"])).max() < 2.0
    assert np.cos(ego["heading"][-1]) == pytest.approx(way, abs=0.05)


def test_a_vehicle_ignores_a_trajectory(tmp_path):
    vertices = "".join(
        f'<Vertex time="{y / 10.0}"><Position><WorldPosition x="{1.75 + y}" y="{-92.0 + y}" h="0.8"/></Position></Vertex>'
        for y in (0.0, 50.0)
    )
    trajectory = f"""<RoutingAction><FollowTrajectoryAction>
        <TrajectoryRef><Trajectory name="t" closed="false"><Shape><Polyline>{vertices}</Polyline></Shape></Trajectory></TrajectoryRef>
        <TimeReference><None/></TimeReference><TrajectoryFollowingMode followingMode="position"/>
        </FollowTrajectoryAction></RoutingAction>"""
    start = '<LanePosition roadId="3" laneId="-1" s="20"/>'
    path = t_intersection_with_ego_at(tmp_path, start, trajectory)
    ego = of(run(path, {}, drivers={"Ego": "normal"}, duration=4.0), "Ego")
    assert ego["x"] == pytest.approx(1.75, abs=0.1)
    assert ego["y"][-1] == pytest.approx(-52.0, abs=2.0)


def test_tempers_differ():
    ends = {kind: run(T, {"c_start_time": 5.0}, drivers={"Ego": kind}).time[-1] for kind in ("cautious", "aggressive")}
    assert ends["aggressive"] < ends["cautious"] - 0.5


def test_all_others_move_as_in_the_builtin_simulator():
    values = {"ego_start": 40.0, "pedestrian_wait": 5.0, "p1_speed": 7.0}
    ours, theirs = run(X, values), run(X, values, Builtin)
    shared = min(ours.time.size, theirs.time.size)
    for name in ("Truck", "C", "Pedestrian"):
        for key in ("x", "y", "heading", "speed"):
            np.testing.assert_array_equal(of(ours, name)[key][:shared], of(theirs, name)[key][:shared])
    assert ours.names == theirs.names
    assert ours.object_types == theirs.object_types


def test_the_ego_stops_for_a_pedestrian_in_its_lane_and_not_for_one_beside_the_road():
    # The pedestrian steps out before the ego arrives, or long after it has passed.
    early = of(run(X, {"ego_start": 20.0, "pedestrian_wait": 7.5}), "Ego")
    late = of(run(X, {"ego_start": 20.0, "pedestrian_wait": 20.0}), "Ego")
    assert early["speed"][20:].min() < 0.5
    assert late["speed"][20:].min() > 3.0


def test_a_driver_of_cornercase_drives_too():
    values = {"c_start_time": 5.0}
    builtin = of(run(T, values, Builtin, drivers={"Ego": "simple"}), "Ego")
    here = of(run(T, values, drivers={"Ego": "simple"}), "Ego")
    np.testing.assert_array_equal(builtin["x"], here["x"])


class Aeb(cc.SystemUnderTest):
    """Keeps its speed, and brakes when it would soon hit something."""

    def step(self, view, dt):
        leader = view.leader
        return -8.0 if leader is not None and leader.gap < 2.0 * leader.closing else 0.0


def test_a_function_of_the_user_drives_as_in_the_builtin_simulator():
    function = PerScenarioDriver(Aeb())
    # On the motorway the ego starts faster than the road allows.
    for path in (X, EXAMPLES / "r157" / "cut_in.xosc"):
        for driver in (function, EquippedDriver(function, vehicle=VEHICLES.create("kinematic"))):
            options = {"drivers": {"Ego": driver}, "duration": 6.0}
            assert same_recording(run(path, {}, **options), run(path, {}, Builtin, **options))


def test_models_of_sumo_take_no_equipment():
    for spec, driven in (
        ("normal + kinematic", False),
        ("normal:horizon=4 + kinematic", True),
        ("simple + kinematic", True),
    ):
        simulator = Sumo(drivers={"Ego": spec}, duration=1.0)
        if driven:
            ran(simulator, [ConcreteScenario(X, {})])
            continue
        with pytest.raises(InputError, match=r"'Ego' asks .* 'normal' is SUMO's own model.* leave out 'kinematic'"):
            simulator.check_supported(ScenarioFile.read(X))


def test_the_same_gives_the_same_whatever_ran_before():
    simulator = Sumo(on_collision="stop")
    concretes = [ConcreteScenario(T, {"c_start_time": c, "ego_sync_s": 12.0}) for c in (0.5, 3.0, 0.5)]
    first, other, again = ran(simulator, concretes)
    np.testing.assert_array_equal(first.x, again.x)
    np.testing.assert_array_equal(first.speed, again.speed)
    assert first.collisions == again.collisions
    assert not np.array_equal(first.x[:, : other.time.size], other.x[:, : first.time.size])


def test_a_crash_ends_the_run_or_does_not():
    space = paper_experiment_config("t-intersection").logical.space
    rng = np.random.default_rng(0)
    for values in space.values(space.snap(rng.random((40, space.dimension)))):
        ended = run(T, values, on_collision="stop")
        if ended.collisions:
            break
    assert ended.collisions[0].entities == ("Ego", "C")
    assert ended.time[-1] == pytest.approx(ended.collisions[0].time, abs=0.051)


def test_a_road_file_that_is_not_there_is_said(tmp_path):
    path = tmp_path / "t.xosc"
    path.write_text(T.read_text())
    with pytest.raises(InputError, match=r"t_intersection.xodr: cannot be read \(No such file or directory\)"):
        find_or_convert_network(ScenarioFile.read(path))


def test_the_network_is_the_scenarios(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first = find_or_convert_network(ScenarioFile.read(T))
    assert first.name.endswith(".net.xml")
    assert first.is_relative_to(tmp_path)
    stamp = first.stat().st_mtime_ns
    assert find_or_convert_network(ScenarioFile.read(T)) == first
    assert first.stat().st_mtime_ns == stamp
    with monkeypatch.context() as context:
        # Another SUMO may convert the roads in another way.
        context.setattr("cornercase.simulators.sumo._network.version", lambda package: "0.1")
        assert find_or_convert_network(ScenarioFile.read(T)) != first
    given = tmp_path / "own.net.xml"
    given.write_bytes(first.read_bytes())
    assert find_or_convert_network(ScenarioFile.read(T), str(given)) == given
    a, b = run(T, {}, network=str(given)), run(T, {})
    np.testing.assert_array_equal(a.x, b.x)


def test_refuses_in_one_sentence(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="no such network file"):
        run(T, {}, network=str(tmp_path / "none.net.xml"))
    with pytest.raises(InputError, match="seed of SUMO is -1"):
        Sumo(seed=-1)
    with pytest.raises(InputError, match="did you mean 'aggressive'"):
        run(T, {}, drivers={"Ego": "agressive"})
    with pytest.raises(InputError, match="known are: aggressive, cautious, cc-human"):
        run(T, {}, drivers={"Ego": "xyz"})
    bare = tmp_path / "bare.xosc"
    bare.write_text(X.read_text().replace('<LogicFile filepath="x_intersection.xodr"/>', ""))
    with pytest.raises(InputError, match="no road network"):
        run(bare, {})
    broken = tmp_path / "broken.xosc"
    broken.write_text(X.read_text().replace("x_intersection.xodr", "broken.xodr"))
    (tmp_path / "broken.xodr").write_text("<OpenDRIVE><road")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(InputError, match=r"broken.xodr: netconvert cannot convert it"):
        run(broken, {})
    # netconvert itself would open the file that an entity names.
    for hostile in (
        '<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/hostname">]><OpenDRIVE>&x;</OpenDRIVE>',
        "<OpenDRIVE>&x;",
    ):
        (tmp_path / "broken.xodr").write_text(hostile)
        with pytest.raises(InputError, match=r"netconvert cannot convert it \(.*(document type|not well-formed)"):
            run(broken, {})
    assert not list((tmp_path / "cornercase" / "sumo").glob("*.net.xml"))
    monkeypatch.setattr("cornercase.simulators.sumo._simulator.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install 'cornercase\[sumo\]'"):
        list(SIMULATORS.create("sumo").run([]))


def test_the_list_says_what_is_here():
    found = list_simulators()
    assert found["builtin"].problem == found["sumo"].problem == ""
    assert found["sumo"].version
    shown = cornercase("simulators")
    assert shown.returncode == 0
    assert "sumo" in shown.stdout
    assert json.loads(cornercase("simulators", "--json").stdout)["sumo"]["missing"] == ""


@pytest.mark.slow
def test_one_scenario_is_recorded_as_in_an_exploration(tmp_path):
    recording = cc.simulate(T, simulator="sumo", duration=5.0)
    with create_simulator("sumo", {"duration": 5.0}) as simulator:
        (expected,) = simulator.run([ConcreteScenario(T, {})])
    assert same_recording(recording, expected)
    ended = cornercase("simulate", T, "--simulator", "sumo", "--duration", "5", "-o", tmp_path / "r.csv")
    assert (ended.returncode, read_recording(tmp_path / "r.csv").names) == (0, recording.names)


COMMON = [
    "--ego", "Ego", "--other", "C", "--metric", "ttc", "--simulator", "sumo", "--on-collision", "stop",
    "--space", EXAMPLES / "t_intersection" / "t_intersection.space.xosc", "--optimizer", "sobol",
]  # fmt: skip


@pytest.mark.slow
def test_the_command_of_the_report_records_a_scenario_again(tmp_path):
    assert (
        cornercase("explore", T, *COMMON, "--budget", "2", "--duration", "5", "-o", tmp_path / "s.db").returncode == 0
    )
    with StudyFile.open(tmp_path / "s.db") as study:
        command = rerun_payload(study, T)["command"]
        row, explored = study.rows()[0], study.recording(1)
    assert command["before"] == ["cornercase", "simulate", T.name]
    values = [f"--set={name}={value!r}" for name, value in row.values.items()]
    ended = cornercase("simulate", T, *values, *command["after"], "-o", tmp_path / "r.csv")
    assert ended.returncode == 0
    explored.to_csv(tmp_path / "explored.csv")
    assert (tmp_path / "r.csv").read_bytes() == (tmp_path / "explored.csv").read_bytes()


def one_is_done(path):
    try:
        with StudyFile.open(path, readonly=True) as study:
            return bool(study.finished_rows())
    except InputError:
        return False


@pytest.mark.slow
def test_a_killed_worker_changes_nothing(tmp_path):
    quiet, killed = tmp_path / "quiet.db", tmp_path / "killed.db"
    assert cornercase("explore", T, *COMMON, "--budget", "12", "-o", quiet).returncode == 0
    command = [
        sys.executable,
        "-c",
        "from cornercase.cli import main; main()",
        "explore",
        T,
        *COMMON,
        "--budget",
        "12",
        "-o",
        killed,
    ]
    with subprocess.Popen([str(one) for one in command], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        victim = None
        while process.poll() is None and victim is None:
            # A process that is starting or ending has no command line.
            with suppress(psutil.Error):
                for child in psutil.Process(process.pid).children():
                    if "multiprocessing.spawn" in " ".join(child.cmdline()):
                        victim = child
        # By then it has reached at least the second one.
        until(lambda: process.poll() is not None or one_is_done(killed))
        assert victim is not None
        victim.kill()
        _, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    with StudyFile.open(quiet, readonly=True) as one, StudyFile.open(killed, readonly=True) as other:
        assert [row.id for row in other.finished_rows()] == list(range(1, 13))
        assert other.failed_rows() == []
        np.testing.assert_array_equal(one.scores("ttc"), other.scores("ttc"))
        np.testing.assert_array_equal(one.recording(5).x, other.recording(5).x)


@pytest.mark.slow
@pytest.mark.parametrize("budget", [12, 60])
def test_the_t_intersection_from_end_to_end(tmp_path, budget):
    workers = ("--workers", "2") if budget == 60 else ()
    done = cornercase("demo", "t-intersection", "--simulator", "sumo", "--budget", budget, *workers, "-o", tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "report.html").exists()
    with StudyFile.open(tmp_path / "study.db", readonly=True) as study:
        assert len(study.finished_rows()) == budget
        info = study.read_analysis("ego-trajectory", "labels")[1]
    if budget < 60:
        return
    crashed = "Ego and C collide"
    homes = [one for one in info["profiles"] if crashed in one["outcomes"]]
    assert len(homes) == 1
    assert homes[0]["outcomes"] == {crashed: homes[0]["size"]}
    assert homes[0]["size"] >= 5


@pytest.mark.slow
def test_the_x_intersection_from_end_to_end(tmp_path):
    done = cornercase(
        "demo", "x-intersection", "--simulator", "sumo", "--budget", "30", "--workers", "2", "-o", tmp_path
    )
    assert done.returncode == 0, done.stderr
    with StudyFile.open(tmp_path / "study.db", readonly=True) as study:
        assert len(study.finished_rows()) == 30
        assert study.meta.settings["sumo"]
    assert len(list((tmp_path / "reduced").glob("*.xosc"))) == 3
