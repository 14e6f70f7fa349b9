"""Tables of a storyboard's actions for compiled code."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple, Protocol

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray

UNKNOWN, SPEED_ACTION, TRAJECTORY_ACTION, LANE_CHANGE, LANE_OFFSET, SYNCHRONISATION, DISTANCE_ACTION = range(7)
"""Types of actions. A `PYTHON_ACTION` has no kernel; only whether it runs is known here."""

SHAPES: Final = ("linear", "cubic", "sinusoidal", "step")
"""Transition shapes, indexed by their numbers in compiled code."""
DIMENSIONS: Final = ("time", "rate", "distance")
"""Transition dimensions, indexed by their numbers in compiled code."""

OPTIONS: Final = 8
"""Number of integers that describe an action: type, entity and type-specific ones."""
MEMORY: Final = 24
"""Number of values that an action can remember of each scenario."""
CHANGING: Final = 8
"""Number of these, the first ones, that can change from step to step."""


class Actions(NamedTuple):
    """J actions in N scenarios, in the order in which they are applied."""

    options: IntArray  # (J, 8): type, entity and type-specific integers
    memory: FloatArray  # (N, J, 24): what an action remembers of a scenario
    running: BoolArray  # (N, J)


class Compilable(Protocol):
    """An action that may have a compiled kernel, and arrays (N,) named in `memory_attributes` that both share."""

    remembered: tuple[str, ...]

    def options(self) -> tuple[int, ...]:
        """Type, entity and type-specific integers of the action; only `PYTHON_ACTION` for one without a kernel."""
        ...


def gather_actions(found: Sequence[Compilable | None], scenarios: int) -> Actions:
    """Build the action tables (None: the action ends at once); arrays that actions remember move into them."""
    options = np.zeros((len(found), OPTIONS), dtype=np.int64)
    memory = np.zeros((scenarios, len(found), MEMORY))
    for j, action in enumerate(found):
        if action is not None:
            values = action.options()
            assert len(values) <= OPTIONS
            options[j, : len(values)] = values
            for k, name in enumerate(action.remembered):
                memory[:, j, k] = getattr(action, name)
                setattr(action, name, memory[:, j, k])
    return Actions(options, memory, np.zeros((scenarios, len(found)), dtype=np.bool_))
