"""Bayesian optimization as in the paper: PHYSBO's Gaussian process with Thompson sampling."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from cornercase._common.typing import FloatArray, IntArray
from cornercase.optimizers.candidates import CandidateOptimizer
from cornercase.scenario import ParameterSpace

_INITIAL = 20


class BayesOptimizer(CandidateOptimizer):
    """Gaussian process over the unit cube, whose samples say where to look next.

    The setting is that of Schütt, Otten and Sax (2023), section "Optimization Workflow": automatic
    hyperparameters, Thompson sampling, random feature maps; PHYSBO is the maintained successor of their COMBO. The
    first 20 points are a Sobol' sequence. Each round learns the process anew from all that was told, so the next
    round depends on nothing else.

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
        super().__init__(space, seed, initial=_INITIAL, candidates=candidates, filling=filling)
        self._features = features

    def _choose(self, candidates: FloatArray, filling: FloatArray, n: int) -> IntArray:
        # Thompson sampling: each point is the best of its share of the candidates, by its own sample of the process.
        import physbo

        points, scores = self._points[self._known], self._scores[self._known]
        # PHYSBO maximises.
        target = -(scores - scores.mean()) / scores.std()
        # An epoch has a gradient step for each batch of points; fewer epochs with more points keep the number of steps.
        config = physbo.misc.SetConfig()
        learning = config.learning
        batches = max(1, len(points) // learning.batch_size)
        learning.max_epoch = max(1, learning.max_epoch // batches)
        learning.max_epoch_init_params_search = max(1, learning.max_epoch_init_params_search // batches)
        learning.num_disp, learning.eval_size = 1, 512
        with _alone(self._round_seed):
            policy = physbo.search.discrete.Policy(test_X=2.0 * candidates - 1.0, config=config)
            policy.bayes_search(
                training=physbo.Variable(X=2.0 * points - 1.0, t=target),
                max_num_probes=0,
                interval=0,
                num_rand_basis=self._features,
                is_disp=False,
            )
            # Consecutive points of a Sobol' sequence fill the space, which every n-th point need not do.
            shares = np.array_split(np.arange(len(candidates)), n)
            chosen = [share[np.argmax(policy.get_score("TS", actions=share))] for share in shares]
        return np.array(chosen, dtype=np.int64)


@contextlib.contextmanager
def _alone(seed: int) -> Iterator[None]:
    """Let PHYSBO print nothing, use one thread, and leave NumPy's global generator, which it draws from, as it was.

    Its matrices are small: more threads take no time off, and sums in another order would give other points.
    """
    state: Any = np.random.get_state()  # noqa: NPY002
    try:
        with contextlib.redirect_stdout(io.StringIO()), threadpool_limits(limits=1):
            np.random.seed(seed)  # noqa: NPY002
            yield
    finally:
        np.random.set_state(state)  # noqa: NPY002
