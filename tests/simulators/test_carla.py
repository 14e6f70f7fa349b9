"""The CARLA adapter with a test server that implements CARLA's protocol, without CARLA.

With CARLA_HOST set to a host or host:port, the tests of runs use the CARLA that listens there instead.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tomllib
import venv
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
from lxml import etree
from packaging.requirements import Requirement

from conftest import AXLES, ran
from cornercase._common.errors import InputError, SimulationError
from cornercase.recordings import Collision, Recording
from cornercase.scenario import ConcreteScenario
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._xml import read_xml
from cornercase.simulators import Carla
from cornercase.simulators._server_addresses import worker_address
from cornercase.simulators.carla import _controller_assignment as dialect
from cornercase.simulators.carla._openscenario_1_0 import ConversionOptions, write_openscenario_1_0
from cornercase.simulators.carla._runner_environment import RunnerEnvironment
from cornercase.simulators.pool._simulator import WorkerSimulator
from cornercase.study import StudyFile
from helpers.carla_or_stand_in import AGAIN_IF_THE_CLIENT_CRASHES, REAL, Served, free_port
from helpers.command_line import cornercase
from helpers.waiting import until

carla = pytest.importorskip("carla", reason="the extra 'carla' is not installed")

pytestmark = AGAIN_IF_THE_CLIENT_CRASHES
HERE = Path(__file__).parents[1]
EXAMPLES = HERE.parent / "examples"
T = EXAMPLES / "t_intersection" / "t_intersection.xosc"
ROAD = T.with_suffix(".xodr")
RUNNER = HERE / "fake_scenario_runner"
STUB_ONLY = pytest.mark.skipif(bool(REAL), reason="what goes wrong is made by the stand-in")
# A real car needs time to reach its speed.
NEAR = 3.0 if REAL else 0.3


def options(server, **more):
    return {
        "hosts": server.host, "port": server.port, "scenario_runner": str(RUNNER), "python": sys.executable,
        "patience": 20.0 if REAL else 3.0,
    } | more  # fmt: skip


@pytest.fixture
def scenario(tmp_path):
    """Ego drives east at 10 m/s, C stands on its path 40 m ahead, a walker crosses behind it."""

    def vehicle(name):
        return f"""<ScenarioObject name="{name}"><Vehicle name="car" vehicleCategory="car"><ParameterDeclarations/>
<Performance maxSpeed="60" maxAcceleration="9" maxDeceleration="9"/><BoundingBox><Center x="1.4" y="0" z="0.7"/>
<Dimensions length="4" width="2" height="1.5"/></BoundingBox><Axles>{AXLES}</Axles><Properties/></Vehicle>
</ScenarioObject>"""

    def at(name, x, y, h, speed):
        return f"""<Private entityRef="{name}"><PrivateAction><TeleportAction><Position><WorldPosition x="{x}" y="{y}"
h="{h}"/></Position></TeleportAction></PrivateAction><PrivateAction><LongitudinalAction><SpeedAction><SpeedActionDynamics
dynamicsShape="step" dynamicsDimension="time" value="0"/><SpeedActionTarget><AbsoluteTargetSpeed value="{speed}"/>
</SpeedActionTarget></SpeedAction></LongitudinalAction></PrivateAction></Private>"""

    path = tmp_path / "straight.xosc"
    path.write_text(f"""<?xml version="1.0"?>
<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="2026-11-21T00:00:00" author="" description="straight"/>
<ParameterDeclarations><ParameterDeclaration name="gap" parameterType="double" value="40"/>
<ParameterDeclaration name="end" parameterType="double" value="6"/></ParameterDeclarations><CatalogLocations/>
<RoadNetwork><LogicFile filepath="road.xodr"/></RoadNetwork><Entities>{vehicle("Ego")}{vehicle("C")}
<ScenarioObject name="Walker"><Pedestrian name="w" mass="80" pedestrianCategory="pedestrian"><ParameterDeclarations/>
<BoundingBox><Center x="0" y="0" z="0.9"/><Dimensions length="0.5" width="0.6" height="1.8"/></BoundingBox><Properties/>
</Pedestrian></ScenarioObject></Entities><Storyboard><Init><Actions>{at("Ego", -80, -1.75, 0, 10)}
{at("C", "${-80 + $gap}", -1.75, 0, 0)}{at("Walker", -95, -8, 1.5707963, 1.5)}</Actions></Init>
<Story name="s"><ParameterDeclarations/><Act name="a"><ManeuverGroup name="g" maximumExecutionCount="1"><Actors
selectTriggeringEntities="false"/></ManeuverGroup><StartTrigger/></Act></Story><StopTrigger><ConditionGroup>
<Condition name="end" delay="0" conditionEdge="none"><ByValueCondition><SimulationTimeCondition value="$end"
rule="greaterThan"/></ByValueCondition></Condition></ConditionGroup></StopTrigger></Storyboard></OpenSCENARIO>""")
    (tmp_path / "road.xodr").write_bytes(ROAD.read_bytes())
    return path


def run(server, scenario, values=None, **more):
    with Carla(**options(server, **more)) as simulator:
        (found,) = ran(simulator, [ConcreteScenario(scenario, values or {})])
    return found


def test_motion_is_in_the_axes_of_the_scenario_and_collisions_go_on(scenario):
    with Served(ROAD) as server:
        found = run(server, scenario)
    assert found.names == ("Ego", "C", "Walker")
    assert found.object_types == ("car", "car", "pedestrian")
    assert 5.8 <= found.time[-1] <= 6.2
    np.testing.assert_allclose(np.diff(found.time), 0.05, atol=1e-12)
    # From the begin of the storyboard on, without the frames in which vehicles fall on their wheels.
    # A recording of CARLA has the middle of each entity, which the scenario has 1.4 m ahead of the rear axle.
    assert np.abs(found.x[0] - (-78.6 + 10 * found.time)).max() < NEAR
    assert np.abs(found.y[0] + 1.75).max() < NEAR
    assert np.abs(found.speed[0] - 10).max() < NEAR
    assert np.abs(found.x[1] + 38.6).max() < NEAR
    # To the left of an entity that drives east, as in the scenario and unlike in CARLA.
    assert found.y[2][-1] - found.y[2][0] == pytest.approx(1.5 * found.time[-1], abs=NEAR)
    assert found.heading[2][-1] == pytest.approx(np.pi / 2, abs=0.05)
    if not REAL:
        np.testing.assert_allclose(found.length, [4.8, 4.8, 0.4], rtol=1e-6)
        np.testing.assert_allclose(found.width, [2.0, 2.0, 0.4], rtol=1e-6)
    (collision,) = found.collisions
    assert collision.entities == ("Ego", "C")
    assert collision.time in found.time


def test_a_collision_in_the_first_frame_is_not_lost(scenario):
    with Served(ROAD) as server:
        found = run(server, scenario, {"gap": 5.0, "end": 1.0})
    assert [(one.time, one.entities) for one in found.collisions] == [(pytest.approx(0.05), ("Ego", "C"))]


def test_a_collision_or_the_duration_may_end_the_run(scenario):
    with Served(ROAD) as server:
        stopped = run(server, scenario, on_collision="stop")
        assert [one.entities for one in stopped.collisions] == [("Ego", "C")]
        assert stopped.time[-1] == stopped.collisions[0].time < 5.0
        short = run(server, scenario, {"end": 50.0}, duration=2.0)
        assert short.time[-1] == pytest.approx(2.0)
        assert short.collisions == ()


def test_the_recorders_file_tells_the_same(scenario, tmp_path):
    with Served(ROAD) as server:
        one = run(server, scenario)
        other = run(server, scenario, record="recorder", folder=str(tmp_path / "kept"))
    assert other.names == one.names
    assert other.object_types == one.object_types
    np.testing.assert_array_equal(one.time, other.time)
    for name in ("x", "y", "heading"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=NEAR / 10)
    assert [c.entities for c in other.collisions] == [("Ego", "C")]
    (kept,) = (tmp_path / "kept").iterdir()
    assert {"cornercase.xosc", "cornercase.log", "scenario_runner.log"} <= {file.name for file in kept.iterdir()}
    # Files that a scenario names are not on Python's path.
    assert [file.name for file in (kept / "road").iterdir()] == ["road.xodr"]
    assert [file.name for file in (kept / "drivers").iterdir() if file.suffix] == ["cornercase_trajectory.py"]
    assert not [file for file in kept.iterdir() if file.suffix in (".py", ".xodr")]


def test_the_recorders_file_is_cut_as_well(scenario, tmp_path):
    with Served(ROAD) as server:
        found = run(server, scenario, record="recorder", on_collision="stop")
    assert found.time[-1] == found.collisions[0].time


def test_one_server_runs_many_and_is_left_as_it_was(scenario):
    with Served(ROAD) as server:
        simulator = Carla(**options(server))
        found = ran(simulator, [ConcreteScenario(scenario, {"gap": gap, "end": 1.0}) for gap in (20.0, 30.0)])
        assert [round(one.x[1][-1]) for one in found] == [-59, -49]
        world = carla.Client(server.host, server.port).get_world()
        assert not world.get_settings().synchronous_mode
        assert not world.get_settings().no_rendering_mode
        assert not [one for one in world.get_actors() if one.type_id.startswith(("vehicle", "walker", "sensor"))]


@pytest.mark.parametrize(("given", "renders"), [({}, False), ({"rendering": True}, True)])
def test_pictures_are_drawn_during_runs_only_if_wished(scenario, given, renders):
    with Served(ROAD) as server:
        simulator = Carla(**options(server), **given)
        simulator._server.connect(simulator._environment)
        simulator._server.prepare("", "")
        settings = carla.Client(server.host, server.port).get_world().get_settings()
        assert settings.no_rendering_mode is not renders
        simulator.close()


def test_one_of_carlas_maps_is_loaded_by_its_name_and_a_road_file_by_its_text(scenario):
    town = scenario.with_name("town.xosc")
    town.write_text(scenario.read_text().replace("road.xodr", "Town02"))
    with Served(ROAD) as server:
        # In a process of its own, as always: CARLA's client may abort while a world is replaced.
        simulator = WorkerSimulator("carla", options(server))
        try:
            for path, name in ((town, "Town02"), (scenario, "OpenDriveMap"), (town, "Town02")):
                (found,) = ran(simulator, [ConcreteScenario(path, {"end": 0.5})])
                assert found.names == ("Ego", "C", "Walker")
                # A new one, as clients keep the map that they know.
                assert carla.Client(server.host, server.port).get_world().get_map().name.endswith(name)
        finally:
            simulator.close()


@STUB_ONLY
def test_a_map_that_the_server_does_not_have_is_said(scenario):
    town = scenario.with_name("town.xosc")
    town.write_text(scenario.read_text().replace("road.xodr", "Town99"))
    with (
        Served(ROAD) as server,
        pytest.raises(InputError, match=r"on localhost:\d+ has no map 'Town99', only Town01, Town02; install it there"),
    ):
        run(server, town)


def test_the_check_of_a_file_names_parameters_that_an_agent_overrides(tmp_path):
    x = EXAMPLES / "x_intersection" / "x_intersection.xosc"
    driven = cornercase("check", x, "--simulator", "carla", "--sut", "Ego=cautious")
    assert driven.returncode == 0
    said = "carla: the parameter ego_speed sets only the first speed of Ego, as an agent drives from then on"
    assert said in driven.stdout.splitlines()
    assert "carla: without effect: <ObjectController>" in driven.stdout
    obeying = cornercase("check", x, "--simulator", "carla", "--sut", "Ego=cc-human")
    assert obeying.returncode == 0
    assert "ego_speed sets" not in obeying.stdout
    # Nothing is said twice, and nothing without the simulator.
    assert "sumo: " not in cornercase("check", x, "--simulator", "sumo").stdout
    assert "carla" not in cornercase("check", x).stdout


def test_the_check_of_a_file_says_that_carla_refuses_it():
    braking = EXAMPLES / "r157" / "deceleration.xosc"
    refused = cornercase("check", braking, "--simulator", "carla")
    assert refused.returncode == 1
    assert f"carla cannot run it: {braking}: 'Ego' has the driver 'cc-human'" in refused.stdout
    misspelled = cornercase("check", braking, "--simulator", "carla:nope=3")
    assert misspelled.returncode == 2
    assert "has no option 'nope'" in misspelled.stderr


def test_values_at_fault_cost_their_scenario_only(tmp_path):
    """A number that is none is no reason to end a search, unless the file has it."""
    simulator = Carla(scenario_runner=str(RUNNER), python=sys.executable, undriven=True)
    with pytest.raises(SimulationError, match="'nonsense', which is not a number"):
        ran(simulator, [ConcreteScenario(T, {"c_start_time": "nonsense"})])
    path = tmp_path / "t.xosc"
    path.write_text(T.read_text().replace("<Storyboard>", "<Storyboard><Unknown/>"))
    shutil.copy(ROAD, tmp_path)
    with pytest.raises(InputError):
        ran(simulator, [ConcreteScenario(path, {"c_start_time": 2.0})])


@STUB_ONLY
@pytest.mark.parametrize(
    ("wrong", "runner", "words"),
    [
        pytest.param("", "cannot load", "did not run the scenario to its end: KeyError: 'Ego'", marks=pytest.mark.slow),
        pytest.param("", "fails at the end", "RuntimeError: a storyboard that is none", marks=pytest.mark.slow),
        ("die-at=30", "", "time-out of 3000ms"),
        pytest.param("lose=30", "", "time-out of 3000ms", marks=pytest.mark.slow),
        pytest.param("half=get_map_data", "", "time-out of 3000ms", marks=pytest.mark.slow),
        pytest.param("silent=spawn_actor", "", "time-out of 3000ms", marks=pytest.mark.slow),
    ],
)
def test_what_goes_wrong_is_one_error_and_only_the_simulators_is_tried_again(
    scenario, monkeypatch, wrong, runner, words
):
    monkeypatch.setenv("FAKE_RUNNER", runner)
    # In a process of its own, as always: CARLA's client may abort when its server dies.
    with Served(ROAD, *filter(None, [wrong])) as server:
        simulator = WorkerSimulator("carla", options(server), retries=0)
        try:
            (found,) = simulator.run([ConcreteScenario(scenario, {})])
        finally:
            simulator.close()
    assert isinstance(found, SimulationError)
    assert words in str(found)
    assert str(found).endswith("tried once") == bool(wrong)
    assert "\n" not in str(found)


@STUB_ONLY
def test_nobody_who_listens_and_another_version_are_said(scenario):
    nobody = SimpleNamespace(host="localhost", port=free_port())
    with pytest.raises(
        InputError, match=rf"No CARLA answers on localhost:{nobody.port} .*-carla-rpc-port={nobody.port}"
    ):
        run(nobody, scenario, patience=0.5)
    with (
        Served(ROAD, "version=0.9.15") as server,
        pytest.raises(
            InputError, match=r"version 0.9.15.*start CARLA 0.9.16, or get the other client by `.* carla==0.9.15`; with"
        ),
    ):
        run(server, scenario)
    with (
        Served(ROAD, "version=0.10.0") as server,
        pytest.raises(
            InputError, match=r"CARLA 0.10.0 has no ScenarioRunner.*use CARLA 0.9.13, 0.9.15 or 0.9.16; with"
        ),
    ):
        run(server, scenario)


@STUB_ONLY
def test_a_scenario_runner_of_another_version_is_said_and_tried_if_wished(scenario, tmp_path):
    runner = tmp_path / "runner"
    shutil.copytree(RUNNER, runner)
    (runner / "Docs").mkdir()
    (runner / "Docs" / "CHANGELOG.md").write_text(
        "## Table of Contents\n\n## Latest changes\n\n## CARLA ScenarioRunner 0.9.15\n\n## CARLA ScenarioRunner 0.9.13\n"
    )
    with Served(ROAD) as server:
        words = r"runner: ScenarioRunner 0.9.15 does not fit CARLA 0.9.16; get 0.9.16 by `git clone --branch v0.9.16 .*; with"
        with pytest.raises(InputError, match=words):
            run(server, scenario, scenario_runner=str(runner))
        found = run(server, scenario, {"end": 0.5}, scenario_runner=str(runner), any_version=True)
    assert isinstance(found, Recording)


@pytest.mark.parametrize(
    ("client", "release"), [("0.9.9", "0.9.13"), ("0.9.14", "0.9.13"), ("0.9.15", "0.9.15"), ("0.9.17", "0.9.16")]
)
def test_the_latest_scenario_runner_up_to_the_clients_version_is_advised(client, release, tmp_path):
    (tmp_path / "Docs").mkdir()
    (tmp_path / "Docs" / "CHANGELOG.md").write_text("## CARLA ScenarioRunner 0.9.12\n")
    with pytest.raises(InputError, match=f"ScenarioRunner 0.9.12 does not fit CARLA {client}; get {release} "):
        RunnerEnvironment(tmp_path, "python", "").check_versions(client, client, "localhost:2000")


@pytest.mark.parametrize(("client", "release"), [("0.9.14", "0.9.13"), ("0.9.15-dirty", "0.9.15")])
def test_a_scenario_runner_that_is_there_is_not_advised(client, release, tmp_path):
    (tmp_path / "Docs").mkdir()
    (tmp_path / "Docs" / "CHANGELOG.md").write_text(f"## CARLA ScenarioRunner {release}\n")
    words = (
        f"ScenarioRunner {release} does not fit CARLA {client}; use CARLA {release}; with `simulator` carla:any_version"
    )
    with pytest.raises(InputError, match=words):
        RunnerEnvironment(tmp_path, "python", "").check_versions(client, client, "localhost:2000")


def test_a_python_without_carlas_client_is_said(tmp_path, monkeypatch):
    monkeypatch.setenv("SCENARIO_RUNNER_ROOT", str(RUNNER))
    bare = tmp_path / "bare"
    venv.create(bare, with_pip=False)
    python = bare / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    monkeypatch.setenv("CORNERCASE_CARLA_PYTHON", str(python))
    assert Carla.availability().problem.startswith(
        f"{python}: CARLA's client is not installed there; install the version that"
    )
    monkeypatch.setenv("CORNERCASE_CARLA_PYTHON", str(tmp_path / "no python"))
    assert "no python: is no Python that can be run" in Carla.availability().problem
    done = cornercase("simulators", "--json")
    assert "is no Python that can be run" in json.loads(done.stdout)["carla"]["missing"]


@pytest.mark.skipif(sys.platform == "win32", reason="a script stands in for a Python")
@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("echo 'ImportError: libjpeg.so.8: cannot open shared object file' >&2; exit 1", "ended with exit code 1: Imp"),
        ("exit 0", "(CARLA's client ended)"),
        ("read line; echo hello", "(CARLA's client printed 'hello' instead of JSON)"),
    ],
)
def test_a_client_that_does_not_run_is_said(tmp_path, monkeypatch, script, words):
    monkeypatch.setenv("SCENARIO_RUNNER_ROOT", str(RUNNER))
    python = tmp_path / "python"
    python.write_text(f"#!/bin/sh\n{script}\n")
    python.chmod(0o755)
    monkeypatch.setenv("CORNERCASE_CARLA_PYTHON", str(python))
    with pytest.raises(InputError) as caught:
        _ = Carla().settings
    for problem in (Carla.availability().problem, str(caught.value)):
        assert problem.startswith(f"{python}: CARLA's client does not run there (")
        assert words in problem


@pytest.mark.slow
@STUB_ONLY
def test_a_client_that_aborts_costs_the_scenario_alone(scenario):
    with Served(ROAD, "cut-at=30") as server:
        simulator = WorkerSimulator("carla", options(server), retries=0)
        values = [{"end": 3.0}, {"end": 0.5}]
        try:
            broken, well = simulator.run([ConcreteScenario(scenario, one) for one in values])
        finally:
            simulator.close()
    assert str(broken).startswith("CARLA's client was ended by SIGABRT")
    assert str(broken).endswith("tried once")
    assert isinstance(well, Recording)
    assert well.time[-1] == pytest.approx(0.5, abs=0.2)


def launchers(mark):
    """Processes of ScenarioRunner with this text in an environment variable."""
    found = []
    for process in psutil.process_iter(["cmdline"]):
        if any("cornercase_launcher.py" in part for part in process.info["cmdline"] or ()):
            with suppress(psutil.Error):
                found += [process] * (process.environ().get("FAKE_RUNNER_STARTS") == mark)
    return found


@STUB_ONLY
def test_a_scenario_that_hangs_takes_its_scenario_runner_with_it(scenario, monkeypatch, tmp_path):
    monkeypatch.setenv("FAKE_RUNNER", "hang")
    monkeypatch.setenv("FAKE_RUNNER_STARTS", str(tmp_path / "starts"))
    with Served(ROAD) as server:
        simulator = WorkerSimulator("carla", options(server, patience=60.0), timeout=4.0, retries=0)
        try:
            (found,) = simulator.run([ConcreteScenario(scenario, {})])
        finally:
            simulator.close()
        assert str(found) == "the simulator did not end within 4 s, tried once"
        assert (tmp_path / "starts").exists()
        until(lambda: not launchers(str(tmp_path / "starts")))
        monkeypatch.setenv("FAKE_RUNNER", "")
        # Its leftovers are removed before the next run.
        assert run(server, scenario, {"end": 1.0}).names == ("Ego", "C", "Walker")


@pytest.mark.slow
def test_the_command_explores_with_repeated_runs(scenario, tmp_path):
    with Served(ROAD) as server:
        given = ",".join(f"{name}={value}" for name, value in options(server).items())
        command = (
            "explore", scenario, "--range", "gap=15:35", "--ego", "Ego", "--other", "C", "--metric", "ttc",
            "--optimizer", "sobol", "--budget", 3, "--repeats", 2, "--duration", 2, "--simulator", f"carla:{given}",
            "-o", tmp_path / "study.db",
        )  # fmt: skip
        done = cornercase(*command)
    assert done.returncode == 0, done.stderr
    with StudyFile.open(tmp_path / "study.db", readonly=False) as study:
        assert len(study.finished_rows()) == 3
        spread = study.score_range("ttc")
        assert spread is not None
        assert spread.shape == (3, 2)
        # With another server, the same command resumes.
        with Served(ROAD) as other:
            given = ",".join(f"{name}={value}" for name, value in options(other).items())
            again = [f"carla:{given}" if str(one).startswith("carla:") else one for one in command]
            again[again.index("--budget") + 1] = 4
            study.close()
            done = cornercase(*again)
            assert done.returncode == 0, done.stderr
            assert done.stdout.startswith("4 scenarios")
        assert study.meta.settings["carla"] == carla.Client("localhost", 1).get_client_version()


STACK = """
import sys, time, carla
client = carla.Client(sys.argv[1], int(sys.argv[2]))
client.set_timeout(20.0)
world = client.get_world()
blueprint = world.get_blueprint_library().find("vehicle.tesla.model3")
blueprint.set_attribute("role_name", "Ego")
ego = world.spawn_actor(blueprint, carla.Transform(carla.Location(-70.0, 1.75, 1.0)))
print("ready", flush=True)
while True:
    ego.set_target_velocity(carla.Vector3D(5.0, 0.0, 0.0))
    time.sleep(0.005)
"""


def test_an_ego_of_another_program_is_waited_for_and_left_alone(scenario):
    with Served(ROAD) as server:
        # Its world is that of the scenario, as a new one would be without the ego.
        run(server, scenario, {"end": 0.2})
        command = [sys.executable, "-c", STACK, server.host, str(server.port)]
        stack = subprocess.Popen(command, stdout=subprocess.PIPE)
        with stack:
            try:
                assert stack.stdout is not None
                assert stack.stdout.readline() == b"ready\n"
                simulator = Carla(**options(server, external_ego=True))
                for _ in range(2):
                    (found,) = ran(simulator, [ConcreteScenario(scenario, {"end": 2.0})])
                    assert found.names == ("Ego", "C", "Walker")
                    assert found.time[-1] == pytest.approx(2.0, abs=0.1)
                    assert found.x[0][0] == pytest.approx(-78.6, abs=3.0)
                    assert 5.0 < found.x[0][-1] - found.x[0][0] < 12.0
                assert stack.poll() is None
            finally:
                stack.kill()


def test_an_ego_of_another_program_has_no_other_driver():
    for driver in ("normal", "cc-human"):
        with pytest.raises(
            InputError, match="external_ego: Ego already has an agent or a driver; leave out that or external_ego"
        ):
            Carla(external_ego=True, drivers={"Ego": driver})


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"drivers": {"Ego": "cautious"}}, ["ego_speed sets only the first speed of Ego"]),
        (
            {"drivers": {"Ego": "cautious", "C": "normal"}},
            ["ego_speed sets only the first speed of Ego", "c_speed has no effect", "ego_sync_s has no effect"],
        ),
        ({"external_ego": True}, ["ego_speed has no effect"]),
        # A driver of cornercase is asked for that speed.
        ({"drivers": {"Ego": "cc-human"}}, []),
        # The file names the driver.
        ({}, ["ego_speed sets only the first speed of Ego"]),
    ],
)
def test_a_parameter_that_an_agent_overrides_is_named(given, said):
    simulator = Carla(scenario_runner=str(RUNNER), undriven=True, **given)
    noticed: list[str] = []
    simulator.on_notice = noticed.append
    simulator.check_supported(ScenarioFile.read(T))
    assert [one.partition(", as an agent drives")[0] for one in noticed] == [f"the parameter {one}" for one in said]


def test_a_parameter_that_counts_all_the_same_is_not_named(tmp_path):
    path = tmp_path / T.name
    declared = '<ParameterDeclarations><ParameterDeclaration name="start" parameterType="double" value="20"/>'
    condition = """<ConditionGroup><Condition name="fast" delay="0" conditionEdge="none"><ByValueCondition>
        <ParameterCondition parameterRef="ego_speed" value="99" rule="greaterThan"/></ByValueCondition></Condition>
        </ConditionGroup></StopTrigger></Storyboard>"""
    before, ego, story = T.read_text().replace("<ParameterDeclarations>", declared, 1).partition('entityRef="Ego"')
    story = re.sub(r"</StopTrigger>\s*</Storyboard>", condition, story.replace('s="20"', 's="$start"', 1))
    path.write_text(f"{before}{ego}{story}")
    # Another program drives the ego, from where the scenario says.
    simulator = Carla(scenario_runner=str(RUNNER), undriven=True, external_ego=True)
    noticed: list[str] = []
    simulator.on_notice = noticed.append
    simulator.check_supported(ScenarioFile.read(path))
    assert noticed == []


def test_what_carla_cannot_do_is_refused_before_there_is_a_study(tmp_path):
    done = cornercase(
        "explore", T, "--range", "c_start_time=0:5", "--ego", "Ego", "--other", "C", "--metric", "ttc",
        "--simulator", f"carla:scenario_runner={RUNNER}", "-o", tmp_path / "study.db",
    )  # fmt: skip
    assert done.returncode == 2
    assert "'C' has the driver 'simple', which CARLA does not support" in done.stderr
    assert not list(tmp_path.iterdir())


def test_the_extra_is_what_the_index_has():
    root = Path(__file__).parents[2]
    extras = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    clients = [Requirement(one) for one in extras["carla"]]

    def wanted(python, machine, system):
        given = {"python_version": python, "platform_machine": machine, "sys_platform": system}
        return [one for one in clients if one.marker is not None and one.marker.evaluate(given)]

    # Wheels of 0.9.16 are there for Python 3.10 to 3.12, on Linux and Windows; of 0.9.15 up to 3.10.
    for machine, system in (("x86_64", "linux"), ("AMD64", "win32")):
        for python in ("3.11", "3.12"):
            (client,) = wanted(python, machine, system)
            assert client.specifier.contains("0.9.16")
            assert not client.specifier.contains("0.9.15")
        assert not wanted("3.13", machine, system)
    for machine, system in (("aarch64", "linux"), ("arm64", "darwin"), ("x86_64", "darwin"), ("ARM64", "win32")):
        assert not wanted("3.12", machine, system)


def test_it_is_listed_with_what_it_needs(monkeypatch):
    monkeypatch.delenv("SCENARIO_RUNNER_ROOT", raising=False)
    assert "set SCENARIO_RUNNER_ROOT to its folder" in Carla.availability().problem
    monkeypatch.setenv("SCENARIO_RUNNER_ROOT", str(RUNNER))
    found = Carla.availability()
    assert found.problem == ""
    assert "not deterministic" in found.features


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"scenario_runner": "nowhere"}, "nowhere: contains no scenario_runner.py"),
        ({"drivers": {"Ego": "agressive"}}, "did you mean 'aggressive'"),
        ({"record": "clinet"}, "did you mean 'client'"),
        ({"agent": "agent.py"}, "agent=agent.py: there is no such file"),
        ({"hosts": "a:b"}, "'a:b' is not a host; write it as host or host:port"),
        ({"port": 70000}, "give a host, and a port from 1 to 65535"),
        ({"patience": 0.0}, "give a time above 0 s"),
    ],
)
def test_options_that_cannot_be_are_refused(given, words):
    with pytest.raises(InputError) as caught:
        _ = Carla(**{"scenario_runner": str(RUNNER)} | given).settings
    assert words in str(caught.value)


def test_workers_share_hosts_and_ports():
    assert [worker_address("a", 2000, k, 4) for k in range(3)] == [("a", 2000), ("a", 2004), ("a", 2008)]
    found = [worker_address("a+b:3000", 2000, k, 4) for k in range(4)]
    assert found == [("a", 2000), ("b", 3000), ("a", 2004), ("b", 3004)]


# What ScenarioRunner finds in the file


def adapted(tmp_path, path=T, ego="Ego", behaviors=None, agent=None):
    run = ConversionOptions(dialect.DrivingAgents(behaviors or {}, agent, None))
    write_openscenario_1_0(ScenarioFile.read(path), {}, tmp_path / "one.xosc", ego=ego, options=run)
    return read_xml(tmp_path / "one.xosc")


def controllers(root):
    return {
        private.get("entityRef"): {p.get("name"): p.get("value") for p in private.iterfind(".//Controller//Property")}
        for private in root.iterfind("Storyboard/Init/Actions/Private")
        if private.find(".//Controller") is not None
    }


def test_a_behaviour_agent_gets_the_entitys_route(tmp_path):
    pytest.importorskip("qc_openscenario")
    root = adapted(tmp_path, behaviors={"Ego": "cautious"})
    found = controllers(root)
    assert found["Ego"]["module"] == "cornercase_driver.py"
    assert found["Ego"]["behavior"] == "cautious"
    waypoints = read_xml(T).findall(".//Private[@entityRef='Ego']//Waypoint")
    assert len(etree.fromstring(found["Ego"]["route"])) == len(waypoints)
    # An entity without an agent follows its route at the storyboard's speed.
    assert "behavior" not in found["C"]
    assert root.find(".//Init//AssignRouteAction") is None
    assert root.find("FileHeader").get("description") == "cornercase"
    own = controllers(adapted(tmp_path, agent=Path("/agents/my_agent.py")))
    assert own["Ego"]["agent"] == "/agents/my_agent.py"
    assert own["Ego"]["route"] == found["Ego"]["route"]


def test_code_that_a_scenario_names_is_not_run(tmp_path, scenario):
    path = tmp_path / "bad.xosc"
    action = '<Property name="module" value="/tmp/evil.py"/>'
    path.write_text(scenario.read_text().replace("<Properties/>", f"<Properties>{action}</Properties>", 1))
    with pytest.raises(
        InputError, match=r"names the module '/tmp/evil.py', which is not one of ScenarioRunner's own. Code that"
    ):
        adapted(tmp_path, path)


def test_a_behaviour_agent_without_a_route_and_other_drivers_are_refused(tmp_path, scenario):
    with pytest.raises(InputError, match=r"'Ego' needs a route for CARLA's behaviour agent"):
        adapted(tmp_path, scenario, behaviors={"Ego": "normal"})
    simulator = Carla(scenario_runner=str(RUNNER), port=free_port())
    with pytest.raises(InputError, match=r"'C' has the driver 'simple', which CARLA does not support.*undriven=true"):
        list(simulator.run([ConcreteScenario(T, {})]))


def test_a_vehicle_that_carla_does_not_have_is_refused(scenario):
    scenario.write_text(scenario.read_text().replace('vehicleCategory="car"', 'vehicleCategory="tram"', 1))
    simulator = Carla(scenario_runner=str(RUNNER), port=free_port())
    with pytest.raises(InputError, match=r"'Ego' is a tram, which CARLA does not have"):
        list(simulator.run([ConcreteScenario(scenario, {})]))


def test_a_log_of_carlas_recorder_tells_collisions(tmp_path):
    from cornercase.recordings import read_recording
    from helpers.carla_protocol_server import Actor, Log

    one, other = (
        Actor(k, [1, "vehicle.tesla.model3", [["role_name", 4, role]]], [[x, 0.0, 0.0], [0.0] * 3])
        for k, role, x in ((7, "hero", 0.0), (8, "other", 9.0))
    )
    one.throw([10.0, 0.0, 0.0])
    log = Log(tmp_path / "r.log")
    log.added(one)
    log.added(other)
    for frame in range(20):
        one.move(0.05)
        if frame in (8, 9):
            log.touch(8, 7)
        log.frame(frame, 0.05, {7: one, 8: other})
    log.close()
    found = read_recording(tmp_path / "r.log")
    assert found.collisions == (Collision(found.time[8], ("hero", "other")),)
