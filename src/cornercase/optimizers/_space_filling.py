"""Optimizers that propose space-filling sequences of points, and do not use scores."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.optimizers._base import Optimizer
from cornercase.optimizers._dedupe import Deduplicator
from cornercase.scenario import ParameterSpace

_CHUNK: Final = 256
_MAX_DRAWN: Final = 1 << 20
"""Number of points after which a sequence counts as exhausted; more if many were observed."""


class SequenceOptimizer(Optimizer):
    """Base class of optimizers that propose the points of an endless sequence, except scenarios that were run before.

    A finite space of up to 262,144 scenarios is run completely. When the sequence hardly reaches new scenarios any
    more, the remaining scenarios follow in a random order, which depends on the same seed. In a larger space the
    sequence ends after about a million points (`_MAX_DRAWN`).
    """

    multi_objective = True

    def prepare(self, space: ParameterSpace, seed: int) -> None:
        """Start the sequence in a space."""
        self._space, self._seed = space, seed
        self._deduplicator = Deduplicator(space)
        # Drawn points of the sequence that can be proposed.
        self._ready_points = np.zeros((0, space.dimension))
        self._n_drawn, self._is_exhausted = 0, False

    @abstractmethod
    def _draw_next(self, count: int) -> FloatArray:
        """Return the next points of the sequence, (count, d)."""

    def ask(self, n: int, exclude: FloatArray | None = None) -> FloatArray:
        """Propose the next points of the sequence, at most `n`, (m, d), neither observed nor in `exclude`.

        Parameters
        ----------
        n : int
        exclude : ndarray of float64, shape (k, d), optional
            Further points to leave out.

        Returns
        -------
        ndarray of float64, shape (m, d)
            Fewer than n points only if the space has no more points, or if the sequence has ended.
        """
        while len(points := self._filter_ready_points(exclude)) < n and self._draw_more(n - len(points)):
            pass
        return points[:n]

    def ask_async(self, n: int, pending: FloatArray, *lies: Any) -> FloatArray:
        """Propose the next points of the sequence that are not pending."""
        return self.ask(n, exclude=pending)

    def tell(self, points: FloatArray, scores: FloatArray) -> None:
        """Exclude the points, shape (m, d), from further proposals; scores have no effect."""
        self._deduplicator.remember(points)
        self._ready_points = self._deduplicator.filter_snapped(self._ready_points)

    def _filter_ready_points(self, exclude: FloatArray | None) -> FloatArray:
        # `_ready_points` has no observed points, so it is filtered only if there is something to exclude.
        return (
            self._ready_points
            if exclude is None or not len(exclude)
            else self._deduplicator.filter_snapped(self._ready_points, exclude)
        )

    def _draw_more(self, missing: int) -> bool:
        """Draw as many further points of the sequence as were drawn before, or more if `missing` is larger.

        Returns False if there are no more points.
        """
        if self._is_exhausted:
            return False
        size = self._space.size
        finite_size = size if size is not None and size <= _MAX_DRAWN // 4 else None
        if finite_size is not None and self._n_drawn >= 4 * finite_size:
            points = np.random.default_rng(self._seed).permutation(self._space.full_factorial())
            self._is_exhausted = True
        elif self._n_drawn >= _MAX_DRAWN + 4 * len(self._deduplicator):
            return False
        else:
            count = max(_CHUNK, self._n_drawn)
            while finite_size is None and count < min(missing, _MAX_DRAWN):
                count *= 2
            self._n_drawn += count
            points = self._draw_next(count)
        self._ready_points = np.concatenate(
            [self._ready_points, self._deduplicator.filter(points, exclude=self._ready_points)]
        )
        return True


class Sobol(SequenceOptimizer):
    """Scrambled Sobol' sequence.

    Source: A. B. Owen, "Scrambling Sobol' and Niederreiter-Xing points", Journal of Complexity 14 (1998); implemented
    in scipy.

    Examples
    --------
    >>> import cornercase as cc
    >>> search = cc.optimizers.Sobol()
    >>> str(search)
    'sobol'
    >>> study.explore(search, budget=100)  # doctest: +SKIP
    """

    name = "sobol"

    def prepare(self, space: ParameterSpace, seed: int) -> None:
        super().prepare(space, seed)
        # Imported late, since it takes half a second and few searches need it.
        from scipy.stats import qmc

        self._sobol = qmc.Sobol(space.dimension, scramble=True, seed=np.random.default_rng(seed))

    def _draw_next(self, count: int) -> FloatArray:
        return np.asarray(self._sobol.random(count))


class Random(SequenceOptimizer):
    """Independent points, uniform over the unit cube.

    Examples
    --------
    >>> import cornercase as cc
    >>> search = cc.optimizers.Random()
    >>> str(search)
    'random'
    >>> study.explore(search, budget=100)  # doctest: +SKIP
    """

    name = "random"

    def prepare(self, space: ParameterSpace, seed: int) -> None:
        super().prepare(space, seed)
        self._random = np.random.default_rng(seed)

    def _draw_next(self, count: int) -> FloatArray:
        return self._random.random((count, self._space.dimension))
