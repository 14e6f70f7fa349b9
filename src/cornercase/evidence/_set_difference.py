"""Differences between two critical sets of the same parameter space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.evidence._critical_set_estimate import CriticalSet
from cornercase.evidence._interval_estimate import Estimate


@dataclass(frozen=True)
class CriticalSetDifference:
    """Difference between two critical sets of the same parameter space.

    Attributes
    ----------
    old, new : Estimate
        Critical fractions of the space.
    change : Estimate
        New critical fraction minus the old one.
    gained, lost : Estimate
        Fractions of the space that are critical in the new set only, and in the old set only.
    middles : tuple of (Estimate, Estimate, Estimate) or None, length d
        For each parameter: mean over the old set, mean over the new set, and the difference of both, in the
        parameter's unit. None for a parameter with choices.
    p : float
        Two-sided tail probability of no change. This is twice the share of the draws in which the critical fraction
        does not grow, or does not shrink, whichever share is smaller. At least one over the number of draws.

    Examples
    --------
    >>> import cornercase as cc
    >>> sets = cc.compare("old.db", "new.db").space.sets  # doctest: +SKIP
    >>> f"{sets.change.value:+.0%} of the space, {sets.change.low:+.0%} to {sets.change.high:+.0%}"  # doctest: +SKIP
    '+18% of the space, +15% to +21%'
    """

    old: Estimate
    new: Estimate
    change: Estimate
    gained: Estimate
    lost: Estimate
    middles: tuple[tuple[Estimate, Estimate, Estimate] | None, ...]
    p: float

    @classmethod
    def from_critical_sets(cls, old: CriticalSet, new: CriticalSet) -> CriticalSetDifference:
        """Compare two critical sets that were estimated from different scenarios.

        Parameters
        ----------
        old, new : CriticalSet
            Estimates for the same space with the same seed; `CriticalSet.missed_interval_unavailable` of both is None.

        Returns
        -------
        CriticalSetDifference

        Notes
        -----
        The rate of surprises (critical scenarios to which no prediction points) depends more on the logical scenario
        than on the version of the tested driving function. So the change comes from pairs of draws whose calibrations
        have nearly the same rank. Apart from the pairing, both sets are drawn independently. If neither set is known
        well, the draws differ even if the sets are equal. So the draws bound `gained` and `lost` only from above, and
        the change of the critical fraction bounds them from below.
        """
        old_draws, new_draws, both_draws = old.draw_overlap_with(new)
        changes = old.draw_changes_to(new)
        change = Estimate.from_draws(changes)
        middles: list[tuple[Estimate, Estimate, Estimate] | None] = []
        for before, after in zip(old.draw_parameter_means().T, new.draw_parameter_means().T, strict=True):
            before, after = before[np.isfinite(before)], after[np.isfinite(after)]
            if len(before) and len(after):
                middles.append(
                    (
                        Estimate.from_draws(before),
                        Estimate.from_draws(after),
                        Estimate.from_draws(_differences_of_draws(before, after)),
                    )
                )
            else:
                middles.append(None)
        return cls(
            old.critical_fraction,
            new.critical_fraction,
            change,
            _estimate_with_lower_bound(new_draws - both_draws, change.low),
            _estimate_with_lower_bound(old_draws - both_draws, -change.high),
            tuple(middles),
            _tail_probability(changes, len(old_draws)),
        )


def _differences_of_draws(before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the differences `after - before` of all pairs of independent draws."""
    return (after[:, None] - before).ravel()


def _tail_probability(changes: FloatArray, n_draws: int) -> float:
    """Return the two-sided tail probability of no change.

    `changes` holds the differences of pairs of draws; each of the two sets has `n_draws` draws.
    """
    tail = min(float((changes <= 0.0).mean()), float((changes >= 0.0).mean()))
    return min(2.0 * max(tail, 0.5 / n_draws), 1.0)


def _estimate_with_lower_bound(draws: FloatArray, low: float) -> Estimate:
    """Estimate a quantity that `draws` bound from above and `low` bounds from below."""
    estimate = Estimate.from_draws(draws)
    low = max(low, 0.0)
    return Estimate(max(estimate.value, low), low, max(estimate.high, low))
