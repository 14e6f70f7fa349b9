"""Verdicts on scenarios."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Literal

VerdictState = Literal["passed", "failed", "inconclusive"]
"""State of a verdict."""

# From best to worst.
_STATES_BEST_FIRST: Final[tuple[VerdictState, ...]] = ("passed", "inconclusive", "failed")


@dataclass(frozen=True)
class Verdict:
    """Verdict on one scenario and one requirement.

    Attributes
    ----------
    state : {"passed", "failed", "inconclusive"}
        Inconclusive if the situation in the requirement never occurred, if it was not observed long enough, or if the
        simulator failed.
    requirement : str
        Text of the requirement.
    reason : str
        Reason in one sentence without a period.
    time : float or None
        Time in s that decides the verdict; None if there is none.
    value : float or None
        Value at that time, in the unit of the requirement; None if there is none.

    Examples
    --------
    >>> import cornercase as cc
    >>> from cornercase.suite import Requirement, judge
    >>> recording = cc.simulate("examples/r157/deceleration.xosc")
    >>> verdict = judge(Requirement.parse("thw > 3 s"), recording, "Ego", "Other")
    >>> verdict.state, verdict.reason
    ('failed', 'thw falls to 1.962 s at 0.9 s, below 3 s, first at 0 s')
    """

    state: VerdictState
    requirement: str
    reason: str
    time: float | None = None
    value: float | None = None


def worst_state(verdicts: Iterable[Verdict]) -> VerdictState:
    """Return the worst state of several verdicts; inconclusive if there are none."""
    return max((verdict.state for verdict in verdicts), key=_STATES_BEST_FIRST.index, default="inconclusive")
