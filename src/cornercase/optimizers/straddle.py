"""Choice of points of which it is least known on which side of the threshold they are."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from cornercase._common.typing import FloatArray, IntArray
from cornercase.evidence import GaussianProcess

Floats = npt.NDArray[np.floating[Any]]


def gains(mean: FloatArray, deviation: FloatArray) -> FloatArray:
    """How much is learned from points about the side of the threshold they are on: the straddle heuristic.

    Parameters
    ----------
    mean, deviation : ndarray of float64, shape (m,)
        Of a process with the threshold at 0.

    Returns
    -------
    ndarray of float64, shape (m,)
    """
    return np.asarray(1.96 * deviation - np.abs(mean))


class Round:
    """Points of a process, of which one after the other becomes known.

    Parameters
    ----------
    process : GaussianProcess
    places : ndarray of float64, shape (m, e)
        As `encoded`.
    mean, variance : ndarray of float64, shape (m,)
        What the process predicts there; the variance is changed in place.
    rows : ndarray of float32 or float64, shape (m, k)
        What `GaussianProcess.predict_with_projections` gives of the places; of no columns where it is to know nothing.
    """

    def __init__(
        self, process: GaussianProcess, places: FloatArray, mean: FloatArray, variance: FloatArray, rows: Floats
    ) -> None:
        self._process, self._places, self._rows = process, places, rows
        self._mean, self._variance = mean, variance
        # The process is computed in single precision, which cannot tell a lower variance from 0.
        self._lowest, self._noise = 1e-5 * process.kernel.signal**2, process.kernel.noise**2
        self._learned: list[FloatArray] = []

    def learn(self, i: int) -> None:
        """Make a point known.

        Parameters
        ----------
        i : int
            Its index.
        """
        shared = self._process.covariance(self._places, self._rows, i)
        for earlier in self._learned:
            shared = shared - earlier * earlier[i]
        step = shared / math.sqrt(max(self._variance[i], self._lowest) + self._noise)
        # A point cannot explain more than the variance that is left; rounding errors are cut off.
        most = np.sqrt(self._variance)
        self._learned.append(np.clip(step, -most, most))
        np.maximum(self._variance - self._learned[-1] ** 2, 0.0, out=self._variance)

    def choose(self, n: int, among: int) -> tuple[IntArray, float]:
        """Choose points, each of the largest gain with those before it known.

        Parameters
        ----------
        n : int
            How many; at most `among`.
        among : int
            Of how many points, the first ones.

        Returns
        -------
        chosen : ndarray of int64, shape (n,)
        least : float
            The least gain of them, as they were chosen.
        """
        chosen: list[int] = []
        least = math.inf
        while len(chosen) < n:
            gain = gains(self._mean, np.sqrt(self._variance))[:among]
            gain[chosen] = -np.inf
            chosen.append(int(np.argmax(gain)))
            least = min(least, float(gain[chosen[-1]]))
            self.learn(chosen[-1])
        return np.array(chosen, dtype=np.int64), least
