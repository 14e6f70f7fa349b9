"""Points that fill the space evenly, without looking at scores."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.optimizers.base import Optimizer
from cornercase.optimizers.unseen import Unseen
from cornercase.scenario import ParameterSpace

_CHUNK: Final = 256
_MOST: Final = 1 << 20
"""Points that are drawn before a sequence counts as used up; more where many were told."""


class SequenceOptimizer(Optimizer):
    """Proposes the points of an endless sequence, without scenarios that were told before.

    A finite space is run whole: when the sequence hardly meets new scenarios any more, those that are left follow in a
    random order of the same seed.

    Parameters
    ----------
    space : ParameterSpace
    seed : int
    """

    takes_several = True

    def __init__(self, space: ParameterSpace, seed: int) -> None:
        self._space, self._seed = space, seed
        self._unseen = Unseen(space)
        # Points of the sequence that were drawn and can be proposed.
        self._ahead = np.zeros((0, space.dimension))
        self._drawn, self._over = 0, False

    @abstractmethod
    def _draw(self, count: int) -> FloatArray:
        """Return the next points of the sequence, shape (count, d)."""

    def ask(self, n: int, besides: FloatArray | None = None) -> FloatArray:
        """Propose the next points of the sequence.

        Parameters
        ----------
        n : int
        besides : ndarray of float64, shape (k, d), optional
            Further points to leave out.

        Returns
        -------
        ndarray of float64, shape (m, d)
            None of them was told or is in `besides`; m < n only when the space has no more.
        """
        while len(found := self._left(besides)) < n and self._lengthen(n - len(found)):
            pass
        return found[:n]

    def ask_beside(self, n: int, pending: FloatArray, *lies: Any) -> FloatArray:
        """Propose the next points of the sequence, as in `Optimizer.ask_beside`; no lie is needed."""
        return self.ask(n, besides=pending)

    def tell(self, points: FloatArray, scores: FloatArray) -> None:
        """Leave these points, shape (m, d), out from now on; the scores are not looked at."""
        self._unseen.tell(points)
        self._ahead = self._unseen.left(self._ahead)

    def _left(self, besides: FloatArray | None) -> FloatArray:
        # What is ahead was never told, and is looked through again only where there is something to leave out.
        return self._ahead if besides is None or not len(besides) else self._unseen.left(self._ahead, besides)

    def _lengthen(self, missing: int) -> bool:
        """Draw as many points again, or at least as many as are missing; False when there are no more."""
        size = self._space.size
        if self._over or self._drawn >= _MOST + 4 * len(self._unseen):
            return False
        listed = size if size is not None and size <= _MOST // 4 else None
        if listed is not None and self._drawn >= 4 * listed:
            points = np.random.default_rng(self._seed).permutation(self._space.lattice())
            self._over = True
        else:
            count = max(_CHUNK, self._drawn)
            while listed is None and count < min(missing, _MOST):
                count *= 2
            self._drawn += count
            points = self._draw(count)
        self._ahead = np.concatenate([self._ahead, self._unseen.among(points, besides=self._ahead)])
        return True


class SobolOptimizer(SequenceOptimizer):
    """Scrambled Sobol' sequence.

    Parameters
    ----------
    space : ParameterSpace
    seed : int

    Notes
    -----
    Source: A. B. Owen, "Scrambling Sobol' and Niederreiter-Xing points", Journal of Complexity 14 (1998); implemented
    in scipy.
    """

    name = "sobol"

    def __init__(self, space: ParameterSpace, seed: int) -> None:
        super().__init__(space, seed)
        # The package takes half a second to load, and few searches need it.
        from scipy.stats import qmc

        self._sobol = qmc.Sobol(space.dimension, scramble=True, seed=np.random.default_rng(seed))

    def _draw(self, count: int) -> FloatArray:
        return np.asarray(self._sobol.random(count))


class RandomOptimizer(SequenceOptimizer):
    """Independent points, uniform over the unit cube.

    Parameters
    ----------
    space : ParameterSpace
    seed : int
    """

    name = "random"

    def __init__(self, space: ParameterSpace, seed: int) -> None:
        super().__init__(space, seed)
        self._random = np.random.default_rng(seed)

    def _draw(self, count: int) -> FloatArray:
        return self._random.random((count, self._space.dimension))
