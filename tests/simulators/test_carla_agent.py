"""The agent by which any driver drives the ego on CARLA, with what it would find in ScenarioRunner replaced."""

from __future__ import annotations

import importlib.util
import math
import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

import cornercase as cc
from cornercase._common.errors import InputError, SimulationError
from cornercase.drivers._system_under_test import PerScenarioDriver
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin, Carla
from cornercase.simulators.carla._agent_server import AGENT_FILE, AgentServer
from helpers.command_line import X
from helpers.isolation import ROOT

carla = pytest.importorskip("carla", reason="the extra 'carla' is not installed")

RUNNER = ROOT / "tests" / "fake_scenario_runner"
STEP = 0.05


class Vehicle:
    """A box that moves as its velocities or controls say, in CARLA's left-handed axes."""

    is_alive = True

    def __init__(self, name, box, x, y, heading, speed=0.0):
        self.attributes = {"role_name": name}
        length, width, center_x = box
        extent = carla.Vector3D(length / 2, width / 2, 0.7)
        self.bounding_box = carla.BoundingBox(carla.Location(center_x, 0.0, 0.7), extent)
        self.yaw_rate = 0.0
        self.put(x, y, heading, speed)

    def put(self, x, y, heading, speed):
        self.transform = carla.Transform(carla.Location(x, -y, 0.0), carla.Rotation(yaw=-math.degrees(heading)))
        self.velocity = carla.Vector3D(speed * math.cos(heading), -speed * math.sin(heading), 0.0)

    def get_transform(self):
        return self.transform

    def set_transform(self, transform):
        self.transform = transform

    def get_velocity(self):
        return self.velocity

    def set_target_velocity(self, velocity):
        self.velocity = velocity

    def set_target_angular_velocity(self, velocity):
        self.yaw_rate = velocity.z

    def move(self):
        self.transform.location += STEP * carla.Location(self.velocity)
        self.transform.rotation.yaw += STEP * self.yaw_rate


class Agent:
    """The base class of ScenarioRunner's agents, as far as ours needs it."""

    setup: Any

    def __init__(self, path_to_conf_file):
        self.setup(path_to_conf_file)


@pytest.fixture
def world(monkeypatch):
    actors: list[Vehicle] = []
    provider = SimpleNamespace(get_world=lambda: SimpleNamespace(get_actors=lambda: actors))
    contents: dict[str, dict[str, Any]] = {
        "srunner": {}, "srunner.autoagents": {}, "srunner.scenariomanager": {},
        "srunner.autoagents.autonomous_agent": {"AutonomousAgent": Agent},
        "srunner.scenariomanager.carla_data_provider": {"CarlaDataProvider": provider},
    }  # fmt: skip
    for name, content in contents.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    return actors


def make_agent(config):
    spec = importlib.util.spec_from_file_location("cornercase_agent", AGENT_FILE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.CornercaseAgent(str(config))


def reference_poses(concrete, driver, duration):
    (recording,) = Builtin(time_step=STEP, duration=duration, drivers={"Ego": driver}).run([concrete])
    return recording


def center_of(recording, k):
    """Where the middle of an entity is at first, at which the file that is run has the origin of its actor."""
    heading, ahead = recording.heading[k, 0], recording.center_x[k]
    return recording.x[k, 0] + ahead * np.cos(heading), recording.y[k, 0] + ahead * np.sin(heading)


def drive(world, driver, folder, duration=5.0):
    """Drive the ego on the stand-in, while all others move as in the builtin simulator; return centres of the ego."""
    checked = PerScenarioDriver(driver)
    concrete = ConcreteScenario(X, {})
    expected = reference_poses(concrete, driver if isinstance(driver, Aeb) else "normal", duration)
    with AgentServer(checked, concrete, "Ego", STEP, folder) as server:
        boxes = np.stack((expected.length, expected.width, expected.center_x), axis=1).tolist()
        # As on CARLA, whose origins are near the centres of boxes.
        boxes[0][2] = 0.1
        for k, name in enumerate(expected.names):
            x, y = center_of(expected, k) if k == 0 else (expected.x[k, 0], expected.y[k, 0])
            world.append(Vehicle(name, boxes[k], x, y, expected.heading[k, 0]))
        agent = make_agent(server.config_file)
        centers = []
        try:
            for instant in range(round(duration / STEP)):
                for k in range(1, len(world)):
                    world[k].put(*(getattr(expected, name)[k, instant] for name in ("x", "y", "heading", "speed")))
                agent.run_step({}, 7.0 + instant * STEP)
                world[0].move()
                position = world[0].transform.location
                centers.append((position.x, -position.y))
        except RuntimeError:
            # The driver has failed.
            pass
        finally:
            agent.destroy()
    return server, np.array(centers), expected


class Aeb(cc.SystemUnderTest):
    """Accelerates up to 12 m/s, and brakes for the leader."""

    def __init__(self, time_to_brake: float = 2.0):
        self.time_to_brake = time_to_brake

    def step(self, view, dt):
        leader = view.leader
        if leader is not None and leader.gap < self.time_to_brake * leader.closing:
            return cc.Control(acceleration=-8.0)
        return 0.5 if view.ego.speed < 12.0 else 0.0


class Pedals(cc.SystemUnderTest):
    def step(self, view, dt):
        return cc.Control(throttle=0.4, brake=0.1, steering=math.radians(15.0))


class Failing(cc.SystemUnderTest):
    def step(self, view, dt):
        if view.time > 0.99:
            raise RuntimeError("no gap")
        return 0.0


class Idle(cc.SystemUnderTest):
    def step(self, view, dt):
        return float("nan")


def test_the_ego_moves_as_on_the_builtin_simulator(world, tmp_path):
    server, centers, expected = drive(world, Aeb(), tmp_path, duration=6.5)
    assert server.failure is None
    ahead = expected.center_x[0] - 0.1
    x = expected.x[0, 1:] + ahead * np.cos(expected.heading[0, 1:])
    y = expected.y[0, 1:] + ahead * np.sin(expected.heading[0, 1:])
    assert expected.acceleration[0].min() == pytest.approx(-8.0)
    gaps = np.hypot(centers[:, 0] - x, centers[:, 1] - y)
    # CARLA has single precision, so it may brake a step later.
    assert gaps[:100].max() < 0.05
    assert gaps.max() < 0.7


def test_a_curve_is_followed_without_a_steering_angle(world, tmp_path):
    """The ego of the T-intersection turns."""
    t = X.parents[1] / "t_intersection" / "t_intersection.xosc"
    concrete = ConcreteScenario(t, {})
    expected = reference_poses(concrete, Aeb(time_to_brake=0.0), 12.0)
    checked = PerScenarioDriver(Aeb(time_to_brake=0.0))
    assert np.ptp(expected.heading[0]) > 1.0
    with AgentServer(checked, concrete, "Ego", STEP, tmp_path) as server:
        x, y = center_of(expected, 0)
        world.append(Vehicle("Ego", (4.4, 1.8, 0.1), x, y, expected.heading[0, 0]))
        agent = make_agent(server.config_file)
        gaps = []
        for instant in range(round(11.0 / STEP)):
            agent.run_step({}, instant * STEP)
            world[0].move()
            yaw, ahead = -math.radians(world[0].transform.rotation.yaw), expected.center_x[0] - 0.1
            x = world[0].transform.location.x - ahead * math.cos(yaw)
            y = -world[0].transform.location.y - ahead * math.sin(yaw)
            gaps.append(np.hypot(expected.x[0] - x, expected.y[0] - y).min())
        agent.destroy()
    assert abs(yaw) < 0.1
    assert max(gaps) < 0.1


def test_steering_leaves_the_path_and_pedals_change_the_speed(world, tmp_path):
    server, centers, _ = drive(world, Pedals(), tmp_path, duration=2.0)
    assert server.failure is None
    # North with 10 m/s, and to the left in a circle.
    moved = centers[-1] - centers[0]
    assert moved[0] < -3.0
    assert 5.0 < moved[1] < 25.0
    assert world[0].yaw_rate < -5.0


@pytest.mark.parametrize(
    ("driver", "words"),
    [
        (Failing(), "failed at t = 1 s: RuntimeError: no gap"),
        (Idle(), "acceleration is nan, which is not a finite number"),
    ],
)
def test_a_driver_that_fails_ends_the_run_with_its_failure(world, tmp_path, driver, words):
    server, _, _ = drive(world, driver, tmp_path, duration=1.5)
    assert isinstance(server.failure, SimulationError)
    assert words in str(server.failure)


def test_values_with_which_no_driver_can_start_cost_their_scenario_only(tmp_path):
    """A search goes on after a scenario that failed; a file that is at fault itself ends it."""

    def start(path, values):
        AgentServer(PerScenarioDriver(Aeb()), ConcreteScenario(path, values), "Ego", STEP, tmp_path)

    with pytest.raises(SimulationError, match="the parameter ego_speed is 'nonsense', which is not a number"):
        start(X, {"ego_speed": "nonsense"})
    path = tmp_path / X.name
    (tmp_path / X.with_suffix(".xodr").name).write_bytes(X.with_suffix(".xodr").read_bytes())
    path.write_text(X.read_text().replace('name="ego_speed" parameterType="double" value="10"', 'name="other"'))
    with pytest.raises(InputError):
        start(path, {"p1_speed": 5.0})


def test_only_the_agent_is_answered(world, tmp_path):
    checked = PerScenarioDriver(Aeb())
    with AgentServer(checked, ConcreteScenario(X, {}), "Ego", STEP, tmp_path) as server:
        config = server.config_file.read_text()
        server.config_file.write_text(config.replace('"token": "', '"token": "0'))
        world.append(Vehicle("Ego", (4.4, 1.8, 0.1), 0.0, 0.0, 0.0))
        agent = make_agent(server.config_file)
        with pytest.raises(RuntimeError, match="cornercase has ended the run"):
            agent.run_step({}, 0.0)
        agent.destroy()


def test_what_carla_cannot_do_with_a_driver_is_refused(tmp_path):
    def refused(**options):
        with pytest.raises(InputError) as caught:
            Carla(scenario_runner=str(RUNNER), **options)
        return str(caught.value)

    assert "Drivers that are no behaviour agents can drive the ego (Ego) only." in refused(drivers={"C": Aeb()})
    (tmp_path / "agent.py").write_text("")
    for driver in (Aeb(), "normal"):
        assert "already drives the ego; leave out this driver or the agent" in refused(
            drivers={"Ego": driver}, agent=str(tmp_path / "agent.py")
        )


def test_a_study_stores_the_driver(monkeypatch):
    pytest.importorskip("carla")
    drivers: dict[str, Any] = {"Ego": Aeb(time_to_brake=3.0), "C": "normal"}
    settings = Carla(scenario_runner=str(RUNNER), drivers=drivers).settings
    stored = settings["drivers"]
    assert isinstance(stored, dict)
    assert stored["C"] == "normal"
    assert stored["Ego"]["options"] == {"time_to_brake": 3.0}


class Degrees(cc.SystemUnderTest):
    def step(self, view, dt):
        return cc.Control(acceleration=99.0, steering=45.0)


def test_limits_that_the_driver_exceeds_are_there_to_be_said(world, tmp_path):
    server, _, _ = drive(world, Degrees(), tmp_path, duration=0.5)
    assert "exceeds the steering angle of" in server.limit_notices["steering"]
