"""Controller for ScenarioRunner that drives a vehicle on CARLA along the route of its scenario.

ScenarioRunner loads this file by its name, in its own environment with an older Python, so it must not import
cornercase.
"""

from __future__ import annotations

import importlib
import inspect
import os
import sys
import time
import xml.etree.ElementTree as ElementTree
from typing import Any, Dict, List, Optional, Set, Tuple

import carla
from agents.navigation.behavior_agent import BehaviorAgent
from agents.navigation.global_route_planner import GlobalRoutePlanner
from agents.navigation.local_planner import RoadOption
from srunner.autoagents.sensor_interface import CallBack
from srunner.scenariomanager.actorcontrols.npc_vehicle_control import NpcVehicleControl
from srunner.scenariomanager.carla_data_provider import CarlaDataProvider
from srunner.scenariomanager.timer import GameTime
from srunner.tools.openscenario_parser import OpenScenarioParser
from srunner.tools.route_manipulation import interpolate_trajectory

# Distance in m that a vehicle continues along its lane after its route, so that it does not block others.
_EXTENSION = 200.0
_WAYPOINT_STEP = 2.0
# Distance in m after which diverging lanes on a junction can be distinguished.
_LOOKAHEAD = 15.0
# Most ticks until all sensors send, and time in s for what they send to arrive.
_MAX_SENSOR_TICKS, _SENSOR_DELAY = 100, 0.02
# Keys of a sensor's position in m and orientation in degrees.
_PLACEMENT = ("x", "y", "z", "pitch", "yaw", "roll")


class CornercaseDriver(NpcVehicleControl):  # type: ignore[misc]
    """Controller that drives a vehicle along a route in ScenarioRunner.

    CARLA's behaviour agent or the user's agent drives the vehicle. Without an agent, the vehicle follows the route at
    the speed of the storyboard.

    The optional `args` are: ``behavior`` ("cautious", "normal" or "aggressive"); ``agent``, the file of an
    ``AutonomousAgent``; ``agent_config``, its configuration; ``route``, an XML element with the positions of a route.
    """

    _init_speed: bool

    def __init__(self, actor: Any, args: Optional[Dict[str, str]] = None) -> None:
        super().__init__(actor)
        args = args or {}
        targets = [
            OpenScenarioParser.convert_position_to_transform(position).location
            for position in ElementTree.fromstring(args.get("route", "<route/>"))
        ]
        self._agent: Any = None
        if args.get("agent"):
            self._agent = _UserAgent(actor, args["agent"], args.get("agent_config", ""), targets)
        elif args.get("behavior"):
            self._agent = BehaviorAgent(actor, behavior=args["behavior"])
            self._agent.set_global_plan(_plan_route(actor, targets))
        elif targets:
            self._local_planner.set_global_plan(_plan_route(actor, targets))

    def run_step(self) -> None:
        """Control the vehicle in one tick."""
        if self._agent is None:
            super().run_step()
            return
        if not self._actor.is_alive:
            return
        if self._init_speed:
            # Only at the start; then the agent decides the speed.
            self._init_speed = False
            forward = self._actor.get_transform().get_forward_vector()
            self._actor.set_target_velocity(forward * float(self._target_speed))
        if self._agent.done():
            self._reached_goal = True
            self._actor.apply_control(carla.VehicleControl(brake=1.0))
        else:
            self._actor.apply_control(self._agent.run_step())

    def reset(self) -> None:
        """Release the agent's resources."""
        if isinstance(self._agent, _UserAgent):
            self._agent.close()
        self._agent = None
        super().reset()


class _UserAgent:
    """The user's agent with its sensors, run in the same way as in route scenarios of ScenarioRunner.

    ScenarioRunner's own `AgentWrapper` fails at sensors other than cameras, lidars and GNSS.
    """

    def __init__(self, actor: Any, file: str, config: str, targets: List[Any]) -> None:
        sys.path.insert(0, os.path.dirname(file))
        module = importlib.import_module(os.path.splitext(os.path.basename(file))[0])
        # ScenarioRunner's naming convention: my_agent.py contains MyAgent.
        self._agent = getattr(module, module.__name__.title().replace("_", ""))(config)
        self._actor = actor
        if targets:
            self._agent.set_global_plan(*_interpolate_trajectory([actor.get_location(), *targets]))
        self._sensors: List[Any] = []
        self._speedometers: List[str] = []
        # Sensors that have sent something, and whether the agent gets what they send.
        self._heard: Set[str] = set()
        self._is_listening = False
        for spec in self._agent.sensors():
            self._add_sensor(spec)
        if self._sensors:
            self._start_sensors()

    def done(self) -> bool:
        return False

    def run_step(self) -> Any:
        interface = self._agent.sensor_interface
        for tag in self._speedometers:
            forward, velocity = self._actor.get_transform().get_forward_vector(), self._actor.get_velocity()
            speed = forward.x * velocity.x + forward.y * velocity.y + forward.z * velocity.z
            interface.update_sensor(tag, {"speed": speed}, GameTime.get_frame())
        return self._agent()

    def close(self) -> None:
        for sensor in self._sensors:
            sensor.stop()
            sensor.destroy()
        self._agent.destroy()

    def _add_sensor(self, spec: Dict[str, Any]) -> None:
        interface, tag = self._agent.sensor_interface, spec["id"]
        if spec["type"] == "sensor.speedometer":
            # CARLA has no such sensor.
            interface.register_sensor(tag, self)
            self._speedometers.append(tag)
            return
        world = CarlaDataProvider.get_world()
        blueprint = world.get_blueprint_library().find(spec["type"])
        for name, value in spec.items():
            if name not in ("type", "id", *_PLACEMENT) and blueprint.has_attribute(name):
                blueprint.set_attribute(name, str(value))
        x, y, z, pitch, yaw, roll = (float(spec.get(name, 0.0)) for name in _PLACEMENT)
        transform = carla.Transform(carla.Location(x, y, z), carla.Rotation(pitch, yaw, roll))
        sensor = world.spawn_actor(blueprint, transform, self._actor)
        callback = CallBack(tag, sensor, interface)

        def receive(data: Any) -> None:
            self._heard.add(tag)
            if self._is_listening:
                callback(data)

        sensor.listen(receive)
        self._sensors.append(sensor)

    def _start_sensors(self) -> None:
        """Tick the server until all sensors have sent data, and then once more.

        The agent receives only the data of this last tick: one value of each sensor for its first step.
        """
        world = CarlaDataProvider.get_world()
        for _ in range(_MAX_SENSOR_TICKS):
            world.tick()
            # What was sent arrives in another thread.
            time.sleep(_SENSOR_DELAY)
            if len(self._heard) == len(self._sensors):
                break
        self._is_listening = True
        world.tick()


def _interpolate_trajectory(points: List[Any]) -> Any:
    """Return the waypoints of a route through positions twice: in GNSS coordinates, and in world coordinates."""
    world = CarlaDataProvider.get_world()
    try:
        if "world" in inspect.signature(interpolate_trajectory).parameters:
            # 0.9.13
            return interpolate_trajectory(world, points)
        return interpolate_trajectory(points)
    except TypeError:
        # As in `_trace_route`.
        legs = [_trace_lane(start, target) for start, target in zip(points[:-1], points[1:])]  # noqa: B905, RUF007 - older Python
        route = [(waypoint.transform, option) for leg in legs for waypoint, option in leg]
        tools = importlib.import_module("srunner.tools.route_manipulation")
        return tools.location_route_to_gps(route, *tools._get_latlon_ref(world)), route


def _trace_route(planner: Any, start: Any, target: Any) -> List[Tuple[Any, Any]]:
    """Return waypoints and road options from one position to another.

    CARLA's planner knows no roads that have neither predecessor nor successor, and fails if a route begins or ends on
    one. The route then follows the lane.
    """
    try:
        return list(planner.trace_route(start, target))
    except TypeError:
        return _trace_lane(start, target)
    except Exception as error:
        if type(error).__name__ != "NetworkXNoPath":
            raise
        ends = " to ".join(f"({end.x:.1f}, {-end.y:.1f})" for end in (start, target))
        raise RuntimeError(f"CARLA's route planner finds no way from {ends}; correct the route") from error


def _trace_lane(start: Any, target: Any) -> List[Tuple[Any, Any]]:
    """Return waypoints and road options along a lane, from a position to the point nearest to a target."""
    waypoint = CarlaDataProvider.get_map().get_waypoint(start)
    plan = [(waypoint, RoadOption.LANEFOLLOW)]
    while True:
        following = waypoint.next(_WAYPOINT_STEP)
        before, after = (
            point.transform.location.distance(target) for point in (waypoint, (following or [waypoint])[0])
        )
        if after >= before:
            return plan
        waypoint = following[0]
        plan.append((waypoint, RoadOption.LANEFOLLOW))


def _plan_route(actor: Any, targets: List[Any]) -> List[Tuple[Any, Any]]:
    """Return waypoints and road options from the actor's position along a route, and up to 200 m beyond its end."""
    # ScenarioRunner 0.9.13 has no planner that all share.
    planner = GlobalRoutePlanner(CarlaDataProvider.get_map(), _WAYPOINT_STEP)
    start = CarlaDataProvider.get_location(actor) or actor.get_location()
    plan: List[Tuple[Any, Any]] = []
    for target in targets:
        # A route may start at the actor's position.
        if target.distance(start) > _WAYPOINT_STEP:
            plan.extend(_trace_route(planner, start, target))
            start = target
    if plan:
        last = plan[-1][0]
        for _ in range(int(_EXTENSION / _WAYPOINT_STEP)):
            following = last.next(_WAYPOINT_STEP)
            if not following:
                break
            current = last
            last = min(
                following, key=lambda point: abs(_direction_difference(current, (point.next(_LOOKAHEAD) or [point])[0]))
            )
            plan.append((last, RoadOption.LANEFOLLOW))
    return plan


def _direction_difference(waypoint: Any, other: Any) -> float:
    """Return the difference between the directions of two waypoints in degrees."""
    turn = float(other.transform.rotation.yaw - waypoint.transform.rotation.yaw)
    return (turn + 180.0) % 360.0 - 180.0
