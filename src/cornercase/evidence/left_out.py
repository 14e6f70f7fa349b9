"""Out-of-sample predictions of scores that neither the values nor the kernel of a process have seen."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.evidence.gaussian_process import GaussianProcess, near_threshold
from cornercase.evidence.posterior import MOST_EXACT

# Values per dimension up to which the kernel overfits, and number of folds.
_FEW: Final = 40
_PARTS: Final = 5


def left_out(
    process: GaussianProcess, points: FloatArray, scores: FloatArray, threshold: float, some: IntArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Predict each score, or `indices`, from all others: mean and deviation as of `GaussianProcess.leave_one_out`.

    With few scores per dimension the length scales of the kernel overfit, and leave-one-out predictions are too good.
    Then each fifth of the scores is predicted with a kernel learned from the other four fifths. `process` is that of
    `fit_boundary_process`.
    """
    count, dims = points.shape
    if count > min(_FEW * dims, MOST_EXACT):
        return process.leave_one_out(some)
    values, critical = near_threshold(scores, threshold, process.near), scores <= threshold
    rare = critical if 2 * critical.sum() < count else ~critical
    # A coordinate that the process ignores has an infinite length scale.
    used = int(np.isfinite(process.kernel.widths).sum())
    mean, deviation = np.empty(count), np.empty(count)
    for part in range(_PARTS):
        test = np.arange(count) % _PARTS == part
        fold = GaussianProcess(process.most_noise, process.near)
        fold.learn(points[~test], values[~test], process, rare[~test], used).know(points, values)
        mean[test], deviation[test] = fold.leave_one_out(np.flatnonzero(test))
    index = slice(None) if some is None else some
    return mean[index], deviation[index]
