"""Differences between two critical sets of one space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.evidence._critical_set_estimate import CriticalSet
from cornercase.evidence._interval_estimate import Estimate


@dataclass(frozen=True)
class SetDifference:
    """Difference between two critical sets of one space.

    Attributes
    ----------
    old, new : Estimate
        Critical fractions of the space.
    change : Estimate
        New critical fraction less the old one.
    gained, lost : Estimate
        Fractions of the space that are critical in the new set only, and in the old set only.
    middles : tuple of (Estimate, Estimate, Estimate) or None, length d
        For each parameter its mean over the old set, over the new set, and the difference, in the parameter's unit.
        None for a parameter with choices.
    p : float
        Two-sided tail probability of no change: twice the smaller of the fractions of the draws in which the critical
        fraction grows, or shrinks. At least 1 / draws.

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
    def from_critical_sets(cls, old: CriticalSet, new: CriticalSet) -> SetDifference:
        """Compare two critical sets that were estimated from different scenarios.

        Parameters
        ----------
        old, new : CriticalSet
            Of the same space and with the same seed; neither may have a `CriticalSet.missed_interval_unavailable`.

        Returns
        -------
        SetDifference

        Notes
        -----
        How frequent surprises are depends on the scenario more than on the version, so the change comes from pairs of
        draws whose calibrations have nearly the same rank. Apart from that, both sets are drawn independently. If
        neither is known well, the draws differ even where the sets are equal, so the draws bound `gained` and `lost`
        from above only; the lower bound is given by the change of the critical fraction.
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
    """Differences `after - before` of all pairs of independent draws."""
    return (after[:, None] - before).ravel()


def _tail_probability(changes: FloatArray, n_draws: int) -> float:
    """Two-sided tail probability of no change; the pairs in `changes` come from `n_draws` draws of each set."""
    tail = min(float((changes <= 0.0).mean()), float((changes >= 0.0).mean()))
    return min(2.0 * max(tail, 0.5 / n_draws), 1.0)


def _estimate_with_lower_bound(draws: FloatArray, low: float) -> Estimate:
    """Estimate of a quantity that `draws` bound from above and `low` bounds from below."""
    estimate = Estimate.from_draws(draws)
    low = max(low, 0.0)
    return Estimate(max(estimate.value, low), low, max(estimate.high, low))
