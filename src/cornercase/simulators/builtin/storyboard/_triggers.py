"""Conditions and triggers, evaluated for all scenarios of a batch."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from lxml import etree

from cornercase._common.errors import suggest_name
from cornercase._common.io.tracked_xml import note_adaptation
from cornercase._common.masks import any_true
from cornercase._common.text.element_locations import add_location_to_input_errors
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario._scenario_runner_criteria import is_condition_never_true
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.actions._longitudinal import require_child
from cornercase.simulators.builtin.kernels import _conditions as conditions_module
from cornercase.simulators.builtin.kernels._conditions import ConditionSpec, LeafCondition
from cornercase.simulators.builtin.kernels._distances import TOLERANCE
from cornercase.simulators.builtin.paths._positions import read_entity_refs
from cornercase.simulators.builtin.storyboard._element import StateWatcher
from cornercase.simulators.builtin.storyboard._entity_conditions import (
    ENTITY_CONDITION_READERS,
    EntityTest,
    comparison_rule_index,
    read_comparison_rule,
)
from cornercase.simulators.builtin.world._text_values import read_text_value
from cornercase.simulators.builtin.world._traffic_signals import read_signal_phase
from cornercase.simulators.builtin.world._world import World

if TYPE_CHECKING:
    from cornercase.simulators.builtin.storyboard._storyboard import Storyboard

Test = Callable[[World, BoolArray], BoolArray]

_CONSTANT: Final = LeafCondition(conditions_module.CONSTANT_CONDITION)

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


class Condition:
    """A condition of a trigger, with its edge and with its delay in s in each scenario.

    `test` takes the world and a mask of scenarios, and returns whether the condition holds in each scenario. `edge` is
    ``"none"``, ``"rising"``, ``"falling"`` or ``"risingOrFalling"``. A delay makes the condition become true, and false
    again, `delay` s later.
    """

    def __init__(self, test: Test, edge: str, delay: FloatArray) -> None:
        self.test, self._edge = test, edge
        self.delayed = np.asarray(delay > 0)
        self._last_value = np.full(len(delay), -1, dtype=np.int8)
        # The delayed values; None without a delay.
        self.delay_buffer = DelayBuffer(delay, edge != "none") if any_true(self.delayed) else None

    def evaluate(self, world: World, where: BoolArray) -> BoolArray:
        if not any_true(where):
            return where
        value = self.test(world, where)
        last = self._last_value
        if self._edge == "none":
            result = value
        elif self._edge == "rising":
            result = value & (last == 0)
        elif self._edge == "falling":
            result = ~value & (last == 1)
        else:
            result = (last >= 0) & (value != (last == 1))
        self._last_value = np.where(where, value.astype(np.int8), last)
        if self._edge != "none":
            world.changed |= self._last_value != last
        return where & (
            result if self.delay_buffer is None else self.delay_buffer.store_and_delay(world, result, where)
        )

    @property
    def kernel_spec(self) -> ConditionSpec | None:
        """Return the form of the condition that compiled code evaluates; None if it can only be evaluated in Python."""
        test, plain = self.test, self._edge == "none" and self.delay_buffer is None
        if isinstance(test, EntityCondition):
            return None if test.leaves is None else ConditionSpec(test.leaves, test.requires_all, plain)
        if isinstance(test, ValueCondition):
            return ConditionSpec([(-1, test.leaf)], True, plain)
        return ConditionSpec([], True, False) if isinstance(test, StateWatcher) else None

    def use_leaf_values(self, leaf_values: BoolArray) -> None:
        """Make the condition read its value from `leaf_values`, which compiled code keeps up to date.

        The shape is (scenarios, leaves); the condition consists of simple conditions, its leaves.
        """
        if isinstance(self.test, EntityCondition | ValueCondition):
            self.test.leaf_values = leaf_values

    def value_until_next_event(self, world: World) -> BoolArray | None:
        """Return the value in each scenario if only the storyboard or a signal controller can change it; else None."""
        test = self.test
        return test.value(world) if isinstance(test, ValueCondition) and test.value is not None else None

    @property
    def changes_by_itself(self) -> bool:
        """Whether a traffic signal controller can change the condition's value."""
        return isinstance(self.test, ValueCondition) and self.test.changes_by_itself

    def reset_edge(self, where: BoolArray) -> None:
        """Make the next evaluation detect no edge, in the scenarios of a mask."""
        self._last_value[where] = -1

    def reset_delay(self, where: BoolArray) -> None:
        if self.delay_buffer is not None:
            self.delay_buffer.clear(where)
        if isinstance(self.test, StateWatcher):
            self.test.clear_changes(where)


class DelayBuffer:
    """Buffer that delays the values of a condition by `delay` s, with a delay for each scenario.

    `is_sudden`: whether the value can change from one frame to the next although the condition's inputs have not
    changed, such as after an edge.
    """

    def __init__(self, delay: FloatArray, is_sudden: bool) -> None:
        self.delay, self._sudden = delay, is_sudden
        # Frames whose delay has not passed in all scenarios: times, values, and where the value changed.
        self._frames: list[tuple[FloatArray, BoolArray, BoolArray]] = []
        self._newest_value, self._current_value = (np.full(len(delay), -1, dtype=np.int8) for _ in range(2))

    def store_and_delay(self, world: World, value: BoolArray, where: BoolArray) -> BoolArray:
        """Store the present values and return the delayed values.

        If several values of a scenario become due at once, the result is True if at least one of them is.
        """
        new, time = where & (self._newest_value != value), world.time
        self._newest_value[new] = value[new]
        if self._sudden:
            world.changed |= new
        for past_time, past_value, changed in self._frames:
            # The first two frames have the same time; the later one counts.
            same_time = new & changed & (time <= past_time)
            past_value[same_time] = value[same_time]
            new &= ~same_time
        if any_true(new):
            self._frames.append((time.copy(), value.copy(), new))
        result, is_due = np.zeros_like(where), np.zeros_like(where)
        for past_time, past_value, changed in self._frames:
            due = where & changed & (past_time <= time - self.delay + TOLERANCE)
            self._current_value[due] = past_value[due]
            result |= due & past_value
            is_due |= due
            changed &= ~due
        if self._sudden:
            world.changed |= is_due
        self._frames = [frame for frame in self._frames if frame[2].any()]
        return np.where(is_due, result, self._current_value == 1)

    def oldest_pending_time(self) -> FloatArray:
        """Return the time in s of the oldest stored change that still waits for its delay; infinite without one."""
        result = np.full(len(self.delay), np.inf)
        for then, _, changed in self._frames:
            result = np.where(changed, np.minimum(result, then), result)
        return result

    def clear(self, where: BoolArray) -> None:
        self._newest_value[where] = self._current_value[where] = -1
        for _, _, changed in self._frames:
            changed &= ~where


class Trigger:
    """A trigger with groups of conditions, which fires when all conditions of a group hold; without groups, never."""

    def __init__(self, groups: list[list[Condition]]) -> None:
        self.groups = groups

    @property
    def entities(self) -> list[int]:
        """Return the indices of the entities that may make the trigger fire, in the order of the conditions."""
        return list(dict.fromkeys(entity for test in self._entity_conditions() for entity in test.entities))

    def is_triggered_by(self, entity: int) -> BoolArray:
        """Return the scenarios in which a condition of the trigger was true for an entity at the last evaluation."""
        return np.asarray(
            np.any(
                [test.last_result_for(entity) for test in self._entity_conditions() if entity in test.entities], axis=0
            )
        )

    def _entity_conditions(self) -> list[EntityCondition]:
        tests = (condition.test for group in self.groups for condition in group)
        return [test for test in tests if isinstance(test, EntityCondition)]

    def fires(self, world: World, where: BoolArray) -> BoolArray:
        """Return the scenarios of a mask in which the trigger fires now, as a mask."""
        fired = np.zeros(len(where), dtype=np.bool_)
        if not any_true(where):
            return fired
        for group in self.groups:
            holds = where.copy()
            for condition in group:
                # Without a delay, a condition is only evaluated (and its edge updated) where all previous ones hold.
                holds &= condition.evaluate(world, where & (holds | condition.delayed))
            fired |= holds
        world.changed |= fired
        if any_true(fired):
            for group in self.groups:
                for condition in group:
                    condition.reset_edge(fired)
        return fired

    def may_fire(self, world: World) -> BoolArray:
        """Return the scenarios in which the trigger can fire later.

        The trigger cannot fire if each group has a condition that stays false unless the storyboard changes its value.
        """
        result = np.zeros(world.scenarios, dtype=np.bool_)
        for group in self.groups:
            constants = [
                condition.value_until_next_event(world) for condition in group if not condition.changes_by_itself
            ]
            result |= np.all([value for value in constants if value is not None], axis=0)
        return result

    def reset(self, where: BoolArray) -> None:
        """Restart the delays of all conditions, in the scenarios of a mask."""
        for group in self.groups:
            for condition in group:
                condition.reset_delay(where)


def read_trigger(element: etree._Element | None, scope: Scope, world: World, storyboard: Storyboard) -> Trigger:
    """Read a ``StartTrigger`` or ``StopTrigger``; if `element` is None, the trigger never fires."""
    groups: list[list[Condition]] = []
    for group in () if element is None else element.iterfind("ConditionGroup"):
        conditions = []
        for condition in group.iterfind("Condition"):
            edge = scope.read_text(condition, "conditionEdge", "none")
            if edge not in ("none", "rising", "falling", "risingOrFalling"):
                raise scope.error_at(
                    condition, f"conditionEdge '{edge}' of <Condition> is not none, rising, falling or risingOrFalling."
                )
            delay = scope.read_numbers(condition, "delay", 0.0)
            scope.mark_invalid(condition, "delay", "is below 0", delay < 0.0)
            with add_location_to_input_errors(condition, scope.file_name):
                conditions.append(Condition(_read_condition_test(condition, scope, world, storyboard), edge, delay))
        if not conditions:
            rule = "a <ConditionGroup> holds at least one <Condition>"
            note_adaptation(group, "<ConditionGroup> without a condition", "is true from the beginning", rule)
        groups.append(conditions)
    return Trigger(groups)


def _read_condition_test(condition: etree._Element, scope: Scope, world: World, storyboard: Storyboard) -> Test:
    kind = condition.find("*")
    if kind is not None and kind.tag == "ByEntityCondition":
        holder = kind.find("EntityCondition")
        inner = None if holder is None else holder.find("*")
        if inner is not None and inner.tag in ENTITY_CONDITION_READERS:
            test = ENTITY_CONDITION_READERS[inner.tag](inner, scope, world)
            return _read_triggering_entities(kind, scope, world, test)
    else:
        inner = None if kind is None else kind.find("*")
        if inner is not None and inner.tag in _VALUE_CONDITION_READERS:
            return _VALUE_CONDITION_READERS[inner.tag](inner, scope, world, storyboard)
    tag = condition.tag if inner is None else inner.tag
    raise scope.error_at(
        condition,
        f"<{tag}> is not supported by the builtin simulator; it reads"
        f" {', '.join((*_VALUE_CONDITION_READERS, *ENTITY_CONDITION_READERS))}.",
    )


class EntityCondition:
    """A condition on entities, true if it holds for any (or for all) of the triggering entities.

    Compiled code may evaluate the condition in parts, the leaves; `leaf_values` (scenarios, leaves) has the results.
    """

    def __init__(self, entities: list[int], requires_all: bool, test: EntityTest, n_scenarios: int) -> None:
        self.entities = entities
        self.requires_all, self._test = requires_all, test
        self.leaf_values: BoolArray | None = None
        # By entity and scenario.
        self._last_results = np.zeros((len(entities), n_scenarios), dtype=np.bool_)

    @property
    def leaves(self) -> list[tuple[int, LeafCondition]] | None:
        """Return the conditions that compiled code evaluates, each with its entity; None if Python must evaluate it."""
        return [(e, leaf) for e in self.entities for leaf in self._test] if isinstance(self._test, tuple) else None

    def __call__(self, world: World, where: BoolArray) -> BoolArray:
        if callable(self._test):
            self._last_results = np.stack([self._test(world, e) & world.present[e] for e in self.entities])
        else:
            assert self.leaf_values is not None
            world.update_leaf_values()
            values = self.leaf_values.T.reshape(len(self.entities), len(self._test), world.scenarios)
            self._last_results = values.any(axis=1)
        results = self._last_results
        return np.asarray(results.all(axis=0) if self.requires_all else results.any(axis=0))

    def last_result_for(self, entity: int) -> BoolArray:
        """Return a mask of the scenarios in which the condition was true for an entity at its last evaluation."""
        return np.asarray(self._last_results[self.entities.index(entity)])


class ValueCondition:
    """A condition on the time, or on a value that only the storyboard or a signal controller changes.

    `value` is a function that returns the value in each scenario. For a condition on the time, `value` is None, and
    compiled code evaluates `leaf` into `leaf_values`, shape (scenarios, 1). `changes_by_itself`: whether a signal
    controller can change the value.
    """

    def __init__(
        self,
        value: Callable[[World], BoolArray] | None,
        leaf: LeafCondition = _CONSTANT,
        changes_by_itself: bool = False,
    ) -> None:
        self.value, self.leaf, self.changes_by_itself = value, leaf, changes_by_itself
        self.leaf_values: BoolArray | None = None

    def __call__(self, world: World, where: BoolArray) -> BoolArray:
        if self.value is not None:
            return self.value(world)
        assert self.leaf_values is not None
        world.update_leaf_values()
        return self.leaf_values[:, 0].copy()


def _read_triggering_entities(element: etree._Element, scope: Scope, world: World, test: EntityTest) -> Test:
    holder = require_child(element, "TriggeringEntities", scope)
    require_all = scope.read_text(holder, "triggeringEntitiesRule", "any") == "all"
    entities = read_entity_refs(holder, scope, world)
    if not entities:
        raise scope.error_at(holder, "<TriggeringEntities> names no entity.")
    return EntityCondition(entities, require_all, test, scope.n_scenarios)


def _simulation_time_condition(element: etree._Element, scope: Scope, world: World, storyboard: Storyboard) -> Test:
    rule, value = read_comparison_rule(element, scope), scope.read_numbers(element, "value")
    leaf = LeafCondition(conditions_module.TIME_CONDITION, rule=comparison_rule_index(rule), values=(value,))
    return ValueCondition(None, leaf)


def _element_state_condition(element: etree._Element, scope: Scope, world: World, storyboard: Storyboard) -> Test:
    kind = scope.read_text(element, "storyboardElementType")
    name, state = scope.read_text(element, "storyboardElementRef"), scope.read_text(element, "state")
    where = f"{scope.file_name}, line {element.sourceline}: <{element.tag}>"

    watch = StateWatcher(state, scope.n_scenarios, where)
    storyboard.add_element_watcher(kind, name, watch, where)
    return watch


def _variable_condition(element: etree._Element, scope: Scope, world: World, storyboard: Storyboard) -> Test:
    attribute = "variableRef" if element.tag == "VariableCondition" else "parameterRef"
    values = world.variables if attribute == "variableRef" else world.parameters
    name = (
        scope.read_text(element, attribute)
        if not element.get(attribute, "").startswith("$")
        else element.get(attribute, "")[1:]
    )
    if name not in values:
        if element.tag == "ParameterCondition" and is_condition_never_true(element, name):
            return _never_true_condition(element, scope, world, storyboard)
        noun = "variable" if attribute == "variableRef" else "parameter"
        raise scope.error_at(element, f"<{element.tag}>: there is no {noun} '{name}'; {suggest_name(name, values)}")
    if values[name].dtype.kind == "f":
        rule, value = read_comparison_rule(element, scope), scope.read_numbers(element, "value")
        return ValueCondition(lambda world: np.asarray(rule(values[name], value)))
    text, compare = read_text_value(element, scope, values[name]), read_comparison_rule(element, scope, _TEXT_RULES)
    if compare not in (np.equal, np.not_equal):
        numeric = not np.isnan(_parse_numbers([text, *np.unique(values[name])])).any()
        why = "as a number" if numeric else "alphabetically, as in esmini"
        why = f"'{name}', which is declared as a text, is compared {why}"
        note_adaptation(element, f"rule of <{element.tag}>", why, "ordered values are declared as numbers")
        if numeric:
            rule, number = read_comparison_rule(element, scope), float(text)
            return ValueCondition(lambda world: np.asarray(rule(_parse_numbers(values[name]), number)))
    return ValueCondition(lambda world: np.asarray(compare(values[name], text)))


def _parse_numbers(texts: Iterable[str]) -> FloatArray:
    """Parse texts as numbers; a text that is not a number gives NaN."""

    def number(text: str) -> float:
        try:
            return float(text)
        except ValueError:
            return np.nan

    return np.array([number(text) for text in texts])


def _never_true_condition(element: etree._Element, scope: Scope, world: World, storyboard: Storyboard) -> Test:
    # Nothing in this simulator can make these conditions true.
    result = np.zeros(scope.n_scenarios, dtype=np.bool_)
    return ValueCondition(lambda world: result)


def _signal_condition(element: etree._Element, scope: Scope, world: World, storyboard: Storyboard) -> Test:
    name, state, n = scope.read_text(element, "name"), scope.read_text(element, "state"), scope.n_scenarios

    def shows(world: World) -> BoolArray:
        return np.asarray(world.signals[name] == state) if name in world.signals else np.zeros(n, np.bool_)

    return ValueCondition(shows, changes_by_itself=bool(world.signal_controllers))


def _signal_controller_condition(element: etree._Element, scope: Scope, world: World, storyboard: Storyboard) -> Test:
    controller, phase = read_signal_phase(element, scope, world.signal_controllers)
    return ValueCondition(lambda world: np.asarray(controller.phase_at(world.time) == phase), changes_by_itself=True)


_VALUE_CONDITION_READERS: Final[dict[str, Callable[[etree._Element, Scope, World, Storyboard], Test]]] = {
    "SimulationTimeCondition": _simulation_time_condition,
    "StoryboardElementStateCondition": _element_state_condition,
    "ParameterCondition": _variable_condition,
    "VariableCondition": _variable_condition,
    "TrafficSignalCondition": _signal_condition,
    "TrafficSignalControllerCondition": _signal_controller_condition,
    **dict.fromkeys(NEVER_TRUE, _never_true_condition),
}
