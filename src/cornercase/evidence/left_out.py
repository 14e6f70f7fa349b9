"""What a process says of a score that neither its values nor its kernel know."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.evidence.gaussian_process import GaussianProcess, near_threshold
from cornercase.evidence.posterior import MOST_EXACT

# Values for each dimension up to which the kernel follows single ones, and the parts of which each is left out.
_FEW: Final = 40
_PARTS: Final = 5


def left_out(
    process: GaussianProcess, points: FloatArray, scores: FloatArray, threshold: float, some: IntArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Predict each score from all others, without having learned from it.

    A kernel has a width for each dimension. Where there are few scores for each, the widths fit every one of them, and
    a score that is left out is predicted better than any that was never run. So a fifth of the scores at a time is
    predicted with a kernel that is learned from the other four.

    Parameters
    ----------
    process : GaussianProcess
        A `boundary_process` of the scores.
    points : ndarray of float64, shape (n, e)
    scores : ndarray of float64, shape (n,)
    threshold : float
    some : ndarray of int64, shape (k,), optional
        Which scores; by default all.

    Returns
    -------
    mean, deviation : ndarray of float64, shape (k,)
        As of `GaussianProcess.leave_one_out`.
    """
    count, dims = points.shape
    if count > min(_FEW * dims, MOST_EXACT):
        return process.leave_one_out(some)
    values, critical = near_threshold(scores, threshold, process.near), scores <= threshold
    rare = critical if 2 * critical.sum() < count else ~critical
    # A coordinate that the process ignores has an infinite width.
    used = int(np.isfinite(process.kernel.widths).sum())
    mean, deviation = np.empty(count), np.empty(count)
    for part in range(_PARTS):
        out = np.arange(count) % _PARTS == part
        other = GaussianProcess(process.most_noise, process.near)
        other.learn(points[~out], values[~out], process, rare[~out], used).know(points, values)
        mean[out], deviation[out] = other.leave_one_out(np.flatnonzero(out))
    these = slice(None) if some is None else some
    return mean[these], deviation[these]
