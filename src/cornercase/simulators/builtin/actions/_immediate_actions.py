"""Reader of all actions of a storyboard, and the actions that take effect immediately."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from lxml import etree

from cornercase._common.errors import suggest_name
from cornercase._common.io.tracked_xml import note_adaptation
from cornercase._common.typing import BoolArray
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.actions._action import Action
from cornercase.simulators.builtin.actions._controller import ControllerAction, VisibilityAction
from cornercase.simulators.builtin.actions._environment import read_environment_action
from cornercase.simulators.builtin.actions._follow_trajectory import FollowTrajectoryAction
from cornercase.simulators.builtin.actions._lateral import LaneChangeAction, LaneOffsetAction, LateralDistanceAction
from cornercase.simulators.builtin.actions._longitudinal import LongitudinalDistanceAction, SpeedAction, require_child
from cornercase.simulators.builtin.actions._speed_profile import SpeedProfileAction
from cornercase.simulators.builtin.actions._synchronize import SynchronizeAction
from cornercase.simulators.builtin.actions._trailer import read_trailer_action
from cornercase.simulators.builtin.paths._positions import read_entity_index, read_position, read_route
from cornercase.simulators.builtin.world._lane_following import assign_route, place_entity
from cornercase.simulators.builtin.world._text_values import has_no_conditions_with_tags, read_text_value
from cornercase.simulators.builtin.world._traffic_signals import SIGNAL_CONDITIONS, SignalController, read_signal_phase
from cornercase.simulators.builtin.world._world import LATERAL, LONGITUDINAL, World

# Actions without influence on criticality metrics.
WITHOUT_EFFECT: Final = (
    "AppearanceAction", "UserDefinedAction", "OverrideControllerValueAction", "SetMonitorAction",
)  # fmt: skip

_GROUPING_TAGS: Final = (
    "LongitudinalAction", "LateralAction", "RoutingAction", "InfrastructureAction", "TrafficSignalAction",
)  # fmt: skip


def read_action(element: etree._Element, scope: Scope, world: World, entity: int | None) -> Action | None:
    """Read a ``PrivateAction`` of an entity, given by index, or a ``GlobalAction``; None if it has no effect."""
    inner = find_action_element(element)
    if element.tag in WITHOUT_EFFECT:
        return None
    if inner is element:
        note_adaptation(element, f"<{element.tag}> without an action", "is skipped", f"<{element.tag}> holds an action")
        return None
    if inner.tag in WITHOUT_EFFECT:
        return None
    if inner.tag in _GLOBAL_READERS:
        return _GLOBAL_READERS[inner.tag](inner, scope, world, entity)
    if inner.tag not in _PRIVATE_READERS:
        raise scope.error_at(
            inner,
            f"<{inner.tag}> is not supported by the builtin simulator;"
            f" it runs {', '.join((*_PRIVATE_READERS, *_GLOBAL_READERS))}.",
        )
    if entity is None:
        raise scope.error_at(inner, f"<{inner.tag}> needs an entity that acts.")
    return _PRIVATE_READERS[inner.tag](inner, scope, world, entity)


def find_action_element(element: etree._Element) -> etree._Element:
    """Return the action inside grouping elements such as ``LongitudinalAction``; `element` if there is no action."""
    inner = element.find("*")
    while inner is not None and inner.tag in _GROUPING_TAGS:
        inner = inner.find("*")
    return element if inner is None else inner


class TeleportAction(Action):
    """Action that moves an entity to a position immediately."""

    domains = (LONGITUDINAL, LATERAL)

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity = entity
        self._position = read_position(require_child(element, "Position", scope), scope, world)

    def start(self, world: World, where: BoolArray) -> None:
        # Relative positions follow the route of the placed entity.
        world.positioned_entity = self._entity
        pose = self._position(world)
        world.positioned_entity = None
        place_entity(world, self._entity, pose, where)


class AssignRouteAction(Action):
    """Action that sets which roads an entity takes at junctions."""

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity = entity
        self._route = read_route(element, scope, world)

    def start(self, world: World, where: BoolArray) -> None:
        roads = np.stack([pose.road for pose in self._route(world) if pose.road is not None])
        for route in np.unique(roads[:, where], axis=1).T:
            rows = where & (roads == route[:, None]).all(axis=0)
            assign_route(world, self._entity, tuple(int(road) for road in route), rows)


class AcquirePositionAction(Action):
    """Action that makes an entity drive to a position, by assigning a route to the road of this position."""

    domains = (LONGITUDINAL,)

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity = entity
        self._position = read_position(require_child(element, "Position", scope), scope, world)

    def start(self, world: World, where: BoolArray) -> None:
        pose = self._position(world)
        if pose.road is None:
            return
        for road in np.unique(pose.road[where]):
            assign_route(world, self._entity, (int(road),), where & (pose.road == road))


class EntityAction(Action):
    """Action that adds an entity to the traffic or removes the entity."""

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int | None) -> None:
        self._entity = read_entity_index(element, scope, world)
        add = element.find("AddEntityAction")
        self._position = None
        if add is not None:
            self._position = read_position(require_child(add, "Position", scope), scope, world)
        elif element.find("DeleteEntityAction") is None:
            raise scope.error_at(element, "<EntityAction> neither adds nor deletes an entity.")

    def start(self, world: World, where: BoolArray) -> None:
        if self._position is None:
            world.present[self._entity][where] = False
        else:
            added = where & ~world.present[self._entity]
            place_entity(world, self._entity, self._position(world), added)
            # Unlike a teleported entity, it moves in the same step.
            world.moved[self._entity][added] = False


class SetOrModifyAction(Action):
    """Action that sets or modifies a variable or, in files before OpenSCENARIO 1.2, a parameter."""

    def __init__(self, element: etree._Element, scope: Scope, values: dict[str, Any], name: str) -> None:
        self._name, self._values = name, values
        source = element.find("SetAction")
        self._set = source is not None
        if source is None:
            rule = element.find("ModifyAction/Rule")
            source = None if rule is None else rule.find("*")
            if source is None or source.tag not in ("AddValue", "MultiplyByValue"):
                raise scope.error_at(element, f"<{element.tag}> neither sets a value nor adds to it nor multiplies it.")
        self._operation = np.multiply if source.tag == "MultiplyByValue" else np.add
        numeric = values[self._name].dtype.kind == "f"
        text = "" if numeric else read_text_value(source, scope, values[self._name])
        self._value = scope.read_numbers(source, "value") if numeric else np.full(scope.n_scenarios, text)
        if not numeric and not self._set:
            raise scope.error_at(element, f"<{element.tag}>: '{name}' is not a number and can only be set.")

    def start(self, world: World, where: BoolArray) -> None:
        values = self._values[self._name]
        new = self._value if self._set else self._operation(values, self._value)
        # A new array, as longer texts need a wider dtype.
        self._values[self._name] = np.where(where, new, values)


def _read_variable_action(element: etree._Element, scope: Scope, world: World, entity: int | None) -> Action | None:
    attribute = "variableRef" if element.tag == "VariableAction" else "parameterRef"
    noun, values = attribute.removesuffix("Ref"), world.variables if attribute == "variableRef" else world.parameters
    name = element.get(attribute, "").lstrip("$")
    if name in values:
        return SetOrModifyAction(element, scope, values, name)
    if has_no_conditions_with_tags(element, f"{noun.capitalize()}Condition"):
        why = f"is skipped, as there is no {noun} '{name}', and no condition uses it"
        note_adaptation(element, f"<{element.tag}>", why, f"{attribute} names a {noun} that is declared")
        return None
    raise scope.error_at(element, f"<{element.tag}>: there is no {noun} '{name}'; {suggest_name(name, values)}")


class TrafficSignalControllerAction(Action):
    """Action that starts a phase of a traffic signal controller, which then continues with the next phases."""

    def __init__(self, controller: SignalController, phase: int) -> None:
        self._controller, self._phase = controller, phase

    def start(self, world: World, where: BoolArray) -> None:
        self._controller.start_phase(self._phase, world.time, where)
        self._controller.update_signals(world.signals, world.time, world.running)


def _read_signal_controller_action(
    element: etree._Element, scope: Scope, world: World, entity: int | None
) -> Action | None:
    name = scope.read_text(element, "trafficSignalControllerRef")
    phase = scope.read_text(element, "phase")
    controller = world.signal_controllers.get(name)
    if (controller is None or phase not in controller.names) and has_no_conditions_with_tags(
        element, *SIGNAL_CONDITIONS
    ):
        lacking = f"signal controller '{name}'" if controller is None else f"phase '{phase}' of '{name}'"
        why = f"is skipped, as there is no {lacking}, and no condition uses signals"
        note_adaptation(element, f"<{element.tag}>", why, "it names a signal controller of the file, and a phase of it")
        return None
    return TrafficSignalControllerAction(*read_signal_phase(element, scope, world.signal_controllers))


class TrafficSignalStateAction(Action):
    """Action that switches a traffic signal; conditions and drivers then read the new state of the signal."""

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int | None) -> None:
        self._name, self._state = scope.read_text(element, "name"), scope.read_text(element, "state")

    def start(self, world: World, where: BoolArray) -> None:
        before = world.signals.get(self._name, np.full(world.scenarios, ""))
        world.signals[self._name] = np.where(where, self._state, before)


_PRIVATE_READERS: Final[dict[str, Callable[[etree._Element, Scope, World, int], Action | None]]] = {
    "TeleportAction": TeleportAction,
    "SpeedAction": SpeedAction,
    "SpeedProfileAction": SpeedProfileAction,
    "LongitudinalDistanceAction": LongitudinalDistanceAction,
    "LaneChangeAction": LaneChangeAction,
    "LaneOffsetAction": LaneOffsetAction,
    "LateralDistanceAction": LateralDistanceAction,
    "AssignRouteAction": AssignRouteAction,
    "AcquirePositionAction": AcquirePositionAction,
    "FollowTrajectoryAction": FollowTrajectoryAction,
    "SynchronizeAction": SynchronizeAction,
    "ControllerAction": ControllerAction,
    "AssignControllerAction": ControllerAction,
    "ActivateControllerAction": ControllerAction,
    "VisibilityAction": VisibilityAction,
    "TrailerAction": read_trailer_action,
}

_GLOBAL_READERS: Final[dict[str, Callable[[etree._Element, Scope, World, int | None], Action | None]]] = {
    "EntityAction": EntityAction,
    "EnvironmentAction": read_environment_action,
    "VariableAction": _read_variable_action,
    "ParameterAction": _read_variable_action,
    "TrafficSignalStateAction": TrafficSignalStateAction,
    "TrafficSignalControllerAction": _read_signal_controller_action,
}
