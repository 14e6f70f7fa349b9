"""States of a storyboard element, and how it goes from one to another."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray

STANDBY, RUNNING, COMPLETE = 0, 1, 2
NOTHING, START, END, STOP, SKIP = 0, 1, 2, 3, 4

_STATES: Final = {"standbyState": STANDBY, "runningState": RUNNING, "completeState": COMPLETE}
_TRANSITIONS: Final = {
    "startTransition": START,
    "endTransition": END,
    "stopTransition": STOP,
    "skipTransition": SKIP,
}

STATES: Final = (*_STATES, *_TRANSITIONS)
"""Names of the states, and of the transitions between them."""


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
        self._transition = np.full(scenarios, NOTHING, dtype=np.int8)
        self.after = np.full(scenarios, STANDBY, dtype=np.int8)
        self.pending = np.full(scenarios, NOTHING, dtype=np.int8)

    def is_in(self, state: str) -> BoolArray:
        """Scenarios in which the element is in a state, or just made a transition, shape (N,)."""
        if state in _STATES:
            return np.asarray(self.state == _STATES[state])
        return np.asarray(self._transition == _TRANSITIONS[state])

    def turn(self) -> None:
        """Let what was decided in the last frame take effect."""
        self._transition[:] = self.pending
        self.pending[:] = NOTHING
        self.state[:] = self.after

    def begin(self, where: BoolArray) -> None:
        """Start in the scenarios of a mask, at once."""
        self.state[where] = self.after[where] = RUNNING
        self._transition[where] = START

    def end(self, where: BoolArray, state: int = COMPLETE, transition: int = END) -> None:
        """Leave the running state in the scenarios of a mask, from the next turn on."""
        self.after[where] = state
        self.pending[where] = transition

    def running(self) -> BoolArray:
        """Scenarios in which the element runs and was not told to end, shape (N,)."""
        return np.asarray((self.state == RUNNING) & (self.after == RUNNING))

    def complete(self) -> BoolArray:
        """Scenarios in which the element has ended, or will at its next turn, shape (N,)."""
        return np.asarray(self.after == COMPLETE)
