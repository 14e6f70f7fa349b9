"""What is said of one scenario and one requirement."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Literal

State = Literal["passed", "failed", "inconclusive"]
"""What a requirement comes to."""

# From what is best to what is worst.
_ORDER: Final[tuple[State, ...]] = ("passed", "inconclusive", "failed")


@dataclass(frozen=True)
class Verdict:
    """Whether one scenario met one requirement.

    Attributes
    ----------
    state : {"passed", "failed", "inconclusive"}
        Inconclusive where the situation never arose, where it was not observed long enough, or where the simulator
        failed.
    requirement : str
        In the words of a requirement of a suite.
    reason : str
        Why, in one sentence without a full stop.
    time : float or None
        Instant that decides, in s; None where there is none.
    value : float or None
        What was found at that instant, in the unit of the requirement; None where there is none.
    """

    state: State
    requirement: str
    reason: str
    time: float | None = None
    value: float | None = None


def worst_state(verdicts: Iterable[Verdict]) -> State:
    """Say how a scenario did of which there are several verdicts.

    Parameters
    ----------
    verdicts : iterable of Verdict

    Returns
    -------
    {"passed", "failed", "inconclusive"}
        Failed where one failed, else inconclusive where one is or there is none, else passed.

    Examples
    --------
    >>> from cornercase.suite import Verdict, worst_state
    >>> far = Verdict("passed", "ttc > 1.5", "ttc is at least 2.1 s")
    >>> worst_state([far, Verdict("failed", "no collision", "Ego and Van collide at 3.2 s", 3.2)])
    'failed'
    """
    return max((one.state for one in verdicts), key=_ORDER.index, default="inconclusive")
