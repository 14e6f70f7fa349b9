"""Bayesian optimization as in the paper: PHYSBO's Gaussian process with Thompson sampling."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from scipy.spatial.distance import pdist

from cornercase._common.numba.blas import single_threaded_blas
from cornercase._common.typing import FloatArray
from cornercase._common.validation import check_float, check_int
from cornercase.evidence.gp._gaussian_process import encode_points
from cornercase.evidence.gp._matern_kernel import evenly_spaced_indices
from cornercase.optimizers._candidates import CandidateOptimizer
from cornercase.optimizers._random_features import RandomFeatureProcess

_STEPS, _STEP_SIZE = 50, 0.01  # of Adam: a tenth of PHYSBO's number of steps, each ten times as large
_N_COMPARED: Final = 200  # points on which initial length scales are compared
_N_DISTANCE_POINTS: Final = 2000  # points whose distances give the initial length scales


class Bayes(CandidateOptimizer):
    """Bayesian optimization with Thompson sampling.

    The settings follow Schütt, Otten and Sax (2023), section "Optimization Workflow": automatic hyperparameters,
    Thompson sampling, random feature maps. PHYSBO is the maintained successor of the package COMBO, which they used.
    The first 20 points are a Sobol' sequence. Hyperparameters are learned and feature maps drawn again after every ten
    new scenarios, failed ones too, or when their number has grown by a tenth if that is later. In between, the Gaussian
    process is only conditioned on the new scores.

    Each point of a round comes from another sample of the process. Each sample chooses among its own candidates, so a
    round contains no scenario twice and does not crowd at one end of a critical region.

    Points from samples crowd in the region with the lowest scores. So a fraction of all points continues the Sobol'
    sequence, to find other critical regions and to have less critical scenarios for comparison.

    Parameters
    ----------
    candidates : int, default 2000
        Number of candidates from which the points of a round are chosen; drawn again for each round.
    features : int, default 500
        Number of random features that approximate the kernel.
    filling : float, default 0.3
        Fraction of the points that come from the Sobol' sequence; 0 is the paper's setting.

    Raises
    ------
    InputError
        An option is out of range.

    Examples
    --------
    >>> import cornercase as cc
    >>> search = cc.optimizers.Bayes(filling=0.0)
    >>> str(search)
    'bayes:filling=0.0'
    >>> study.explore(search, budget=300)  # doctest: +SKIP
    """

    name = "bayes"
    initial = 20

    _process: RandomFeatureProcess
    _score_mean_and_deviation: tuple[float, float]

    def __init__(self, candidates: int = 2000, features: int = 500, filling: float = 0.3) -> None:
        self._count, self._features = check_int("candidates", candidates, 1), check_int("features", features, 1)
        self._filling = check_float("filling", filling, minimum=0.0, maximum=1.0)

    def _fit_model(self, points: FloatArray, scores: FloatArray, seed: int) -> None:
        self._score_mean_and_deviation = float(scores.mean()), float(scores.std())
        with _isolate_physbo(seed):
            self._process = _fit_feature_process(
                self._process_coordinates(points), self._standardized_negative_scores(scores), self._features
            )

    def _choose_points(self, points: FloatArray, scores: FloatArray, filling: FloatArray, n: int) -> FloatArray:
        # Thompson sampling: each point is the best of its part of the candidates, by its own sample of the process.
        candidates = self._draw_round_candidates(max(self._count * n // (n + self._n_pending), n), filling)
        if len(candidates) <= n:
            return candidates
        # Consecutive points of a Sobol' sequence fill the space; every n-th point need not.
        parts = np.array_split(candidates, n)
        with single_threaded_blas():
            process = self._process.with_more_values(
                self._process_coordinates(points), self._standardized_negative_scores(scores)
            )
            if self._n_pending:
                process = process.conditioned_on_own_mean(self._process_coordinates(filling[: self._n_pending]))
            samples = process.draw_weights(n, np.random.default_rng(self._round_seed))
            return np.array(
                [
                    part[np.argmax(process.random_features(self._process_coordinates(part)) @ sample)]
                    for part, sample in zip(parts, samples, strict=True)
                ]
            )

    def _process_coordinates(self, points: FloatArray) -> FloatArray:
        """Return the coordinates of points for the Gaussian process, shape (n, e).

        A parameter with choices has one coordinate per choice, so that all its choices are equally far apart.
        """
        return 2.0 * encode_points(self._space, points) - 1.0

    def _standardized_negative_scores(self, scores: FloatArray) -> FloatArray:
        """Return the negative standardized scores, shape (n,); negative, since PHYSBO maximizes."""
        mean, deviation = self._score_mean_and_deviation
        return -(scores - mean) / deviation


def _fit_feature_process(points: FloatArray, values: FloatArray, features: int) -> RandomFeatureProcess:
    """Fit a Gaussian process with random features to values, shape (n,), at points, shape (n, d).

    PHYSBO learns the hyperparameters by Adam, from the best of five initial length scales.
    """
    import physbo

    gp = physbo.gp
    model = gp.core.Model(
        lik=gp.lik.Gauss(), mean=gp.mean.Const(), cov=gp.cov.Gauss(num_dim=points.shape[1], ard=False)
    )
    # Noise, mean, length scale and signal of the process; all but the mean as logarithms.
    signal = np.log(np.std(values))
    scales = np.log(
        np.quantile(pdist(points[evenly_spaced_indices(len(points), _N_DISTANCE_POINTS)]), (0.1, 0.3, 0.5, 0.7, 0.9))
        + 1e-6
    )
    starts = [np.array([signal - np.log(10.0), np.median(values), scale, signal]) for scale in scales]
    start = min(starts, key=lambda x: model.eval_marlik(x.copy(), points[:_N_COMPARED], values[:_N_COMPARED]))
    config = physbo.misc.SetConfig()
    config.learning.alpha, config.learning.num_disp = _STEP_SIZE, 1
    # An epoch has a step per batch of points, so fewer epochs with more points keep the number of steps.
    epochs = max(1, _STEPS // max(1, len(points) // config.learning.batch_size))
    model.set_params(gp.core.learning.Adam(model, config).one_run(start, points, values, epochs))
    linear = model.export_blm(features).lik.linear
    frequencies, phases, amplitude = linear.basis.params
    scalars = [np.asarray(scalar).item() for scalar in (amplitude, linear.bias, model.lik.std)]
    return RandomFeatureProcess(frequencies, phases, *scalars).with_more_values(points, values)


@contextlib.contextmanager
def _isolate_physbo(seed: int) -> Iterator[None]:
    """Run PHYSBO without output and on one thread, and restore NumPy's global random generator afterwards.

    PHYSBO draws from NumPy's global generator. Several threads could add numbers in another order, and so give slightly
    different points. They would not be faster, since PHYSBO's matrices are small.
    """
    state: Any = np.random.get_state()  # noqa: NPY002
    try:
        with contextlib.redirect_stdout(io.StringIO()), single_threaded_blas():
            np.random.seed(seed)  # noqa: NPY002
            yield
    finally:
        np.random.set_state(state)  # noqa: NPY002
