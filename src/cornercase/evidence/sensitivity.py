"""Which parameters matter for a score, and which do not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from cornercase._common.threads import one_thread
from cornercase._common.typing import FloatArray
from cornercase.evidence.gaussian_process import GaussianProcess, encoded, enough
from cornercase.evidence.kernel import evenly
from cornercase.evidence.products import lower_times
from cornercase.scenario import ParameterSpace

# Samples for the figures; places at which the process is drawn for their intervals, and the number of draws.
_SAMPLES: Final = 4096
_PLACES, _DRAWS = 2048, 200
# Values that are left out in turn, evenly apart among more.
_LEFT_OUT: Final = 4096
_INTERVAL: Final = (0.05, 0.95)
LITTLE: Final = 0.05
"""Total sensitivity below which a parameter counts as of little influence."""
FORETOLD: Final = 0.1
"""Share of the variance that has to be predicted for anything to be said of a parameter's influence."""


@dataclass(frozen=True)
class Sensitivity:
    """How much of a score's variance comes from each parameter.

    Attributes
    ----------
    names : tuple of str
        Of the parameters that have more than one value.
    first, total : tuple of float
        Share of the variance that a parameter explains alone, and with all others together.
    first_interval, total_interval : tuple of (float, float)
        90 % credible intervals of these, from draws of the process.
    predicted : float
        Share of the variance of the scores that the process predicts when each scenario is left out in turn, of more
        than 4,096 scenarios so many: how far the figures can be relied on.
    """

    names: tuple[str, ...]
    first: tuple[float, ...]
    total: tuple[float, ...]
    first_interval: tuple[tuple[float, float], ...]
    total_interval: tuple[tuple[float, float], ...]
    predicted: float

    @property
    def foretold(self) -> bool:
        """Whether enough of the scores is predicted for the figures to say something."""
        return self.predicted >= FORETOLD

    @property
    def little(self) -> tuple[str, ...]:
        """Parameters whose total lies below 0.05 with its interval; none where hardly anything is predicted."""
        each = zip(self.names, self.total_interval, strict=True)
        return tuple(name for name, (_, high) in each if high < LITTLE) if self.foretold else ()


def estimate_sensitivity(space: ParameterSpace, points: FloatArray, scores: FloatArray, seed: int = 0) -> Sensitivity:
    """Sobol' indices of the mean of a Gaussian process of the scores, with intervals from draws of the process.

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
    some = evenly(len(values), _LEFT_OUT)
    left = values[some] - process.leave_one_out(some)[0]

    def predict(places: FloatArray) -> FloatArray:
        mean, _ = process.predict(encoded(space, space.snap(places.T)))
        return mean[None, :]

    predicted = float(1.0 - np.mean(left**2))
    if space.dimension == 1:
        return Sensitivity(space.names, (1.0,), (1.0,), ((1.0, 1.0),), ((1.0, 1.0),), predicted)
    from scipy.stats import sobol_indices, uniform

    each: Any = [uniform()] * space.dimension
    with one_thread():
        found: Any = sobol_indices(func=predict, n=_SAMPLES, dists=each, rng=np.random.default_rng(seed))
        spreads = _spreads(space, process, seed)
    # Where the scores do not vary the indices are not defined; they count as 0.
    varied = [one.size != 1 for one in space.parameters]
    names = tuple(name for name, varies in zip(space.names, varied, strict=True) if varies)
    figures, intervals = [], []
    for index, spread in zip((found.first_order, found.total_order), spreads, strict=True):
        figure = np.clip(np.nan_to_num(index.ravel()[varied]), 0.0, 1.0)
        drawn = np.clip(figure + spread[:, varied], 0.0, 1.0)
        low, high = np.quantile(drawn, _INTERVAL, axis=0)
        figures.append(tuple(figure.tolist()))
        bounds = np.minimum(low, figure).tolist(), np.maximum(high, figure).tolist()
        intervals.append(tuple(zip(*bounds, strict=True)))
    return Sensitivity(names, figures[0], figures[1], intervals[0], intervals[1], predicted)


def _spreads(space: ParameterSpace, process: GaussianProcess, seed: int) -> tuple[FloatArray, FloatArray]:
    """How far the first-order and total indices of draws of a process lie from those of its mean, (draws, d) each.

    Both are taken at the same few places, so that what these miss of the space falls out.
    """
    dims = space.dimension
    count = 1 << ((_PLACES // (dims + 2)).bit_length() - 1)
    # The package takes half a second to load.
    from scipy.stats import qmc

    both = qmc.Sobol(2 * dims, seed=np.random.default_rng([seed, 2])).random(count)
    a, b = both[:, :dims], both[:, dims:]
    mixed = [np.where(np.arange(dims) == j, b, a) for j in range(dims)]
    places = encoded(space, space.snap(np.concatenate([a, b, *mixed])))
    mean, _ = process.predict(places)
    factor, _ = process.joint(places, noisy=False)
    normal = np.random.default_rng([seed, 3]).standard_normal((len(places), _DRAWS))
    values = np.concatenate([mean[:, None], mean[:, None] + lower_times(factor, normal)], axis=1)
    of_a, of_b, *others = values.reshape(dims + 2, count, -1)
    variance = np.maximum(np.concatenate([of_a, of_b]).var(axis=0), 1e-12)
    first = np.array([(of_b * (one - of_a)).mean(axis=0) / variance for one in others]).T
    total = np.array([0.5 * ((of_a - one) ** 2).mean(axis=0) / variance for one in others]).T
    return first[1:] - first[0], total[1:] - total[0]
