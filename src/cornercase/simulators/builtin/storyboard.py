"""The storyboard: a tree of elements, each in a state of its own in every scenario of a batch."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, TypeVar

import numpy as np
from lxml import etree

from cornercase.errors import InputError
from cornercase.scenario.openscenario import Scenario
from cornercase.simulators.builtin.actions import Action, read_action
from cornercase.simulators.builtin.conditions import Trigger, read_trigger
from cornercase.simulators.builtin.positions import entity_index
from cornercase.simulators.builtin.scope import Scope
from cornercase.simulators.builtin.world import World
from cornercase.typing import BoolArray

E = TypeVar("E", bound="Element")

STANDBY, RUNNING, COMPLETE = 0, 1, 2
_NOTHING, _START, _END, _STOP, _SKIP = 0, 1, 2, 3, 4

_STATES: Final = {"standbyState": STANDBY, "runningState": RUNNING, "completeState": COMPLETE}
_TRANSITIONS: Final = {
    "startTransition": _START,
    "endTransition": _END,
    "stopTransition": _STOP,
    "skipTransition": _SKIP,
}


class Element:
    """A storyboard element.

    A transition is seen from the element's turn in one frame until its turn in the next: elements later in the
    file see a start in the same frame. An end takes effect only at the next turn.

    Parameters
    ----------
    kind : str
        As in ``storyboardElementType``: ``"event"``.
    name : str
    scenarios : int
        N.
    """

    def __init__(self, kind: str, name: str, scenarios: int) -> None:
        self.kind, self.name = kind, name
        self.state = np.full(scenarios, STANDBY, dtype=np.int8)
        self._transition = np.full(scenarios, _NOTHING, dtype=np.int8)
        self._after = np.full(scenarios, STANDBY, dtype=np.int8)
        self._pending = np.full(scenarios, _NOTHING, dtype=np.int8)

    def is_in(self, state: str, where: str) -> BoolArray:
        """Scenarios in which the element is in a state, or just made a transition, shape (N,)."""
        if state in _STATES:
            return np.asarray(self.state == _STATES[state])
        if state in _TRANSITIONS:
            return np.asarray(self._transition == _TRANSITIONS[state])
        raise InputError(f"{where}: '{state}' is no state of a storyboard element.")

    def turn(self) -> None:
        """Let what was decided in the last frame take effect."""
        self._transition[:] = self._pending
        self._pending[:] = _NOTHING
        self.state[:] = self._after

    def begin(self, where: BoolArray) -> None:
        """Start in the scenarios of a mask, at once."""
        self.state[where] = self._after[where] = RUNNING
        self._transition[where] = _START

    def end(self, where: BoolArray, state: int = COMPLETE, transition: int = _END) -> None:
        """Leave the running state in the scenarios of a mask, from the next turn on."""
        self._after[where] = state
        self._pending[where] = transition

    def running(self) -> BoolArray:
        """Scenarios in which the element runs and was not told to end, shape (N,)."""
        return np.asarray((self.state == RUNNING) & (self._after == RUNNING))

    def complete(self) -> BoolArray:
        """Scenarios in which the element has ended, or will at its next turn, shape (N,)."""
        return np.asarray(self._after == COMPLETE)


class RunningAction(Element):
    """An action of one event, for one of its actors; without effect when `action` is None."""

    def __init__(self, name: str, scenarios: int, action: Action | None) -> None:
        super().__init__("action", name, scenarios)
        self._action = action

    def start(self, world: World, where: BoolArray) -> None:
        self.begin(where)
        if self._action is not None:
            self._action.start(world, where)

    def step(self, world: World, dt: float) -> None:
        where = self.running() & world.running
        if where.any():
            self.end(where if self._action is None else self._action.step(world, dt, where) & where)


class Event(Element):
    """An event: when its trigger fires, its actions start."""

    def __init__(
        self, name: str, scenarios: int, actions: list[RunningAction], trigger: Trigger | None, times: int
    ) -> None:
        super().__init__("event", name, scenarios)
        self.actions = actions
        self.priority = "parallel"
        self._trigger = trigger
        self._left = np.full(scenarios, times)

    def step(self, world: World, dt: float, parent: BoolArray, siblings: Sequence[Event]) -> None:
        self.turn()
        for action in self.actions:
            action.turn()
        waiting = parent & (self._after == STANDBY) & (self._left > 0)
        if waiting.any():
            fired = waiting if self._trigger is None else self._trigger.fires(world, waiting)
            if fired.any():
                self._start(world, fired, siblings)
        for action in self.actions:
            action.step(world, dt)
        done = self.running()
        for action in self.actions:
            done &= action.complete()
        self.end(done & (self._left == 0))
        self.end(done & (self._left > 0), STANDBY)

    def stop(self, where: BoolArray) -> None:
        where = where & (self._after != COMPLETE)
        self.end(where, COMPLETE, _STOP)
        for action in self.actions:
            action.end(where & (action._after != COMPLETE), COMPLETE, _STOP)

    def _start(self, world: World, fired: BoolArray, siblings: Sequence[Event]) -> None:
        others = [event for event in siblings if event is not self]
        self._left[fired] -= 1
        if self.priority == "skip":
            busy = np.zeros_like(fired)
            for event in others:
                busy |= event.running()
            skipped = fired & busy
            self.end(skipped & (self._left == 0), COMPLETE, _SKIP)
            self._pending[skipped] = _SKIP
            fired = fired & ~busy
        elif self.priority in ("overwrite", "override"):
            for event in others:
                event.stop(fired & event.running())
        self.begin(fired)
        for action in self.actions:
            action.start(world, fired)


class Group(Element):
    """A maneuver, maneuver group, act or story: runs its children until all of them have ended.

    Parameters
    ----------
    kind, name, scenarios
        As of `Element`.
    children : list of Group or Event
    start, stop : Trigger, optional
        Without a start trigger it starts with its parent.
    """

    def __init__(
        self,
        kind: str,
        name: str,
        scenarios: int,
        children: Sequence[Group] | Sequence[Event],
        start: Trigger | None = None,
        stop: Trigger | None = None,
    ) -> None:
        super().__init__(kind, name, scenarios)
        self.children = children
        self._start, self._stop = start, stop

    def step(self, world: World, dt: float, parent: BoolArray) -> None:
        """Advance the element and all below it by one frame, where its parent runs."""
        self.turn()
        waiting = parent & (self._after == STANDBY)
        if waiting.any():
            self.begin(waiting if self._start is None else self._start.fires(world, waiting))
        if self._stop is not None and not self._stop.empty:
            self.stop(self._stop.fires(world, self.running() & parent))
        here = self.running() & parent
        done = here.copy()
        for child in self.children:
            if isinstance(child, Event):
                child.step(world, dt, here, self.children)  # type: ignore[arg-type]
            else:
                child.step(world, dt, here)
            done &= child.complete()
        self.end(done)

    def stop(self, where: BoolArray) -> None:
        """End the element and all below it in the scenarios of a mask."""
        where = where & (self._after != COMPLETE)
        self.end(where, COMPLETE, _STOP)
        for child in self.children:
            child.stop(where)


class Storyboard:
    """A file's whole storyboard, for all scenarios of a batch.

    Parameters
    ----------
    scenario : Scenario
    scope : Scope
        The parameters' values.
    world : World

    Raises
    ------
    InputError
        Something in it is not supported, or is malformed.
    """

    def __init__(self, scenario: Scenario, scope: Scope, world: World) -> None:
        self._scenario, self._world = scenario, world
        self._elements: dict[tuple[str, str], Element] = {}
        root = scenario.root.find("Storyboard")
        assert root is not None
        self._init = list(self._read_init(root, scope))
        self.stories = [self._read_story(story, scope) for story in root.iterfind("Story")]
        self._stop = read_trigger(root.find("StopTrigger"), scope, world, self)

    def named(self, kind: str, name: str) -> Element | None:
        """Element of a kind and name; names may be given with those of the parents, as ``Act::Group``."""
        return self._elements.get((kind, name)) or self._elements.get((kind, name.split("::")[-1]))

    def step(self, dt: float) -> None:
        """Advance by one frame: triggers at the present time, then the actions."""
        world = self._world
        if dt == 0.0:
            for action in self._init:
                action.start(world, world.running.copy())
        else:
            world.running &= ~self._stop.fires(world, world.running.copy())
        for action in self._init:
            action.turn()
            action.step(world, dt)
        for story in self.stories:
            story.step(world, dt, world.running)

    def over(self) -> BoolArray:
        """Scenarios in which all stories have ended and no stop trigger is left to wait for, shape (N,)."""
        done = np.full(self._world.scenarios, bool(self.stories) and self._stop.empty)
        for story in self.stories:
            done &= story.complete()
        return done

    def _read_init(self, root: etree._Element, scope: Scope) -> Iterator[RunningAction]:
        actions = root.find("Init/Actions")
        for element in () if actions is None else actions.iterchildren("*"):
            if element.tag != "Private":
                action = read_action(element, scope, self._world, None)
                yield RunningAction("init", scope.scenarios, action)
                continue
            entity = entity_index(element, scope, self._world)
            for item in element.iterfind("PrivateAction"):
                yield RunningAction("init", scope.scenarios, read_action(item, scope, self._world, entity))

    def _read_story(self, story: etree._Element, scope: Scope) -> Group:
        scope = scope.within(story)
        acts = []
        for act in story.iterfind("Act"):
            groups = [self._read_group(group, scope) for group in act.iterfind("ManeuverGroup")]
            start, stop = act.find("StartTrigger"), act.find("StopTrigger")
            acts.append(
                self._known(
                    Group(
                        "act",
                        act.get("name", ""),
                        scope.scenarios,
                        groups,
                        # An act without start trigger starts with its story, one with an empty one never does.
                        None if start is None else read_trigger(start, scope, self._world, self),
                        read_trigger(stop, scope, self._world, self),
                    )
                )
            )
        return self._known(Group("story", story.get("name", ""), scope.scenarios, acts))

    def _read_group(self, group: etree._Element, scope: Scope) -> Group:
        if int(scope.one_number(group, "maximumExecutionCount", 1.0)) != 1:
            raise InputError(
                f"{scope.source}, line {group.sourceline}: a <ManeuverGroup> that runs more than once is not supported"
                " by the builtin simulator."
            )
        holder = group.find("Actors")
        if holder is not None and scope.flag(holder, "selectTriggeringEntities", False):
            raise InputError(
                f"{scope.source}, line {holder.sourceline}: selectTriggeringEntities is not supported by the builtin"
                " simulator; name the actors with <EntityRef>."
            )
        actors = [entity_index(e, scope, self._world) for e in group.iterfind("Actors/EntityRef")]
        maneuvers = []
        for element in group.iterchildren("Maneuver", "CatalogReference"):
            maneuver, inner = element, scope
            if element.tag == "CatalogReference":
                maneuver = self._scenario.catalog_entry(
                    scope.text(element, "catalogName"), scope.text(element, "entryName")
                )
                inner = scope.within(maneuver, element.find("ParameterAssignments"))
            else:
                inner = scope.within(maneuver)
            events = [self._read_event(event, inner, actors) for event in maneuver.iterfind("Event")]
            maneuvers.append(self._known(Group("maneuver", maneuver.get("name", ""), scope.scenarios, events)))
        return self._known(Group("maneuverGroup", group.get("name", ""), scope.scenarios, maneuvers))

    def _read_event(self, event: etree._Element, scope: Scope, actors: list[int]) -> Event:
        actions = []
        for action in event.iterfind("Action"):
            name = action.get("name", "")
            for element in action.iterchildren("*"):
                for actor in actors if element.tag == "PrivateAction" else [None]:
                    running = RunningAction(name, scope.scenarios, read_action(element, scope, self._world, actor))
                    actions.append(running)
                    self._known(running)
        start = event.find("StartTrigger")
        trigger = None if start is None else read_trigger(start, scope, self._world, self)
        times = int(scope.one_number(event, "maximumExecutionCount", 1.0))
        result = Event(event.get("name", ""), scope.scenarios, actions, trigger, times)
        result.priority = scope.text(event, "priority", "parallel")
        self._known(result)
        return result

    def _known(self, element: E) -> E:
        self._elements.setdefault((element.kind, element.name), element)
        return element
