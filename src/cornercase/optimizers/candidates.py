"""Searches that choose among many points of the space by what they have learned."""

from __future__ import annotations

import math
from abc import abstractmethod

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.optimizers.base import Optimizer
from cornercase.optimizers.sequences import SobolOptimizer
from cornercase.scenario import ParameterSpace


class CandidateOptimizer(Optimizer):
    """Begins with a Sobol' sequence, then chooses among points of another one, drawn anew for each round.

    A share of all points goes on with the first sequence, so that a critical region is met that nothing points to.
    Each round is learned anew from all that was told and depends on nothing else.

    Parameters
    ----------
    space : ParameterSpace
    seed : int
    initial : int
        Points of the sequence before anything is learned.
    candidates : int
        Points among which a round chooses.
    filling : float
        Share of all points that fills the space.
    """

    def __init__(self, space: ParameterSpace, seed: int, *, initial: int, candidates: int, filling: float) -> None:
        self._space, self._seed = space, seed
        self._initial, self._candidates, self._filling = initial, candidates, filling
        self._sequence = SobolOptimizer(space, seed)
        self._points, self._scores = np.zeros((0, space.dimension)), np.zeros(0)

    def ask(self, n: int) -> FloatArray:
        """Propose at most `n` points, shape (m, d), as in `Optimizer.ask`."""
        told, scores = len(self._points), self._scores[self._known]
        if told < self._initial or len(scores) < 3 or np.ptp(scores) == 0.0:
            return self._sequence.ask(n)
        filling = self._sequence.ask(self._filled(told + n) - self._filled(told))
        wanted = n - len(filling)
        everyone = SobolOptimizer(self._space, self._round_seed)
        candidates = everyone.ask(max(self._candidates, wanted), besides=np.concatenate([self._points, filling]))
        if len(candidates) > wanted > 0:
            candidates = candidates[self._choose(candidates, filling, wanted)]
        return np.concatenate([candidates[:wanted], filling])

    def tell(self, points: FloatArray, scores: FloatArray) -> None:
        """Take scores, shape (m,), of points, shape (m, d), as in `Optimizer.tell`."""
        self._points = np.concatenate([self._points, points])
        self._scores = np.concatenate([self._scores, scores])
        self._sequence.tell(points, scores)

    @property
    def _known(self) -> BoolArray:
        return np.isfinite(self._scores)

    @property
    def _round_seed(self) -> int:
        return int(np.random.SeedSequence([self._seed, len(self._points)]).generate_state(1)[0])

    def _filled(self, told: int) -> int:
        return math.floor(self._filling * told + 1e-9)

    @abstractmethod
    def _choose(self, candidates: FloatArray, filling: FloatArray, n: int) -> IntArray:
        """Choose `n` different candidates.

        Parameters
        ----------
        candidates : ndarray of float64, shape (c, d)
        filling : ndarray of float64, shape (f, d)
            Points of this round that fill the space.
        n : int

        Returns
        -------
        ndarray of int64, shape (n,)
            Places among the candidates.
        """
