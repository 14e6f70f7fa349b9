"""Tables of the actions of a storyboard, for kernels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple, Protocol

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray

(
    PYTHON_ACTION,
    SPEED_ACTION,
    TRAJECTORY_ACTION,
    LANE_CHANGE_ACTION,
    LANE_OFFSET_ACTION,
    SYNCHRONIZE_ACTION,
    DISTANCE_ACTION,
) = range(7)
"""Types of actions. A `PYTHON_ACTION` has no kernel; only whether it runs is known here."""

NEEDS_PYTHON, NEEDS_LOOKUP, ACTION_APPLIED, ACTION_ENDED, TRACK_ENDED = range(5)
"""Outcome of an action in a frame: it has no kernel, or needs an entity located on its road after the actions before
it; it needs an entity located on its track or road, which may be done before the frame; applied; applied, and it has
ended; applied, and its entity needs another track."""

DYNAMICS_SHAPES: Final = ("linear", "cubic", "sinusoidal", "step")
"""Transition shapes, indexed by their numbers in compiled code."""
DYNAMICS_DIMENSIONS: Final = ("time", "rate", "distance")
"""Transition dimensions, indexed by their numbers in compiled code."""

N_OPTIONS: Final = 8
"""Number of integers that describe an action: type, entity and type-specific ones."""
MEMORY_SIZE: Final = 24
"""Number of values that an action can remember of each scenario."""
N_SAVED: Final = 8
"""Number of these, the first ones, that can change from step to step."""


class ActionTable(NamedTuple):
    """J actions in N scenarios, in the order in which they are applied, as arrays for kernels."""

    options: IntArray  # (J, 8): type, entity and type-specific integers
    memory: FloatArray  # (N, J, 24): what an action remembers of a scenario
    is_running: BoolArray  # (N, J)
    kernels: IntArray  # (7,): addresses of the kernels by type of action


class CompilableAction(Protocol):
    """An action that may have a kernel; the arrays (N,) named in `memory_attributes` belong to both."""

    memory_attributes: tuple[str, ...]
    table_row: int

    def kernel_options(self) -> tuple[int, ...]:
        """Return type and entity of the action, and integers that depend on its type.

        `PYTHON_ACTION` alone without a kernel.
        """
        ...


def build_action_table(actions: Sequence[CompilableAction | None], n_scenarios: int, kernels: IntArray) -> ActionTable:
    """Build the tables of actions; None stands for an action that ends at once.

    The arrays in the `memory_attributes` of the actions become views of the tables.
    """
    options = np.zeros((len(actions), N_OPTIONS), dtype=np.int64)
    memory = np.zeros((n_scenarios, len(actions), MEMORY_SIZE))
    for j, action in enumerate(actions):
        if action is not None:
            action.table_row, values = j, action.kernel_options()
            assert len(values) <= N_OPTIONS
            options[j, : len(values)] = values
            for k, name in enumerate(action.memory_attributes):
                memory[:, j, k] = getattr(action, name)
                setattr(action, name, memory[:, j, k])
    return ActionTable(options, memory, np.zeros((n_scenarios, len(actions)), dtype=np.bool_), kernels)
