"""Conditions and triggers, evaluated for every scenario of a batch."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final, Protocol

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError, suggestion
from cornercase._common.masks import anywhere
from cornercase._common.places import placed
from cornercase._common.recorded_xml import adapt
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario import Scope, is_never_true
from cornercase.simulators.builtin.actions.longitudinal import child
from cornercase.simulators.builtin.frames import leaves
from cornercase.simulators.builtin.frames.gaps import TOLERANCE
from cornercase.simulators.builtin.frames.leaves import Asked, Leaf
from cornercase.simulators.builtin.paths.positions import entities_in
from cornercase.simulators.builtin.storyboard.element import Watch
from cornercase.simulators.builtin.storyboard.entity_conditions import (
    BY_ENTITY,
    EntityTest,
    Known,
    number_of_rule,
    rule_of,
)
from cornercase.simulators.builtin.world.held import as_held
from cornercase.simulators.builtin.world.signals import named_controller, named_phase
from cornercase.simulators.builtin.world.state import World

Test = Callable[[World, BoolArray], BoolArray]

_CONSTANT: Final = Leaf(leaves.CONSTANT)

# Conditions that only a user's program or the time of day can make true.
NEVER_TRUE: Final = ("UserDefinedValueCondition", "TimeOfDayCondition")


_TEXT_RULES: Final[dict[str, Callable[[Any, Any], Any]]] = {
    "equalTo": np.equal,
    "notEqualTo": np.not_equal,
    "lessThan": np.less,
    "lessOrEqual": np.less_equal,
    "greaterThan": np.greater,
    "greaterOrEqual": np.greater_equal,
}


class Elements(Protocol):
    """Storyboard elements by name, available once the whole storyboard is read."""

    def watch(self, kind: str, name: str, watch: Watch, where: str) -> None:
        """Connect a condition to the element of a kind and name once all elements are read."""
        ...


class Condition:
    """One condition with its edge and its delay in s, shape (N,).

    `test` takes the world and a mask of scenarios, and returns a boolean array (N,). `edge` is ``"none"``,
    ``"rising"``, ``"falling"`` or ``"risingOrFalling"``. With a delay, the value of that long ago counts.
    """

    def __init__(self, test: Test, edge: str, delay: FloatArray) -> None:
        self.test, self._edge = test, edge
        self.delayed = np.asarray(delay > 0)
        self._last = np.full(len(delay), -1, dtype=np.int8)
        self._past = Past(delay, edge != "none") if anywhere(self.delayed) else None

    def evaluate(self, world: World, where: BoolArray) -> BoolArray:
        """Evaluate the condition in the scenarios of the mask, shape (N,)."""
        if not anywhere(where):
            return where
        value = self.test(world, where)
        last = self._last
        if self._edge == "none":
            result = value
        elif self._edge == "rising":
            result = value & (last == 0)
        elif self._edge == "falling":
            result = ~value & (last == 1)
        else:
            result = (last >= 0) & (value != (last == 1))
        self._last = np.where(where, value.astype(np.int8), last)
        if self._edge != "none":
            world.stirred |= self._last != last
        return where & (result if self._past is None else self._past.recall(world, result, where))

    @property
    def asked(self) -> Asked | None:
        """What kernels evaluate for it; None if they cannot."""
        test, plain = self.test, self._edge == "none" and self._past is None
        if isinstance(test, OfEntities):
            return None if test.leaves is None else Asked(test.leaves, test.every, plain)
        if isinstance(test, ByValue):
            return Asked([(-1, test.leaf)], True, plain)
        return Asked([], True, False) if isinstance(test, Watch) else None

    def constant(self, world: World) -> BoolArray | None:
        """Its value (N,) if only the storyboard can change it; otherwise None."""
        test = self.test
        return test.value(world) if isinstance(test, ByValue) and test.leaf.kind == leaves.CONSTANT else None

    @property
    def past(self) -> Past | None:
        """Its delayed values, if it has a delay."""
        return self._past

    def rearm(self, where: BoolArray) -> None:
        """See no edge at the next evaluation in the scenarios of the mask."""
        self._last[where] = -1

    def reset(self, where: BoolArray) -> None:
        """Restart delays in the scenarios of the mask."""
        if self._past is not None:
            self._past.forget(where)
        if isinstance(self.test, Watch):
            self.test.forget(where)


class Past:
    """Earlier values of a condition with a delay in s, shape (N,).

    `is_sudden`: whether its value may change in the next frame although its inputs have not.
    """

    def __init__(self, delay: FloatArray, sudden: bool) -> None:
        self._delay, self._sudden = delay, sudden
        # Frames whose delay has not passed in all scenarios: times, values, and where the value changed.
        self._frames: list[tuple[FloatArray, BoolArray, BoolArray]] = []
        self._newest, self._now = (np.full(len(delay), -1, dtype=np.int8) for _ in range(2))

    def recall(self, world: World, value: BoolArray, where: BoolArray) -> BoolArray:
        """Store the current value, and return the delayed one, shape (N,).

        Of several values since the last call, any true one counts.
        """
        new, time = where & (self._newest != value), world.time
        self._newest[new] = value[new]
        if self._sudden:
            world.stirred |= new
        for past_time, past_value, changed in self._frames:
            # The first two frames have the same time; the later one counts.
            same_time = new & changed & (time <= past_time)
            past_value[same_time] = value[same_time]
            new &= ~same_time
        if anywhere(new):
            self._frames.append((time.copy(), value.copy(), new))
        result, is_due = np.zeros_like(where), np.zeros_like(where)
        for past_time, past_value, changed in self._frames:
            due = where & changed & (past_time <= time - self._delay + TOLERANCE)
            self._now[due] = past_value[due]
            result |= due & past_value
            is_due |= due
            changed &= ~due
        if self._sudden:
            world.stirred |= is_due
        self._frames = [frame for frame in self._frames if frame[2].any()]
        return np.where(is_due, result, self._now == 1)

    @property
    def delay(self) -> FloatArray:
        """The delay in s, shape (N,)."""
        return self._delay

    def pending(self) -> FloatArray:
        """Time in s of the oldest change that waits for its delay, infinite if none, shape (N,)."""
        result = np.full(len(self._delay), np.inf)
        for then, _, changed in self._frames:
            result = np.where(changed, np.minimum(result, then), result)
        return result

    def forget(self, where: BoolArray) -> None:
        """Clear all values in the scenarios of the mask."""
        self._newest[where] = self._now[where] = -1
        for _, _, changed in self._frames:
            changed &= ~where


class Trigger:
    """Condition groups; the trigger fires when all conditions of one group hold, and never without groups."""

    def __init__(self, groups: list[list[Condition]]) -> None:
        self._groups = groups

    @property
    def groups(self) -> list[list[Condition]]:
        """All conditions, by group."""
        return self._groups

    @property
    def empty(self) -> bool:
        """Whether there are no conditions, so that it never fires."""
        return not self._groups

    @property
    def entities(self) -> list[int]:
        """Entities that may trigger it by themselves, in order."""
        return list(dict.fromkeys(entity for test in self._of_entities() for entity in test.entities))

    def triggered_by(self, entity: int) -> BoolArray:
        """Scenarios in which a condition was last true for an entity, shape (N,)."""
        return np.asarray(
            np.any([test.held_of(entity) for test in self._of_entities() if entity in test.entities], axis=0)
        )

    def _of_entities(self) -> list[OfEntities]:
        tests = (condition.test for group in self._groups for condition in group)
        return [test for test in tests if isinstance(test, OfEntities)]

    def fires(self, world: World, where: BoolArray) -> BoolArray:
        """Scenarios of the mask in which the trigger fires, shape (N,)."""
        fired = np.zeros(len(where), dtype=np.bool_)
        if not anywhere(where):
            return fired
        for group in self._groups:
            holds = where.copy()
            for condition in group:
                # Without a delay, a condition is only evaluated (and its edge updated) where all previous ones hold.
                holds &= condition.evaluate(world, where & (holds | condition.delayed))
            fired |= holds
        world.stirred |= fired
        if anywhere(fired):
            for group in self._groups:
                for condition in group:
                    condition.rearm(fired)
        return fired

    def may_fire(self, world: World) -> BoolArray:
        """Scenarios in which no constant condition prevents all groups from holding, shape (N,)."""
        result = np.zeros(world.scenarios, dtype=np.bool_)
        for group in self._groups:
            constants = [condition.constant(world) for condition in group]
            result |= np.all([value for value in constants if value is not None], axis=0)
        return result

    def reset(self, where: BoolArray) -> None:
        """Restart delays in the scenarios of the mask."""
        for group in self._groups:
            for condition in group:
                condition.reset(where)


def read_trigger(element: etree._Element | None, scope: Scope, world: World, elements: Elements) -> Trigger:
    """Read a ``StartTrigger`` or ``StopTrigger``; a missing one never fires."""
    groups: list[list[Condition]] = []
    for group in () if element is None else element.iterfind("ConditionGroup"):
        conditions = []
        for condition in group.iterfind("Condition"):
            edge = scope.text(condition, "conditionEdge", "none")
            if edge not in ("none", "rising", "falling", "risingOrFalling"):
                raise InputError(
                    f"{scope.source}, line {condition.sourceline}: conditionEdge '{edge}' of <Condition> is not none,"
                    " rising, falling or risingOrFalling."
                )
            delay = scope.number(condition, "delay", 0.0)
            scope.refuse(condition, "delay", "is below 0", delay < 0.0)
            with placed(condition, scope.source):
                conditions.append(Condition(_read_test(condition, scope, world, elements), edge, delay))
        if not conditions:
            rule = "a <ConditionGroup> holds at least one <Condition>"
            adapt(group, "<ConditionGroup> without a condition", "is true from the beginning", rule)
        groups.append(conditions)
    return Trigger(groups)


def _read_test(condition: etree._Element, scope: Scope, world: World, elements: Elements) -> Test:
    kind = next(iter(condition.iterchildren("*")), None)
    if kind is not None and kind.tag == "ByEntityCondition":
        holder = kind.find("EntityCondition")
        inner = None if holder is None else next(iter(holder.iterchildren("*")), None)
        if inner is not None and inner.tag in BY_ENTITY:
            test = BY_ENTITY[inner.tag](inner, scope, world)
            return _of_triggering_entities(kind, scope, world, test)
    else:
        inner = None if kind is None else next(iter(kind.iterchildren("*")), None)
        if inner is not None and inner.tag in _BY_VALUE:
            return _BY_VALUE[inner.tag](inner, scope, world, elements)
    tag = condition.tag if inner is None else inner.tag
    raise InputError(
        f"{scope.source}, line {condition.sourceline}: <{tag}> is not supported by the builtin simulator; it reads"
        f" {', '.join((*_BY_VALUE, *BY_ENTITY))}."
    )


class OfEntities:
    """A condition on entities: true for any, or for all, triggering entities."""

    def __init__(self, entities: list[int], every: bool, test: EntityTest) -> None:
        self.entities = entities
        self.every, self._test = every, test
        self._held: list[BoolArray] = []

    @property
    def leaves(self) -> list[tuple[int, Leaf]] | None:
        """Leaves to evaluate for each entity; None if kernels cannot."""
        test = self._test
        return [(e, leaf) for e in self.entities for leaf in test.leaves] if isinstance(test, Known) else None

    def __call__(self, world: World, where: BoolArray) -> BoolArray:
        self._held = [self._test(world, e) & world.present[e] for e in self.entities]
        result = np.stack(self._held)
        return np.asarray(result.all(axis=0) if self.every else result.any(axis=0))

    def held_of(self, entity: int) -> BoolArray:
        """Scenarios in which it was last true for an entity, shape (N,)."""
        return self._held[self.entities.index(entity)]


class ByValue:
    """A condition on time, or on values that only the storyboard changes, which kernels can evaluate too."""

    def __init__(self, value: Callable[[World], BoolArray], leaf: Leaf = _CONSTANT) -> None:
        self.value, self.leaf = value, leaf

    def __call__(self, world: World, where: BoolArray) -> BoolArray:
        return self.value(world)


def _of_triggering_entities(element: etree._Element, scope: Scope, world: World, test: EntityTest) -> Test:
    holder = child(element, "TriggeringEntities", scope)
    require_all = scope.text(holder, "triggeringEntitiesRule", "any") == "all"
    entities = entities_in(holder, scope, world)
    if not entities:
        raise InputError(f"{scope.source}, line {holder.sourceline}: <TriggeringEntities> names no entity.")
    return OfEntities(entities, require_all, test)


def _simulation_time(element: etree._Element, scope: Scope, world: World, elements: Elements) -> Test:
    rule, value = rule_of(element, scope), scope.number(element, "value")
    leaf = Leaf(leaves.CLOCK, rule=number_of_rule(rule), values=(value,))
    return ByValue(lambda world: np.asarray(rule(world.time, value)), leaf)


def _element_state(element: etree._Element, scope: Scope, world: World, elements: Elements) -> Test:
    kind = scope.text(element, "storyboardElementType")
    name, state = scope.text(element, "storyboardElementRef"), scope.text(element, "state")
    where = f"{scope.source}, line {element.sourceline}: <{element.tag}>"

    watch = Watch(state, scope.scenarios, where)
    elements.watch(kind, name, watch, where)
    return watch


def _held(element: etree._Element, scope: Scope, world: World, elements: Elements) -> Test:
    attribute = "variableRef" if element.tag == "VariableCondition" else "parameterRef"
    values = world.variables if attribute == "variableRef" else world.parameters
    name = (
        scope.text(element, attribute)
        if not element.get(attribute, "").startswith("$")
        else element.get(attribute, "")[1:]
    )
    if name not in values:
        if element.tag == "ParameterCondition" and is_never_true(element, name):
            return _never(element, scope, world, elements)
        noun = "variable" if attribute == "variableRef" else "parameter"
        raise InputError(
            f"{scope.source}, line {element.sourceline}: <{element.tag}>: there is no {noun} '{name}';"
            f" {suggestion(name, values)}"
        )
    if values[name].dtype.kind == "f":
        rule, value = rule_of(element, scope), scope.number(element, "value")
        return ByValue(lambda world: np.asarray(rule(values[name], value)))
    text, compare = as_held(element, scope, values[name]), rule_of(element, scope, _TEXT_RULES)
    if compare not in (np.equal, np.not_equal):
        numeric = not np.isnan(_numbers([text, *np.unique(values[name])])).any()
        why = "as a number" if numeric else "alphabetically, as in esmini"
        why = f"'{name}', which is declared as a text, is compared {why}"
        adapt(element, f"rule of <{element.tag}>", why, "ordered values are declared as numbers")
        if numeric:
            rule, number = rule_of(element, scope), float(text)
            return ByValue(lambda world: np.asarray(rule(_numbers(values[name]), number)))
    return ByValue(lambda world: np.asarray(compare(values[name], text)))


def _numbers(texts: Iterable[str]) -> FloatArray:
    """Parse texts as numbers, NaN if not a number."""

    def number(text: str) -> float:
        try:
            return float(text)
        except ValueError:
            return np.nan

    return np.array([number(text) for text in texts])


def _never(element: etree._Element, scope: Scope, world: World, elements: Elements) -> Test:
    # Nothing in this simulator can make these conditions true.
    result = np.zeros(scope.scenarios, dtype=np.bool_)
    return ByValue(lambda world: result)


def _signal(element: etree._Element, scope: Scope, world: World, elements: Elements) -> Test:
    name, state, n = scope.text(element, "name"), scope.text(element, "state"), scope.scenarios

    def shows(world: World) -> BoolArray:
        return np.asarray(world.signals[name] == state) if name in world.signals else np.zeros(n, np.bool_)

    # With controllers, signals change by themselves.
    return (lambda world, where: shows(world)) if world.signal_controllers else ByValue(shows)


def _signal_controller(element: etree._Element, scope: Scope, world: World, elements: Elements) -> Test:
    location = f"{scope.source}, line {element.sourceline}: <{element.tag}>"
    controller = named_controller(world.signal_controllers, scope.text(element, "trafficSignalControllerRef"), location)
    phase = named_phase(controller, scope.text(element, "phase"), location)
    return lambda world, where: np.asarray(controller.phase(world.time) == phase)


_BY_VALUE: Final[dict[str, Callable[[etree._Element, Scope, World, Elements], Test]]] = {
    "SimulationTimeCondition": _simulation_time,
    "StoryboardElementStateCondition": _element_state,
    "ParameterCondition": _held,
    "VariableCondition": _held,
    "TrafficSignalCondition": _signal,
    "TrafficSignalControllerCondition": _signal_controller,
    **dict.fromkeys(NEVER_TRUE, _never),
}
