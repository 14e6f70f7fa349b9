"""The actions of a storyboard as compiled code sees them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple, Protocol

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray

UNKNOWN, SPEED_ACTION, TRAJECTORY_ACTION, LANE_CHANGE, LANE_OFFSET, SYNCHRONISATION, DISTANCE_ACTION = range(7)
"""Kinds of actions; of the first, compiled code only knows that they run."""

SHAPES: Final = ("linear", "cubic", "sinusoidal", "step")
"""Shapes of transitions, as compiled code numbers them."""
DIMENSIONS: Final = ("time", "rate", "distance")
"""Dimensions of transitions, as compiled code numbers them."""

OPTIONS: Final = 8
"""How many whole numbers describe an action: its kind, its entity, and what it needs besides."""
MEMORY: Final = 24
"""How many numbers an action can remember of each scenario."""
CHANGING: Final = 8
"""So many of these, the first ones, can change from step to step."""


class Actions(NamedTuple):
    """J actions in N scenarios, in the order in which they act.

    Attributes
    ----------
    options : ndarray of int64, shape (J, 8)
    memory : ndarray of float64, shape (N, J, 24)
        What each remembers of each scenario.
    running : ndarray of bool, shape (N, J)
    """

    options: IntArray
    memory: FloatArray
    running: BoolArray


class Compilable(Protocol):
    """An action that may have a compiled twin.

    Attributes
    ----------
    remembered : tuple of str
        Names of its arrays (N,) that compiled code shares.
    """

    remembered: tuple[str, ...]

    def options(self) -> tuple[int, ...]:
        """Kind, entity, and what else its twin needs to know; `UNKNOWN` alone for an action that has none."""
        ...


def gather_actions(found: Sequence[Compilable | None], scenarios: int) -> Actions:
    """Make the tables of actions; what they remember moves into them.

    Parameters
    ----------
    found : sequence of Compilable, or None for what ends at once
    scenarios : int
        N.

    Returns
    -------
    Actions
    """
    options = np.zeros((len(found), OPTIONS), dtype=np.int64)
    memory = np.zeros((scenarios, len(found), MEMORY))
    for j, action in enumerate(found):
        if action is not None:
            given = action.options()
            assert len(given) <= OPTIONS
            options[j, : len(given)] = given
            for k, name in enumerate(action.remembered):
                memory[:, j, k] = getattr(action, name)
                setattr(action, name, memory[:, j, k])
    return Actions(options, memory, np.zeros((scenarios, len(found)), dtype=np.bool_))
