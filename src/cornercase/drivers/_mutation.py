"""Mutation: a change that makes a driver worse, for mutation testing."""

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
        Smallest and largest change: factors that multiply the parameter, or increases in the unit of the parameter.
    is_offset : bool
        True if `mild` and `severe` are increases, False if they are factors.

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
