"""Choose points by the straddle heuristic."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from cornercase._common.typing import FloatArray, IntArray
from cornercase.evidence import GaussianProcess

Floats = npt.NDArray[np.floating[Any]]


def gains(mean: FloatArray, deviation: FloatArray) -> FloatArray:
    """Straddle heuristic: how uncertain it is on which side of the threshold points are, (m,).

    `mean` and `deviation` are those of a process with the threshold at 0.
    """
    return np.asarray(1.96 * deviation - np.abs(mean))


class Round:
    """Choose points of a process one after the other, each given those before it.

    `points` (m, e) are encoded, `mean` and `variance` (m,) the predictions there; the variance is changed in place.
    `projections` (m, k) are those of `GaussianProcess.predict_with_projections`; no columns for a process without
    values.
    """

    def __init__(
        self, process: GaussianProcess, places: FloatArray, mean: FloatArray, variance: FloatArray, rows: Floats
    ) -> None:
        self._process, self._places, self._rows = process, places, rows
        self._mean, self._variance = mean, variance
        # The process is computed in single precision, where a lower variance is indistinguishable from 0.
        self._lowest, self._noise = 1e-5 * process.kernel.signal**2, process.kernel.noise**2
        self._learned: list[FloatArray] = []

    def learn(self, i: int) -> None:
        """Condition the variances on point `index`."""
        shared = self._process.covariance(self._places, self._rows, i)
        for earlier in self._learned:
            shared = shared - earlier * earlier[i]
        step = shared / math.sqrt(max(self._variance[i], self._lowest) + self._noise)
        # A point cannot explain more than the remaining variance; larger steps are rounding errors.
        limit = np.sqrt(self._variance)
        self._learned.append(np.clip(step, -limit, limit))
        np.maximum(self._variance - self._learned[-1] ** 2, 0.0, out=self._variance)

    def choose(self, n: int, among: int) -> tuple[IntArray, float]:
        """Choose `n` of the first `n_candidates` points, each of the largest gain: indices (n,), and least gain."""
        chosen: list[int] = []
        least = math.inf
        while len(chosen) < n:
            gain = gains(self._mean, np.sqrt(self._variance))[:among]
            gain[chosen] = -np.inf
            chosen.append(int(np.argmax(gain)))
            least = min(least, float(gain[chosen[-1]]))
            self.learn(chosen[-1])
        return np.array(chosen, dtype=np.int64), least
