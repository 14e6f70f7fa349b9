"""Features of recordings, predicted by Gaussian processes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from cornercase._common.threads import one_thread
from cornercase._common.typing import FloatArray, IntArray
from cornercase.evidence.kernel import Floats, Kernel, learned_kernel
from cornercase.evidence.posterior import ExactPosterior

_MOST_NOISE: Final = 0.5
_LEAST: Final = 1e-9
"""Standard deviation up to which a feature is the same for all."""
# Of the variance, beside the noise, so that points that lie close to each other can be told apart; an `ExactPosterior`
# adds 1e-10 of it by itself.
_JITTER: Final = 1e-8 - 1e-10
# Rounding errors up to which single precision does, in standard deviations of a feature.
_ROUNDING: Final = 0.01
# Scenarios of one way from which on processes of their own learn from them.
_OF_ONE_WAY: Final = 8

Kernels = Sequence[Kernel | None]


class ForetoldByWay:
    """Features as foretold by all scenarios, and beside that by those of each way that a scenario can go.

    Many a feature jumps from one way to another, and is smooth within one. A process of all of them bends to follow the
    jump; one that knows a single way says what would be if the scenario went this way. Whoever learns from the columns
    tells which of them counts where. A way with fewer than 8 scenarios has none of its own.

    Parameters
    ----------
    points : ndarray of float64, shape (n, e)
        As `encoded`.
    features : ndarray of float64, shape (n, f)
        Finite.
    ways : ndarray of int64, shape (n,)
        Which way each scenario went.
    kernels : mapping of int or None to sequence of Kernel or None, optional
        As in `Foretold`, of each way, and of all by the key None. Those that are not given are learned.
    known : ndarray of int64, shape (k,), optional
        As in `Foretold`.

    Attributes
    ----------
    kernels : dict
    left_out : ndarray of float64, shape (n, g)
        As in `Foretold`, of all, and then of each way. Of a scenario that went another way it is what this way's
        processes predict.
    """

    def __init__(
        self,
        points: FloatArray,
        features: FloatArray,
        ways: IntArray,
        kernels: Mapping[int | None, Kernels] | None = None,
        known: IntArray | None = None,
    ) -> None:
        kernels = {} if kernels is None else kernels
        every = Foretold(points, features, kernels.get(None), known)
        self._parts, left_out = [every], [every.left_out]
        self.kernels: dict[int | None, Kernels] = {None: every.kernels}
        gone, counts = np.unique(ways, return_counts=True)
        # Where all go one way, the first ones know it already.
        for way in gone[counts >= _OF_ONE_WAY].tolist() if len(gone) > 1 else []:
            of_way = np.flatnonzero(ways == way)
            known_of_way = None if known is None else np.flatnonzero(np.isin(of_way, known))
            part = Foretold(points[of_way], features[of_way], kernels.get(way), known_of_way)
            predicted = part.predict(points)
            predicted[of_way] = part.left_out
            self._parts.append(part)
            left_out.append(predicted)
            self.kernels[way] = part.kernels
        self.left_out = np.hstack(left_out)

    def predict(self, points: FloatArray) -> FloatArray:
        """Predict the features at points.

        Parameters
        ----------
        points : ndarray of float64, shape (m, e)

        Returns
        -------
        ndarray of float64, shape (m, g)
            In the order of `left_out`.
        """
        return np.hstack([part.predict(points) for part in self._parts])


class Foretold:
    """A Gaussian process of each feature, with a Matérn kernel (5/2) of its own.

    Some features follow all parameters and jump, others hardly do: where the other is at some time depends on its own
    parameters alone. So each has its own widths and its own noise.

    Parameters
    ----------
    points : ndarray of float64, shape (n, e)
        As `encoded`.
    features : ndarray of float64, shape (n, f)
        Finite.
    kernels : sequence of Kernel or None, optional
        Of each feature, f of them, where they are known; None for a feature that is left out. By default they are
        learned.
    known : ndarray of int64, shape (k,), optional
        Scenarios that the processes know; by default all. Matrices of k × k numbers are made.

    Attributes
    ----------
    kernels : list of Kernel or None
        Of each feature, scaled to a standard deviation of 1; None for one that is the same for all.
    left_out : ndarray of float64, shape (n, g)
        What each scenario's features are by the processes of all others that they know, scaled; g <= f, since features
        that are the same for all are left out.

    Notes
    -----
    Source: C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning" (2006), equations 5.8, 5.9
    and 5.12.
    """

    def __init__(
        self,
        points: FloatArray,
        features: FloatArray,
        kernels: Kernels | None = None,
        known: IntArray | None = None,
    ) -> None:
        spread = features.std(axis=0)
        scaled = (features - features.mean(axis=0)) / np.maximum(spread, _LEAST)
        some: IntArray | slice = slice(None) if known is None else known
        self._points = points[some]
        self._each: list[tuple[Kernel, Floats]] = []
        left_out = []
        # Sums in one order, whatever the number of threads.
        with one_thread():
            if kernels is None:
                varied = (spread > _LEAST).tolist()
                kernels = [
                    learned_kernel(points, scaled[:, j], _MOST_NOISE) if one else None for j, one in enumerate(varied)
                ]
            self.kernels: Kernels = list(kernels)
            for kernel, values in zip(self.kernels, scaled[some].T, strict=True):
                if kernel is not None:
                    noise = float(np.sqrt(kernel.noise**2 + _JITTER * kernel.signal**2))
                    process = ExactPosterior(replace(kernel, noise=noise), self._points, values)
                    self._each.append((kernel, _short(process.weights, kernel)))
                    left_out.append(process.leave_one_out()[0])
        by_others = np.array(left_out).reshape(-1, len(self._points)).T
        # What the processes do not know they predict without it anyway.
        self.left_out = by_others if known is None else self.predict(points)
        self.left_out[some] = by_others

    def predict(self, points: FloatArray) -> FloatArray:
        """Predict the features at points.

        Parameters
        ----------
        points : ndarray of float64, shape (m, e)

        Returns
        -------
        ndarray of float64, shape (m, g)
            Scaled as `left_out`.
        """
        found = np.empty((len(points), len(self._each)))
        with one_thread():
            for k, (kernel, weights) in enumerate(self._each):
                single = weights.dtype == np.float32
                covariance = kernel.single_covariance if single else kernel.covariance
                found[:, k] = covariance(points, self._points) @ weights
        return found


def _short(weights: FloatArray, kernel: Kernel) -> Floats:
    """Weights in single precision, where no sum of them and covariances is off by much for it."""
    rounding = np.finfo(np.float32).eps * np.abs(weights).sum() * kernel.signal**2
    return weights.astype(np.float32) if rounding <= _ROUNDING else weights
