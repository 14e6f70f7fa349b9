"""Tell ScenarioRunner which controller moves each entity of a scenario."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError
from cornercase.simulators.carla.storyboard import plain

DRIVER: Final = Path(__file__).with_name("cornercase_driver.py")
TRAJECTORY: Final = Path(__file__).with_name("cornercase_trajectory.py")
BEHAVIORS: Final = ("aggressive", "cautious", "normal")
_UNTOUCHED: Final = (
    ("Throttle", "value"), ("Brake", "value"), ("Clutch", "value"), ("ParkingBrake", "value"),
    ("SteeringWheel", "value"), ("Gear", "number"),
)  # fmt: skip


@dataclass(frozen=True)
class Agents:
    """Agents that drive entities instead of the storyboard.

    `behaviors`: CARLA's behaviour agents by entity; `agent` and `config`: the user's own agent, which drives the ego,
    and its configuration.
    """

    behaviors: Mapping[str, str] = field(default_factory=dict)
    agent: Path | None = None
    config: Path | None = None

    def driven(self, ego: str) -> set[str]:
        """Entities that an agent drives."""
        return set(self.behaviors) | ({ego} if self.agent is not None else set())


def assign_controllers(
    root: etree._Element, source: Path, ego: str, agents: Agents, sampled: Mapping[str, float]
) -> set[Path]:
    """Assign controllers to entities that ScenarioRunner's own controls do not move; return those that it must find.

    ScenarioRunner 0.9.16 does not execute routes (its waypoints need times since then), so our own controller follows
    the initial route. `sampled` are the entities on trajectories, with the distance in m by which the centre of the box
    is ahead of the reference point. Raises `InputError` if an entity with a behaviour agent has no route.
    """
    controllers = set()
    for private in root.iterfind("Storyboard/Init/Actions/Private"):
        entity = private.get("entityRef", "")
        route = _taken_route(private)
        properties = {}
        if entity in sampled:
            properties = {"module": TRAJECTORY.name, "center_x": plain(sampled[entity])}
        elif entity == ego and agents.agent is not None:
            properties = {"module": DRIVER.name, "agent": str(agents.agent), "agent_config": str(agents.config or "")}
        elif entity in agents.behaviors:
            if not len(route):
                raise InputError(
                    f"{source}: '{entity}' needs a route for CARLA's behaviour agent; give it an <AssignRouteAction> or"
                    " an <AcquirePositionAction> in <Init>."
                )
            properties = {"module": DRIVER.name, "behavior": agents.behaviors[entity]}
        elif len(route):
            properties = {"module": DRIVER.name}
        if not properties:
            continue
        if len(route):
            properties["route"] = etree.tostring(route, encoding="unicode")
        for old_action in private.findall("PrivateAction"):
            if old_action.find("ControllerAction") is not None:
                private.remove(old_action)
        private.append(_controller_action(entity, properties))
        controllers.add(TRAJECTORY if entity in sampled else DRIVER)
    return controllers


def _taken_route(private: etree._Element) -> etree._Element:
    """Remove an entity's initial route, and return its positions."""
    route = etree.Element("route")
    for action in private.findall("PrivateAction"):
        routing = action.find("RoutingAction")
        if routing is None or routing.find("FollowTrajectoryAction") is not None:
            continue
        private.remove(action)
        route.extend(routing.iterfind(".//Position"))
    return route


def _controller_action(entity: str, properties: Mapping[str, str]) -> etree._Element:
    action = etree.Element("PrivateAction")
    controller_action = etree.SubElement(action, "ControllerAction")
    controller = etree.SubElement(
        etree.SubElement(controller_action, "AssignControllerAction"), "Controller", name=f"driver of {entity}"
    )
    holder = etree.SubElement(controller, "Properties")
    for name, value in properties.items():
        etree.SubElement(holder, "Property", name=name, value=value)
    # Required in 1.0; all inactive, since ScenarioRunner would execute them.
    override = etree.SubElement(controller_action, "OverrideControllerValueAction")
    for tag, attribute in _UNTOUCHED:
        etree.SubElement(override, tag, {attribute: "0", "active": "false"})
    return action
