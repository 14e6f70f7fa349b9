"""Choice of points by the straddle heuristic: points that may be on either side of the threshold."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from cornercase._common.typing import FloatArray, IntArray
from cornercase.evidence.gp._gaussian_process import GaussianProcess

_N_FIRST_TRIED: Final = 512  # candidates with the largest gain that are tried first

Floats = npt.NDArray[np.floating[Any]]


def straddle_gains(mean: FloatArray, deviation: FloatArray) -> FloatArray:
    """Return the gain of points by the straddle heuristic, shape (m,).

    The gain is high if it is uncertain on which side of the threshold the score of a point is. `mean` and `deviation`,
    shape (m,), are predictions of a process with the threshold at 0.
    """
    return np.asarray(1.96 * deviation - np.abs(mean))


class StraddleSelection:
    """Selection of candidates one after the other by the straddle heuristic, given the candidates selected before.

    `points`, shape (m, e), are the encoded candidates. `mean` and `variance`, shape (m,), are the predictions of
    `process` for the candidates; the variance is changed in place. `projections`, shape (m, k), come from
    `GaussianProcess.predict_with_projections`; k is 0 if the process has no values yet.
    """

    def __init__(
        self, process: GaussianProcess, points: FloatArray, mean: FloatArray, variance: FloatArray, projections: Floats
    ) -> None:
        self._process, self._points, self._rows = process, points, projections
        self._mean, self._variance = mean, variance
        # The process is computed in single precision, where a lower variance is indistinguishable from 0.
        self._lowest, self._noise = 1e-5 * process.kernel.signal**2, process.kernel.noise**2
        self._learned_steps: list[FloatArray] = []

    def condition_on_point(self, index: int) -> None:
        """Update the variances as if the score at point `index` were known."""
        shared = self._process.covariance_with_point(self._points, self._rows, index)
        for earlier in self._learned_steps:
            shared = shared - earlier * earlier[index]
        step = shared / math.sqrt(max(self._variance[index], self._lowest) + self._noise)
        # A point cannot explain more than the remaining variance; larger steps are rounding errors.
        limit = np.sqrt(self._variance)
        self._learned_steps.append(np.clip(step, -limit, limit))
        np.maximum(self._variance - self._learned_steps[-1] ** 2, 0.0, out=self._variance)

    def choose_points(self, n: int, n_candidates: int) -> tuple[IntArray, float]:
        """Choose `n` of the first `n_candidates` points, each with the largest gain at its turn.

        Returns the indices, shape (n,), and the smallest gain of a chosen point.
        """
        chosen: list[int] = []
        least = math.inf
        while len(chosen) < n:
            gain = straddle_gains(self._mean, np.sqrt(self._variance))[:n_candidates]
            gain[chosen] = -np.inf
            chosen.append(int(np.argmax(gain)))
            least = min(least, float(gain[chosen[-1]]))
            self.condition_on_point(chosen[-1])
        return np.array(chosen, dtype=np.int64), least


def choose_by_straddle(process: GaussianProcess, candidates: FloatArray, sampled: FloatArray, n: int) -> IntArray:
    """Choose `n` candidates by the straddle heuristic, one after the other.

    Variances are computed as if the scores of the `sampled` points, and of the points chosen before, were known.
    """
    mean, deviation, rows = process.predict_with_projections(np.concatenate([candidates, sampled]))
    variance, others = deviation**2, np.arange(len(candidates), len(mean))
    gain = straddle_gains(mean, np.sqrt(variance))[: len(candidates)]
    order, count = np.argsort(-gain, kind="stable"), max(_N_FIRST_TRIED, n)
    while True:
        best = np.sort(order[:count])
        index = np.concatenate([best, others])
        selection = StraddleSelection(
            process, np.concatenate([candidates[best], sampled]), mean[index], variance[index], rows[index]
        )
        for i in range(len(best), len(index)):
            selection.condition_on_point(i)
        chosen, least = selection.choose_points(n, len(best))
        # Gains only decrease as other points become known, so none of the remaining candidates can be better.
        if count >= len(candidates) or least > gain[order[count]]:
            return best[chosen]
        count *= 4
