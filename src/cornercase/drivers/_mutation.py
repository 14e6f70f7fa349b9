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
    """

    description: str
    parameter: str
    mild: float
    severe: float
    is_offset: bool = False
