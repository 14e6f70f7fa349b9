"""Searches that choose among many points of the space by what they have learned."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Any, ClassVar, Final

import numpy as np

from cornercase._common.threads import one_thread
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.optimizers.base import Optimizer
from cornercase.optimizers.sequences import SobolOptimizer
from cornercase.scenario import ParameterSpace

_STEP: Final = 10
"""Scenarios after which a model is learned anew, or a share of what it was learned from where that is more."""

_FEWEST: Final = 3
"""Scores from which something is learned."""


class CandidateOptimizer(Optimizer):
    """Begins with a Sobol' sequence, then chooses among points of another one by a model of the scores.

    A share of all points goes on with the first sequence, so that a critical region is met that nothing points to.

    What is costly to learn, such as the kernel of a Gaussian process, is learned each time that ten scenarios more
    were told, failed ones too, or a tenth more where that is more: from the first 20, the first 30, and so on to 100,
    110, 121. The scores that came since then are known to the model too. So each round depends on what was told and on
    nothing else, not on the size of the rounds either.

    Points that are being run, in a search without rounds, count in the share that fills the space. To choose others
    they are known without a score, like those of the same round which fill the space.

    Parameters
    ----------
    space : ParameterSpace
    seed : int
    initial : int
        Points of the sequence before anything is learned.
    filling : float
        Share of all points that fills the space.
    """

    growth: ClassVar[float] = 0.1
    """Share of what was learned from by which it has to grow before it is learned anew."""

    def __init__(self, space: ParameterSpace, seed: int, *, initial: int, filling: float) -> None:
        self._space, self._seed = space, seed
        self._initial, self._filling = initial, filling
        self._sequence = SobolOptimizer(space, seed)
        self._points, self._scores = np.zeros((0, space.dimension)), np.zeros(0)
        self._learned, self._pending = 0, 0

    def ask(self, n: int) -> FloatArray:
        """Propose at most `n` points, shape (m, d), as in `Optimizer.ask`."""
        return self.ask_beside(n, self._points[:0])

    def ask_beside(self, n: int, pending: FloatArray, *lies: Any) -> FloatArray:
        """Propose points, as in `Optimizer.ask_beside`: the model knows of `pending` where it is run, and no lie."""
        with one_thread():
            return self._ask(n, pending)

    def _ask(self, n: int, pending: FloatArray) -> FloatArray:
        scores = self._scores[self._known]
        if not self._begins() or len(scores) < _FEWEST or np.ptp(scores) == 0.0:
            return self._sequence.ask(n, besides=pending)
        self._pending = len(pending)
        points, number = self._points[self._known], self._number()
        first = int(self._known[:number].sum())
        if number != self._learned:
            self._learned = number
            self._learn(points[:first], scores[:first], self._seed_of(number))
        share = self._filled(self._asked + n) - self._filled(self._asked)
        filling = self._sequence.ask(min(share, n), besides=pending)
        if (wanted := n - len(filling)) == 0:
            return filling
        besides = np.concatenate([pending, filling])
        return np.concatenate([self._choose(points[first:], scores[first:], besides, wanted), filling])

    def tell(self, points: FloatArray, scores: FloatArray) -> None:
        """Take scores, shape (m,), of points, shape (m, d), as in `Optimizer.tell`."""
        self._points = np.concatenate([self._points, points])
        self._scores = np.concatenate([self._scores, scores])
        self._sequence.tell(points, scores)

    def _begins(self) -> bool:
        """Whether enough was told to learn from."""
        return len(self._points) >= self._initial

    @property
    def _known(self) -> BoolArray:
        return np.isfinite(self._scores)

    @property
    def _asked(self) -> int:
        """Number of points that were told, or are being run."""
        return len(self._points) + self._pending

    @property
    def _round_seed(self) -> int:
        return self._seed_of(self._asked)

    def _seed_of(self, number: int) -> int:
        return int(np.random.SeedSequence([self._seed, number]).generate_state(1)[0])

    def _number(self) -> int:
        """Number of scenarios, the first ones, from which is learned."""
        told = len(self._scores)
        number = min(_STEP, told)
        while (more := number + max(_STEP, int(self.growth * number))) <= told:
            number = more
        known = self._scores[:number][self._known[:number]]
        return number if len(known) >= _FEWEST and np.ptp(known) > 0.0 else told

    def _filled(self, told: int) -> int:
        return math.floor(self._filling * told + 1e-9)

    def _new(self, count: int, filling: FloatArray) -> FloatArray:
        """Points of a sequence of this round, shape (m, d), that were neither told nor are in `filling`, (f, d)."""
        return self._drawn(self._round_seed, count, np.concatenate([self._points, filling]))

    def _drawn(self, seed: int, count: int, besides: FloatArray) -> FloatArray:
        """Points of a sequence of its own, shape (m, d), without those of `besides`, shape (k, d)."""
        sequence = SobolOptimizer(self._space, seed)
        # Told, so that they are left out as the points are drawn, and not looked for again among all of them.
        sequence.tell(besides, np.zeros(len(besides)))
        return sequence.ask(count)

    @abstractmethod
    def _learn(self, points: FloatArray, scores: FloatArray, seed: int) -> None:
        """Learn from points, shape (m, d), and their scores, shape (m,), which are not all the same."""

    @abstractmethod
    def _choose(self, points: FloatArray, scores: FloatArray, filling: FloatArray, n: int) -> FloatArray:
        """Choose points of this round.

        Parameters
        ----------
        points : ndarray of float64, shape (m, d)
            Those that came since something was learned.
        scores : ndarray of float64, shape (m,)
        filling : ndarray of float64, shape (f, d)
            Points that are being run, and those of this round that fill the space.
        n : int

        Returns
        -------
        ndarray of float64, shape (k, d)
            Neither told nor in `filling`; k < n only when the space has no more.
        """
