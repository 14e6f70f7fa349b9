"""What can be wrong in a driver, for mutation testing."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Mutation:
    """A change that makes a driver worse in one parameter.

    Attributes
    ----------
    description : str
        What is worse, in words, for tables: ``"reacts later"``.
    parameter : str
        Option of the driver's constructor.
    mild, severe : float
        Bounds of the factor that the parameter is multiplied by; or of the increase, in its unit.
    is_offset : bool
        Whether the parameter is increased instead.

    Examples
    --------
    >>> import cornercase as cc
    >>> from cornercase.drivers import Mutation
    >>> class Aeb(cc.SystemUnderTest):
    ...     mutations = (
    ...         Mutation("brakes later", "time_to_brake", 0.8, 0.3),
    ...         Mutation("reacts later", "reaction", 0.1, 1.0, is_offset=True),
    ...     )
    ...
    ...     def __init__(self, time_to_brake=1.5, reaction=0.0):
    ...         self.time_to_brake, self.reaction = time_to_brake, reaction
    ...
    ...     def step(self, view, dt):
    ...         leader = view.leader
    ...         is_late = leader is not None and leader.gap < self.time_to_brake * leader.closing
    ...         return -8.0 if is_late and view.time > self.reaction else 0.0
    """

    description: str
    parameter: str
    mild: float
    severe: float
    is_offset: bool = False
