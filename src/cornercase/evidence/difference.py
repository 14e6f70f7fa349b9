"""How two critical sets of one space differ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.evidence.critical_set import CriticalSet
from cornercase.evidence.estimate import Estimate


@dataclass(frozen=True)
class SetDifference:
    """How the critical set of a space became another one.

    Attributes
    ----------
    old, new : Estimate
        Critical shares of the space.
    change : Estimate
        The new one less the old one.
    gained, lost : Estimate
        Shares of the space that are critical in the new one only, and in the old one only.
    middles : tuple of (Estimate, Estimate, Estimate) or None, length d
        Of each parameter its mean over the old set, over the new one, and how far that moved, in the parameter's unit;
        None of one with choices.
    """

    old: Estimate
    new: Estimate
    change: Estimate
    gained: Estimate
    lost: Estimate
    middles: tuple[tuple[Estimate, Estimate, Estimate] | None, ...]

    @classmethod
    def between(cls, old: CriticalSet, new: CriticalSet) -> SetDifference:
        """Compare two critical sets, of each of which scenarios of its own are known.

        Parameters
        ----------
        old, new : CriticalSet
            Of the same space and with the same seed; neither may have a `CriticalSet.missed_doubt`.

        Returns
        -------
        SetDifference

        Notes
        -----
        Both sets are drawn independently of each other. So where neither is known well, they differ in each draw,
        also where they are the same: how much lies in one of them only is bounded from above by the draws, and from
        below by nothing but the change of the share, without which they may be the same.
        """
        here, there, both = old.against(new)
        change = _differences(here, there)
        middles, moved = [], [one.middle() for one in (old, new)]
        for before, after in zip(moved[0].T, moved[1].T, strict=True):
            before, after = before[np.isfinite(before)], after[np.isfinite(after)]
            known = len(before) and len(after)
            each = (Estimate.of_draws(before), Estimate.of_draws(after), _differences(before, after)) if known else None
            middles.append(each)
        return cls(
            old.share,
            new.share,
            change,
            _at_least(there - both, change.low),
            _at_least(here - both, -change.high),
            tuple(middles),
        )


def _differences(before: FloatArray, after: FloatArray) -> Estimate:
    """Each draw of one less each of the other."""
    return Estimate.of_draws((after[:, None] - before).ravel())


def _at_least(draws: FloatArray, low: float) -> Estimate:
    found = Estimate.of_draws(draws)
    low = max(low, 0.0)
    return Estimate(max(found.value, low), low, max(found.high, low))
