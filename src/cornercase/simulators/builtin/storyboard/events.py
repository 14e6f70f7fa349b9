"""Storyboard elements: actions, events, and their groups."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from cornercase._common.masks import anywhere
from cornercase._common.typing import BoolArray
from cornercase.simulators.builtin.actions.action import Action
from cornercase.simulators.builtin.storyboard.element import INIT, NOTHING, RUNNING, SKIP, STANDBY, START, Element
from cornercase.simulators.builtin.storyboard.triggers import Trigger
from cornercase.simulators.builtin.world.state import World


class RunningAction(Element):
    """An action of one event for one actor; without effect if `action` is None.

    `rivals`: all actions of the same entity, to which this one is added. `chosen`: scenarios in which the actor takes
    part, evaluated at the start. `place`: line, element and name for errors.
    """

    def __init__(
        self,
        name: str,
        scenarios: int,
        action: Action | None,
        world: World,
        rivals: list[RunningAction],
        chosen: Callable[[], BoolArray] | None = None,
        place: str = "",
    ) -> None:
        super().__init__("action", name, scenarios)
        self._place = place
        self.action, self._chosen, self._world, self._rivals = action, chosen, world, rivals
        self.domains = () if action is None else action.domains
        rivals.append(self)

    @property
    def momentary(self) -> bool:
        """Whether it is done as soon as it has started, and ends in the same frame."""
        return self.action is None or type(self.action).step is Action.step

    def start(self, where: BoolArray) -> None:
        if self._chosen is not None:
            taking_part = where & self._chosen()
            self.move(where & ~taking_part, STANDBY, NOTHING)
            self.end(where & ~taking_part)
            where = taking_part
        self.move(where, RUNNING, START)
        if self.action is not None:
            self._world.acting = self._place
            self.action.start(self._world, where)
            self._world.acting = None

    def take_over(self, where: BoolArray) -> None:
        """End all actions of the same entity with a common domain, in the scenarios of a mask."""
        for rival in self._rivals:
            if rival is not self and not set(rival.domains).isdisjoint(self.domains):
                rival.end(where & (rival.state == RUNNING))

    def step(self, dt: float, where: BoolArray) -> None:
        """Act for one time step in the scenarios of a mask."""
        where = where & (self.state == RUNNING)
        if anywhere(where):
            self._world.acting = self._place
            is_done = where if self.action is None else self.action.step(self._world, dt, where) & where
            self._world.acting = None
            self._world.stirred |= is_done
            self._finish(is_done)

    def look_up(self, where: BoolArray) -> None:
        """Look up what kernels cannot before the action acts, in the scenarios of a mask."""
        where = where & (self.state == RUNNING)
        if self.action is not None and anywhere(where):
            self._world.acting = self._place
            self.action.look_up(self._world, where)
            self._world.acting = None

    def end(self, where: BoolArray) -> None:
        self._leave(where & (self.state == RUNNING))
        super().end(where)

    def stop(self, where: BoolArray) -> None:
        self._leave(where & (self.state == RUNNING))
        super().stop(where)

    def _finish(self, where: BoolArray) -> None:
        super().end(where)

    def _leave(self, where: BoolArray) -> None:
        if self.action is not None and where.any():
            self.action.leave(self._world, where)


class Event(Element):
    """An event: when its trigger fires, its actions start.

    Without a trigger it fires immediately. `times`: number of executions. `priority`: ``"overwrite"`` ends the other
    events of its maneuver, ``"skip"`` does not start while one of them runs.
    """

    def __init__(
        self,
        name: str,
        scenarios: int,
        actions: Sequence[RunningAction],
        trigger: Trigger | None,
        times: int,
        priority: str,
    ) -> None:
        super().__init__("event", name, scenarios, actions, trigger, None, times)
        self._actions = actions
        self._priority = priority

    def evaluate(self, world: World, where: BoolArray) -> None:
        """Start where the maneuver runs and the trigger fires."""
        waiting = where & (self.state == STANDBY)
        if anywhere(waiting):
            fired = waiting if self._start is None else self._start.fires(world, waiting)
            world.stirred |= fired
            self._execute(fired)

    def start(self, where: BoolArray) -> None:
        """Become ready as the maneuver starts."""
        self.move(where & (self.state == INIT), STANDBY, NOTHING)

    def step(self, dt: float, where: BoolArray) -> None:
        """Let the actions act for one time step."""
        if anywhere(where & (self.state == RUNNING)):
            for action in self._actions:
                action.step(dt, where)

    def _execute(self, fired: BoolArray) -> None:
        if not anywhere(fired):
            return
        others = [] if self._parent is None else [event for event in self._parent.children if event is not self]
        if self._priority == "skip":
            busy = np.zeros_like(fired)
            for event in others:
                busy |= event.state == RUNNING
            # A skipped event has not run, and keeps waiting.
            self.move(fired & busy, STANDBY, SKIP)
            fired = fired & ~busy
        elif self._priority in ("overwrite", "override"):
            for event in others:
                event.end(fired & (event.state == RUNNING))
        self.move(fired, RUNNING, START)
        self._executions[fired] += 1
        for action in self._actions:
            action.take_over(fired)
            action.start(fired)
        if not self._actions:
            self.end(fired)


class Group(Element):
    """A maneuver, maneuver group, act or story: runs its children until all of them have ended."""

    def __init__(
        self,
        kind: str,
        name: str,
        scenarios: int,
        parts: Sequence[Group | Event],
        start: Trigger | None = None,
        stop: Trigger | None = None,
        times: int | None = None,
    ) -> None:
        super().__init__(kind, name, scenarios, parts, start, stop, times)
        self._parts = parts

    def evaluate(self, world: World, where: BoolArray) -> None:
        """Evaluate the triggers of the element and its descendants, where its parent runs."""
        if self._stop is not None:
            self.stop(self._stop.fires(world, where & (self.state == RUNNING)))
        waiting = where & (self.state == STANDBY)
        if anywhere(waiting):
            begins = waiting if self._start is None else self._start.fires(world, waiting)
            world.stirred |= begins
            self._run(begins)
        running = where & (self.state == RUNNING)
        if anywhere(running):
            for child in self._parts:
                child.evaluate(world, running)

    def start(self, where: BoolArray) -> None:
        """Start with the parent, or wait for the start trigger."""
        new = where & (self.state == INIT)
        if self._start is not None:
            self.move(new, STANDBY, NOTHING)
        else:
            self._run(new)

    def step(self, dt: float, where: BoolArray) -> None:
        """Let all actions below the element act for one time step."""
        where = where & (self.state == RUNNING)
        if anywhere(where):
            for child in self._parts:
                child.step(dt, where)

    def has_end(self, world: World) -> BoolArray:
        """Where it runs and its stop trigger may fire later, but does not fire now, shape (N,)."""
        if self._stop is None:
            return np.zeros(world.scenarios, dtype=np.bool_)
        running = self.state == RUNNING
        return np.asarray(running & self._stop.may_fire(world) & ~self._stop.fires(world, running))

    def _run(self, where: BoolArray) -> None:
        if anywhere(where):
            self.move(where, RUNNING, START)
            self._executions[where] += 1
            for child in self._parts:
                child.start(where)
