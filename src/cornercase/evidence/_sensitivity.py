"""Global sensitivity of a score to the parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from cornercase._common.numba.blas import single_threaded_blas
from cornercase._common.text.notebook_html import render_html_table
from cornercase._common.typing import FloatArray
from cornercase.evidence._score_surrogate import MIN_PREDICTED, ScoreSurrogate, fit_surrogate
from cornercase.evidence.gp._gaussian_process import GaussianProcess, encode_points
from cornercase.evidence.gp._matern_kernel import evenly_spaced_indices
from cornercase.evidence.gp._triangular_products import multiply_lower_triangular
from cornercase.scenario import ParameterSpace

if TYPE_CHECKING:
    import pandas as pd
    from sklearn.ensemble import ExtraTreesRegressor

_SAMPLES: Final = 4096
# Points at which the process is drawn for the intervals, and number of draws.
_N_POINTS, _N_DRAWS = 2048, 200
# Trees, greatest number of scenarios that they use, and samples for their indices.
_N_TREES, _MAX_TREE_SCENARIOS, _TREE_SAMPLES = 100, 1000, 1024
_INTERVAL: Final = (0.05, 0.95)
LITTLE_INFLUENCE: Final = 0.05
"""Total index below which a parameter has little influence."""


@dataclass(frozen=True, repr=False)
class Sensitivity:
    """Sensitivity of a score to the parameters: the fraction of the variance that comes from each parameter.

    Attributes
    ----------
    names : tuple of str
        Parameters that have more than one value.
    first, total : tuple of float
        Fraction of the variance that a parameter explains alone (first-order index), and with interactions (total
        index).
    first_interval, total_interval : tuple of (float, float)
        90 % credible intervals of these indices, from draws of the process.
    predicted : float
        Fraction of the variance of the scores that the process predicts by leave-one-out, from at most 4,096 scenarios.
        The nearer this fraction is to 1, the more reliable the indices are.
    total_by_trees : tuple of float
        Total index by extremely randomised trees of the scores, which follow jumps. If the score jumps along a
        parameter, a smooth process can miss the influence of this parameter.

    Examples
    --------
    >>> import cornercase as cc
    >>> sensitivity = cc.Study.open("study.db").sensitivity()  # doctest: +SKIP
    >>> sensitivity.table()["total"].round(2).to_dict()  # doctest: +SKIP
    {'pedestrian_wait': 0.88, 'ego_start': 0.65, 'p1_speed': 0.0}
    >>> sensitivity.uninfluential_parameters, round(sensitivity.predicted, 2)  # doctest: +SKIP
    (('p1_speed',), 0.98)
    """

    names: tuple[str, ...]
    first: tuple[float, ...]
    total: tuple[float, ...]
    first_interval: tuple[tuple[float, float], ...]
    total_interval: tuple[tuple[float, float], ...]
    predicted: float
    total_by_trees: tuple[float, ...]

    @property
    def is_meaningful(self) -> bool:
        """True if the process predicts enough of the variance (10 %) for the indices to be meaningful."""
        return self.predicted >= MIN_PREDICTED

    def table(self) -> pd.DataFrame:
        """Make a table of the sensitivity indices of all parameters.

        Returns
        -------
        DataFrame
            One row per parameter, indexed by its name, the most influential first. The columns are the indices,
            ``total`` and ``first``, and the bounds of their 90 % intervals, ``total low``, ``total high``,
            ``first low`` and ``first high``.
        """
        import pandas as pd

        indices = {"total": (self.total, self.total_interval), "first": (self.first, self.first_interval)}
        columns: dict[str, Any] = {name: values for name, (values, _) in indices.items()}
        for name, (_, intervals) in indices.items():
            for k, bound in enumerate(("low", "high")):
                columns[f"{name} {bound}"] = [interval[k] for interval in intervals]
        table = pd.DataFrame(columns, index=pd.Index(self.names, name="parameter"))
        return table.sort_values("total", ascending=False, kind="stable")

    def __repr__(self) -> str:
        totals = ", ".join(f"{name} {total:.2f}" for name, total in self.table()["total"].items())
        return f"<Sensitivity: total {totals}; {self._reliability}>"

    def _repr_html_(self) -> str:
        """HTML table of the parameters, for notebooks."""
        return render_html_table(f"Sensitivity: {self._reliability}", self.table(), n_rows=len(self.names))

    @property
    def _reliability(self) -> str:
        return f"the parameters predict {max(self.predicted, 0.0):.0%} of the variance"

    @property
    def uninfluential_parameters(self) -> tuple[str, ...]:
        """Parameters with little influence: their total index is below 0.05 by two estimates.

        The two are `total_by_trees` and the upper bound of `total_interval`. Empty if the process predicts too
        little of the variance (`is_meaningful` is False).
        """
        both = zip(self.names, self.total_interval, self.total_by_trees, strict=True)
        is_little = (name for name, (_, high), by_trees in both if max(high, by_trees) < LITTLE_INFLUENCE)
        return tuple(is_little) if self.is_meaningful else ()


def estimate_sensitivity(space: ParameterSpace, points: FloatArray, scores: FloatArray, seed: int = 0) -> Sensitivity:
    """Estimate Sobol' indices of a score from a Gaussian process, with intervals from draws of the process.

    The indices belong to the mean of the process. Parameters vary independently over their ranges, regardless of
    constraints. `points` (n, d) are in the unit cube. Whether low or high `scores` (n,) are critical does not matter;
    NaN stands for a failed scenario. ValueError if there are fewer than 10 scores, or all are equal.

    Source: I. M. Sobol', "Global sensitivity indices for nonlinear mathematical models and their Monte Carlo
    estimates", Mathematics and Computers in Simulation 55 (2001); A. Saltelli et al., "Variance based sensitivity
    analysis of model output", Computer Physics Communications 181 (2010), with the estimators of scipy.
    """
    return sensitivity_of_surrogate(fit_surrogate(space, points, scores), seed)


def sensitivity_of_surrogate(surrogate: ScoreSurrogate, seed: int = 0) -> Sensitivity:
    """Estimate Sobol' indices as `estimate_sensitivity` does, from a Gaussian process that is already fitted."""
    space, process, predicted = surrogate.space, surrogate.process, surrogate.predicted

    if space.dimension == 1:
        return Sensitivity(space.names, (1.0,), (1.0,), ((1.0, 1.0),), ((1.0, 1.0),), predicted, (1.0,))
    with single_threaded_blas():
        result = _sobol_indices(space, lambda encoded: process.predict(encoded)[0], _SAMPLES, seed)
        spreads = _index_deviations(space, process, seed)
    varied = [parameter.size != 1 for parameter in space.parameters]
    names = tuple(name for name, is_varied in zip(space.names, varied, strict=True) if is_varied)
    indices, intervals = [], []
    for order, spread in zip((result.first_order, result.total_order), spreads, strict=True):
        # Indices are not defined if the scores do not vary; they count as 0.
        index = np.clip(np.nan_to_num(order.ravel()[varied]), 0.0, 1.0)
        low, high = np.quantile(np.clip(index + spread[:, varied], 0.0, 1.0), _INTERVAL, axis=0)
        indices.append(tuple(index.tolist()))
        bounds = np.minimum(low, index).tolist(), np.maximum(high, index).tolist()
        intervals.append(tuple(zip(*bounds, strict=True)))
    trees = _fit_trees(surrogate, seed)
    by_trees = _sobol_indices(space, trees.predict, _TREE_SAMPLES, seed).total_order.ravel()[varied]
    total_by_trees = tuple(np.clip(np.nan_to_num(by_trees), 0.0, 1.0).tolist())
    return Sensitivity(names, indices[0], indices[1], intervals[0], intervals[1], predicted, total_by_trees)


def _sobol_indices(
    space: ParameterSpace, predict: Callable[[FloatArray], FloatArray], n_samples: int, seed: int
) -> Any:
    """Estimate the first-order and total Sobol' indices of a function of encoded points."""
    from scipy.stats import sobol_indices, uniform

    distributions: Any = [uniform()] * space.dimension
    return sobol_indices(
        func=lambda points: predict(encode_points(space, space.snap(points.T)))[None, :],
        n=n_samples,
        dists=distributions,
        rng=np.random.default_rng(seed),
    )


def _fit_trees(surrogate: ScoreSurrogate, seed: int) -> ExtraTreesRegressor:
    """Fit extremely randomised trees to the scores of a surrogate; to 1,000 of the scores if there are more.

    Source: P. Geurts, D. Ernst, L. Wehenkel, "Extremely randomized trees", Machine Learning 63 (2006).
    """
    from sklearn.ensemble import ExtraTreesRegressor

    subset = evenly_spaced_indices(len(surrogate.values), _MAX_TREE_SCENARIOS)
    return ExtraTreesRegressor(_N_TREES, random_state=seed).fit(surrogate.points[subset], surrogate.values[subset])


def _index_deviations(space: ParameterSpace, process: GaussianProcess, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return how much Sobol' indices of draws of a process deviate from the indices of its mean, (draws, d) each.

    The first result is for first-order indices, the second for total indices. All indices are computed at the same few
    points, so that the sampling error cancels.
    """
    dims = space.dimension
    count = 1 << ((_N_POINTS // (dims + 2)).bit_length() - 1)
    # Imported late, since it takes half a second.
    from scipy.stats import qmc

    samples = qmc.Sobol(2 * dims, seed=np.random.default_rng([seed, 2])).random(count)
    a, b = samples[:, :dims], samples[:, dims:]
    mixed = [np.where(np.arange(dims) == j, b, a) for j in range(dims)]
    points = encode_points(space, space.snap(np.concatenate([a, b, *mixed])))
    mean, _ = process.predict(points)
    factor, _ = process.joint_covariance_factor(points, with_noise=False)
    normal = np.random.default_rng([seed, 3]).standard_normal((len(points), _N_DRAWS))
    values = np.concatenate([mean[:, None], mean[:, None] + multiply_lower_triangular(factor, normal)], axis=1)
    values_a, values_b, *values_mixed = values.reshape(dims + 2, count, -1)
    variance = np.maximum(np.concatenate([values_a, values_b]).var(axis=0), 1e-12)
    first = np.array([(values_b * (value - values_a)).mean(axis=0) / variance for value in values_mixed]).T
    total = np.array([0.5 * ((values_a - value) ** 2).mean(axis=0) / variance for value in values_mixed]).T
    return first[1:] - first[0], total[1:] - total[0]
