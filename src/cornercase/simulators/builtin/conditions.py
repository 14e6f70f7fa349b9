"""Conditions: a boolean for every scenario of a batch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np
from lxml import etree

from cornercase.errors import InputError, suggestion
from cornercase.simulators.builtin.positions import entity_index, read_position
from cornercase.simulators.builtin.scope import Scope
from cornercase.simulators.builtin.world import World
from cornercase.typing import BoolArray, FloatArray

if TYPE_CHECKING:
    from cornercase.simulators.builtin.storyboard import Element

Test = Callable[[World], BoolArray]

_TOLERANCE: Final = 1e-6


def _equal(a: Any, b: Any) -> Any:
    return np.abs(a - b) <= _TOLERANCE


_RULES: Final[dict[str, Callable[[Any, Any], Any]]] = {
    "greaterThan": lambda a, b: a > b + _TOLERANCE,
    "lessThan": lambda a, b: a < b - _TOLERANCE,
    "equalTo": _equal,
    "greaterOrEqual": lambda a, b: a >= b - _TOLERANCE,
    "lessOrEqual": lambda a, b: a <= b + _TOLERANCE,
    "notEqualTo": lambda a, b: ~_equal(a, b),
}


class Elements(Protocol):
    """Storyboard elements by name, known only once the whole storyboard is read."""

    def named(self, kind: str, name: str) -> Element | None:
        """Element of a kind and name; None where there is none."""
        ...


class Condition:
    """One condition with its edge and delay.

    Parameters
    ----------
    test : callable
        World to boolean array of shape (N,).
    edge : str
        ``"none"``, ``"rising"``, ``"falling"`` or ``"risingOrFalling"``.
    delay : ndarray of float64, shape (N,)
        s; what held this long ago counts now.
    """

    def __init__(self, test: Test, edge: str, delay: FloatArray) -> None:
        self._test, self._edge, self._delay = test, edge, delay
        self.delayed = bool((delay > 0).any())
        self._last = np.full(len(delay), -1, dtype=np.int8)
        self._times: list[float] = []
        self._held: list[BoolArray] = []

    def evaluate(self, world: World, where: BoolArray) -> BoolArray:
        """Whether the condition holds in the scenarios of the mask, shape (N,)."""
        now = self._test(world)
        last = self._last
        if self._edge == "none":
            result = now
        elif self._edge == "rising":
            result = now & (last == 0)
        elif self._edge == "falling":
            result = ~now & (last == 1)
        else:
            result = (last >= 0) & (now != (last == 1))
        self._last = np.where(where, now.astype(np.int8), last)
        if not self.delayed:
            return result & where
        self._times.append(world.time)
        self._held.append(result & where)
        then = np.searchsorted(self._times, world.time - self._delay + _TOLERANCE, "right") - 1
        delayed = np.zeros_like(where)
        for frame in np.unique(then[then >= 0]):
            delayed |= self._held[frame] & (then == frame)
        return delayed & where

    def forget(self, where: BoolArray) -> None:
        """Begin anew in the scenarios of the mask."""
        self._last[where] = -1


class Trigger:
    """Condition groups, of which one has to hold with all its conditions.

    Parameters
    ----------
    groups : list of list of Condition
        A trigger without groups never fires.
    """

    def __init__(self, groups: list[list[Condition]]) -> None:
        self._groups = groups

    @property
    def empty(self) -> bool:
        """Whether there is nothing that could ever hold."""
        return not self._groups

    def fires(self, world: World, where: BoolArray) -> BoolArray:
        """Scenarios of the mask in which the trigger fires, shape (N,)."""
        fired = np.zeros_like(where)
        if not where.any():
            return fired
        for group in self._groups:
            holds = where.copy()
            for condition in group:
                # A condition without delay is not looked at where an earlier one is false: its edge state rests.
                holds &= condition.evaluate(world, where if condition.delayed else holds)
            fired |= holds
        if fired.any():
            for group in self._groups:
                for condition in group:
                    condition.forget(fired)
        return fired


def read_trigger(element: etree._Element | None, scope: Scope, world: World, elements: Elements) -> Trigger:
    """Read a ``StartTrigger`` or ``StopTrigger``; one that is missing never fires."""
    groups: list[list[Condition]] = []
    for group in () if element is None else element.iterfind("ConditionGroup"):
        conditions = []
        for item in group.iterfind("Condition"):
            edge = scope.text(item, "conditionEdge", "none")
            if edge not in ("none", "rising", "falling", "risingOrFalling"):
                raise InputError(
                    f"{scope.source}, line {item.sourceline}: conditionEdge '{edge}' is not none, rising, falling or"
                    " risingOrFalling."
                )
            conditions.append(
                Condition(_read_test(item, scope, world, elements), edge, scope.number(item, "delay", 0.0))
            )
        groups.append(conditions)
    return Trigger(groups)


def _read_test(condition: etree._Element, scope: Scope, world: World, elements: Elements) -> Test:
    kind = next(iter(condition.iterchildren("*")), None)
    if kind is not None and kind.tag == "ByEntityCondition":
        holder = kind.find("EntityCondition")
        inner = None if holder is None else next(iter(holder.iterchildren("*")), None)
        if inner is not None and inner.tag in _BY_ENTITY:
            test = _BY_ENTITY[inner.tag](inner, scope, world)
            return _of_triggering_entities(kind, scope, world, test)
    else:
        inner = None if kind is None else next(iter(kind.iterchildren("*")), None)
        if inner is not None and inner.tag in _BY_VALUE:
            return _BY_VALUE[inner.tag](inner, scope, world, elements)
    tag = condition.tag if inner is None else inner.tag
    raise InputError(
        f"{scope.source}, line {condition.sourceline}: <{tag}> is not supported by the builtin simulator; it reads"
        f" {', '.join((*_BY_VALUE, *_BY_ENTITY))}."
    )


EntityTest = Callable[[World, int], BoolArray]


def _of_triggering_entities(element: etree._Element, scope: Scope, world: World, test: EntityTest) -> Test:
    holder = element.find("TriggeringEntities")
    if holder is None:
        raise InputError(f"{scope.source}, line {element.sourceline}: <ByEntityCondition> has no <TriggeringEntities>.")
    every = scope.text(holder, "triggeringEntitiesRule", "any") == "all"
    entities = [entity_index(e, scope, world) for e in holder.iterfind("EntityRef")]

    def of_all(world: World) -> BoolArray:
        result = np.stack([test(world, e) & world.present[e] for e in entities])
        return np.asarray(result.all(axis=0) if every else result.any(axis=0))

    return of_all


def _rule(element: etree._Element, scope: Scope) -> Callable[[Any, Any], Any]:
    rule = scope.text(element, "rule", "equalTo")
    if rule not in _RULES:
        raise InputError(f"{scope.source}, line {element.sourceline}: rule '{rule}': {suggestion(rule, _RULES)}")
    return _RULES[rule]


def _simulation_time(element: etree._Element, scope: Scope, world: World, elements: Elements) -> Test:
    rule, value, n = _rule(element, scope), scope.number(element, "value"), scope.scenarios
    return lambda world: np.asarray(rule(np.full(n, world.time), value))


def _element_state(element: etree._Element, scope: Scope, world: World, elements: Elements) -> Test:
    kind = scope.text(element, "storyboardElementType")
    name, state = scope.text(element, "storyboardElementRef"), scope.text(element, "state")
    where = f"{scope.source}, line {element.sourceline}"

    def holds(world: World) -> BoolArray:
        found = elements.named(kind, name)
        if found is None:
            raise InputError(f"{where}: there is no {kind} '{name}' in the storyboard.")
        return found.is_in(state, where)

    return holds


def _parameter(element: etree._Element, scope: Scope, world: World, elements: Elements) -> Test:
    name, n = scope.text(element, "parameterRef").lstrip("$"), scope.scenarios
    if name not in scope.values:
        raise InputError(
            f"{scope.source}, line {element.sourceline}: there is no parameter '{name}';"
            f" {suggestion(name, scope.values)}"
        )
    held = scope.values[name]
    if isinstance(held, str | bool):
        text = str(held).lower() if isinstance(held, bool) else held
        same = text == scope.text(element, "value")
        result = np.full(n, same if scope.text(element, "rule", "equalTo") == "equalTo" else not same)
    else:
        result = np.broadcast_to(_rule(element, scope)(held, scope.number(element, "value")), (n,)).copy()
    return lambda world: result


def _traveled(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    value = scope.number(element, "value")
    return lambda world, e: np.asarray(world.odometer[e] >= value - _TOLERANCE)


def _reach_position(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    holder = element.find("Position")
    if holder is None:
        raise InputError(f"{scope.source}, line {element.sourceline}: <ReachPositionCondition> has no <Position>.")
    position, tolerance = read_position(holder, scope, world), scope.number(element, "tolerance")

    def reached(world: World, e: int) -> BoolArray:
        pose = position(world)
        return np.asarray(np.hypot(pose.x - world.x[e], pose.y - world.y[e]) < tolerance)

    return reached


def _speed(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    rule, value = _rule(element, scope), scope.number(element, "value")
    return lambda world, e: np.asarray(rule(world.speed[e], value))


def _relative_speed(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    rule, value, other = (
        _rule(element, scope),
        scope.number(element, "value"),
        entity_index(element, scope, world),
    )
    return lambda world, e: np.asarray(rule(world.speed[e] - world.speed[other], value))


def _acceleration(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    rule, value = _rule(element, scope), scope.number(element, "value")
    return lambda world, e: np.asarray(rule(world.acceleration[e], value))


def _stand_still(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    duration = scope.number(element, "duration")
    return lambda world, e: np.asarray(world.time - world.standing_since[e] > duration)


def _collision(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    if element.find("EntityRef") is None:
        by_type = element.find("ByType")
        if by_type is None:
            raise InputError(f"{scope.source}, line {element.sourceline}: <CollisionCondition> names no entity.")
        raise InputError(
            f"{scope.source}, line {element.sourceline}: <CollisionCondition> by type is not supported by the builtin"
            " simulator; name an entity with <EntityRef>."
        )
    other = entity_index(element.find("EntityRef"), scope, world)  # type: ignore[arg-type]
    return lambda world, e: world.touching[e, other].copy()


def _relative_distance(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    kind = scope.text(element, "relativeDistanceType", "euclidianDistance")
    system = scope.text(element, "coordinateSystem", "entity")
    if system != "entity" or kind not in _ALONG:
        raise InputError(
            f"{scope.source}, line {element.sourceline}: <RelativeDistanceCondition> in the {system} system of kind"
            f" {kind} is not supported by the builtin simulator; use the entity system."
        )
    other = entity_index(element, scope, world)
    rule, value = _rule(element, scope), scope.number(element, "value")
    free = scope.flag(element, "freespace", False)
    if free:
        raise InputError(
            f'{scope.source}, line {element.sourceline}: <RelativeDistanceCondition> with freespace="true" is not'
            " supported by the builtin simulator."
        )
    measure = _ALONG[kind]
    return lambda world, e: np.asarray(rule(measure(world, e, other), value))


def _euclidean(world: World, e: int, other: int) -> FloatArray:
    return np.asarray(np.hypot(world.x[other] - world.x[e], world.y[other] - world.y[e]))


def _longitudinal(world: World, e: int, other: int) -> FloatArray:
    dx, dy = world.x[other] - world.x[e], world.y[other] - world.y[e]
    return np.asarray(np.abs(dx * np.cos(world.heading[e]) + dy * np.sin(world.heading[e])))


def _lateral(world: World, e: int, other: int) -> FloatArray:
    dx, dy = world.x[other] - world.x[e], world.y[other] - world.y[e]
    return np.asarray(np.abs(dy * np.cos(world.heading[e]) - dx * np.sin(world.heading[e])))


_ALONG: Final[Mapping[str, Callable[[World, int, int], FloatArray]]] = {
    "euclidianDistance": _euclidean,
    "cartesianDistance": _euclidean,
    "longitudinal": _longitudinal,
    "lateral": _lateral,
}

_BY_VALUE: Final[dict[str, Callable[[etree._Element, Scope, World, Elements], Test]]] = {
    "SimulationTimeCondition": _simulation_time,
    "StoryboardElementStateCondition": _element_state,
    "ParameterCondition": _parameter,
}

_BY_ENTITY: Final[dict[str, Callable[[etree._Element, Scope, World], EntityTest]]] = {
    "TraveledDistanceCondition": _traveled,
    "ReachPositionCondition": _reach_position,
    "SpeedCondition": _speed,
    "RelativeSpeedCondition": _relative_speed,
    "AccelerationCondition": _acceleration,
    "StandStillCondition": _stand_still,
    "CollisionCondition": _collision,
    "RelativeDistanceCondition": _relative_distance,
}
