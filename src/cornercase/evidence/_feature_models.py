"""Prediction of features of recordings (numbers that describe what happened) by Gaussian processes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from cornercase._common.numba.blas import single_threaded_blas
from cornercase._common.typing import FloatArray, IntArray
from cornercase.evidence.gp._matern_kernel import Floats, MaternKernel, evenly_spaced_indices, fit_kernel
from cornercase.evidence.gp._posterior import ExactPosterior

_MAX_NOISE: Final = 0.5
_TOLERANCE: Final = 1e-4  # of the search for a kernel; a smaller tolerance predicts features no better
_MIN_SPREAD: Final = 1e-9  # standard deviation up to which a feature is constant
# Fraction of the variance that is added for points close to each other; `ExactPosterior` adds 1e-10 itself.
_JITTER: Final = 1e-8 - 1e-10
_ROUNDING: Final = 0.01  # greatest error of single precision, in standard deviations of a feature
_CACHED_COVARIANCES: Final = 65536  # covariances that are computed at a time, so that they stay in the cache
_MIN_BRANCH_SCENARIOS: Final = 8  # least number of scenarios of a branch that has its own processes

FeatureKernels = Sequence[MaternKernel | None]


class PerBranchFeatureModels:
    """Gaussian processes that predict features, from all scenarios and additionally from the scenarios of each branch.

    Many features are discontinuous between branches (ego first, other first, contact) but smooth within a branch. A
    process of all scenarios smooths the jump. A process of a single branch predicts the features that a scenario would
    have if it took this branch. A classifier (`CommitteeModel`) gets the predictions of all these processes, and learns
    which of them matter. Branches with fewer than 8 scenarios have no process of their own.

    `branches` (n,) is the branch of each scenario. `kernels` maps each branch, and None for all scenarios, to the
    kernels of `FeatureModels`; missing kernels are learned from at most `max_kernel_scenarios`. `subset` holds the
    indices of scenarios that the processes use, by default all. A branch with fewer than 8 scenarios in `subset` uses
    all scenarios of the branch. `leave_one_out` (n, g) holds leave-one-out predictions: first from all scenarios, then
    from each branch. For scenarios outside of a branch, the column of this branch holds the ordinary prediction.
    """

    def __init__(
        self,
        points: FloatArray,
        features: FloatArray,
        branches: IntArray,
        kernels: Mapping[int | None, FeatureKernels] | None = None,
        subset: IntArray | None = None,
        max_kernel_scenarios: int | None = None,
    ) -> None:
        kernels = {} if kernels is None else kernels
        overall = FeatureModels(points, features, kernels.get(None), subset, max_kernel_scenarios)
        self._models, left_out = [overall], [overall.leave_one_out]
        self.kernels: dict[int | None, FeatureKernels] = {None: overall.kernels}
        present, counts = np.unique(branches, return_counts=True)
        # With a single branch, its processes would equal those of all scenarios.
        for branch in present[counts >= _MIN_BRANCH_SCENARIOS].tolist() if len(present) > 1 else []:
            members = np.flatnonzero(branches == branch)
            known_members = None if subset is None else np.flatnonzero(np.isin(members, subset))
            if known_members is not None and len(known_members) < _MIN_BRANCH_SCENARIOS:
                # A rare branch, far from the threshold: the subset has too few of it to learn from.
                known_members = None
            part = FeatureModels(
                points[members], features[members], kernels.get(branch), known_members, max_kernel_scenarios
            )
            predicted = part.predict_features(points)
            predicted[members] = part.leave_one_out
            self._models.append(part)
            left_out.append(predicted)
            self.kernels[branch] = part.kernels
        self.leave_one_out = np.hstack(left_out)

    def predict_features(self, points: FloatArray) -> FloatArray:
        """Predict the standardized features (m, g) at points (m, e); constant features are left out."""
        return np.hstack([part.predict_features(points) for part in self._models])


class FeatureModels:
    """Gaussian processes that predict features: one per feature, each with its own Matérn kernel (5/2).

    Some features depend on all parameters and jump. Other features depend on few parameters: where an entity is at a
    given time often depends on this entity's parameters alone. So each feature has its own length scales and noise.

    `points` (n, e) are encoded, `features` (n, f) are finite. `kernels` has one kernel per feature, None for a constant
    feature; by default they are learned from at most `max_kernel_scenarios`. `subset` has the indices of the scenarios
    that the processes use, by default all. Memory grows with the square of their number. `leave_one_out`
    (n, g) holds the standardized leave-one-out predictions, without constant features.

    Source: C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning" (2006), equations 5.8, 5.9 and
    5.12.
    """

    def __init__(
        self,
        points: FloatArray,
        features: FloatArray,
        kernels: FeatureKernels | None = None,
        subset: IntArray | None = None,
        max_kernel_scenarios: int | None = None,
    ) -> None:
        spread = features.std(axis=0)
        scaled = (features - features.mean(axis=0)) / np.maximum(spread, _MIN_SPREAD)
        used: IntArray | slice = slice(None) if subset is None else subset
        self._points = points[used]
        self._kernels_and_weights: list[tuple[MaternKernel, Floats]] = []
        left_out = []
        # One thread, so that sums do not depend on the number of threads.
        with single_threaded_blas():
            if kernels is None:
                some = evenly_spaced_indices(len(points), max_kernel_scenarios or len(points))
                kernels = [
                    fit_kernel(points[some], scaled[some, j], _MAX_NOISE, tolerance=_TOLERANCE) if is_varied else None
                    for j, is_varied in enumerate((spread > _MIN_SPREAD).tolist())
                ]
            self.kernels: FeatureKernels = list(kernels)
            for kernel, values in zip(self.kernels, scaled[used].T, strict=True):
                if kernel is not None:
                    noise = float(np.sqrt(kernel.noise**2 + _JITTER * kernel.signal**2))
                    process = ExactPosterior(replace(kernel, noise=noise), self._points, values)
                    self._kernels_and_weights.append((kernel, _single_precision_if_accurate(process.weights, kernel)))
                    left_out.append(process.leave_one_out()[0])
        leave_one_out = np.array(left_out).reshape(-1, len(self._points)).T
        # Scenarios that the processes do not use are predicted without them anyway.
        self.leave_one_out = leave_one_out if subset is None else self.predict_features(points)
        self.leave_one_out[used] = leave_one_out

    def predict_features(self, points: FloatArray) -> FloatArray:
        """Predict the standardized features (m, g) at points (m, e); constant features are left out."""
        predicted = np.empty((len(points), len(self._kernels_and_weights)))
        step = max(_CACHED_COVARIANCES // max(len(self._points), 1), 1)
        with single_threaded_blas():
            for k, (kernel, weights) in enumerate(self._kernels_and_weights):
                single = weights.dtype == np.float32
                covariance = kernel.covariance_in_single_precision if single else kernel.covariance
                for first in range(0, len(points), step):
                    some = slice(first, first + step)
                    predicted[some, k] = covariance(points[some], self._points) @ weights
        return predicted


def _single_precision_if_accurate(weights: FloatArray, kernel: MaternKernel) -> Floats:
    """Convert weights to single precision, if weighted sums of covariances are then accurate enough."""
    rounding = np.finfo(np.float32).eps * np.abs(weights).sum() * kernel.signal**2
    return weights.astype(np.float32) if rounding <= _ROUNDING else weights
