"""An estimated quantity with its interval."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray

_INTERVAL: Final = (0.05, 0.95)


@dataclass(frozen=True)
class Estimate:
    """An estimated quantity with its 90 % interval.

    Attributes
    ----------
    value, low, high : float
        Mean, 5 % and 95 % quantile of draws. If the mean lies outside the interval, the interval is extended to the
        mean, for example for a quantity that is nearly always 0. For a fraction from audits alone, their proportion
        and its Clopper-Pearson interval.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.evidence import Estimate
    >>> estimate = Estimate.from_draws(np.linspace(0.1, 0.2, 101))
    >>> f"{estimate.value:.3f} ({estimate.low:.3f} to {estimate.high:.3f})"
    '0.150 (0.105 to 0.195)'
    """

    value: float
    low: float
    high: float

    @classmethod
    def from_draws(cls, draws: FloatArray) -> Estimate:
        """Estimate a quantity by the mean and the quantiles of draws.

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
