"""Elements of the storyboard: actions, events, and groups such as maneuvers."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from cornercase._common.masks import any_true
from cornercase._common.typing import BoolArray
from cornercase.simulators.builtin.actions._action import Action
from cornercase.simulators.builtin.storyboard._element import INIT, NOTHING, RUNNING, SKIP, STANDBY, START, Element
from cornercase.simulators.builtin.storyboard._triggers import Trigger
from cornercase.simulators.builtin.world._world import World


class ActionElement(Element):
    """Element of the storyboard for one action of one actor; without effect if `action` is None.

    The element adds itself to `entity_actions`, the list of all actions of the same entity. `takes_part` is called when
    the action starts, and returns the scenarios in which the actor takes part. `location` says line, element and name
    in error messages.
    """

    def __init__(
        self,
        name: str,
        scenarios: int,
        action: Action | None,
        world: World,
        entity_actions: list[ActionElement],
        takes_part: Callable[[], BoolArray] | None = None,
        location: str = "",
    ) -> None:
        super().__init__("action", name, scenarios)
        self._location = location
        self.action, self._takes_part, self._world, self._entity_actions = action, takes_part, world, entity_actions
        self.domains = () if action is None else action.domains
        entity_actions.append(self)

    @property
    def is_instantaneous(self) -> bool:
        """Whether the action takes effect when it starts, and ends in the same frame."""
        return self.action is None or type(self.action).step is Action.step

    def start(self, where: BoolArray) -> None:
        if self._takes_part is not None:
            taking_part = where & self._takes_part()
            self.set_state(where & ~taking_part, STANDBY, NOTHING)
            self.end(where & ~taking_part)
            where = taking_part
        self.set_state(where, RUNNING, START)
        if self.action is not None:
            self._world.current_action = self._location
            self.action.start(self._world, where)
            self._world.current_action = None
            self._world.has_leaf_values = False

    def end_conflicting_actions(self, where: BoolArray) -> None:
        """End all other actions of the entity that control the same part of its motion, in the scenarios of a mask."""
        for rival in self._entity_actions:
            if rival is not self and not set(rival.domains).isdisjoint(self.domains):
                rival.end(where & (rival.state == RUNNING))

    def step(self, dt: float, where: BoolArray) -> None:
        where = where & (self.state == RUNNING)
        if any_true(where):
            self._world.current_action = self._location
            is_done = where if self.action is None else self.action.step(self._world, dt, where) & where
            self._world.current_action = None
            self._world.changed |= is_done
            self._end_without_release(is_done)

    def look_up_positions(self, where: BoolArray) -> None:
        """Look up road positions that compiled code cannot look up, for the action, in the scenarios of a mask."""
        where = where & (self.state == RUNNING)
        if self.action is not None and any_true(where):
            self._world.current_action = self._location
            self.action.look_up_positions(self._world, where)
            self._world.current_action = None

    def end(self, where: BoolArray) -> None:
        self._release_entity(where & (self.state == RUNNING))
        super().end(where)

    def stop(self, where: BoolArray) -> None:
        self._release_entity(where & (self.state == RUNNING))
        super().stop(where)

    def _end_without_release(self, where: BoolArray) -> None:
        super().end(where)

    def _release_entity(self, where: BoolArray) -> None:
        if self.action is not None and where.any():
            self.action.release(self._world, where)
            self._world.has_leaf_values = False


class Event(Element):
    """An event, which starts its actions when its trigger fires; without a trigger it starts immediately.

    The event is complete after `max_executions` executions. With the `priority` ``"overwrite"``, the event ends the
    other events of its maneuver; with ``"skip"``, the event does not start while another event of the maneuver runs.
    """

    def __init__(
        self,
        name: str,
        scenarios: int,
        actions: Sequence[ActionElement],
        trigger: Trigger | None,
        max_executions: int,
        priority: str,
    ) -> None:
        super().__init__("event", name, scenarios, actions, trigger, None, max_executions)
        self._actions = actions
        self._priority = priority

    def evaluate_triggers(self, world: World, where: BoolArray) -> None:
        """Start the event in those scenarios of a mask in which it waits and its trigger fires."""
        waiting = where & (self.state == STANDBY)
        if any_true(waiting):
            fired = waiting if self.start_trigger is None else self.start_trigger.fires(world, waiting)
            world.changed |= fired
            self._start_actions(fired)

    def start(self, where: BoolArray) -> None:
        """Make the event wait for its trigger, in scenarios in which its maneuver starts."""
        self.set_state(where & (self.state == INIT), STANDBY, NOTHING)

    def step(self, dt: float, where: BoolArray) -> None:
        if any_true(where & (self.state == RUNNING)):
            for action in self._actions:
                action.step(dt, where)

    def _start_actions(self, fired: BoolArray) -> None:
        if not any_true(fired):
            return
        others = [] if self._parent is None else [event for event in self._parent.children if event is not self]
        if self._priority == "skip":
            busy = np.zeros_like(fired)
            for event in others:
                busy |= event.state == RUNNING
            # A skipped event has not run, and keeps waiting.
            self.set_state(fired & busy, STANDBY, SKIP)
            fired = fired & ~busy
        elif self._priority in ("overwrite", "override"):
            for event in others:
                event.end(fired & (event.state == RUNNING))
        self.set_state(fired, RUNNING, START)
        self._executions[fired] += 1
        for action in self._actions:
            action.end_conflicting_actions(fired)
            action.start(fired)
        if not self._actions:
            self.end(fired)


class ElementGroup(Element):
    """A maneuver, maneuver group, act or story, which runs its children until all of them have ended."""

    def __init__(
        self,
        kind: str,
        name: str,
        scenarios: int,
        children: Sequence[ElementGroup | Event],
        start: Trigger | None = None,
        stop: Trigger | None = None,
        max_executions: int | None = None,
    ) -> None:
        super().__init__(kind, name, scenarios, children, start, stop, max_executions)
        self._parts = children

    def evaluate_triggers(self, world: World, where: BoolArray) -> None:
        """Evaluate the triggers of the group and its descendants, in the scenarios of a mask."""
        if self._stop is not None:
            self.stop(self._stop.fires(world, where & (self.state == RUNNING)))
        waiting = where & (self.state == STANDBY)
        if any_true(waiting):
            begins = waiting if self.start_trigger is None else self.start_trigger.fires(world, waiting)
            world.changed |= begins
            self._start_running(begins)
        running = where & (self.state == RUNNING)
        if any_true(running):
            for child in self._parts:
                child.evaluate_triggers(world, running)

    def start(self, where: BoolArray) -> None:
        """Start the group together with its parent, or make the group wait for its start trigger."""
        new = where & (self.state == INIT)
        if self.start_trigger is not None:
            self.set_state(new, STANDBY, NOTHING)
        else:
            self._start_running(new)

    def step(self, dt: float, where: BoolArray) -> None:
        where = where & (self.state == RUNNING)
        if any_true(where):
            for child in self._parts:
                child.step(dt, where)

    def has_pending_stop(self, world: World) -> BoolArray:
        """Return the scenarios in which the group runs and its stop trigger does not fire now, but can fire later."""
        if self._stop is None:
            return np.zeros(world.scenarios, dtype=np.bool_)
        running = self.state == RUNNING
        return np.asarray(running & self._stop.may_fire(world) & ~self._stop.fires(world, running))

    def _start_running(self, where: BoolArray) -> None:
        if any_true(where):
            self.set_state(where, RUNNING, START)
            self._executions[where] += 1
            for child in self._parts:
                child.start(where)
