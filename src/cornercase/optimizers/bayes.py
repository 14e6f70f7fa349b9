"""Bayesian optimization as in the paper: PHYSBO's Gaussian process with Thompson sampling."""

from __future__ import annotations

import contextlib
import io
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from cornercase.optimizers.sobol import SequenceOptimizer
from cornercase.scenario.space import ParameterSpace
from cornercase.typing import FloatArray

_INITIAL = 20


class BayesOptimizer:
    """Gaussian process over the unit cube, whose samples say where to look next.

    The setting is that of Schütt, Otten and Sax (2023), section "Optimization Workflow": automatic
    hyperparameters, Thompson sampling, random feature maps; PHYSBO is the maintained successor of their COMBO. The
    first 20 points are a Sobol' sequence. Each round learns the process anew from all that was told, so the next
    round depends on nothing else.

    Samples of the process crowd where it is lowest. So that a critical region elsewhere is not overlooked, and less
    critical scenarios are there to be compared with, a share of each round goes on with the Sobol' sequence.

    Parameters
    ----------
    space : ParameterSpace
    seed : int
    candidates : int, default 2000
        Points among which a round chooses; drawn anew for each.
    features : int, default 500
        Random features that stand for the kernel.
    filling : float, default 0.3
        Share of a round that fills the space; 0 is the paper's setting.
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
        self._space, self._seed = space, seed
        self._candidates, self._features, self._filling = candidates, features, filling
        self._start = SequenceOptimizer(space, seed, "sobol")
        self._points = np.zeros((0, space.dimension))
        self._scores = np.zeros(0)

    def ask(self, n: int) -> FloatArray:
        """Return at most `n` points, shape (m, d), none of which was told before."""
        told = len(self._points)
        known = np.isfinite(self._scores)
        if told < _INITIAL:
            return self._start.ask(min(n, _INITIAL - told))
        if known.sum() < 3 or np.ptp(self._scores[known]) == 0.0:
            return self._start.ask(n)
        filling = self._start.ask(int(n * self._filling))
        rest = SequenceOptimizer(self._space, _seed(self._seed, told), "sobol")
        rest.tell(np.concatenate([self._points, filling]), np.zeros(told + len(filling)))
        candidates = rest.ask(self._candidates)
        wanted = n - len(filling)
        if len(candidates) > wanted:
            seed = _seed(self._seed, told)
            candidates = candidates[self._thompson(candidates, self._points[known], self._scores[known], wanted, seed)]
        return np.concatenate([candidates, filling])

    def tell(self, points: FloatArray, scores: FloatArray) -> None:
        """Take scores, lower being more critical; NaN for a scenario that failed."""
        self._points = np.concatenate([self._points, points])
        self._scores = np.concatenate([self._scores, scores])
        self._start.tell(points, scores)

    def _thompson(self, candidates: FloatArray, points: FloatArray, scores: FloatArray, n: int, seed: int) -> list[int]:
        import physbo

        # PHYSBO maximises, and takes its random numbers from NumPy's global generator.
        target = -(scores - scores.mean()) / scores.std()
        state: Any = np.random.get_state()  # noqa: NPY002
        try:
            # One thread: the matrices are small, and the number of threads would change the last digits.
            with contextlib.redirect_stdout(io.StringIO()), threadpool_limits(limits=1):
                policy = physbo.search.discrete.Policy(test_X=2.0 * candidates - 1.0)
                policy.set_seed(seed)
                training = physbo.Variable(X=2.0 * points - 1.0, t=target)
                # A round is that many samples of one posterior: the process is learned for the first only.
                chosen = [
                    int(action)
                    for k in range(n)
                    for action in policy.bayes_search(
                        training=training if k == 0 else None,
                        max_num_probes=1,
                        is_disp=False,
                        score="TS",
                        interval=0 if k == 0 else -1,
                        num_rand_basis=self._features,
                    )
                ]
        finally:
            np.random.set_state(state)  # noqa: NPY002
        return list(dict.fromkeys(chosen))


def _seed(seed: int, told: int) -> int:
    return int(np.random.SeedSequence([seed, told]).generate_state(1)[0])
