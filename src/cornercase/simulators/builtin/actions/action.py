"""What all actions have in common."""

from __future__ import annotations

from cornercase._common.typing import BoolArray
from cornercase.simulators.builtin.frames.table import UNKNOWN
from cornercase.simulators.builtin.world.state import World


class Action:
    """What an event does to an entity: runs in some of the scenarios of a batch until it has ended there.

    Without a `step` of its own it ends at once.

    Attributes
    ----------
    domains : tuple of str
        What of the entity's motion it decides: ``"longitudinal"``, ``"lateral"``. When an action of an event starts,
        all actions of the same entity end that decide some of the same.
    remembered : tuple of str
        Names of arrays (N,) that it shares with compiled code.
    keeps_time : bool
        Whether it ends at a time of its own.
    """

    domains: tuple[str, ...] = ()
    remembered: tuple[str, ...] = ()
    keeps_time: bool = False

    def options(self) -> tuple[int, ...]:
        """What compiled code is told of it: its kind, its entity, and so on; it has to know no action."""
        return (UNKNOWN,)

    def start(self, world: World, where: BoolArray) -> None:
        """Begin in the scenarios of the mask."""
        raise NotImplementedError

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        """Act for one time step; return where it has ended, shape (N,)."""
        return where.copy()

    def look_up(self, world: World, where: BoolArray) -> None:
        """Look up what compiled code cannot before it acts in the coming frame, in the scenarios of a mask."""

    def leave(self, world: World, where: BoolArray) -> None:
        """Leave the entity to another action, or to nobody, in the scenarios in which it is ended early."""
