"""Bayesian optimization as in the paper: PHYSBO's Gaussian process with Thompson sampling."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from scipy.spatial.distance import pdist

from cornercase._common.threads import one_thread
from cornercase._common.typing import FloatArray
from cornercase.evidence import encoded, evenly
from cornercase.optimizers.candidates import CandidateOptimizer
from cornercase.optimizers.feature_process import FeatureProcess
from cornercase.scenario import ParameterSpace

_INITIAL: Final = 20
_STEPS, _STEP_SIZE = 50, 0.01  # of Adam: a tenth of PHYSBO's number of steps, ten times as long
_COMPARED: Final = 200  # points on which initial length scales are compared
_APART: Final = 2000  # points whose distances give the initial length scales


class BayesOptimizer(CandidateOptimizer):
    """Bayesian optimization with Thompson sampling.

    The setting is that of Schütt, Otten and Sax (2023), section "Optimization Workflow": automatic hyperparameters,
    Thompson sampling, random feature maps; PHYSBO is the maintained successor of their COMBO. The first 20 points are a
    Sobol' sequence. Hyperparameters are learned and feature maps drawn anew for every ten new scores, or every tenth
    more if that is more; the process is conditioned on the scores in between.

    The points of a round come from as many samples of one process. Each sample chooses among its own candidates, so
    that a round contains no scenario twice and does not crowd at one end of a critical region.

    Samples of the process crowd where it is lowest. To find other critical regions, and to have less critical scenarios
    to compare with, a fraction of all points continues the Sobol' sequence.

    Parameters
    ----------
    space : ParameterSpace
    seed : int
    candidates : int, default 2000
        Number of points from which a round is chosen; drawn anew for each round.
    features : int, default 500
        Number of random features that approximate the kernel.
    filling : float, default 0.3
        Fraction of the points that fills the space; 0 is the paper's setting.
    """

    name = "bayes"

    def __init__(
        self, space: ParameterSpace, seed: int, candidates: int = 2000, features: int = 500, filling: float = 0.3
    ) -> None:
        super().__init__(space, seed, initial=_INITIAL, filling=filling)
        self._count, self._features = candidates, features
        self._process: FeatureProcess
        self._scale: tuple[float, float]

    def _learn(self, points: FloatArray, scores: FloatArray, seed: int) -> None:
        self._scale = float(scores.mean()), float(scores.std())
        with _alone(seed):
            self._process = _learned(self._places(points), self._target(scores), self._features)

    def _choose(self, points: FloatArray, scores: FloatArray, filling: FloatArray, n: int) -> FloatArray:
        # Thompson sampling: each point is the best of its part of the candidates, by its own sample of the process.
        candidates = self._new(max(self._count * n // (n + self._pending), n), filling)
        if len(candidates) <= n:
            return candidates
        # Consecutive points of a Sobol' sequence fill the space; every n-th point need not.
        parts = np.array_split(candidates, n)
        with one_thread():
            process = self._process.extended(self._places(points), self._target(scores))
            if self._pending:
                process = process.expecting(self._places(filling[: self._pending]))
            samples = process.samples(n, np.random.default_rng(self._round_seed))
            return np.array(
                [
                    part[np.argmax(process.features(self._places(part)) @ sample)]
                    for part, sample in zip(parts, samples, strict=True)
                ]
            )

    def _places(self, points: FloatArray) -> FloatArray:
        """Coordinates of points for the process, (n, e); choices are equidistant."""
        return 2.0 * encoded(self._space, points) - 1.0

    def _target(self, scores: FloatArray) -> FloatArray:
        """Standardized negative scores, which PHYSBO maximizes, (n,)."""
        mean, deviation = self._scale
        return -(scores - mean) / deviation


def _learned(points: FloatArray, values: FloatArray, features: int) -> FeatureProcess:
    """Process with the hyperparameters that PHYSBO learns by Adam, started at the best of five length scales."""
    import physbo

    gp = physbo.gp
    model = gp.core.Model(
        lik=gp.lik.Gauss(), mean=gp.mean.Const(), cov=gp.cov.Gauss(num_dim=points.shape[1], ard=False)
    )
    # Noise, mean, length scale and signal of the process; all but the mean as logarithms.
    signal = np.log(np.std(values))
    scales = np.log(np.quantile(pdist(points[evenly(len(points), _APART)]), (0.1, 0.3, 0.5, 0.7, 0.9)) + 1e-6)
    starts = [np.array([signal - np.log(10.0), np.median(values), scale, signal]) for scale in scales]
    start = min(starts, key=lambda x: model.eval_marlik(x.copy(), points[:_COMPARED], values[:_COMPARED]))
    config = physbo.misc.SetConfig()
    config.learning.alpha, config.learning.num_disp = _STEP_SIZE, 1
    # An epoch has a step per batch of points, so fewer epochs with more points keep the number of steps.
    epochs = max(1, _STEPS // max(1, len(points) // config.learning.batch_size))
    model.set_params(gp.core.learning.Adam(model, config).one_run(start, points, values, epochs))
    linear = model.export_blm(features).lik.linear
    frequencies, phases, amplitude = linear.basis.params
    scalars = [np.asarray(scalar).item() for scalar in (amplitude, linear.bias, model.lik.std)]
    return FeatureProcess(frequencies, phases, *scalars).extended(points, values)


@contextlib.contextmanager
def _alone(seed: int) -> Iterator[None]:
    """Silence PHYSBO, run it on one thread, and restore NumPy's global generator, which it draws from.

    Its matrices are small, so more threads would not be faster, and sums in another order would give other points.
    """
    state: Any = np.random.get_state()  # noqa: NPY002
    try:
        with contextlib.redirect_stdout(io.StringIO()), one_thread():
            np.random.seed(seed)  # noqa: NPY002
            yield
    finally:
        np.random.set_state(state)  # noqa: NPY002
