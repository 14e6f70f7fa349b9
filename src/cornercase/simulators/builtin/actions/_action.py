"""Base class of actions."""

from __future__ import annotations

from cornercase._common.typing import BoolArray
from cornercase.simulators.builtin.kernels._action_table import PYTHON_ACTION
from cornercase.simulators.builtin.world._world import World


class Action:
    """What an event does to an entity, in some scenarios of a batch, until it has ended there.

    Without its own `step` it ends immediately. `domains`: ``"longitudinal"`` and ``"lateral"`` parts of the motion that
    it controls; when an action starts, it ends those of the same entity with a common domain. `memory_attributes`:
    names of arrays (N,) shared with kernels. `has_own_timing`: whether it ends at a time of its own.
    """

    domains: tuple[str, ...] = ()
    memory_attributes: tuple[str, ...] = ()
    has_own_timing: bool = False

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
