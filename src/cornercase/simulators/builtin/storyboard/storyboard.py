"""The storyboard: a tree of elements, each with its own state in every scenario of a batch."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Final, TypeVar

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.places import place_of, placed
from cornercase._common.recorded_xml import adapt
from cornercase._common.typing import BoolArray
from cornercase.scenario import Scenario, Scope
from cornercase.simulators.builtin.actions.basic import inner_action, read_action
from cornercase.simulators.builtin.paths.positions import entities_in, entity_index
from cornercase.simulators.builtin.storyboard.element import RUNNING, STANDBY, Element, Starter, Watch
from cornercase.simulators.builtin.storyboard.events import Event, Group, RunningAction
from cornercase.simulators.builtin.storyboard.triggers import Trigger, read_trigger
from cornercase.simulators.builtin.world.contacts import find_contacts
from cornercase.simulators.builtin.world.motion import velocity_ahead
from cornercase.simulators.builtin.world.state import World

E = TypeVar("E", bound="Element")

# Elements of <Init>, in their order of execution.
_INIT: Final = ("GlobalAction", "UserDefinedAction", "Private")
_PLACING: Final = ("TeleportAction", "AddEntityAction")
_RELATIVE: Final = ("RelativeLanePosition", "RelativeRoadPosition", "RelativeObjectPosition", "RelativeWorldPosition")


class Storyboard:
    """A file's storyboard for all scenarios of a batch.

    `actions`: all of its actions in the order in which they act.
    """

    def __init__(self, scenario: Scenario, scope: Scope, world: World) -> None:
        self._scenario, self._world = scenario, world
        self._elements: dict[tuple[str, str], list[tuple[Element, tuple[str, ...]]]] = {}
        self._parents: list[str] = []
        self._watches: list[tuple[str, str, Watch, str]] = []
        # By entity; None for global actions.
        self._actions: dict[int | None, list[RunningAction]] = {}
        self.actions: list[RunningAction] = []
        self._triggered: list[Element] = []
        root = scenario.root.find("Storyboard")
        assert root is not None
        self._init = list(self._read_init(root, scope))
        self._stopped = np.zeros(scope.scenarios, dtype=np.bool_)
        self._going = ~self._stopped
        self.stories = [self._read_story(story, scope) for story in root.iterfind("Story")]
        self._momentary = [action for action in self.actions if action.momentary]
        self._stop = read_trigger(root.find("StopTrigger"), scope, world, self)
        for kind, reference, watch, where in self._watches:
            element = self.named(kind, reference)
            if element is None:
                raise InputError(f"{where}: there is no {kind} '{reference}' in the storyboard.")
            element.watch(watch)

    def waits(self) -> Iterator[tuple[Starter, BoolArray]]:
        """Yield all triggers in a fixed order, and where each may fire in the next frame."""
        yield self._stop, np.ones(self._world.scenarios, dtype=np.bool_)
        for element in self._triggered:
            yield from element.waits()

    def starting(self) -> BoolArray:
        """Scenarios in which an element without a start trigger waits for the next frame, shape (N,)."""
        result = self._stopped.copy()
        for element in self._triggered:
            if element.starts_by_itself:
                result |= element.state == STANDBY
        return result

    def watch(self, kind: str, name: str, watch: Watch, where: str) -> None:
        """Connect a condition to the element of a kind and name once all elements are read."""
        self._watches.append((kind, name, watch, where))

    def named(self, kind: str, name: str) -> Element | None:
        """Find the element of a kind and name; names may include those of parents, as in ``Act::Group``."""
        path = tuple(name.split("::"))
        for element, parents in self._elements.get((kind, path[-1]), ()):
            # A name need not include all parents.
            names = iter(parents)
            if all(segment in names for segment in path[:-1]):
                return element
        return None

    def look(self, dt: float) -> None:
        """Evaluate all triggers at the start of a frame of `dt` s, and start elements.

        `dt` is 0 in the first frame, which places entities.
        """
        world = self._world
        if dt == 0.0:
            for action in self._init:
                action.start(world.running.copy())
            # Nothing has moved yet, but conditions on velocities and collisions already apply.
            world.gone[0][:], world.gone[1][:] = velocity_ahead(world)
            find_contacts(world)
            for story in self.stories:
                story.start(world.running.copy())
        stopped = self._stop.fires(world, world.running.copy())
        ends = stopped | (self._stopped & world.running)
        self._stopped |= stopped
        if dt > 0.0:
            world.running &= ~ends
        # A storyboard that stops in the first frame does nothing in it; the frame is recorded.
        self._going = ~stopped
        for story in self.stories:
            story.evaluate(world, world.running & self._going)

    def unfinished(self) -> BoolArray:
        """Scenarios that would end later although all elements have run, shape (N,).

        The storyboard, or a running act, has a stop trigger that may fire, or an entity follows a trajectory with
        times.
        """
        all_scenarios = np.ones(self._world.scenarios, dtype=np.bool_)
        result = self._stop.may_fire(self._world)
        for act in (act for story in self.stories for act in story.children if isinstance(act, Group)):
            result |= act.has_end(self._world)
        for action in self.actions:
            if action.action is not None and action.action.keeps_time:
                result |= action.state == RUNNING
        # It may fire in the last frame, in which triggers are not evaluated.
        return result & ~self._stopped & ~self._stop.fires(self._world, all_scenarios)

    def look_up(self, where: BoolArray) -> None:
        """Look up what kernels cannot before the actions act, in the scenarios of a mask."""
        for action in self.actions:
            action.look_up(where)

    def end_momentary(self) -> None:
        """End the actions that were done when they started; later actions cannot tell the difference."""
        for action in self._momentary:
            action.step(0.0, self._world.running)

    def act(self, dt: float) -> None:
        """Let all actions act for a step of `dt` s."""
        running = self._world.running
        for action in self._init:
            action.step(dt, running)
        for story in self.stories:
            story.step(dt, running & self._going)

    def _read_init(self, root: etree._Element, scope: Scope) -> Iterator[RunningAction]:
        actions = root.find("Init/Actions")
        if actions is None:
            return
        elements = [child for tag in _INIT for child in actions.iterfind(tag)]
        for element in _in_order_of_reference(elements, scope):
            if element.tag != "Private":
                yield self._action("init", element, scope, None)
                continue
            for entity in self._entities(element, scope):
                for private_action in element.iterfind("PrivateAction"):
                    yield self._action("init", private_action, scope, entity)

    def _entities(self, element: etree._Element, scope: Scope) -> list[int]:
        members = self._world.selections.get(scope.text(element, "entityRef"))
        return [entity_index(element, scope, self._world)] if members is None else members

    def _read_story(self, story: etree._Element, scope: Scope) -> Group:
        scope = scope.within(story)
        name = story.get("name", "")
        with self._inside(name), placed(story, scope.source):
            acts = [self._read_act(act, scope) for act in story.iterfind("Act")]
        return self._known(Group("story", name, scope.scenarios, acts))

    def _read_act(self, act: etree._Element, scope: Scope) -> Group:
        name = act.get("name", "")
        with self._inside(name), placed(act, scope.source):
            groups = [self._read_group(group, scope) for group in act.iterfind("ManeuverGroup")]
        start = self._start_trigger(act, scope)
        ending = read_trigger(act.find("StopTrigger"), scope, self._world, self)
        stop = None if ending.empty else ending
        return self._known(Group("act", name, scope.scenarios, groups, start, stop))

    def _start_trigger(self, element: etree._Element, scope: Scope) -> Trigger | None:
        """Start trigger of an act or event; None, which fires immediately, if missing or empty."""
        trigger = read_trigger(element.find("StartTrigger"), scope, self._world, self)
        return None if trigger.empty else trigger

    def _read_group(self, group: etree._Element, scope: Scope) -> Group:
        name, holder = group.get("name", ""), group.find("Actors")
        select = holder is not None and scope.flag(holder, "selectTriggeringEntities", False)
        actors = [] if holder is None else entities_in(holder, scope, self._world)
        maneuvers = []
        for element in group.iterchildren("Maneuver", "CatalogReference"):
            if element.tag == "CatalogReference":
                maneuver, inner = scope.from_catalog(element, "Maneuver")
            else:
                maneuver, inner = element, scope.within(element)
            maneuver_name = maneuver.get("name", "")
            with self._inside(name), self._inside(maneuver_name):
                events = []
                for event in maneuver.iterfind("Event"):
                    with placed(event, inner.source):
                        events.append(self._read_event(event, inner, actors, select))
            with self._inside(name):
                maneuvers.append(self._known(Group("maneuver", maneuver_name, scope.scenarios, events)))
        times = scope.whole_number(group, "maximumExecutionCount", 1, least=1)
        return self._known(Group("maneuverGroup", name, scope.scenarios, maneuvers, times=times))

    def _read_event(self, event: etree._Element, scope: Scope, actors: list[int], select: bool) -> Event:
        trigger = self._start_trigger(event, scope)
        # Triggering entities may act too, besides the named actors.
        choices: dict[int, Callable[[], BoolArray] | None] = {}
        if select and trigger is not None:
            choices = {e: partial(trigger.triggered_by, e) for e in trigger.entities}
        choices |= dict.fromkeys(actors)
        actions = []
        for action in event.iterfind("Action"):
            name = action.get("name", "")
            if action.find("*") is None:
                adapt(action, "<Action> without an action", "is skipped", "<Action> holds an action")
            for element in action.iterchildren("*"):
                private = element.tag == "PrivateAction"
                for actor, chosen in choices.items() if private else [(None, None)]:
                    running = self._action(name, element, scope, actor, chosen)
                    actions.append(running)
                    with self._inside(event.get("name", "")):
                        self._known(running)
        times = scope.whole_number(event, "maximumExecutionCount", 1, least=1)
        priority = scope.text(event, "priority", "parallel")
        return self._known(Event(event.get("name", ""), scope.scenarios, actions, trigger, times, priority))

    def _action(
        self,
        name: str,
        element: etree._Element,
        scope: Scope,
        entity: int | None,
        chosen: Callable[[], BoolArray] | None = None,
    ) -> RunningAction:
        rivals, action_element = self._actions.setdefault(entity, []), inner_action(element)
        with placed(action_element, scope.source):
            action = read_action(element, scope, self._world, entity)
        # The name of the scenario file itself is omitted.
        scenario_file = str(self._scenario.path)
        location = (
            f"line {action_element.sourceline}"
            if scope.source == scenario_file
            else place_of(action_element, scope.source)
        )
        holder = "<Init>" if next(action_element.iterancestors("Init"), None) is not None else f"'{name}'"
        location += f": <{action_element.tag}> of {holder}"
        self.actions.append(RunningAction(name, scope.scenarios, action, self._world, rivals, chosen, location))
        return self.actions[-1]

    def _known(self, element: E) -> E:
        self._elements.setdefault((element.kind, element.name), []).append((element, tuple(self._parents)))
        self._triggered.append(element)
        return element

    @contextmanager
    def _inside(self, name: str) -> Iterator[None]:
        self._parents.append(name)
        try:
            yield
        finally:
            self._parents.pop()


def _in_order_of_reference(actions: list[etree._Element], scope: Scope) -> list[etree._Element]:
    """Sort initial actions so that entities are placed before others are placed relative to them."""
    remaining = [_Initial.of(element, scope) for element in actions]
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
class _Initial:
    """An initial action: its entity, the entities it refers to, and whether it adds or places its entity."""

    element: etree._Element
    entity: str
    references: frozenset[str]
    adds: bool
    places: bool

    @classmethod
    def of(cls, element: etree._Element, scope: Scope) -> _Initial:
        adding = element.find("EntityAction")
        entity = (element if adding is None else adding).get("entityRef", "")
        placing = list(element.iter(*_PLACING))
        positions = (position for action in placing for position in action.iter(*_RELATIVE))
        references = frozenset(scope.text(position, "entityRef") for position in positions)
        return cls(element, entity, references - {entity}, adding is not None, bool(placing))
