"""The storyboard: a tree of elements, each with a state in every scenario of a batch."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Final, TypeVar

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.io.tracked_xml import note_adaptation
from cornercase._common.text.element_locations import add_location_to_input_errors, format_location
from cornercase._common.typing import BoolArray
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.actions._immediate_actions import find_action_element, read_action
from cornercase.simulators.builtin.paths._positions import read_entity_or_members, read_entity_refs
from cornercase.simulators.builtin.storyboard._element import RUNNING, STANDBY, Element, StateWatcher
from cornercase.simulators.builtin.storyboard._events import ActionElement, ElementGroup, Event
from cornercase.simulators.builtin.storyboard._triggers import Trigger, read_trigger
from cornercase.simulators.builtin.world._track_motion import heading_velocity
from cornercase.simulators.builtin.world._world import World

E = TypeVar("E", bound="Element")

# Elements of <Init>, in their order of execution.
_INIT_TAGS: Final = ("GlobalAction", "UserDefinedAction", "Private")
_PLACING_TAGS: Final = ("TeleportAction", "AddEntityAction")
_RELATIVE_POSITION_TAGS: Final = (
    "RelativeLanePosition",
    "RelativeRoadPosition",
    "RelativeObjectPosition",
    "RelativeWorldPosition",
)


class Storyboard:
    """The storyboard of a file, for all scenarios of a batch.

    `actions` has all actions in the order in which they act. `triggers` has all triggers, in a fixed order.
    """

    def __init__(self, scenario: ScenarioFile, scope: Scope, world: World) -> None:
        self._scenario, self._world = scenario, world
        self._elements: dict[tuple[str, str], list[tuple[Element, tuple[str, ...]]]] = {}
        self._parents: list[str] = []
        self._watches: list[tuple[str, str, StateWatcher, str]] = []
        # By entity; None for global actions.
        self._actions: dict[int | None, list[ActionElement]] = {}
        self.actions: list[ActionElement] = []
        self._registered: list[Element] = []
        root = scenario.root.find("Storyboard")
        assert root is not None
        self._init_actions = list(self._read_init(root, scope))
        self._stopped = np.zeros(scope.n_scenarios, dtype=np.bool_)
        self._is_active = ~self._stopped
        self.stories = [self._read_story(story, scope) for story in root.iterfind("Story")]
        self._momentary = [action for action in self.actions if action.is_instantaneous]
        self._stop = read_trigger(root.find("StopTrigger"), scope, world, self)
        for kind, reference, watch, where in self._watches:
            element = self.find_element(kind, reference)
            if element is None:
                raise InputError(f"{where}: there is no {kind} '{reference}' in the storyboard.")
            element.add_watcher(watch)
        self._gather_states()

    def _gather_states(self) -> None:
        """Move the states of all elements into one table; each element keeps a view of its row."""
        elements = list(dict.fromkeys([*self._registered, *self.actions]))
        self._states = np.array([element.state for element in elements]).reshape(-1, self._world.scenarios)
        for element, state in zip(elements, self._states, strict=True):
            element.state = state
        rows = {element: k for k, element in enumerate(elements)}
        triggers = [(trigger, rows[e], state) for e in self._registered for trigger, state in e.iter_triggers()]
        self.triggers: list[Trigger] = [self._stop, *(trigger for trigger, _, _ in triggers)]
        self._trigger_rows = np.array([row for _, row, _ in triggers], dtype=np.int64)
        self._awaited_states = np.array([[state] for _, _, state in triggers], dtype=np.int8).reshape(-1, 1)
        self._untriggered_rows = [rows[element] for element in self._registered if element.start_trigger is None]
        self._action_rows = [rows[action] for action in self.actions]

    def find_waiting_triggers(self) -> BoolArray:
        """Return which triggers can fire in the next frame, boolean array (number of triggers, number of scenarios)."""
        return np.concatenate(
            [
                np.ones((1, self._world.scenarios), dtype=np.bool_),
                self._states[self._trigger_rows] == self._awaited_states,
            ]
        )

    def find_running_actions(self) -> BoolArray:
        """Return which actions run, boolean array (number of actions, number of scenarios)."""
        return np.asarray(self._states[self._action_rows] == RUNNING)

    def find_triggerless_standby(self) -> BoolArray:
        """Return the scenarios in which an element without start trigger waits, or the storyboard has stopped."""
        return np.asarray(self._stopped | (self._states[self._untriggered_rows] == STANDBY).any(axis=0))

    def add_element_watcher(self, kind: str, name: str, watch: StateWatcher, location: str) -> None:
        """Note that a condition waits for the element with a type and name.

        Condition and element are connected once all elements are read.
        """
        self._watches.append((kind, name, watch, location))

    def find_element(self, kind: str, name: str) -> Element | None:
        """Return the element with a type and name; the name may include the names of parents, as in ``Act::Group``."""
        path = tuple(name.split("::"))
        for element, parents in self._elements.get((kind, path[-1]), ()):
            # A name need not include all parents.
            names = iter(parents)
            if all(segment in names for segment in path[:-1]):
                return element
        return None

    def evaluate_triggers(self, dt: float) -> None:
        """Evaluate all triggers at the start of a frame of `dt` s (0 for the first one), and start elements."""
        world = self._world
        if dt == 0.0:
            for action in self._init_actions:
                action.start(world.running.copy())
            # Nothing has moved yet, but conditions on velocities and collisions already apply.
            world.step_velocity[0][:], world.step_velocity[1][:] = heading_velocity(world)
            world.update_overlaps()
            for story in self.stories:
                story.start(world.running.copy())
        world.has_leaf_values = False
        world.update_leaf_values()
        stopped = self._stop.fires(world, world.running.copy())
        ends = stopped | (self._stopped & world.running)
        self._stopped |= stopped
        if dt > 0.0:
            world.running &= ~ends
        # A storyboard that stops in the first frame does nothing in it; the frame is recorded.
        self._is_active = ~stopped
        for story in self.stories:
            story.evaluate_triggers(world, world.running & self._is_active)

    def would_continue(self) -> BoolArray:
        """Return the scenarios that a longer run would continue: a stop trigger may fire, or a timed action runs."""
        all_scenarios = np.ones(self._world.scenarios, dtype=np.bool_)
        result = self._stop.may_fire(self._world)
        for act in (act for story in self.stories for act in story.children if isinstance(act, ElementGroup)):
            result |= act.has_pending_stop(self._world)
        for action in self.actions:
            if action.action is not None and action.action.has_own_timing:
                result |= action.state == RUNNING
        # It may fire in the last frame, in which triggers are not evaluated.
        return result & ~self._stopped & ~self._stop.fires(self._world, all_scenarios)

    def look_up_positions(self, where: BoolArray) -> None:
        """Look up road positions that compiled code cannot look up, for all actions, in the scenarios of a mask."""
        for action in self.actions:
            action.look_up_positions(where)

    def end_instantaneous_actions(self) -> None:
        """End all running actions that take effect when they start; their end does not influence other actions."""
        for action in self._momentary:
            action.step(0.0, self._world.running)

    def step_actions(self, dt: float) -> None:
        running = self._world.running
        for action in self._init_actions:
            action.step(dt, running)
        for story in self.stories:
            story.step(dt, running & self._is_active)

    def _read_init(self, root: etree._Element, scope: Scope) -> Iterator[ActionElement]:
        actions = root.find("Init/Actions")
        if actions is None:
            return
        elements = [child for tag in _INIT_TAGS for child in actions.iterfind(tag)]
        for element in _sort_init_actions(elements, scope):
            if element.tag != "Private":
                yield self._read_action("init", element, scope, None)
                continue
            for entity in read_entity_or_members(element, scope, self._world):
                for private_action in element.iterfind("PrivateAction"):
                    yield self._read_action("init", private_action, scope, entity)

    def _read_story(self, story: etree._Element, scope: Scope) -> ElementGroup:
        scope = scope.nested_scope(story)
        name = story.get("name", "")
        with self._inside_parent(name), add_location_to_input_errors(story, scope.file_name):
            acts = [self._read_act(act, scope) for act in story.iterfind("Act")]
        return self._register_element(ElementGroup("story", name, scope.n_scenarios, acts))

    def _read_act(self, act: etree._Element, scope: Scope) -> ElementGroup:
        name = act.get("name", "")
        with self._inside_parent(name), add_location_to_input_errors(act, scope.file_name):
            groups = [self._read_group(group, scope) for group in act.iterfind("ManeuverGroup")]
        start, stop = (self._read_trigger(act, tag, scope) for tag in ("StartTrigger", "StopTrigger"))
        return self._register_element(ElementGroup("act", name, scope.n_scenarios, groups, start, stop))

    def _read_trigger(self, element: etree._Element, tag: str, scope: Scope) -> Trigger | None:
        """Return a trigger of an act or event; None if it is missing or empty."""
        trigger = read_trigger(element.find(tag), scope, self._world, self)
        return trigger if trigger.groups else None

    def _read_group(self, group: etree._Element, scope: Scope) -> ElementGroup:
        name, holder = group.get("name", ""), group.find("Actors")
        select = holder is not None and scope.read_boolean(holder, "selectTriggeringEntities", False)
        actors = [] if holder is None else read_entity_refs(holder, scope, self._world)
        maneuvers = []
        for element in group.iterchildren("Maneuver", "CatalogReference"):
            if element.tag == "CatalogReference":
                maneuver, inner = scope.resolve_catalog_reference(element, "Maneuver")
            else:
                maneuver, inner = element, scope.nested_scope(element)
            maneuver_name = maneuver.get("name", "")
            with self._inside_parent(name), self._inside_parent(maneuver_name):
                events = []
                for event in maneuver.iterfind("Event"):
                    with add_location_to_input_errors(event, inner.file_name):
                        events.append(self._read_event(event, inner, actors, select))
            with self._inside_parent(name):
                maneuvers.append(
                    self._register_element(ElementGroup("maneuver", maneuver_name, scope.n_scenarios, events))
                )
        times = scope.read_integer(group, "maximumExecutionCount", 1, minimum=1)
        return self._register_element(
            ElementGroup("maneuverGroup", name, scope.n_scenarios, maneuvers, max_executions=times)
        )

    def _read_event(
        self, event: etree._Element, scope: Scope, actors: list[int], select_triggering_entities: bool
    ) -> Event:
        trigger = self._read_trigger(event, "StartTrigger", scope)
        # Triggering entities may act too, besides the named actors.
        choices: dict[int, Callable[[], BoolArray] | None] = {}
        if select_triggering_entities and trigger is not None:
            choices = {e: partial(trigger.is_triggered_by, e) for e in trigger.entities}
        choices |= dict.fromkeys(actors)
        actions = []
        for action in event.iterfind("Action"):
            name = action.get("name", "")
            if action.find("*") is None:
                note_adaptation(action, "<Action> without an action", "is skipped", "<Action> holds an action")
            for element in action.iterchildren("*"):
                private = element.tag == "PrivateAction"
                for actor, chosen in choices.items() if private else [(None, None)]:
                    running = self._read_action(name, element, scope, actor, chosen)
                    actions.append(running)
                    with self._inside_parent(event.get("name", "")):
                        self._register_element(running)
        times = scope.read_integer(event, "maximumExecutionCount", 1, minimum=1)
        priority = scope.read_text(event, "priority", "parallel")
        return self._register_element(
            Event(event.get("name", ""), scope.n_scenarios, actions, trigger, times, priority)
        )

    def _read_action(
        self,
        name: str,
        element: etree._Element,
        scope: Scope,
        entity: int | None,
        takes_part: Callable[[], BoolArray] | None = None,
    ) -> ActionElement:
        rivals, action_element = self._actions.setdefault(entity, []), find_action_element(element)
        with add_location_to_input_errors(action_element, scope.file_name):
            action = read_action(element, scope, self._world, entity)
        # The name of the scenario file itself is omitted.
        scenario_file = str(self._scenario.path)
        location = (
            f"line {action_element.sourceline}"
            if scope.file_name == scenario_file
            else format_location(action_element, scope.file_name)
        )
        holder = "<Init>" if next(action_element.iterancestors("Init"), None) is not None else f"'{name}'"
        location += f": <{action_element.tag}> of {holder}"
        self.actions.append(ActionElement(name, scope.n_scenarios, action, self._world, rivals, takes_part, location))
        return self.actions[-1]

    def _register_element(self, element: E) -> E:
        self._elements.setdefault((element.kind, element.name), []).append((element, tuple(self._parents)))
        self._registered.append(element)
        return element

    @contextmanager
    def _inside_parent(self, name: str) -> Iterator[None]:
        self._parents.append(name)
        try:
            yield
        finally:
            self._parents.pop()


def _sort_init_actions(actions: list[etree._Element], scope: Scope) -> list[etree._Element]:
    """Sort the initial actions, so that an entity is placed before other entities are placed relative to it."""
    remaining = [_InitAction.from_element(element, scope) for element in actions]
    ordered: list[etree._Element] = []
    while remaining:
        adding = {action.entity for action in remaining if action.adds}
        placing = {action.entity for action in remaining if action.places}
        ready = [
            action
            for action in remaining
            if (action.adds or action.entity not in adding) and not action.references & placing
        ]
        # Keep the file's order for entities that refer to each other.
        ready = ready or remaining[:1]
        ordered += [action.element for action in ready]
        remaining = [action for action in remaining if action not in ready]
    return ordered


@dataclass(frozen=True, eq=False)
class _InitAction:
    """An initial action with its entity, the entities to which it refers, and whether it adds or places its entity."""

    element: etree._Element
    entity: str
    references: frozenset[str]
    adds: bool
    places: bool

    @classmethod
    def from_element(cls, element: etree._Element, scope: Scope) -> _InitAction:
        adding = element.find("EntityAction")
        entity = (element if adding is None else adding).get("entityRef", "")
        placing = list(element.iter(*_PLACING_TAGS))
        positions = (position for action in placing for position in action.iter(*_RELATIVE_POSITION_TAGS))
        references = frozenset(scope.read_text(position, "entityRef") for position in positions)
        return cls(element, entity, references - {entity}, adding is not None, bool(placing))
