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
# Steps of Adam and their size: a tenth of PHYSBO's number, ten times as long.
_STEPS, _STEP_SIZE = 50, 0.01
# Points on which widths to begin with are compared.
_COMPARED: Final = 200
# Points whose distances from each other say which widths those are.
_APART: Final = 2000


class BayesOptimizer(CandidateOptimizer):
    """Gaussian process over the unit cube, whose samples say where to look next.

    The setting is that of Schütt, Otten and Sax (2023), section "Optimization Workflow": automatic
    hyperparameters, Thompson sampling, random feature maps; PHYSBO is the maintained successor of their COMBO. The
    first 20 points are a Sobol' sequence. The hyperparameters are learned, and the feature maps drawn, each time that
    there are ten scores more to learn from, or a tenth more where that is more; what was told since then is known to
    the process too.

    A round is that many samples of one process. Each sample chooses among candidates of its own, which keeps a round
    from running the same scenario twice and from crowding at one end of a critical region.

    Samples of the process crowd where it is lowest. So that a critical region elsewhere is not overlooked, and less
    critical scenarios are there to be compared with, a share of all points goes on with the Sobol' sequence.

    Parameters
    ----------
    space : ParameterSpace
    seed : int
    candidates : int, default 2000
        Points among which a round chooses; drawn anew for each.
    features : int, default 500
        Random features that stand for the kernel.
    filling : float, default 0.3
        Share of the points that fills the space; 0 is the paper's setting.
    """

    name = "bayes"

    def __init__(
        self,
        space: ParameterSpace,
        seed: int,
        candidates: int = 2000,
        features: int = 500,
        filling: float = 0.3,
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
        # Thompson sampling: each point is the best of its share of the candidates, by its own sample of the process.
        candidates = self._new(max(self._count * n // (n + self._pending), n), filling)
        if len(candidates) <= n:
            return candidates
        # Consecutive points of a Sobol' sequence fill the space, which every n-th point need not do.
        shares = np.array_split(candidates, n)
        with one_thread():
            process = self._process.extended(self._places(points), self._target(scores))
            if self._pending:
                process = process.expecting(self._places(filling[: self._pending]))
            samples = process.samples(n, np.random.default_rng(self._round_seed))
            chosen = [
                np.argmax(process.features(self._places(share)) @ sample)
                for share, sample in zip(shares, samples, strict=True)
            ]
        return np.array([share[k] for share, k in zip(shares, chosen, strict=True)])

    def _places(self, points: FloatArray) -> FloatArray:
        """Where the process has points, shape (n, e): names are equally far from each other."""
        return 2.0 * encoded(self._space, points) - 1.0

    def _target(self, scores: FloatArray) -> FloatArray:
        """What PHYSBO maximises, shape (n,)."""
        mean, deviation = self._scale
        return -(scores - mean) / deviation


def _learned(points: FloatArray, values: FloatArray, features: int) -> FeatureProcess:
    """Process of the hyperparameters that PHYSBO learns: from the best of five widths on, by Adam."""
    import physbo

    kinds = physbo.gp
    model = kinds.core.Model(
        lik=kinds.lik.Gauss(), mean=kinds.mean.Const(), cov=kinds.cov.Gauss(num_dim=points.shape[1], ard=False)
    )
    # Noise, mean, width and size of the process; all but the mean as logarithms.
    size = np.log(np.std(values))
    widths = np.log(np.quantile(pdist(points[evenly(len(points), _APART)]), (0.1, 0.3, 0.5, 0.7, 0.9)) + 1e-6)
    starts = [np.array([size - np.log(10.0), np.median(values), width, size]) for width in widths]
    some = slice(None, _COMPARED)
    start = min(starts, key=lambda one: model.eval_marlik(one.copy(), points[some], values[some]))
    config = physbo.misc.SetConfig()
    config.learning.alpha, config.learning.num_disp = _STEP_SIZE, 1
    # An epoch has a step for each batch of points; fewer epochs with more points keep the number of steps.
    epochs = max(1, _STEPS // max(1, len(points) // config.learning.batch_size))
    model.set_params(kinds.core.learning.Adam(model, config).one_run(start, points, values, epochs))
    linear = model.export_blm(features).lik.linear
    frequencies, phases, amplitude = linear.basis.params
    numbers = [np.asarray(number).item() for number in (amplitude, linear.bias, model.lik.std)]
    process = FeatureProcess(frequencies, phases, *numbers)
    return process.extended(points, values)


@contextlib.contextmanager
def _alone(seed: int) -> Iterator[None]:
    """Let PHYSBO print nothing, use one thread, and leave NumPy's global generator, which it draws from, as it was.

    Its matrices are small: more threads take no time off, and sums in another order would give other points.
    """
    state: Any = np.random.get_state()  # noqa: NPY002
    try:
        with contextlib.redirect_stdout(io.StringIO()), one_thread():
            np.random.seed(seed)  # noqa: NPY002
            yield
    finally:
        np.random.set_state(state)  # noqa: NPY002
