"""Base class of optimizers that choose points among candidates by a model of the scores."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Any, ClassVar, Final

import numpy as np

from cornercase._common.numba.blas import single_threaded_blas
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.optimizers._base import Optimizer
from cornercase.optimizers._space_filling import Sobol
from cornercase.scenario import ParameterSpace

MIN_NEW_SCENARIOS: Final = 10  # number of new scenarios after which the model is learned anew, at least
_MIN_SCORES: Final = 3  # number of scores from which the model is learned


class CandidateOptimizer(Optimizer):
    """Base class of optimizers that choose points among candidates by a model of the scores.

    The first points are a Sobol' sequence. Candidates come from another sequence. A fraction of all points continues
    the first sequence, to find critical regions that the model does not predict.

    Costly parts of the model, such as the kernel of a Gaussian process, are learned again after every ten new
    scenarios, or when the number of scenarios has grown by a tenth if that is later: from the first 20, the first 30,
    and so on to 100, 110, 121. Failed scenarios count. In between, the model is only conditioned on the new scores. So
    proposals depend on the observed results only, not on the sizes of the earlier rounds.

    In a search without rounds, some points are pending: proposed, but without a result. The fraction of space-filling
    points is a fraction of all proposed points, including pending ones. The model knows the positions of pending
    points, and of the space-filling points of the same round, but no scores of them.

    A subclass sets `initial`, the number of points before anything is learned, and `_filling`, the fraction of all
    points that fills the space.
    """

    initial: ClassVar[int]

    relearn_growth: ClassVar[float] = 0.1
    """Relative growth of the data after which the model is learned anew."""

    _filling: float

    def prepare(self, space: ParameterSpace, seed: int, *further: Any, **required: Any) -> None:
        """Start the Sobol' sequence of the space."""
        self._space, self._seed = space, seed
        self._sequence = Sobol().start(space, seed)
        self._points, self._scores = np.zeros((0, space.dimension)), np.zeros(0)
        self._n_learned, self._n_pending = 0, 0

    def ask(self, n: int) -> FloatArray:
        """Propose at most `n` points, (m, d), as in `Optimizer.ask`."""
        return self.ask_async(n, self._points[:0])

    def ask_async(self, n: int, pending: FloatArray, *lies: Any) -> FloatArray:
        """Propose points while others are pending; the model knows where `pending` points are, but not their scores."""
        with single_threaded_blas():
            return self._propose(n, pending)

    def _propose(self, n: int, pending: FloatArray) -> FloatArray:
        scores = self._scores[self._is_finished]
        if not self._has_enough_scores() or len(scores) < _MIN_SCORES or np.ptp(scores) == 0.0:
            return self._sequence.ask(n, exclude=pending)
        self._n_pending = len(pending)
        points, number = self._points[self._is_finished], self._count_to_learn_from()
        first = int(self._is_finished[:number].sum())
        if number != self._n_learned:
            self._n_learned = number
            self._fit_model(points[:first], scores[:first], self._seed_of(number))
        count = self._count_space_filling(self._n_proposed + n) - self._count_space_filling(self._n_proposed)
        filling = self._sequence.ask(min(count, n), exclude=pending)
        if (remaining := n - len(filling)) == 0:
            return filling
        exclude = np.concatenate([pending, filling])
        return np.concatenate([self._choose_points(points[first:], scores[first:], exclude, remaining), filling])

    def tell(self, points: FloatArray, scores: FloatArray) -> None:
        """Observe scores (m,) of points (m, d), as in `Optimizer.tell`."""
        self._points = np.concatenate([self._points, points])
        self._scores = np.concatenate([self._scores, scores])
        self._sequence.tell(points, scores)

    def _has_enough_scores(self) -> bool:
        """Return True if there are enough scores to learn from."""
        return len(self._points) >= self.initial

    @property
    def _is_finished(self) -> BoolArray:
        return np.isfinite(self._scores)

    @property
    def _n_proposed(self) -> int:
        """Number of points that were observed or are pending."""
        return len(self._points) + self._n_pending

    @property
    def _round_seed(self) -> int:
        return self._seed_of(self._n_proposed)

    def _seed_of(self, number: int) -> int:
        return int(np.random.SeedSequence([self._seed, number]).generate_state(1)[0])

    def _count_to_learn_from(self) -> int:
        """Return how many of the first scenarios the model is learned from."""
        count = len(self._scores)
        number = min(MIN_NEW_SCENARIOS, count)
        while (more := number + max(MIN_NEW_SCENARIOS, int(self.relearn_growth * number))) <= count:
            number = more
        scores = self._scores[:number][self._is_finished[:number]]
        return number if len(scores) >= _MIN_SCORES and np.ptp(scores) > 0.0 else count

    def _count_space_filling(self, n_points: int) -> int:
        return math.floor(self._filling * n_points + 1e-9)

    def _draw_round_candidates(self, count: int, filling: FloatArray) -> FloatArray:
        """Draw candidates for this round, shape (m, d), that were not observed before.

        Points in `filling`, shape (f, d), which are pending or already chosen for this round, are left out.
        """
        return self._draw_candidates(self._round_seed, count, np.concatenate([self._points, filling]))

    def _draw_candidates(self, seed: int, count: int, exclude: FloatArray) -> FloatArray:
        """Draw candidates from a new Sobol' sequence with the given seed, shape (m, d).

        Points in `exclude`, shape (k, d), are left out.
        """
        sequence = Sobol().start(self._space, seed)
        # If the sequence observes the excluded points, this is faster than to filter all drawn points afterwards.
        sequence.tell(exclude, np.zeros(len(exclude)))
        return sequence.ask(count)

    @abstractmethod
    def _fit_model(self, points: FloatArray, scores: FloatArray, seed: int) -> None:
        """Learn the model from points (m, d) and their scores (m,), which are not all the same."""

    @abstractmethod
    def _choose_points(self, points: FloatArray, scores: FloatArray, filling: FloatArray, n: int) -> FloatArray:
        """Choose at most `n` points for this round, (k, d), neither observed nor in `filling`.

        `points` (m, d) and `scores` (m,) were observed since the model was learned. `filling` (f, d) are the pending
        points and the space-filling points of this round. There are fewer than `n` points only if the space is
        exhausted.
        """
