"""Which parameters matter for a score, and which do not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.stats import sobol_indices, uniform

from cornercase._common.threads import one_thread
from cornercase._common.typing import FloatArray
from cornercase.evidence.gaussian_process import GaussianProcess, encoded, enough
from cornercase.scenario import ParameterSpace

_SAMPLES: Final = 4096
LITTLE: Final = 0.05
"""Total sensitivity below which a parameter counts as of little influence."""


@dataclass(frozen=True)
class Sensitivity:
    """How much of a score's variance comes from each parameter.

    Attributes
    ----------
    names : tuple of str
        Of the parameters that have more than one value.
    first, total : tuple of float
        Share of the variance that a parameter explains alone, and with all others together.
    predicted : float
        Share of the variance of the scores that the process predicts when each scenario is left out in turn: how far
        the figures can be relied on.
    """

    names: tuple[str, ...]
    first: tuple[float, ...]
    total: tuple[float, ...]
    predicted: float

    @property
    def little(self) -> tuple[str, ...]:
        """Parameters of little influence."""
        return tuple(name for name, total in zip(self.names, self.total, strict=True) if total < LITTLE)


def estimate_sensitivity(space: ParameterSpace, points: FloatArray, scores: FloatArray, seed: int = 0) -> Sensitivity:
    """Sobol' indices of the mean of a Gaussian process of the scores.

    Parameters vary independently over their ranges, without regard to constraints.

    Parameters
    ----------
    space : ParameterSpace
    points : ndarray of float64, shape (n, d)
        In the unit cube.
    scores : ndarray of float64, shape (n,)
        Oriented or not; NaN for a scenario that failed.
    seed : int, default 0

    Returns
    -------
    Sensitivity

    Raises
    ------
    ValueError
        There are fewer than 10 scores, or all are the same.

    Notes
    -----
    Source: I. M. Sobol', "Global sensitivity indices for nonlinear mathematical models and their Monte Carlo
    estimates", Mathematics and Computers in Simulation 55 (2001); A. Saltelli et al., "Variance based sensitivity
    analysis of model output", Computer Physics Communications 181 (2010), with the estimators of scipy.
    """
    points, scores = enough(points, scores)
    values = (scores - scores.mean()) / scores.std()
    process = GaussianProcess(1.0).fit(encoded(space, points), values)
    left = values - process.leave_one_out()[0]

    def predict(places: FloatArray) -> FloatArray:
        mean, _ = process.predict(encoded(space, space.snap(places.T)))
        return mean[None, :]

    each: Any = [uniform()] * space.dimension
    if space.dimension == 1:
        return Sensitivity(space.names, (1.0,), (1.0,), float(1.0 - np.mean(left**2)))
    with one_thread():
        found: Any = sobol_indices(func=predict, n=_SAMPLES, dists=each, rng=np.random.default_rng(seed))
    # Where the scores do not vary the indices are not defined; they count as 0.
    varied = [one.size != 1 for one in space.parameters]
    names = tuple(name for name, varies in zip(space.names, varied, strict=True) if varies)
    indices = (index.ravel()[varied] for index in (found.first_order, found.total_order))
    first, total = (np.clip(np.nan_to_num(index), 0.0, 1.0).tolist() for index in indices)
    return Sensitivity(names, tuple(first), tuple(total), float(1.0 - np.mean(left**2)))
