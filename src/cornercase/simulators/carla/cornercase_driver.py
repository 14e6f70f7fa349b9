"""Drives a vehicle on CARLA along the route of its scenario.

ScenarioRunner loads this file by its name, in its own environment and an older Python; it uses nothing of cornercase.
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

# m that a vehicle drives on along its lane after its route, so that it does not stop in the way of others.
_BEYOND = 200.0
_STEP = 2.0
# m after which lanes that part on a junction can be told apart.
_AHEAD = 15.0


class CornercaseDriver(NpcVehicleControl):  # type: ignore[misc]
    """Follows a route as CARLA's behaviour agent, as an agent of the user's, or at the storyboard's speed.

    Parameters
    ----------
    actor : carla.Vehicle
    args : dict
        ``behavior`` is "cautious", "normal" or "aggressive", or missing; ``agent`` the file of an ``AutonomousAgent``
        and ``agent_config`` its configuration, or missing; ``route`` an XML element whose children are the positions
        of an OpenSCENARIO route.
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
            self._agent = _OwnAgent(actor, args["agent"], args.get("agent_config", ""), targets)
        elif args.get("behavior"):
            self._agent = BehaviorAgent(actor, behavior=args["behavior"])
            self._agent.set_global_plan(_plan(actor, targets))
        elif targets:
            self._local_planner.set_global_plan(_plan(actor, targets))

    def run_step(self) -> None:
        """Control the vehicle in one tick."""
        if self._agent is None:
            super().run_step()
            return
        if not self._actor.is_alive:
            return
        if self._init_speed:
            # Only at the start; from then on the agent decides the speed.
            self._init_speed = False
            ahead = self._actor.get_transform().get_forward_vector()
            self._actor.set_target_velocity(ahead * float(self._target_speed))
        if self._agent.done():
            self._reached_goal = True
            self._actor.apply_control(carla.VehicleControl(brake=1.0))
        else:
            self._actor.apply_control(self._agent.run_step())

    def reset(self) -> None:
        """Give back what the agent holds."""
        if isinstance(self._agent, _OwnAgent):
            self._agent.close()
        self._agent = None
        super().reset()


class _OwnAgent:
    """An agent of the user's, as ScenarioRunner would run it; it does so in route scenarios only."""

    def __init__(self, actor: Any, file: str, config: str, targets: List[Any]) -> None:
        sys.path.insert(0, os.path.dirname(file))
        module = importlib.import_module(os.path.splitext(os.path.basename(file))[0])
        # Named as ScenarioRunner would have it: my_agent.py holds MyAgent.
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


def _plan(actor: Any, targets: List[Any]) -> List[Tuple[Any, Any]]:
    """Waypoints and road options from where the actor is along a route, and beyond."""
    planner = CarlaDataProvider.get_global_route_planner()
    at = CarlaDataProvider.get_location(actor) or actor.get_location()
    plan: List[Tuple[Any, Any]] = []
    for target in targets:
        # A route may begin where the actor is.
        if target.distance(at) > _STEP:
            plan.extend(planner.trace_route(at, target))
            at = target
    if plan:
        last = plan[-1][0]
        for _ in range(int(_BEYOND / _STEP)):
            following = last.next(_STEP)
            if not following:
                break
            here = last
            last = min(following, key=lambda point: abs(_turn(here, (point.next(_AHEAD) or [point])[0])))
            plan.append((last, RoadOption.LANEFOLLOW))
    return plan


def _turn(one: Any, other: Any) -> float:
    """Difference of two waypoints' directions, in degrees."""
    turn = float(other.transform.rotation.yaw - one.transform.rotation.yaw)
    return (turn + 180.0) % 360.0 - 180.0
