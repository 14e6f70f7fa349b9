"""Controller that drives a vehicle on CARLA along the route of its scenario.

ScenarioRunner loads this file by its name, in its own environment with an older Python, so it must not import
cornercase.
"""

from __future__ import annotations

import importlib
import os
import sys
import xml.etree.ElementTree as ElementTree
from typing import Any, Dict, List, Optional, Tuple

import carla
from agents.navigation.behavior_agent import BehaviorAgent
from agents.navigation.local_planner import RoadOption
from srunner.autoagents.agent_wrapper import AgentWrapper
from srunner.scenariomanager.actorcontrols.npc_vehicle_control import NpcVehicleControl
from srunner.scenariomanager.carla_data_provider import CarlaDataProvider
from srunner.tools.openscenario_parser import OpenScenarioParser
from srunner.tools.route_manipulation import interpolate_trajectory

# Distance in m that a vehicle continues along its lane after its route, so that it does not block others.
_EXTENSION = 200.0
_WAYPOINT_STEP = 2.0
# Distance in m after which diverging lanes on a junction can be distinguished.
_LOOKAHEAD = 15.0


class CornercaseDriver(NpcVehicleControl):  # type: ignore[misc]
    """Follows a route as CARLA's behaviour agent, as the user's agent, or at the speed of the storyboard.

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
    """The user's agent, run in the way in which ScenarioRunner runs it in route scenarios."""

    def __init__(self, actor: Any, file: str, config: str, targets: List[Any]) -> None:
        sys.path.insert(0, os.path.dirname(file))
        module = importlib.import_module(os.path.splitext(os.path.basename(file))[0])
        # ScenarioRunner's naming convention: my_agent.py contains MyAgent.
        self._agent = getattr(module, module.__name__.title().replace("_", ""))(config)
        if targets:
            self._agent.set_global_plan(*interpolate_trajectory([actor.get_location(), *targets]))
        self._wrapper = AgentWrapper(self._agent)
        self._wrapper.setup_sensors(actor)

    def done(self) -> bool:
        return False

    def run_step(self) -> Any:
        return self._wrapper()

    def close(self) -> None:
        self._wrapper.cleanup()
        self._agent.destroy()


def _plan_route(actor: Any, targets: List[Any]) -> List[Tuple[Any, Any]]:
    """Return waypoints and road options from the actor's position along a route, and on beyond its end."""
    planner = CarlaDataProvider.get_global_route_planner()
    start = CarlaDataProvider.get_location(actor) or actor.get_location()
    plan: List[Tuple[Any, Any]] = []
    for target in targets:
        # A route may start at the actor's position.
        if target.distance(start) > _WAYPOINT_STEP:
            plan.extend(planner.trace_route(start, target))
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
    """Difference of two waypoints' directions in degrees."""
    turn = float(other.transform.rotation.yaw - waypoint.transform.rotation.yaw)
    return (turn + 180.0) % 360.0 - 180.0
