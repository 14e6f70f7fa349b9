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
"""Types of actions. A `PYTHON_ACTION` has no kernel; kernels only know if it runs."""

NEEDS_PYTHON, NEEDS_LOOKUP, ACTION_APPLIED, ACTION_ENDED, TRACK_ENDED = range(5)
"""Outcome of an action in a frame.

`NEEDS_PYTHON`: it has no kernel, or an entity must be located on its road after the earlier actions of the frame.
`NEEDS_LOOKUP`: an entity must first be located on its track or road. `ACTION_APPLIED`: it goes on. `ACTION_ENDED`: it
was applied for the last time. `TRACK_ENDED`: it was applied for the last time, and its entity needs another track."""

DYNAMICS_SHAPES: Final = ("linear", "cubic", "sinusoidal", "step")
"""Shapes of transitions; compiled code uses their indices."""
DYNAMICS_DIMENSIONS: Final = ("time", "rate", "distance")
"""Dimensions of transitions; compiled code uses their indices."""

N_OPTIONS: Final = 8
"""Number of integers that describe an action: its type, its entity, and integers that depend on the type."""
MEMORY_SIZE: Final = 24
"""Number of values that an action can store for each scenario."""
N_SAVED: Final = 8
"""Number of stored values that can be restored if an action is undone: the first of the `MEMORY_SIZE` values."""


class ActionTable(NamedTuple):
    """Arrays for kernels that describe J actions in N scenarios, in the order in which the actions are applied."""

    options: IntArray  # (J, 8): type, entity and integers that depend on the type
    memory: FloatArray  # (N, J, 24): values that an action stores for a scenario
    is_running: BoolArray  # (N, J)
    kernels: IntArray  # (7,): addresses of the kernels by type of action


class CompilableAction(Protocol):
    """An action that may have a kernel.

    `memory_attributes` names the arrays of the action, shape (N,), that Python and the kernel share. `table_row` is the
    row of the action in the `ActionTable`.
    """

    memory_attributes: tuple[str, ...]
    table_row: int

    def kernel_options(self) -> tuple[int, ...]:
        """Return the type of the action, its entity, and integers that depend on the type.

        An action without a kernel returns only `PYTHON_ACTION`.
        """
        ...


def build_action_table(actions: Sequence[CompilableAction | None], n_scenarios: int, kernels: IntArray) -> ActionTable:
    """Build the table of actions for kernels; None stands for an action that ends at once.

    The arrays named in `memory_attributes` of an action become views of the table. `kernels` are the addresses of the
    kernels by type of action.
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
