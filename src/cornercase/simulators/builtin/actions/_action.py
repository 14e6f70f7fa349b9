"""Base classes of actions."""

from __future__ import annotations

import numpy as np

from cornercase._common.masks import any_true
from cornercase._common.typing import BoolArray
from cornercase.simulators.builtin.kernels._action_table import ACTION_APPLIED, ACTION_ENDED, PYTHON_ACTION, TRACK_ENDED
from cornercase.simulators.builtin.world._world import World


class Action:
    """What an event does to an entity, in some scenarios of a batch, until it has ended there.

    Without its own `step` it ends immediately. `domains`: ``"longitudinal"`` and ``"lateral"`` parts of the motion that
    it controls; when an action starts, it ends those of the same entity with a common domain. `memory_attributes`:
    names of arrays (N,) shared with kernels. `has_own_timing`: whether it ends at a time of its own. `table_row`: its
    row in the tables for kernels.
    """

    domains: tuple[str, ...] = ()
    memory_attributes: tuple[str, ...] = ()
    has_own_timing: bool = False
    table_row: int = -1

    def kernel_options(self) -> tuple[int, ...]:
        """Kind, entity and options for the kernels, which need not know every action."""
        return (PYTHON_ACTION,)

    def start(self, world: World, where: BoolArray) -> None:
        """Start in the scenarios of the mask."""
        raise NotImplementedError

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        """Act for one time step; return where it has ended, shape (N,)."""
        return where.copy()

    def look_up_positions(self, world: World, where: BoolArray) -> None:
        """Look up what kernels cannot before the coming frame, in the scenarios of a mask."""

    def release(self, world: World, where: BoolArray) -> None:
        """Release the entity when the action is ended early, in the scenarios of a mask."""


class CompiledAction(Action):
    """An action whose time steps are compiled: in the loop, or asked for here where the storyboard is evaluated."""

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        outcomes = world.compiled.apply_action(self.table_row, dt, where)
        needs_lookup = outcomes < ACTION_APPLIED
        if any_true(needs_lookup):
            self.look_up_present_positions(world, needs_lookup)
            again = world.compiled.apply_action(self.table_row, dt, needs_lookup)
            outcomes = np.where(needs_lookup, again, outcomes)
        leaves = outcomes == TRACK_ENDED
        if any_true(leaves):
            self.leave_track(world, leaves)
        return np.asarray(outcomes >= ACTION_ENDED)

    def look_up_present_positions(self, world: World, where: BoolArray) -> None:
        """Look up what kernels cannot after the actions before this one, in the scenarios of a mask."""
        self.look_up_positions(world, where)

    def leave_track(self, world: World, where: BoolArray) -> None:
        """Make the entity follow another track as the action ends, in the scenarios of a mask."""
        self.release(world, where)
