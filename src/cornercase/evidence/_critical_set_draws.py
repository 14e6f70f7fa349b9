"""Critical sets drawn from the posterior, on a sample of points that represents a parameter space."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Final

import numpy as np
from scipy.sparse import coo_array
from scipy.special import ndtr, ndtri

from cornercase._common.numba.blas import single_threaded_blas
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.evidence._probit_calibration import ProbitCalibration

N_DRAWS: Final = 400
"""Number of critical sets that are drawn."""

# Bins of points with nearly the same probability.
_N_BINS: Final = 1024


class CriticalSetDraws:
    """Draws of a critical set from the posterior, on n points that represent a space.

    A draw decides for m of the points jointly which of them are critical. For all n points, it gives the probability
    that each is critical, without the dependence between points. `weights` (n,) are the fractions of the space that the
    points represent. `z` (n,) are the predictions, as distances to the threshold in standard deviations.
    `known_outcome` (n,) is inf if a scenario was run and is critical, -inf if it was run and is not critical, else 0.
    `joint_points` holds the indices (m,) of the points with joint draws, and the fraction of the space that each
    represents. `draw_errors` returns standard normal numbers (m, `N_DRAWS`) for these points, with the correlation of
    their scores.
    """

    def __init__(
        self,
        calibration: ProbitCalibration,
        seed: int,
        weights: FloatArray,
        z: FloatArray,
        known_outcome: FloatArray,
        joint_points: tuple[IntArray, FloatArray],
        draw_errors: Callable[[], FloatArray],
    ) -> None:
        self._weights, self._z, self._known_outcome, self._draw_errors = weights, z, known_outcome, draw_errors
        self._a, self._b, self._rate = calibration.draw_parameters(N_DRAWS, np.random.default_rng([seed, 3]))
        self.joint_indices, self._joint_weights = joint_points

    @cached_property
    def order_by_calibration(self) -> IntArray:
        """Indices of the draws, sorted by the rate of surprises, then by the offset and slope of the calibration."""
        return np.asarray(np.lexsort((self._b, self._a, self._rate)), dtype=np.int64)

    @cached_property
    def joint_draws(self) -> BoolArray:
        """True where one of the m points with joint draws is critical in a draw, (m, draws)."""
        return np.asarray(self._draw_errors() <= self._critical_deviate_limits(self.joint_indices))

    @cached_property
    def _residuals(self) -> FloatArray:
        """Outcome (0 or 1) minus marginal probability of each point with joint draws, in each draw, (m, draws)."""
        return np.asarray(self.joint_draws - ndtr(self._critical_deviate_limits(self.joint_indices)))

    @cached_property
    def _probability_bins(self) -> tuple[IntArray, FloatArray]:
        """Bin of each point by its prediction `z`, (n,), and the probability of being critical, (bins, draws)."""
        undecided = np.flatnonzero(self._known_outcome == 0.0)
        undecided = undecided[np.argsort(self._z[undecided], kind="stable")]
        n_bins = min(_N_BINS, len(undecided))
        starts = np.arange(n_bins) * len(undecided) // max(n_bins, 1)
        sizes = np.diff(starts, append=len(undecided))
        # The last two bins hold the scenarios that were run: those that are not critical, then the critical ones.
        bin_of = np.where(self._known_outcome > 0.0, n_bins + 1, n_bins)
        bin_of[undecided] = np.repeat(np.arange(n_bins), sizes)
        middle = np.add.reduceat(self._z[undecided], starts) / sizes if n_bins else np.zeros(0)
        probability = self._rate + (1.0 - self._rate) * ndtr(-(self._a + self._b * middle[:, None]))
        return bin_of, np.concatenate([probability, np.zeros((1, N_DRAWS)), np.ones((1, N_DRAWS))])

    def _critical_deviate_limits(self, indices: IntArray) -> FloatArray:
        """Return limits (k, draws): a point is critical in a draw if its standard normal error is at most the limit.

        The limit is inf if the scenario was run and is critical, and -inf if it was run and is not critical.
        """
        limit = -(self._a + self._b * self._z[indices, None])
        surprising = self._rate > 0.0
        limit[:, surprising] = ndtri(
            self._rate[surprising] + (1.0 - self._rate[surprising]) * ndtr(limit[:, surprising])
        )
        return np.where(self._known_outcome[indices, None] == 0.0, limit, self._known_outcome[indices, None])

    def critical_fraction_within(self, weights: BoolArray | FloatArray) -> FloatArray:
        """Return the fraction of the space that is critical and selected by `weights`, for each draw, (draws,).

        `weights` (n,) are a mask of the points, or factors by which each point counts.
        """
        bin_of, probability = self._probability_bins
        expected = np.bincount(bin_of, weights=self._weights * weights, minlength=len(probability)) @ probability
        # The joint draws on some points give the spread, the probabilities on all points the mean.
        return np.asarray(expected + (self._joint_weights * weights[self.joint_indices]) @ self._residuals)

    @cached_property
    def critical_fraction(self) -> FloatArray:
        """Critical fraction of the space in each draw, (draws,)."""
        with single_threaded_blas():
            return np.clip(self.critical_fraction_within(np.ones(len(self._z), dtype=np.bool_)), 0.0, 1.0)

    def overlap_fraction(self, other: CriticalSetDraws, standardized_errors: FloatArray, order: IntArray) -> FloatArray:
        """Return the fraction of the space that is critical in a draw of this set and in a draw of `other`, (draws,).

        `standardized_errors` (m, `N_DRAWS`) are errors of the predictions of `other`, drawn at the points at which this
        set has joint draws. Draw i of this set is paired with draw `order[i]` of `other`.
        """
        limit = other._critical_deviate_limits(self.joint_indices)[:, order]
        # As in `critical_fraction_within`: some points give the spread, all points the mean.
        (bins, probability), (other_bins, other_probability) = self._probability_bins, other._probability_bins
        weights = coo_array((self._weights, (bins, other_bins)), shape=(len(probability), len(other_probability)))
        both = (probability * np.asarray(weights.tocsr() @ other_probability[:, order])).sum(axis=0)
        both += self._joint_weights @ (
            (self.joint_draws & (standardized_errors <= limit)) - (self.joint_draws - self._residuals) * ndtr(limit)
        )
        return np.asarray(both)
