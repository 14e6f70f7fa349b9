"""A quantity, and how well it is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray

_INTERVAL: Final = (0.05, 0.95)


@dataclass(frozen=True)
class Estimate:
    """A quantity with its 90 % credible interval.

    Attributes
    ----------
    value, low, high : float
        Mean, 5 % and 95 % quantile; the interval reaches to the mean where that lies beyond, as it does for a
        quantity that is nearly always 0.
    """

    value: float
    low: float
    high: float

    @classmethod
    def of_draws(cls, draws: FloatArray) -> Estimate:
        """Make it of draws of the quantity.

        Parameters
        ----------
        draws : ndarray of float64, shape (n,)

        Returns
        -------
        Estimate
        """
        mean = float(draws.mean())
        low, high = np.quantile(draws, _INTERVAL).tolist()
        return cls(mean, min(low, mean), max(high, mean))
