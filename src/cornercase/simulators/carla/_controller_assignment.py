"""Assignment of controllers to the entities of a scenario, as ScenarioRunner reads them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError
from cornercase.simulators.carla._agent_server import AGENT_FILE
from cornercase.simulators.carla._storyboard_rewrite import E

DRIVER_FILE: Final = Path(__file__).with_name("cornercase_driver.py")
TRAJECTORY_FILE: Final = Path(__file__).with_name("cornercase_trajectory.py")
BEHAVIORS: Final = ("aggressive", "cautious", "normal")
# Controller of ScenarioRunner that does nothing.
_EXTERNAL_CONTROL: Final = "external_control"
_INACTIVE_OVERRIDES: Final = (
    ("Throttle", "value"), ("Brake", "value"), ("Clutch", "value"), ("ParkingBrake", "value"),
    ("SteeringWheel", "value"), ("Gear", "number"),
)  # fmt: skip


@dataclass(frozen=True)
class DrivingAgents:
    """Agents that drive entities instead of the storyboard.

    `behaviors`: names of CARLA's behaviour agents, by entity. `agent`: file of an agent that drives the ego. `config`:
    configuration file of this agent. `external`: whether another program has made the ego and drives it.
    """

    behaviors: Mapping[str, str] = field(default_factory=dict)
    agent: Path | None = None
    config: Path | None = None
    external: bool = False

    def driven_entities(self, ego: str) -> set[str]:
        """Return the entities that an agent or another program drives."""
        return set(self.behaviors) | ({ego} if self.agent is not None or self.external else set())

    def driven_by_route(self, ego: str) -> set[str]:
        """Return the entities whose agents follow a route along CARLA's lanes."""
        return set(self.behaviors) | ({ego} if self.agent not in (None, AGENT_FILE) else set())


def assign_controllers(
    root: etree._Element,
    source: Path,
    ego: str,
    agents: DrivingAgents,
    trajectories: Mapping[str, Mapping[str, str]],
) -> set[Path]:
    """Assign controllers to entities that ScenarioRunner's own controls cannot move; return the controllers' files.

    Entities with an initial route get a controller of cornercase, since ScenarioRunner does not execute routes. An ego
    that another program drives gets ScenarioRunner's controller that does nothing, and no route.

    `trajectories`: properties of the controllers that move entities along trajectories, by entity. `source` names the
    scenario in messages.
    """
    controllers: set[Path] = set()
    for private in root.iterfind("Storyboard/Init/Actions/Private"):
        entity = private.get("entityRef", "")
        route = _pop_initial_route(private)
        properties = {}
        if entity in trajectories:
            properties = {"module": TRAJECTORY_FILE.name, **trajectories[entity]}
        elif entity == ego and agents.external:
            properties = {"module": _EXTERNAL_CONTROL}
        elif entity == ego and agents.agent is not None:
            properties = {
                "module": DRIVER_FILE.name,
                "agent": str(agents.agent),
                "agent_config": str(agents.config or ""),
            }
        elif entity in agents.behaviors:
            if not len(route):
                raise InputError(
                    f"{source}: '{entity}' needs a route for CARLA's behaviour agent; give it an <AssignRouteAction> or"
                    " an <AcquirePositionAction> in <Init>."
                )
            properties = {"module": DRIVER_FILE.name, "behavior": agents.behaviors[entity]}
        elif len(route):
            properties = {"module": DRIVER_FILE.name}
        if not properties:
            continue
        if len(route) and properties["module"] != _EXTERNAL_CONTROL:
            properties["route"] = etree.tostring(route, encoding="unicode")
        for old_action in private.findall("PrivateAction"):
            if old_action.find("ControllerAction") is not None:
                private.remove(old_action)
        private.append(_make_controller_action(entity, properties))
        controllers |= {file for file in (TRAJECTORY_FILE, DRIVER_FILE) if file.name == properties["module"]}
    return controllers


def _pop_initial_route(private: etree._Element) -> etree._Element:
    """Remove the initial route of an entity; return an element with the route's positions, none without a route."""
    route = etree.Element("route")
    for action in private.findall("PrivateAction"):
        routing = action.find("RoutingAction")
        if routing is None or routing.find("FollowTrajectoryAction") is not None:
            continue
        private.remove(action)
        route.extend(routing.iterfind(".//Position"))
    return route


def _make_controller_action(entity: str, properties: Mapping[str, str]) -> etree._Element:
    elements = [E.Property(name=name, value=value) for name, value in properties.items()]
    controller = E.Controller(E.Properties(*elements), name=f"driver of {entity}")
    # Required in 1.0; all inactive, since ScenarioRunner would execute them.
    overrides = [getattr(E, tag)({attribute: "0", "active": "false"}) for tag, attribute in _INACTIVE_OVERRIDES]
    return E.PrivateAction(
        E.ControllerAction(E.AssignControllerAction(controller), E.OverrideControllerValueAction(*overrides))
    )
