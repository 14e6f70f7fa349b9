"""Search for the whole set of critical scenarios by what a committee is not sure of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from cornercase._common.typing import FloatArray, IntArray
from cornercase.evidence import Committee, encoded, with_foretold
from cornercase.metrics import Feature
from cornercase.optimizers.begun import BegunOptimizer
from cornercase.optimizers.unseen import Unseen
from cornercase.scenario import ParameterSpace

_INITIAL: Final = 24
_TREES: Final = 64
# What not knowing which way a scenario goes counts, against not knowing whether it is critical.
_WAY: Final = 0.5
# Scenarios are spread less along a coordinate on which the score hangs less: this little at least.
_LEAST: Final = 0.1
# Candidates near a scenario that is critical, as a share, and how far from it they are.
_NEAR, _STEP = 0.85, 0.06


class CommitteeOptimizer(BegunOptimizer):
    """Asks for the scenarios of which a `Committee` is least sure.

    It learns from what happened in the runs, by features of their recordings, so that it follows scores that jump
    where a scenario goes another way. It asks where the mean probability that a scenario is critical is near one half,
    and where it is not sure which way a scenario goes: who is first, or whether both touch. The points of a round are
    spread out, the more along a coordinate the shorter the way on which the score varies along it. The first 24
    points, and a share of all others, are a Sobol' sequence, so that a critical region that nothing points to is met.

    While no scenario is critical, it looks for lower scores: the threshold is then the lowest score so far; and
    likewise while all are critical. Where scenarios fail, it learns where, and asks there less, the likelier they
    fail.

    With another study to begin from, what it predicts is one more coordinate for all members (`Elsewhere`). Half of the
    first 10 points are where it predicts the boundary, and the members learn from fewer points where it predicts the
    first 10 of them, or more.

    The kernels of the committee are learned each time that there are ten scores more to learn from, or a quarter
    more where that is more.

    Parameters
    ----------
    space : ParameterSpace
    seed : int
    threshold : float
        Score up to which a scenario is critical.
    features : sequence of Feature, optional
        What it is told of each scenario beside its score. Without any, or when it is told none, it learns from the
        scores alone.
    candidates : int, default 4096
        Points among which a round is chosen; 85 % of them near critical scenarios.
    filling : float, default 0.15
        Share of the points that fills the space.
    """

    name = "committee"
    needs = frozenset({"threshold", "features"})
    growth = 0.25

    def __init__(
        self,
        space: ParameterSpace,
        seed: int,
        threshold: float,
        features: Sequence[Feature] = (),
        candidates: int = 4096,
        filling: float = 0.15,
    ) -> None:
        super().__init__(space, seed, initial=_INITIAL, filling=filling)
        self.threshold, self._features, self._count = threshold, tuple(features), candidates
        self._unseen = Unseen(space)
        self._told: FloatArray | None = np.zeros((0, len(self._features))) if self._features else None
        self._committee: Committee

    def tell(self, points: FloatArray, scores: FloatArray, features: FloatArray | None = None) -> None:
        """Take the scores of one round, as in `Optimizer.tell`, and features of the recordings.

        Parameters
        ----------
        points : ndarray of float64, shape (m, d)
        scores : ndarray of float64, shape (m,)
            NaN for a scenario that failed.
        features : ndarray of float64, shape (m, f), optional
            NaN for a scenario that failed.
        """
        super().tell(points, scores)
        self._unseen.tell(points)
        self._told = None if self._told is None or features is None else np.concatenate([self._told, features])

    def _learn(self, points: FloatArray, scores: FloatArray, seed: int) -> None:
        self._committee = Committee(
            _level(scores, self.threshold),
            self._features if self._told is not None else (),
            foretold=self._elsewhere is not None,
        )
        self._committee.fit(self._coordinates(points), scores, self._known_features(len(points)))

    def _choose(self, points: FloatArray, scores: FloatArray, filling: FloatArray, n: int) -> FloatArray:
        known, every = self._points[self._known], self._scores[self._known]
        candidates = self._candidates(known[every <= max(self.threshold, every.min())], filling, n)
        if len(candidates) <= n:
            return candidates
        if len(points):
            self._committee.know(self._coordinates(known), every, self._known_features(len(known)))
        places = encoded(self._space, candidates)
        told = with_foretold(self._elsewhere, places)
        gain = acquisition(*self._committee.predict(told)) * (1.0 - self._failing(places))
        known = np.concatenate([self._points, filling])
        # The coordinate of another study is no place of a scenario.
        widths = self._committee.process.kernel.widths[: places.shape[1]]
        matters = np.maximum(widths.min() / widths, _LEAST)
        return candidates[_spread(places * matters, gain, encoded(self._space, known) * matters, matters, n)]

    def _known_features(self, count: int) -> FloatArray | None:
        return None if self._told is None else self._told[self._known][:count]

    def _candidates(self, critical: FloatArray, filling: FloatArray, n: int) -> FloatArray:
        """Points all over the space, and around critical ones."""
        near = int(_NEAR * self._count)
        rng = np.random.default_rng(self._round_seed)
        around = critical[rng.integers(len(critical), size=near)]
        # Some near and some far, whatever the size of what is critical.
        sizes = _STEP * rng.random((near, 1)) ** 2
        moved = np.clip(around + sizes * rng.normal(size=around.shape), 0.0, 1.0)
        everywhere = self._new(max(self._count - near, n), filling)
        return np.concatenate([everywhere, self._unseen.among(moved, np.concatenate([everywhere, filling]))])

    def _failing(self, places: FloatArray) -> FloatArray:
        """Probability that scenarios fail, shape (m,)."""
        failed = ~self._known
        if not failed.any():
            return np.zeros(len(places))
        from sklearn.ensemble import ExtraTreesClassifier

        trees = ExtraTreesClassifier(_TREES, random_state=0).fit(encoded(self._space, self._points), failed)
        found: FloatArray = trees.predict_proba(places)[:, trees.classes_].sum(axis=1)
        return found


def acquisition(critical: FloatArray, branch: FloatArray) -> FloatArray:
    """How much is learned from scenarios.

    Parameters
    ----------
    critical : ndarray of float64, shape (m,)
        Probability that it is critical.
    branch : ndarray of float64, shape (m,)
        Probability of the likeliest way that it can go.

    Returns
    -------
    ndarray of float64, shape (m,)
    """
    return np.maximum(0.5 - np.abs(critical - 0.5), _WAY * (1.0 - branch))


def _level(scores: FloatArray, threshold: float) -> float:
    """Threshold with scenarios on each side of it: the one that is asked for, where it has."""
    lowest, below_highest = np.sort(scores)[[0, -2]]
    return float(min(max(threshold, lowest), below_highest))


def _spread(places: FloatArray, gain: FloatArray, known: FloatArray, sides: FloatArray, n: int) -> IntArray:
    """Choose `n` of the places, shape (m, e), each by its gain, shape (m,), and how far it is from all others.

    Those are the `known` ones, shape (k, e), and the ones that were chosen before it. What is as far as points are
    from each other that are spread evenly in a box of these sides, shape (e,), is far enough.
    """
    # So far apart they do not differ along short sides: the longest ones alone, as many as make it largest.
    longest = np.sort(sides)[::-1]
    enough = ((np.cumprod(longest) / len(known)) ** (1.0 / np.arange(1, len(sides) + 1))).max()
    apart = np.minimum(cKDTree(known).query(places)[0], enough)
    chosen: list[int] = []
    for _ in range(n):
        worth = gain * apart
        worth[chosen] = -1.0
        chosen.append(int(np.argmax(worth)))
        apart = np.minimum(apart, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return np.array(chosen, dtype=np.int64)
