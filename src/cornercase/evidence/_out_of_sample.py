"""Out-of-sample predictions of scores by a Gaussian process that was fitted without these scores."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.evidence.gp._gaussian_process import GaussianProcess, squash_around_threshold
from cornercase.evidence.gp._posterior import MAX_EXACT_VALUES
from cornercase.study._criterion import Criterion

# Number of values per dimension up to which the kernel overfits, and number of folds.
_OVERFIT_PER_DIMENSION: Final = 40
_N_FOLDS: Final = 5


def cross_validate_scores(
    process: GaussianProcess,
    points: FloatArray,
    scores: FloatArray,
    criterion: Criterion,
    indices: IntArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Predict each squashed score from all other scores; return means and standard deviations, (k,) each.

    Scores are squashed by `squash_around_threshold`. `indices` selects the scores to predict, by default all. `process`
    is the fitted process of all scores (`fit_boundary_process`). With few scores per dimension the length scales of its
    kernel overfit, and leave-one-out predictions are too good. In this case each fifth of the scores is predicted with
    a kernel learned from the other four fifths.
    """
    count, dims = points.shape
    if count > min(_OVERFIT_PER_DIMENSION * dims, MAX_EXACT_VALUES):
        return process.leave_one_out(indices)
    values, critical = squash_around_threshold(scores, criterion, process.squash_scale), criterion.is_critical(scores)
    rare = critical if 2 * critical.sum() < count else ~critical
    # A coordinate that the process ignores has an infinite length scale.
    used = int(np.isfinite(process.kernel.length_scales).sum())
    mean, deviation = np.empty(count), np.empty(count)
    for part in range(_N_FOLDS):
        test = np.arange(count) % _N_FOLDS == part
        fold = GaussianProcess(process.max_noise, process.squash_scale)
        fold.fit_hyperparameters(points[~test], values[~test], process, rare[~test], used).condition_on(points, values)
        mean[test], deviation[test] = fold.leave_one_out(np.flatnonzero(test))
    index = slice(None) if indices is None else indices
    return mean[index], deviation[index]
