"""The real ScenarioRunner builds and ticks behaviour trees of converted files, on the test server of CARLA.

CORNERCASE_SCENARIO_RUNNER names its folder, CORNERCASE_CARLA_PYTHON the Python of its environment, and CARLA_ROOT the
folder in which PythonAPI/carla/agents lies.
"""

from __future__ import annotations

import os
import subprocess
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

import cornercase as cc
from cornercase.roads._network import RoadNetwork
from cornercase.scenario import ConcreteScenario
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._xml import read_xml
from cornercase.simulators import Carla, simulate
from cornercase.simulators.carla._client_process import find_client_version
from cornercase.simulators.carla._openscenario_1_0 import ConversionOptions, write_openscenario_1_0
from cornercase.simulators.carla._road_conversion import road_text_for_carla
from cornercase.simulators.carla._runner_environment import RunnerEnvironment
from cornercase.testing._agent_runs import measure_agent_motion
from cornercase.testing._small_scenarios import LANE_Y, write_small_scenarios
from helpers.carla_or_stand_in import Served
from helpers.command_line import X
from helpers.isolation import REFERENCE

FOLDER = os.environ.get("CORNERCASE_SCENARIO_RUNNER", "")
pytestmark = pytest.mark.skipif(not FOLDER or not REFERENCE.is_dir(), reason="CORNERCASE_SCENARIO_RUNNER is not set")
# s of each scenario; the whole tree is built whatever is run of it.
T = X.parents[1] / "t_intersection" / "t_intersection.xosc"
DURATION = 4.0
# Half a frame at 130 km/h, and what a walker or a controlled car is behind.
NEAR = 1.5


def client_version():
    return find_client_version(RunnerEnvironment.find(FOLDER, "", ""))


def protocols():
    files = [one for folder in ("ncap", "alks") for one in sorted((REFERENCE / folder).rglob("*.xosc"))]
    return [one for one in files if "<Storyboard" in one.read_text(errors="replace")]


def centers(recording, name):
    k = recording.names.index(name)
    ahead = recording.center_x[k]
    return np.stack(
        [recording.x[k] + ahead * np.cos(recording.heading[k]), recording.y[k] + ahead * np.sin(recording.heading[k])]
    )


def apart(one, other):
    """Largest distance of two paths, of which one may be a frame late."""
    found = []
    for later in range(-1, 2):
        a, b = one[:, max(later, 0) :], other[:, max(-later, 0) :]
        shared = min(a.shape[1], b.shape[1])
        if shared > 20:
            found.append(float(np.nanmax(np.hypot(*(a[:, :shared] - b[:, :shared])))))
    return min(found)


@pytest.mark.parametrize("file", protocols(), ids=lambda file: file.stem)
def test_the_real_tree_of_each_protocol_is_built_and_moves_as_the_scenario_says(file, tmp_path):
    scenario = ScenarioFile.read(file)
    notes = write_openscenario_1_0(
        scenario, {}, tmp_path / "one.xosc", ego="Ego", options=ConversionOptions(duration=DURATION)
    )
    assert (tmp_path / "one.xosc").exists()
    sampled = {note.partition(" moves along")[0] for note in notes if " moves along a trajectory" in note}
    expected = simulate(scenario, duration=DURATION)
    with Served(scenario.road_path_for({}), f"version={client_version()}") as server:
        simulator = Carla(
            hosts=server.host,
            port=server.port,
            scenario_runner=FOLDER,
            ego="Ego",
            duration=DURATION,
            patience=20.0,
            any_version=True,
        )
        (found,) = simulator.run([ConcreteScenario(file, {}, scenario)])
    assert not isinstance(found, Exception), found
    assert set(found.names) == set(scenario.entities)
    for name in sampled:
        assert apart(centers(found, name), centers(expected, name)) < NEAR, name


class Approach(cc.SystemUnderTest):
    """Accelerates up to 12 m/s."""

    n_objects = 3

    def step(self, view, dt):
        assert len(view.objects) == self.n_objects
        return 0.5 if view.ego.speed < 12.0 else 0.0


class ApproachOne(Approach):
    """The same, with a single other vehicle."""

    n_objects = 1


def test_a_driver_of_ones_own_drives_the_ego_as_on_the_builtin_simulator():
    concrete = ConcreteScenario(X, {})
    options: dict[str, Any] = {"duration": DURATION, "drivers": {"Ego": Approach()}}
    with Served(X.with_suffix(".xodr"), f"version={client_version()}") as server:
        simulator = Carla(
            hosts=server.host, port=server.port, scenario_runner=FOLDER, ego="Ego", patience=20.0, undriven=True,
            open_loop=True, any_version=True, **options,
        )  # fmt: skip
        (found,) = simulator.run([concrete])
    assert not isinstance(found, Exception), found
    (expected,) = cc.simulators.Builtin(**options).run([concrete])
    # The ego is placed in the first frame.
    assert apart(centers(found, "Ego")[:, 2:], centers(expected, "Ego")[:, 2:]) < 0.05


AGENT = """
import carla
from srunner.autoagents.autonomous_agent import AutonomousAgent

class MyAgent(AutonomousAgent):
    def setup(self, path_to_conf_file):
        self.seen = open(path_to_conf_file, "a")
    def sensors(self):
        place = {"x": 0.7, "y": 0.0, "z": 1.6, "roll": 0.0, "pitch": 0.0, "yaw": 0.0}
        return [
            {"type": "sensor.other.imu", "id": "IMU", **place},
            {"type": "sensor.other.radar", "id": "RADAR", "horizontal_fov": 35, **place},
            {"type": "sensor.speedometer", "reading_frequency": 20, "id": "SPEED"},
        ]
    def run_step(self, input_data, timestamp):
        imu, radar, speed = (input_data[name][1] for name in ("IMU", "RADAR", "SPEED"))
        assert len(self._global_plan_world_coord) > 5
        print(imu[2], radar.shape, speed["speed"], file=self.seen, flush=True)
        return carla.VehicleControl(throttle=0.5)
"""


def run_on_t(tmp_path, **options):
    """The T-intersection on the real ScenarioRunner."""
    with Served(T.with_suffix(".xodr"), f"version={client_version()}") as server:
        simulator = Carla(
            hosts=server.host, port=server.port, scenario_runner=FOLDER, ego="Ego", duration=DURATION, patience=20.0,
            any_version=True, undriven=True, open_loop=True, folder=str(tmp_path / "runs"), **options,
        )  # fmt: skip
        (found,) = simulator.run([ConcreteScenario(T, {})])
    assert not isinstance(found, Exception), found
    return found


def stack_of(server):
    """Another program that makes the ego and drives it, where it is put, at 5 m/s."""
    script = """
import math, sys, time, carla
client = carla.Client(sys.argv[1], int(sys.argv[2]))
client.set_timeout(20.0)
world = client.get_world()
blueprint = world.get_blueprint_library().find("vehicle.tesla.model3")
blueprint.set_attribute("role_name", "Ego")
ego = world.spawn_actor(blueprint, carla.Transform(carla.Location(0.0, 0.0, 1.0)))
print("ready", flush=True)
while True:
    ego.set_target_velocity(5.0 * ego.get_transform().get_forward_vector())
    time.sleep(0.005)
"""
    python = os.environ["CORNERCASE_CARLA_PYTHON"]
    process = subprocess.Popen([python, "-c", script, server.host, str(server.port)], stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"ready\n"
    return ended(process)


@contextmanager
def ended(process):
    try:
        yield
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize(
    ("drivers", "files"),
    [({}, (T, X, T)), ({"Ego": "cautious"}, (T, X, T)), ({"Ego": ApproachOne()}, (T, T))],
    ids=["storyboard", "behaviour agent", "own driver"],
)
def test_scenarios_of_one_program_are_to_the_bit_those_of_a_program_each(drivers, files):
    concretes = [ConcreteScenario(file, {}) for file in files]

    def make():
        return Carla(
            hosts=server.host, port=server.port, scenario_runner=FOLDER, ego="Ego", duration=DURATION, patience=20.0,
            any_version=True, undriven=True, open_loop=True, drivers=drivers,
        )  # fmt: skip

    with Served(T.with_suffix(".xodr"), f"version={client_version()}") as server:
        alone = []
        for concrete in concretes:
            with make() as simulator:
                alone += simulator.run([concrete])
        with make() as simulator:
            together = list(simulator.run(concretes))
    for one, other in zip(together, alone, strict=True):
        assert not isinstance(one, Exception), one
        assert not isinstance(other, Exception), other
        assert (one.names, one.collisions) == (other.names, other.collisions)
        for name in ("time", "x", "y", "heading", "speed", "acceleration"):
            assert np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True), name


@pytest.mark.parametrize("driver", ["cautious", "normal", "aggressive"])
def test_carlas_behaviour_agents_drive_the_ego_along_its_route(tmp_path, driver):
    found = run_on_t(tmp_path, drivers={"Ego": driver})
    path = centers(found, "Ego")
    # In the direction of its lane, at once with the first speed of the storyboard.
    assert np.hypot(*(path[:, -1] - path[:, 0])) > 10.0
    assert found.speed[0][0] == pytest.approx(found.speed[0][1])
    assert found.speed[0][0] > 5.0
    network = RoadNetwork.read(T.with_suffix(".xodr"))
    assert np.abs(network.locate(*path).offset).max() < 1.0


def drive_to_van(concrete, driver):
    """How a behaviour agent drives to a standing van, on a road that CARLA's planner leaves out."""
    with Served(T.with_suffix(".xodr"), f"version={client_version()}") as server:
        simulator = Carla(
            hosts=server.host, port=server.port, scenario_runner=FOLDER, ego="Ego", patience=20.0, any_version=True,
            drivers={"Ego": driver},
        )  # fmt: skip
        (found,) = simulator.run([concrete])
    assert not isinstance(found, Exception), found
    return measure_agent_motion(found)


@pytest.mark.parametrize("driver", ["cautious", "normal"])
def test_carlas_behaviour_agents_stop_before_a_van(tmp_path, driver):
    concrete = write_small_scenarios(tmp_path, "a standing van")["a standing van"]
    motion = drive_to_van(concrete, driver)
    assert motion.collision is None
    assert motion.last_speed < 0.01
    assert motion.gap is not None
    assert 0.0 < motion.gap < 8.0


def test_carlas_behaviour_agents_do_not_see_a_van_that_is_exactly_ahead(tmp_path):
    """As docs/simulators/carla.md says of them, so that nobody looks for the cause here."""
    concrete = write_small_scenarios(tmp_path, "a standing van")["a standing van"]
    text = concrete.path.read_text()
    assert text.count(f'y="{LANE_Y + 0.1}"') == 1
    concrete.path.write_text(text.replace(f'y="{LANE_Y + 0.1}"', f'y="{LANE_Y}"'))
    motion = drive_to_van(concrete, "cautious")
    assert motion.collision is not None
    assert motion.last_speed > 6.0


def test_an_own_agent_has_imu_radar_and_speedometer(tmp_path):
    (tmp_path / "my_agent.py").write_text(AGENT)
    (tmp_path / "seen.txt").write_text("")
    found = run_on_t(tmp_path, agent=str(tmp_path / "my_agent.py"), agent_config=str(tmp_path / "seen.txt"))
    seen = [line.split(" ", 1) for line in (tmp_path / "seen.txt").read_text().splitlines()]
    assert len(seen) > 70
    assert {line[0] for line in seen} == {"9.8100004196167"}
    assert all(line[1].startswith("(1, 4) ") for line in seen)
    speeds = [float(line[1].rpartition(" ")[2]) for line in seen]
    assert speeds[-1] == pytest.approx(found.speed[0][-1], abs=1.0)
    assert speeds[-1] > speeds[1]


def test_an_ego_of_another_program_is_driven_by_it(tmp_path):
    network = RoadNetwork.read(T.with_suffix(".xodr"))
    with Served(T.with_suffix(".xodr"), f"version={client_version()}") as server:
        simulator = Carla(
            hosts=server.host, port=server.port, scenario_runner=FOLDER, ego="Ego", duration=DURATION, patience=20.0,
            any_version=True, undriven=True, open_loop=True, external_ego=True,
        )  # fmt: skip
        # Its map is loaded before the other program makes the ego.
        simulator._server.connect(simulator._environment)
        simulator._server.prepare("", road_text_for_carla(read_xml(T.with_suffix(".xodr"))))
        with stack_of(server):
            (found,) = simulator.run([ConcreteScenario(T, {})])
    assert not isinstance(found, Exception), found
    path = centers(found, "Ego")
    assert np.abs(network.locate(*path[:, :1]).offset).max() < 0.5
    assert 5.0 < np.hypot(*(path[:, -1] - path[:, 0])) < 30.0
