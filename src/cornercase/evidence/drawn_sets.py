"""Samples of critical sets from the posterior, on the sampled points of a space."""

from __future__ import annotations

from functools import cached_property
from typing import Final

import numpy as np
from scipy.sparse import coo_array
from scipy.special import ndtr

from cornercase._common.threads import one_thread
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.evidence.correction import Correction

DRAWS: Final = 400
"""Number of critical sets that are drawn."""

# Bins of points with nearly the same probability.
_GROUPS: Final = 1024


class DrawnSets:
    """Samples of a critical set: drawn jointly on some points, with marginal probabilities on all points.

    `weights` (n,) are the fractions of the space that points represent, `z` (n,) the predictions, and `known_outcome`
    (n,) is inf where a critical scenario was run, -inf where another one was run, else 0. `joint_points` holds the
    indices (m,) of the points with joint draws and the fraction of the space that each represents,
    `standardized_errors` (m, `N_DRAWS`) standard normal numbers for them, with the correlation of their scores.
    """

    def __init__(
        self,
        correction: Correction,
        seed: int,
        weights: FloatArray,
        t: FloatArray,
        certain: FloatArray,
        some: tuple[IntArray, FloatArray],
        normal: FloatArray,
    ) -> None:
        self._weights, self._t, self._certain, self._normal = weights, t, certain, normal
        self._a, self._b = correction.draws(DRAWS, np.random.default_rng([seed, 3]))
        self.at, self._each = some

    @cached_property
    def drawn(self) -> BoolArray:
        """Whether each of the joint points is critical in each draw, (m, draws)."""
        return np.asarray(self._normal <= self._limit(self.at))

    @cached_property
    def _surplus(self) -> FloatArray:
        """Outcome less marginal probability of each joint point in each draw, (m, draws)."""
        return np.asarray(self.drawn - ndtr(self._limit(self.at)))

    @cached_property
    def _groups(self) -> tuple[IntArray, FloatArray]:
        """Bin of each point by `z`, and the probability of being critical by bin and draw."""
        order = np.argsort(self._t[self._certain == 0.0], kind="stable")
        bins = [part for part in np.array_split(np.flatnonzero(self._certain == 0.0)[order], _GROUPS) if len(part)]
        # The last two bins hold the scenarios that were run: those that are not critical, then the critical ones.
        bin_of = np.where(self._certain > 0.0, len(bins) + 1, len(bins))
        for k, members in enumerate(bins):
            bin_of[members] = k
        middle = np.array([self._t[members].mean() for members in bins])
        probability = ndtr(-(self._a + self._b * middle[:, None]))
        return bin_of, np.concatenate([probability, np.zeros((1, DRAWS)), np.ones((1, DRAWS))])

    def _limit(self, at: IntArray) -> FloatArray:
        """Normal deviate up to which a point is critical in each draw; infinite if it was run."""
        limit = -(self._a + self._b * self._t[at, None])
        return np.where(self._certain[at, None] == 0.0, limit, self._certain[at, None])

    def shares(self, among: BoolArray | FloatArray) -> FloatArray:
        """Sum of `weights` (a mask or numbers) over the critical set, as a fraction of the space, (draws,)."""
        bin_of, probability = self._groups
        expected = np.bincount(bin_of, weights=self._weights * among, minlength=len(probability)) @ probability
        # The joint draws on some points give the spread, the probabilities on all points the mean.
        return np.asarray(expected + (self._each * among[self.at]) @ self._surplus)

    @cached_property
    def all(self) -> FloatArray:
        """Critical fraction of the space in each draw, (draws,)."""
        with one_thread():
            return np.clip(self.shares(np.ones(len(self._t), dtype=np.bool_)), 0.0, 1.0)

    def shared(self, other: DrawnSets, normal: FloatArray, order: IntArray) -> FloatArray:
        """Fraction of the space that is critical here and in a draw of `other`, (draws,).

        `standardized_errors` (m, `N_DRAWS`) is as for this set, with the correlation of the other scores; draw
        `order[i]` of `other` is paired with draw i.
        """
        limit = other._limit(self.at)[:, order]
        # As in `fractions`: some points give the spread, all points the mean.
        (bins, probability), (other_bins, other_probability) = self._groups, other._groups
        weights = coo_array((self._weights, (bins, other_bins)), shape=(len(probability), len(other_probability)))
        both = (probability * np.asarray(weights.tocsr() @ other_probability[:, order])).sum(axis=0)
        both += self._each @ ((self.drawn & (normal <= limit)) - (self.drawn - self._surplus) * ndtr(limit))
        return np.asarray(both)
