"""Base classes of actions."""

from __future__ import annotations

import numpy as np

from cornercase._common.masks import any_true
from cornercase._common.typing import BoolArray
from cornercase.simulators.builtin.kernels._action_table import ACTION_APPLIED, ACTION_ENDED, PYTHON_ACTION, TRACK_ENDED
from cornercase.simulators.builtin.world._world import World


class Action:
    """An action on an entity, in some scenarios of a batch, from its start until it has ended there.

    `domains`: parts of the motion that it controls, ``"longitudinal"`` and ``"lateral"``; when it starts, it ends other
    actions of the entity with a common domain. `memory_attributes`: names of its arrays, shape (N,),
    in which kernels keep values from step to step. `has_own_timing`: whether it ends at a time that the file gives.
    `table_row`: index of its row in the tables that kernels read.

    An action that does not override `step` ends immediately.
    """

    domains: tuple[str, ...] = ()
    memory_attributes: tuple[str, ...] = ()
    has_own_timing: bool = False
    table_row: int = -1

    def kernel_options(self) -> tuple[int, ...]:
        """Return type, entity and options of the action for kernels; by default the type of one without a kernel."""
        return (PYTHON_ACTION,)

    def start(self, world: World, where: BoolArray) -> None:
        """Start the action in the scenarios of a mask."""
        raise NotImplementedError

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        """Act for one time step in the scenarios of a mask; return where the action has ended, shape (N,)."""
        return where.copy()

    def look_up_positions(self, world: World, where: BoolArray) -> None:
        """Look up positions that kernels cannot look up, before the coming frame, in the scenarios of a mask."""

    def release(self, world: World, where: BoolArray) -> None:
        """Release the entity in the scenarios of a mask, as the action is ended early."""


class CompiledAction(Action):
    """An action whose time steps are compiled."""

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        outcomes = world.compiled.apply_action(self.table_row, dt, where)
        needs_lookup = outcomes < ACTION_APPLIED
        if any_true(needs_lookup):
            self.look_up_positions_now(world, needs_lookup)
            again = world.compiled.apply_action(self.table_row, dt, needs_lookup)
            outcomes = np.where(needs_lookup, again, outcomes)
        leaves = outcomes == TRACK_ENDED
        if any_true(leaves):
            self.leave_track(world, leaves)
        return np.asarray(outcomes >= ACTION_ENDED)

    def look_up_positions_now(self, world: World, where: BoolArray) -> None:
        """Look up positions that kernels cannot, after earlier actions of the frame, in the scenarios of a mask."""
        self.look_up_positions(world, where)

    def leave_track(self, world: World, where: BoolArray) -> None:
        """Make the entity follow another track when the action ends, in the scenarios of a mask."""
        self.release(world, where)
