"""The storyboard: a tree of elements, each in a state of its own in every scenario of a batch."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Final, TypeVar

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray
from cornercase.scenario import Scenario, Scope
from cornercase.simulators.builtin.actions.basic import Action, read_action
from cornercase.simulators.builtin.paths.positions import entities_in, entity_index
from cornercase.simulators.builtin.storyboard.triggers import Trigger, read_trigger
from cornercase.simulators.builtin.world import World

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

    A transition is seen until the end of the frame in which it takes effect: elements later in the file see a start in
    the same frame. An end takes effect at the beginning of the next frame, for all.

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
    """An action of one event, for one of its actors; without effect when `action` is None.

    With `chosen` it takes part only in the scenarios of that mask, as of the moment when it starts.
    """

    def __init__(
        self, name: str, scenarios: int, action: Action | None, chosen: Callable[[], BoolArray] | None = None
    ) -> None:
        super().__init__("action", name, scenarios)
        self._action, self._chosen = action, chosen

    def start(self, world: World, where: BoolArray) -> None:
        if self._chosen is not None:
            taking_part = where & self._chosen()
            self.end(where & ~taking_part)
            where = taking_part
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
        self._times = times
        self._left = np.full(scenarios, times)

    def update(self, world: World, parent: BoolArray, siblings: Sequence[Event]) -> None:
        """Start where the trigger fires."""
        waiting = parent & (self._after == STANDBY) & (self._left > 0)
        if waiting.any():
            fired = waiting if self._trigger is None else self._trigger.fires(world, waiting)
            if fired.any():
                self._start(world, fired, siblings)

    def step(self, world: World, dt: float) -> None:
        """Let the actions act for one time step."""
        for action in self.actions:
            action.step(world, dt)
        done = self.running()
        for action in self.actions:
            done &= action.complete()
        self.end(done & (self._left == 0))
        self.end(done & (self._left > 0), STANDBY)

    def reset(self, where: BoolArray) -> None:
        """Make the event ready to run again in the scenarios of a mask, as often as at first."""
        self.end(where, STANDBY)
        self._left[where] = self._times

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
    times : int
        How often it runs.
    """

    def __init__(
        self,
        kind: str,
        name: str,
        scenarios: int,
        children: Sequence[Group] | Sequence[Event],
        start: Trigger | None = None,
        stop: Trigger | None = None,
        times: int = 1,
    ) -> None:
        super().__init__(kind, name, scenarios)
        self.children = children
        self._start, self._stop = start, stop
        self._left = np.full(scenarios, times)
        self._here = np.zeros(scenarios, dtype=np.bool_)

    def update(self, world: World, parent: BoolArray) -> None:
        """Evaluate the triggers of the element and of all below it, where its parent runs."""
        waiting = parent & (self._after == STANDBY)
        if waiting.any():
            self.begin(waiting if self._start is None else self._start.fires(world, waiting))
        if self._stop is not None and not self._stop.empty:
            self.stop(self._stop.fires(world, self.running() & parent))
        self._here = self.running() & parent
        for child in self.children:
            if isinstance(child, Event):
                child.update(world, self._here, self.children)  # type: ignore[arg-type]
            else:
                child.update(world, self._here)

    def step(self, world: World, dt: float) -> None:
        """Let all actions below the element act for one time step, and see whether it has ended."""
        done = self._here & self.running()
        for child in self.children:
            child.step(world, dt)
            done &= child.complete()
        self._left[done] -= 1
        again = done & (self._left > 0)
        self.end(done & ~again)
        if again.any():
            self.end(again, STANDBY)
            for child in self.children:
                child.reset(again)

    def reset(self, where: BoolArray) -> None:
        """Make the element, and all below it, ready to run again in the scenarios of a mask."""
        self.end(where, STANDBY)
        for child in self.children:
            child.reset(where)

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
        self._elements: dict[tuple[str, str], list[tuple[Element, tuple[str, ...]]]] = {}
        self._parents: list[str] = []
        root = scenario.root.find("Storyboard")
        assert root is not None
        self._init = list(self._read_init(root, scope))
        self.stories = [self._read_story(story, scope) for story in root.iterfind("Story")]
        self._stop = read_trigger(root.find("StopTrigger"), scope, world, self)

    def named(self, kind: str, name: str) -> Element | None:
        """Element of a kind and name; names may be given with those of the parents, as ``Act::Group``."""
        path = tuple(name.split("::"))
        for element, parents in self._elements.get((kind, path[-1]), ()):
            # A name may leave out parents between those that it gives.
            given = iter(parents)
            if all(part in given for part in path[:-1]):
                return element
        return None

    def step(self, dt: float) -> None:
        """Advance by one frame: triggers at the present time, then the actions."""
        world = self._world
        if dt == 0.0:
            for action in self._init:
                action.start(world, world.running.copy())
        else:
            world.running &= ~self._stop.fires(world, world.running.copy())
        for known in self._elements.values():
            for element, _ in known:
                element.turn()
        for story in self.stories:
            story.update(world, world.running)
        for action in self._init:
            action.turn()
            action.step(world, dt)
        for story in self.stories:
            story.step(world, dt)

    def _read_init(self, root: etree._Element, scope: Scope) -> Iterator[RunningAction]:
        actions = root.find("Init/Actions")
        if actions is None:
            return
        for element in (*actions.iterfind("GlobalAction"), *actions.iterfind("UserDefinedAction")):
            yield RunningAction("init", scope.scenarios, read_action(element, scope, self._world, None))
        for private in _in_order_of_reference(list(actions.iterfind("Private")), scope):
            for entity in self._entities(private, scope):
                for item in private.iterfind("PrivateAction"):
                    yield RunningAction("init", scope.scenarios, read_action(item, scope, self._world, entity))

    def _entities(self, element: etree._Element, scope: Scope) -> list[int]:
        members = self._world.selections.get(scope.text(element, "entityRef"))
        return [entity_index(element, scope, self._world)] if members is None else members

    def _read_story(self, story: etree._Element, scope: Scope) -> Group:
        scope = scope.within(story)
        name = story.get("name", "")
        with self._inside(name):
            acts = [self._read_act(act, scope) for act in story.iterfind("Act")]
        return self._known(Group("story", name, scope.scenarios, acts))

    def _read_act(self, act: etree._Element, scope: Scope) -> Group:
        name = act.get("name", "")
        with self._inside(name):
            groups = [self._read_group(group, scope) for group in act.iterfind("ManeuverGroup")]
        start = self._start_trigger(act, scope)
        stop = read_trigger(act.find("StopTrigger"), scope, self._world, self)
        return self._known(Group("act", name, scope.scenarios, groups, start, stop))

    def _start_trigger(self, element: etree._Element, scope: Scope) -> Trigger | None:
        """Start trigger of an act or event; None, which fires at once, for a missing or an empty one."""
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
            own = maneuver.get("name", "")
            with self._inside(name), self._inside(own):
                events = [self._read_event(event, inner, actors, select) for event in maneuver.iterfind("Event")]
            with self._inside(name):
                maneuvers.append(self._known(Group("maneuver", own, scope.scenarios, events)))
        times = int(scope.one_number(group, "maximumExecutionCount", 1.0))
        return self._known(Group("maneuverGroup", name, scope.scenarios, maneuvers, times=times))

    def _read_event(self, event: etree._Element, scope: Scope, actors: list[int], select: bool) -> Event:
        trigger = self._start_trigger(event, scope)
        # Who triggers the event may be an actor besides those that are named.
        choices: dict[int, Callable[[], BoolArray] | None] = {}
        if select and trigger is not None:
            choices = {e: partial(trigger.triggered_by, e) for e in trigger.entities}
        choices |= dict.fromkeys(actors)
        actions = []
        for action in event.iterfind("Action"):
            name = action.get("name", "")
            for element in action.iterchildren("*"):
                private = element.tag == "PrivateAction"
                for actor, chosen in choices.items() if private else [(None, None)]:
                    what = read_action(element, scope, self._world, actor)
                    running = RunningAction(name, scope.scenarios, what, chosen)
                    actions.append(running)
                    with self._inside(event.get("name", "")):
                        self._known(running)
        times = int(scope.one_number(event, "maximumExecutionCount", 1.0))
        result = Event(event.get("name", ""), scope.scenarios, actions, trigger, times)
        result.priority = scope.text(event, "priority", "parallel")
        self._known(result)
        return result

    def _known(self, element: E) -> E:
        self._elements.setdefault((element.kind, element.name), []).append((element, tuple(self._parents)))
        return element

    @contextmanager
    def _inside(self, name: str) -> Iterator[None]:
        self._parents.append(name)
        try:
            yield
        finally:
            self._parents.pop()


def _in_order_of_reference(privates: list[etree._Element], scope: Scope) -> list[etree._Element]:
    """Init blocks, those whose teleport is relative to an entity after the block of that entity."""
    ordered: list[etree._Element] = []
    placed: set[str] = set()
    names = {private.get("entityRef", "") for private in privates}
    left = list(privates)
    while left:
        ready = [one for one in left if _references(one, scope) & names <= placed | {one.get("entityRef", "")}]
        # Two that refer to each other keep the file's order.
        for one in ready or left[:1]:
            ordered.append(one)
            placed.add(one.get("entityRef", ""))
            left.remove(one)
    return ordered


def _references(private: etree._Element, scope: Scope) -> set[str]:
    kinds = ("RelativeLanePosition", "RelativeRoadPosition", "RelativeObjectPosition", "RelativeWorldPosition")
    return {
        scope.text(position, "entityRef")
        for teleport in private.iter("TeleportAction")
        for kind in kinds
        for position in teleport.iter(kind)
    }
