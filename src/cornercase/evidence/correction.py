"""From what a surrogate says of scenarios to the probability that they are critical, by its own record."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.special import log_ndtr, ndtr

from cornercase._common.typing import BoolArray, FloatArray

# Places of the grid on which the posterior is known, and how far it reaches in deviations of the prior.
_STEPS: Final = 49
_REACH: Final = 4.0
# Number of predictions from which on each counts less, as they lie closer together, and neighbours are wrong together:
# then their weight grows with the root of their number.
_ALONE: Final = 160
# Scenarios of one kind up to which each is looked at by itself.
_MANY: Final = 128


class Correction:
    """Posterior of a and b in the probability ``p = Φ(-(a + b t))`` that a scenario is critical.

    What t is does not matter, as long as the lower it is, the likelier a scenario is critical: the mean of a Gaussian
    process over its standard deviation, or what another classifier says as a normal deviate. Before anything is known,
    a and the logarithm of b are normal, of deviation 1 around what leaves t as it is.

    Parameters
    ----------
    t : ndarray of float64, shape (n,)
        What was said of scenarios without knowing their scores.
    critical : ndarray of bool, shape (n,)
        What they were.
    worth : float, default 1.0
        What one prediction counts: less than 1 if those of neighbours are correlated.

    Notes
    -----
    More than 160 count as much as the root of 160
    times their number, so that the posterior then narrows with the fourth root.

    Correction of probabilities: J. Platt, "Probabilistic outputs for support vector machines" (1999), here with the
    normal distribution function, and all of the posterior on a grid.
    """

    def __init__(self, t: FloatArray, critical: BoolArray, worth: float = 1.0) -> None:
        a, log_b = (each.ravel() for each in np.meshgrid(*[np.linspace(-_REACH, _REACH, _STEPS)] * 2, indexing="ij"))
        likely = -0.5 * (a**2 + log_b**2)
        slope, weight = np.exp(log_b), worth * min(1.0, (_ALONE / max(len(t), 1)) ** 0.5)
        for side, said in ((1.0, t[critical]), (-1.0, t[~critical])):
            # Of many the neighbours count together.
            for some in np.array_split(np.sort(said), min(_MANY, max(len(said), 1))):
                if len(some):
                    likely += weight * len(some) * log_ndtr(-side * (a + slope * some.mean()))
        share = np.exp(likely - likely.max())
        self._a, self._b, self._likely = a, slope, share / share.sum()

    def draws(self, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Draw a and b from their posterior.

        Parameters
        ----------
        count : int
        rng : Generator

        Returns
        -------
        a, b : ndarray of float64, shape (count,)
        """
        # One in each of so many equal shares of the posterior, in a random order.
        at = (rng.permutation(count) + rng.random(count)) / count
        found = np.minimum(np.searchsorted(np.cumsum(self._likely), at), len(self._a) - 1)
        return self._a[found], self._b[found]

    def probability(self, t: FloatArray) -> FloatArray:
        """Give the probability of scenarios to be critical at the mean of a and b.

        Parameters
        ----------
        t : ndarray of float64, shape (n,)

        Returns
        -------
        ndarray of float64, shape (n,)
        """
        return np.asarray(ndtr(-(self._likely @ self._a + (self._likely @ self._b) * t)))
