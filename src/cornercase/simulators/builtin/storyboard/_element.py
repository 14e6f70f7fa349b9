"""Elements of the storyboard, their states and their transitions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.masks import any_true
from cornercase._common.typing import BoolArray
from cornercase.simulators.builtin.world._world import World

if TYPE_CHECKING:
    from cornercase.simulators.builtin.storyboard._triggers import Trigger

INIT, STANDBY, RUNNING, COMPLETE = 0, 1, 2, 3
NOTHING, START, END, STOP, SKIP = 0, 1, 2, 3, 4

_STATES: Final = {"standbyState": STANDBY, "runningState": RUNNING, "completeState": COMPLETE}
_TRANSITIONS: Final = {"startTransition": START, "endTransition": END, "stopTransition": STOP, "skipTransition": SKIP}


class StateWatcher:
    """Condition that waits for a state or a transition of a storyboard element.

    `state` names the state or transition, such as ``"runningState"``; `location` starts error messages. A transition is
    remembered until the condition is evaluated next, which may be several frames later. If `clear_changes` is called
    before then, the condition never sees the transition, as in esmini.
    """

    def __init__(self, state: str, scenarios: int, location: str) -> None:
        if state not in _STATES and state not in _TRANSITIONS:
            states = (*_STATES, *_TRANSITIONS)
            raise InputError(
                f"{location}: '{state}' is not a state of a storyboard element; {suggest_name(state, states)}"
            )
        self._state, self._transition = _STATES.get(state), _TRANSITIONS.get(state)
        # Current state, and state at the last evaluation.
        self._current_state, self._last_state = (np.full(scenarios, INIT, dtype=np.int8) for _ in range(2))
        self._has_changed, self._was_matched = (np.zeros(scenarios, dtype=np.bool_) for _ in range(2))

    def __call__(self, world: World, where: BoolArray) -> BoolArray:
        """Return the scenarios in which the state holds, or state or transition has occurred since the last call."""
        result = (
            self._was_matched
            if self._state is None
            else np.where(self._has_changed, self._was_matched, self._last_state == self._state)
        )
        result = np.asarray(result & where)
        world.changed |= where & self._has_changed
        self._last_state = np.where(where & self._has_changed, self._current_state, self._last_state)
        self.clear_changes(where)
        return result

    def record_change(self, where: BoolArray, state: int, transition: int) -> None:
        self._current_state[where] = state
        self._has_changed |= where
        if state == self._state or transition == self._transition:
            self._was_matched |= where

    def clear_changes(self, where: BoolArray) -> None:
        self._has_changed &= ~where
        self._was_matched &= ~where


class Element:
    """An element of the storyboard; `state` has its state in each scenario, such as `RUNNING`.

    A change of state takes effect immediately: elements that come later in the file see the change in the same frame,
    all other elements in the next frame. `kind` is a ``storyboardElementType``. Without a start trigger, the element
    starts as soon as possible. The element is complete after `max_executions` executions, or as soon as it ends if
    `max_executions` is None.
    """

    def __init__(
        self,
        kind: str,
        name: str,
        scenarios: int,
        children: Sequence[Element] = (),
        start: Trigger | None = None,
        stop: Trigger | None = None,
        max_executions: int | None = None,
    ) -> None:
        self.kind, self.name, self.children = kind, name, children
        self.state = np.full(scenarios, INIT, dtype=np.int8)
        self.start_trigger, self._stop, self._times = start, stop, max_executions
        self._executions = np.zeros(scenarios, dtype=np.int64)
        self._parent: Element | None = None
        self._watches: list[StateWatcher] = []
        for child in children:
            child._parent = self

    def add_watcher(self, watcher: StateWatcher) -> None:
        """Report all further changes of the element's state to a condition, the watcher."""
        self._watches.append(watcher)

    def iter_triggers(self) -> Iterator[tuple[Trigger, int]]:
        """Yield the triggers of the element, each with the state in which it can fire."""
        if self.start_trigger is not None:
            yield self.start_trigger, STANDBY
        if self._stop is not None:
            yield self._stop, RUNNING

    def set_state(self, where: BoolArray, state: int, transition: int) -> None:
        if any_true(where):
            for watch in self._watches:
                watch.record_change(where, state, transition)
            self.state[where] = state

    def end(self, where: BoolArray) -> None:
        """End the element and its running children in the scenarios of a mask; the parent ends with its last child."""
        where = where & (self.state != COMPLETE)
        if not any_true(where):
            return
        for child in self.children:
            child.end(where & (child.state == RUNNING))
        # The last child that ends ends its parent.
        ending = where & ((self.state == RUNNING) | (self.state == STANDBY))
        runs_again = ending & (self._executions < self._times) if self._times is not None else np.zeros_like(ending)
        self.set_state(ending & ~runs_again, COMPLETE, END)
        if any_true(runs_again):
            self._reset_triggers(runs_again)
            self.set_state(runs_again, STANDBY, END)
            for child in self.children:
                child.reset(runs_again)
        self._end_complete_parent(ending)

    def stop(self, where: BoolArray) -> None:
        if not any_true(where):
            return
        for child in self.children:
            child.stop(where)
        stopped = where & ((self.state == RUNNING) | (self.state == STANDBY))
        self.set_state(stopped, COMPLETE, STOP)
        self._end_complete_parent(stopped)

    def reset(self, where: BoolArray) -> None:
        for child in self.children:
            child.reset(where)
        self.state[where] = INIT
        self._reset_triggers(where)

    def _reset_triggers(self, where: BoolArray) -> None:
        for trigger in (self.start_trigger, self._stop):
            if trigger is not None:
                trigger.reset(where)

    def _end_complete_parent(self, where: BoolArray) -> None:
        if self._parent is not None and where.any():
            complete = where.copy()
            for child in self._parent.children:
                complete &= child.state == COMPLETE
            self._parent.end(complete)
