"""Points that fill the space evenly, without looking at scores."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.stats import qmc

from cornercase._common.typing import FloatArray
from cornercase.scenario import ParameterSpace

_CHUNK: Final = 256
_MOST: Final = 1 << 20


class SequenceOptimizer:
    """Proposes an endless sequence of points, leaving out scenarios that were told before.

    A finite space is run whole: when the sequence hardly meets new scenarios any more, those that are left follow in a
    random order of the same seed.

    Parameters
    ----------
    space : ParameterSpace
    seed : int
    kind : {"sobol", "random"}
        A scrambled Sobol' sequence (Owen 1998), or independent uniform points.
    """

    takes_several = True

    def __init__(self, space: ParameterSpace, seed: int, kind: str) -> None:
        self.name = kind
        self._space, self._seed = space, seed
        self._told: set[bytes] = set()
        self._sequence = np.zeros((0, space.dimension))
        self._keys: list[bytes] = []
        self._first, self._drawn, self._over = 0, 0, False
        self._random = np.random.default_rng(seed)
        self._sobol = qmc.Sobol(space.dimension, scramble=True, seed=np.random.default_rng(seed))

    def ask(self, n: int, besides: FloatArray | None = None) -> FloatArray:
        """Return at most `n` points, shape (m, d), none of which was told or is in `besides`, shape (k, d).

        m < n only when the space has no more.
        """
        left_out = self._told if besides is None else self._told | self._as_keys(besides)
        while self._first < len(self._keys) and self._keys[self._first] in self._told:
            self._first += 1
        found: dict[bytes, int] = {}
        place = self._first
        while len(found) < n and (place < len(self._keys) or self._lengthen()):
            key = self._keys[place]
            if key not in left_out:
                found.setdefault(key, place)
            place += 1
        return self._sequence[list(found.values())].reshape(-1, self._space.dimension)

    def tell(self, points: FloatArray, scores: FloatArray) -> None:
        """Remember what was run."""
        self._told |= self._as_keys(points)

    def _as_keys(self, points: FloatArray) -> set[bytes]:
        return {point.tobytes() for point in self._space.snap(points)}

    def _lengthen(self) -> bool:
        """Draw as many points again; False when there are no more."""
        size = self._space.size
        if self._over or self._drawn >= _MOST + 4 * len(self._told):
            return False
        if size is not None and size <= _MOST // 4 and self._drawn >= 4 * size:
            points = np.random.default_rng(self._seed).permutation(self._space.lattice())
            self._over = True
        else:
            count = max(_CHUNK, self._drawn)
            self._drawn += count
            points = self._space.snap(
                self._sobol.random(count)
                if self.name == "sobol"
                else self._random.random((count, self._space.dimension))
            )
        points = points[self._space.admits(points)]
        self._sequence = np.concatenate([self._sequence, points])
        self._keys += [point.tobytes() for point in points]
        return True


def sobol(space: ParameterSpace, seed: int) -> SequenceOptimizer:
    """Scrambled Sobol' sequence of scipy."""
    return SequenceOptimizer(space, seed, "sobol")


def random(space: ParameterSpace, seed: int) -> SequenceOptimizer:
    """Independent uniform points."""
    return SequenceOptimizer(space, seed, "random")
