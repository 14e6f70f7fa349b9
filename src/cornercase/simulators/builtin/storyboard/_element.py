"""Storyboard elements, their states and transitions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final, Protocol

import numpy as np

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.masks import any_true
from cornercase._common.typing import BoolArray
from cornercase.simulators.builtin.world._world import World

INIT, STANDBY, RUNNING, COMPLETE = 0, 1, 2, 3
NOTHING, START, END, STOP, SKIP = 0, 1, 2, 3, 4

_STATES: Final = {"standbyState": STANDBY, "runningState": RUNNING, "completeState": COMPLETE}
_TRANSITIONS: Final = {
    "startTransition": START,
    "endTransition": END,
    "stopTransition": STOP,
    "skipTransition": SKIP,
}


class StateWatcher:
    """State of an element as a condition sees it, or its transition since the condition was last evaluated.

    A change is seen once, by the next evaluation, however late; as in esmini, one that is cleared before is never seen.
    `state` is the awaited state or transition, such as ``"runningState"``; `where` starts error messages.
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
        """Check the element's state, or its transition since the last call, shape (N,)."""
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
        """Record a change in the scenarios of a mask."""
        self._current_state[where] = state
        self._has_changed |= where
        if state == self._state or transition == self._transition:
            self._was_matched |= where

    def clear_changes(self, where: BoolArray) -> None:
        """Clear recorded changes in the scenarios of a mask."""
        self._has_changed &= ~where
        self._was_matched &= ~where


class ElementTrigger(Protocol):
    """Interface of triggers for elements."""

    def fires(self, world: World, where: BoolArray) -> BoolArray:
        """Scenarios of the mask in which it fires, shape (N,)."""
        ...

    def reset(self, where: BoolArray) -> None:
        """Reset in the scenarios of the mask."""
        ...

    def may_fire(self, world: World) -> BoolArray:
        """Scenarios in which it may ever fire, shape (N,)."""
        ...

    @property
    def groups(self) -> list[list[Any]]:
        """All its conditions, by group."""
        ...


class Element:
    """A storyboard element with a state in every scenario, ndarray of int8 (N,).

    A state change takes effect immediately: elements later in the file see it in the same frame, the others in the
    next. `kind` is as in ``storyboardElementType``. Without a start trigger the element starts as soon as it can.
    `times` is the number of executions until it is complete; None if it is complete once it has ended.
    """

    def __init__(
        self,
        kind: str,
        name: str,
        scenarios: int,
        children: Sequence[Element] = (),
        start: ElementTrigger | None = None,
        stop: ElementTrigger | None = None,
        max_executions: int | None = None,
    ) -> None:
        self.kind, self.name, self.children = kind, name, children
        self.state = np.full(scenarios, INIT, dtype=np.int8)
        self._start, self._stop, self._times = start, stop, max_executions
        self._executions = np.zeros(scenarios, dtype=np.int64)
        self._parent: Element | None = None
        self._watches: list[StateWatcher] = []
        for child in children:
            child._parent = self

    def add_watcher(self, watcher: StateWatcher) -> None:
        """Report all changes to a condition from now on."""
        self._watches.append(watcher)

    def iter_triggers(self) -> Iterator[tuple[ElementTrigger, int]]:
        """Yield the element's triggers, and the state in which each may fire."""
        if self._start is not None:
            yield self._start, STANDBY
        if self._stop is not None:
            yield self._stop, RUNNING

    @property
    def has_no_start_trigger(self) -> bool:
        """Whether it has no start trigger."""
        return self._start is None

    def set_state(self, where: BoolArray, state: int, transition: int) -> None:
        """Change the state in the scenarios of a mask."""
        if any_true(where):
            for watch in self._watches:
                watch.record_change(where, state, transition)
            self.state[where] = state

    def end(self, where: BoolArray) -> None:
        """End the element and its running children in the scenarios of a mask; the last child ends its parent."""
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
        """Stop the element and its descendants in the scenarios of a mask."""
        if not any_true(where):
            return
        for child in self.children:
            child.stop(where)
        stopped = where & ((self.state == RUNNING) | (self.state == STANDBY))
        self.set_state(stopped, COMPLETE, STOP)
        self._end_complete_parent(stopped)

    def reset(self, where: BoolArray) -> None:
        """Reset the element and its descendants to their initial state."""
        for child in self.children:
            child.reset(where)
        self.state[where] = INIT
        self._reset_triggers(where)

    def _reset_triggers(self, where: BoolArray) -> None:
        for trigger in (self._start, self._stop):
            if trigger is not None:
                trigger.reset(where)

    def _end_complete_parent(self, where: BoolArray) -> None:
        if self._parent is not None and where.any():
            complete = where.copy()
            for child in self._parent.children:
                complete &= child.state == COMPLETE
            self._parent.end(complete)
