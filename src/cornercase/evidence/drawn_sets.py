"""Critical sets as one posterior of the correction has them, drawn on the places of a space."""

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

# Groups of places of nearly the same probability.
_GROUPS: Final = 1024


class DrawnSets:
    """Draws of a critical set: on few places together, and how probable it is on all.

    Parameters
    ----------
    correction : Correction
    seed : int
    weights : ndarray of float64, shape (n,)
        Share of the space that each place stands for.
    t : ndarray of float64, shape (n,)
        What is said of each place.
    certain : ndarray of float64, shape (n,)
        Infinite where a critical scenario was run, minus infinite where another was run, else 0.
    some : tuple of (ndarray of int64, shape (m,), ndarray of float64, shape (m,))
        Places on which sets are drawn together, and the share of the space that each of them stands for.
    normal : ndarray of float64, shape (m, `DRAWS`)
        Standard normal numbers for these places, with the correlation of their scores.
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
        """Where each draw is critical, of the places on which sets are drawn together, shape (m, draws)."""
        return np.asarray(self._normal <= self._limit(self.at))

    @cached_property
    def _surplus(self) -> FloatArray:
        """What a place counts more in a draw than its probability, shape (m, draws)."""
        return np.asarray(self.drawn - ndtr(self._limit(self.at)))

    @cached_property
    def _groups(self) -> tuple[IntArray, FloatArray]:
        """Places of nearly the same probability: group of each place, and that probability by group and draw."""
        order = np.argsort(self._t[self._certain == 0.0], kind="stable")
        groups = [one for one in np.array_split(np.flatnonzero(self._certain == 0.0)[order], _GROUPS) if len(one)]
        # The last two are for what was run: first what is not critical.
        group = np.where(self._certain > 0.0, len(groups) + 1, len(groups))
        for k, one in enumerate(groups):
            group[one] = k
        middle = np.array([self._t[one].mean() for one in groups])
        likely = ndtr(-(self._a + self._b * middle[:, None]))
        return group, np.concatenate([likely, np.zeros((1, DRAWS)), np.ones((1, DRAWS))])

    def _limit(self, at: IntArray) -> FloatArray:
        """Normal deviate up to which a place is critical in each draw; infinite where it was run."""
        limit = -(self._a + self._b * self._t[at, None])
        return np.where(self._certain[at, None] == 0.0, limit, self._certain[at, None])

    def shares(self, among: BoolArray | FloatArray) -> FloatArray:
        """Give the share of the space that is critical and among some places, in each draw.

        Parameters
        ----------
        among : ndarray of bool or float64, shape (n,)
            Numbers are summed over what is critical.

        Returns
        -------
        ndarray of float64, shape (draws,)
        """
        group, likely = self._groups
        expected = np.bincount(group, weights=self._weights * among, minlength=len(likely)) @ likely
        # The joint draws on few places give the spread, the probabilities on all places the mean.
        return np.asarray(expected + (self._each * among[self.at]) @ self._surplus)

    @cached_property
    def all(self) -> FloatArray:
        """Critical share of the space in each draw, shape (draws,)."""
        with one_thread():
            return np.clip(self.shares(np.ones(len(self._t), dtype=np.bool_)), 0.0, 1.0)

    def shared(self, other: DrawnSets, normal: FloatArray, order: IntArray) -> FloatArray:
        """Give the share of the space that is critical here and in other draws.

        Parameters
        ----------
        other : DrawnSets
            On the same places.
        normal : ndarray of float64, shape (m, `DRAWS`)
            As this one's, with the correlation of the scores of the other.
        order : ndarray of int64, shape (draws,)
            Which draw of the other goes with each draw here.

        Returns
        -------
        ndarray of float64, shape (draws,)
        """
        limit = other._limit(self.at)[:, order]
        # As for the share of the space: few places give the spread, all places the mean.
        (mine, likely), (others, likely_too) = self._groups, other._groups
        places = coo_array((self._weights, (mine, others)), shape=(len(likely), len(likely_too)))
        both = (likely * np.asarray(places.tocsr() @ likely_too[:, order])).sum(axis=0)
        both += self._each @ ((self.drawn & (normal <= limit)) - (self.drawn - self._surplus) * ndtr(limit))
        return np.asarray(both)
