"""What a storyboard is made of: actions, events, and the groups that hold them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from cornercase._common.typing import BoolArray
from cornercase.simulators.builtin.actions.basic import Action
from cornercase.simulators.builtin.storyboard.element import COMPLETE, SKIP, STANDBY, STOP, Element
from cornercase.simulators.builtin.storyboard.triggers import Trigger
from cornercase.simulators.builtin.world.state import World


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
        waiting = parent & (self.after == STANDBY) & (self._left > 0)
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
        where = where & (self.after != COMPLETE)
        self.end(where, COMPLETE, STOP)
        for action in self.actions:
            action.end(where & (action.after != COMPLETE), COMPLETE, STOP)

    def _start(self, world: World, fired: BoolArray, siblings: Sequence[Event]) -> None:
        others = [event for event in siblings if event is not self]
        self._left[fired] -= 1
        if self.priority == "skip":
            busy = np.zeros_like(fired)
            for event in others:
                busy |= event.running()
            skipped = fired & busy
            self.end(skipped & (self._left == 0), COMPLETE, SKIP)
            self.pending[skipped] = SKIP
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
        As in `Element`.
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
        waiting = parent & (self.after == STANDBY)
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
        where = where & (self.after != COMPLETE)
        self.end(where, COMPLETE, STOP)
        for child in self.children:
            child.stop(where)
