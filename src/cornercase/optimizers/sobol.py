"""Points that fill the space evenly, without looking at scores."""

from __future__ import annotations

import numpy as np
from scipy.stats import qmc

from cornercase.scenario.space import ParameterSpace
from cornercase.typing import FloatArray


class SequenceOptimizer:
    """Proposes an endless sequence of points, leaving out scenarios that it proposed before.

    Parameters
    ----------
    space : ParameterSpace
    seed : int
    kind : {"sobol", "random"}
        A scrambled Sobol' sequence (Owen 1998), or independent uniform points.
    """

    def __init__(self, space: ParameterSpace, seed: int, kind: str) -> None:
        self.name = kind
        self._space, self._seed = space, seed
        self._seen: dict[bytes, None] = {}

    def ask(self, n: int) -> FloatArray:
        """Return at most `n` points, shape (m, d), none of which was told or asked before."""
        wanted, new = len(self._seen) + n, dict[bytes, FloatArray]()
        drawn, last = 0, 0
        while len(new) < n:
            drawn = max(2 * drawn, 1 << (2 * wanted - 1).bit_length())
            if drawn > 1 << 20:
                break
            points = self._space.snap(self._draw(drawn))
            for point in points[last:]:
                key = point.tobytes()
                if key not in self._seen and len(new) < n:
                    new.setdefault(key, point)
            last = drawn
            if self._space.size is not None and len(self._seen) + len(new) >= self._space.size:
                break
        return np.array(list(new.values())).reshape(-1, self._space.dimension)

    def tell(self, points: FloatArray, scores: FloatArray) -> None:
        """Remember what was run."""
        self._seen.update(dict.fromkeys(point.tobytes() for point in self._space.snap(points)))

    def _draw(self, count: int) -> FloatArray:
        if self.name == "random":
            return np.random.default_rng(self._seed).random((count, self._space.dimension))
        engine = qmc.Sobol(self._space.dimension, scramble=True, rng=np.random.default_rng(self._seed))
        return np.asarray(engine.random(count))


def sobol(space: ParameterSpace, seed: int) -> SequenceOptimizer:
    """Scrambled Sobol' sequence of scipy."""
    return SequenceOptimizer(space, seed, "sobol")


def random(space: ParameterSpace, seed: int) -> SequenceOptimizer:
    """Independent uniform points."""
    return SequenceOptimizer(space, seed, "random")
