"""What ScenarioRunner has to find in a scenario so that the right one drives."""

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
    """Who drives entities instead of the storyboard.

    Attributes
    ----------
    behaviors : mapping of str to str
        Which of CARLA's behaviour agents drives an entity.
    agent, config : Path or None
        The user's own agent, which drives the ego, and its configuration.
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
    """Assign to each entity who moves it, where that is not ScenarioRunner's own control.

    ScenarioRunner 0.9.16 takes no routes (its waypoints need times since then), so a route of the initial actions is
    left to our own controller.

    Parameters
    ----------
    root : Element
        Of a scenario in OpenSCENARIO 1.0 without parameters; changed in place.
    source : Path
        For messages.
    ego : str
    agents : Agents
    sampled : mapping of str to float
        Entities that move along a trajectory, and how far the centre of the box lies ahead of the reference point, m.

    Returns
    -------
    set of Path
        Controllers that ScenarioRunner has to find.

    Raises
    ------
    InputError
        An entity with a behaviour agent has no route.
    """
    needed = set()
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
        for other in private.findall("PrivateAction"):
            if other.find("ControllerAction") is not None:
                private.remove(other)
        private.append(_controller_action(entity, properties))
        needed.add(TRAJECTORY if entity in sampled else DRIVER)
    return needed


def _taken_route(private: etree._Element) -> etree._Element:
    """Positions of the route that an entity is assigned at first, which is taken out."""
    route = etree.Element("route")
    for action in private.findall("PrivateAction"):
        found = action.find("RoutingAction")
        if found is None or found.find("FollowTrajectoryAction") is not None:
            continue
        private.remove(action)
        route.extend(found.iterfind(".//Position"))
    return route


def _controller_action(entity: str, properties: Mapping[str, str]) -> etree._Element:
    action = etree.Element("PrivateAction")
    both = etree.SubElement(action, "ControllerAction")
    controller = etree.SubElement(
        etree.SubElement(both, "AssignControllerAction"), "Controller", name=f"driver of {entity}"
    )
    holder = etree.SubElement(controller, "Properties")
    for name, value in properties.items():
        etree.SubElement(holder, "Property", name=name, value=value)
    # 1.0 requires this element; nothing in it is active, as ScenarioRunner would act on it.
    override = etree.SubElement(both, "OverrideControllerValueAction")
    for tag, attribute in _UNTOUCHED:
        etree.SubElement(override, tag, {attribute: "0", "active": "false"})
    return action
