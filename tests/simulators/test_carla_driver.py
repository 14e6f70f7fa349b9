"""What drives on ScenarioRunner's side, with all that it would find there replaced."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from cornercase.simulators.carla import _controller_assignment as dialect

carla = pytest.importorskip("carla", reason="the extra 'carla' is not installed")

ROAD = Path(__file__).parents[2] / "examples" / "t_intersection" / "t_intersection.xodr"


class Control:
    def __init__(self, actor):
        self._actor, self._local_planner, self._target_speed, self._init_speed = actor, Planner(), 8.0, True
        self._reached_goal = False

    def reset(self):
        self._actor = None

    def run_step(self):
        self._actor.did.append("storyboard")


class Planner:
    plan = None

    def set_global_plan(self, plan):
        self.plan = plan


class Agent(Planner):
    steps = 2

    def __init__(self, actor, behavior):
        self.behavior = behavior

    def done(self):
        return self.steps == 0

    def run_step(self):
        self.steps -= 1
        return "control"


class Sensors:
    """The sensors that are made, and what agents are told of them."""

    def __init__(self):
        self.made, self.told, self.ticks = [], {}, 0

    # The world

    def get_blueprint_library(self):
        return self

    def find(self, kind):
        return Blueprint(kind)

    def spawn_actor(self, blueprint, transform, parent):
        self.made.append(SimpleNamespace(
            kind=blueprint.kind, attributes=blueprint.attributes, transform=transform, parent=parent, done=[],
        ))  # fmt: skip
        sensor = self.made[-1]
        sensor.listen = lambda callback: setattr(sensor, "callback", callback)
        sensor.stop, sensor.destroy = (lambda: sensor.done.append("stop")), (lambda: sensor.done.append("destroy"))
        return sensor

    def tick(self):
        self.ticks += 1
        for late, sensor in enumerate(self.made):
            # It takes a while until a sensor sends.
            if self.ticks > 2 * late:
                sensor.callback(f"{self.ticks} of {sensor.kind}")

    # The interface of an agent

    def register_sensor(self, tag, sensor):
        self.told[tag] = []

    def update_sensor(self, tag, data, frame):
        self.told[tag].append(data)


class Blueprint:
    def __init__(self, kind):
        self.kind, self.attributes = kind, {}

    def has_attribute(self, name):
        return name in ("range", "horizontal_fov")

    def set_attribute(self, name, content):
        self.attributes[name] = content


class CallBack:
    def __init__(self, tag, sensor, interface):
        self.tag, self.interface = tag, interface
        interface.register_sensor(tag, sensor)

    def __call__(self, data):
        self.interface.update_sensor(self.tag, data, 1)


class Router:
    def __init__(self, *_):
        pass

    def trace_route(self, here, there):
        road_map = carla.Map("road", ROAD.read_text())
        return [(road_map.get_waypoint(one), "lane") for one in (here, there)]


@pytest.fixture
def sensors():
    return Sensors()


@pytest.fixture(params=["0.9.13", "0.9.15"])
def driver(request, sensors, monkeypatch):
    """Our controller, with what it finds in ScenarioRunner of a version."""
    version = request.param

    def module(name, **content):
        made = ModuleType(name)
        vars(made).update(content)
        monkeypatch.setitem(sys.modules, name, made)

    road_map = carla.Map("road", ROAD.read_text())
    provider = SimpleNamespace(
        get_map=lambda: road_map, get_location=lambda actor: actor.get_location(), get_world=lambda: sensors
    )
    if version != "0.9.13":
        provider.get_global_route_planner = Router

    def position(element):
        return carla.Transform(carla.Location(float(element.get("x")), float(element.get("y")), 0.0))

    for package in ("agents", "agents.navigation", "srunner", "srunner.tools", "srunner.scenariomanager"):
        module(package)
    module("srunner.scenariomanager.actorcontrols")
    module("srunner.autoagents")
    module("srunner.autoagents.sensor_interface", CallBack=CallBack)
    module("agents.navigation.global_route_planner", GlobalRoutePlanner=Router)
    module("srunner.scenariomanager.timer", GameTime=SimpleNamespace(get_frame=lambda: 7))
    old = {
        "interpolate_trajectory": lambda world, waypoints_trajectory: (
            [len(waypoints_trajectory)],
            waypoints_trajectory,
        )
    }
    new = {"interpolate_trajectory": lambda waypoints_trajectory: ([len(waypoints_trajectory)], waypoints_trajectory)}
    module("srunner.tools.route_manipulation", **(old if version == "0.9.13" else new))
    module("agents.navigation.behavior_agent", BehaviorAgent=Agent)
    module("agents.navigation.local_planner", RoadOption=SimpleNamespace(LANEFOLLOW="follow"))
    module("srunner.scenariomanager.actorcontrols.npc_vehicle_control", NpcVehicleControl=Control)
    module("srunner.scenariomanager.carla_data_provider", CarlaDataProvider=provider)
    module(
        "srunner.tools.openscenario_parser",
        OpenScenarioParser=SimpleNamespace(convert_position_to_transform=position),
    )
    spec = importlib.util.spec_from_file_location("cornercase_driver", dialect.DRIVER_FILE)
    assert spec is not None
    assert spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded.CornercaseDriver


class Vehicle:
    is_alive = True

    def __init__(self):
        self.did = []

    def get_location(self):
        return carla.Location(-60.0, 1.75, 0.0)

    def get_transform(self):
        return carla.Transform(self.get_location())

    def get_velocity(self):
        return carla.Vector3D(3.0, 0.0, 0.0)

    def set_target_velocity(self, velocity):
        self.did.append(("speed", velocity.x))

    def apply_control(self, control):
        self.did.append("brake" if getattr(control, "brake", 0.0) == 1.0 else control)


ROUTE = '<route><Position x="-60" y="1.75"/><Position x="-20" y="1.75"/></route>'


def test_the_driver_follows_its_route_beyond_its_end_and_brakes_then(driver):
    vehicle = Vehicle()
    made = driver(vehicle, {"behavior": "aggressive", "route": ROUTE})
    assert made._agent.behavior == "aggressive"
    plan = [point.transform.location.x for point, _ in made._agent.plan]
    # Its current position is not part of the route.
    assert plan[:2] == pytest.approx([-60.0, -20.0], abs=0.1)
    assert plan[-1] > 20.0
    for _ in range(4):
        made.run_step()
    assert vehicle.did == [("speed", 8.0), "control", "control", "brake", "brake"]
    assert made._reached_goal


def test_where_carlas_planner_knows_no_road_the_lane_is_followed(driver, monkeypatch):
    """It leaves out a road that neither comes from nor leads to another one, such as a motorway."""

    def fail(*_):
        raise TypeError("'NoneType' object is not subscriptable")

    monkeypatch.setattr(Router, "trace_route", fail)
    plan = driver(Vehicle(), {"behavior": "normal", "route": ROUTE})._agent.plan
    x = [point.transform.location.x for point, _ in plan]
    assert x[:2] == pytest.approx([-60.0, -58.0], abs=0.1)
    assert min(abs(one + 20.0) for one in x) < 1.1
    assert x[-1] > 20.0


def test_the_route_of_an_own_agent_is_then_the_lane_too(driver, monkeypatch):
    loaded = sys.modules["srunner.tools.route_manipulation"]

    def fail(waypoints_trajectory):
        raise TypeError("'NoneType' object is not subscriptable")

    def to_gps(route, lat_ref, lon_ref):
        return [(lat_ref, lon_ref)] * len(route)

    monkeypatch.setitem(driver.run_step.__globals__, "interpolate_trajectory", fail)
    monkeypatch.setattr(loaded, "location_route_to_gps", to_gps, raising=False)
    monkeypatch.setattr(loaded, "_get_latlon_ref", lambda world: (49.0, 8.0), raising=False)
    points = [carla.Location(x, 1.75, 0.0) for x in (-60.0, -40.0, -20.0)]
    gps, world = driver.run_step.__globals__["_interpolate_trajectory"](points)
    assert gps[0] == (49.0, 8.0)
    x = [transform.location.x for transform, _ in world]
    assert len(gps) == len(x)
    assert (x[0], x[-1]) == (pytest.approx(-60.0, abs=0.1), pytest.approx(-20.0, abs=1.1))


def test_without_a_behaviour_the_storyboard_sets_the_speed(driver):
    vehicle = Vehicle()
    made = driver(vehicle, {"route": ROUTE})
    made.run_step()
    assert vehicle.did == ["storyboard"]
    assert len(made._local_planner.plan) > 2
    assert driver(Vehicle())._local_planner.plan is None


def test_an_agent_of_ones_own_gets_the_route_and_its_sensors_and_is_closed(driver, sensors, tmp_path, monkeypatch):
    (tmp_path / "my_own_agent.py").write_text(
        "from srunner.autoagents import interface\n"
        "class MyOwnAgent:\n"
        "    def __init__(self, config): self.said, self.sensor_interface = [config], interface\n"
        "    def set_global_plan(self, gps, world): self.said.append((gps, world))\n"
        "    def sensors(self): return [\n"
        "        {'type': 'sensor.other.imu', 'id': 'IMU', 'x': 0.5, 'y': 0.0, 'z': 1.0},\n"
        "        {'type': 'sensor.other.radar', 'id': 'RADAR', 'x': 2.0, 'y': 0.0, 'z': 1.0, 'yaw': 90.0,\n"
        "         'horizontal_fov': 30, 'unknown': 1},\n"
        "        {'type': 'sensor.speedometer', 'reading_frequency': 20, 'id': 'SPEED'}]\n"
        "    def __call__(self): return 'own control'\n"
        "    def destroy(self): self.said.append('destroyed')\n"
    )
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.delitem(sys.modules, "my_own_agent", raising=False)
    # ScenarioRunner's base class has it.
    vars(sys.modules["srunner.autoagents"])["interface"] = sensors
    vehicle = Vehicle()
    made = driver(vehicle, {"agent": str(tmp_path / "my_own_agent.py"), "agent_config": "c.json", "route": ROUTE})
    agent = made._agent._agent
    made.run_step()
    assert vehicle.did == [("speed", 8.0), "own control"]
    imu, radar = sensors.made
    assert (imu.kind, radar.kind) == ("sensor.other.imu", "sensor.other.radar")
    assert radar.attributes == {"horizontal_fov": "30"}
    assert radar.transform.rotation.yaw == 90.0
    assert radar.transform.location.x == 2.0
    assert sensors.told == {
        "IMU": ["4 of sensor.other.imu"],
        "RADAR": ["4 of sensor.other.radar"],
        "SPEED": [{"speed": 3.0}],
    }
    # Each once for the first step.
    assert sensors.ticks == 4
    made.reset()
    assert imu.done == radar.done == ["stop", "destroy"]
    config, (gps, world), *rest = agent.said
    assert (config, gps, rest) == ("c.json", [3], ["destroyed"])
    assert [round(one.x) for one in world] == [-60, -60, -20]
