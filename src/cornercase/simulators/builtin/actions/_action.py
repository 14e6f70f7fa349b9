"""Base classes of the actions that a storyboard runs on entities."""

from __future__ import annotations

import numpy as np

from cornercase._common.masks import any_true
from cornercase._common.typing import BoolArray
from cornercase.simulators.builtin.kernels._action_table import ACTION_APPLIED, ACTION_ENDED, PYTHON_ACTION, TRACK_ENDED
from cornercase.simulators.builtin.world._world import World


class Action:
    """Base class of actions of a storyboard; an action acts on one entity, in some of the N scenarios of a batch.

    `domains`: parts of the motion that the action controls, ``"longitudinal"`` and ``"lateral"``. When the action
    starts, other actions of the entity with a common domain end. `memory_attributes`: names of the action's arrays,
    shape (N,), in which kernels (compiled functions) keep values from step to step. `has_own_timing`: whether the
    action ends at a time that the file gives. `table_row`: index of the action in the tables that kernels read.

    An action that does not override `step` ends immediately.
    """

    domains: tuple[str, ...] = ()
    memory_attributes: tuple[str, ...] = ()
    has_own_timing: bool = False
    table_row: int = -1

    def kernel_options(self) -> tuple[int, ...]:
        """Return type, entity and options of the action for compiled code.

        By default this is only the type `PYTHON_ACTION`, for actions that run in Python.
        """
        return (PYTHON_ACTION,)

    def start(self, world: World, where: BoolArray) -> None:
        """Start the action in the scenarios of a mask."""
        raise NotImplementedError

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        """Act for one time step in the scenarios of a mask; return the scenarios in which the action has ended."""
        return where.copy()

    def look_up_positions(self, world: World, where: BoolArray) -> None:
        """Look up road positions that compiled code cannot look up, for the next frame, in the scenarios of a mask."""

    def release(self, world: World, where: BoolArray) -> None:
        """Let the entity move on without the action in the scenarios of a mask, because the action is ended early."""


class CompiledAction(Action):
    """An action whose time steps run in compiled code."""

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
        """Look up road positions after earlier actions of the same frame, in the scenarios of a mask."""
        self.look_up_positions(world, where)

    def leave_track(self, world: World, where: BoolArray) -> None:
        """Make the entity follow another track (path) when the action ends, in the scenarios of a mask."""
        self.release(world, where)
