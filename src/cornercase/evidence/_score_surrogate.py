"""Gaussian process of the scores of a study, which predicts the scores between its scenarios."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.evidence.gp._gaussian_process import GaussianProcess, encode_points, require_enough_scores
from cornercase.evidence.gp._matern_kernel import evenly_spaced_indices
from cornercase.scenario import ParameterSpace

_MAX_LEFT_OUT: Final = 4096  # greatest number of values that are left out in turn
MIN_PREDICTED: Final = 0.1
"""Least fraction of the variance that a process must predict for conclusions from it."""


@dataclass(frozen=True, eq=False)
class ScoreSurrogate:
    """Gaussian process of the scores of some scenarios, minus their mean and divided by their standard deviation.

    The process is conditioned on `values` (n,), the standardized scores, at `points` (n, e), which are encoded. `mean`
    and `deviation` belong to the scores. `predicted` is the fraction of the variance that the process predicts by
    leave-one-out, from at most 4,096 scenarios.
    """

    space: ParameterSpace
    process: GaussianProcess
    points: FloatArray
    values: FloatArray
    mean: float
    deviation: float
    predicted: float

    def condense(self, max_points: int) -> ScoreSurrogate:
        """Return a surrogate with the same kernel and scenarios, whose predictions need at most `max_points` points.

        `predicted` is computed anew, since the new surrogate may predict worse.
        """
        process = self.process.condense(self.points, self.values, max_points)
        predicted = _predicted_fraction(process, self.values)
        return ScoreSurrogate(self.space, process, self.points, self.values, self.mean, self.deviation, predicted)

    @property
    def is_meaningful(self) -> bool:
        """True if the process predicts enough of the variance of the scores (10 %) for conclusions."""
        return self.predicted >= MIN_PREDICTED


def fit_surrogate(space: ParameterSpace, points: FloatArray, scores: FloatArray) -> ScoreSurrogate:
    """Fit a process to scores (n,) at points (n, d) of the unit cube; NaN stands for a failed scenario.

    ValueError if there are fewer than 10 scores, or all are equal.
    """
    points, scores = require_enough_scores(points, scores)
    mean, deviation = float(scores.mean()), float(scores.std())
    encoded, values = encode_points(space, points), (scores - mean) / deviation
    process = GaussianProcess(1.0).fit(encoded, values)
    return ScoreSurrogate(space, process, encoded, values, mean, deviation, _predicted_fraction(process, values))


def _predicted_fraction(process: GaussianProcess, values: FloatArray) -> float:
    subset = evenly_spaced_indices(len(values), _MAX_LEFT_OUT)
    errors = values[subset] - process.leave_one_out(subset)[0]
    return float(1.0 - np.mean(errors**2))
