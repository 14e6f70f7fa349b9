"""Kinds that distances show: groups farther apart than chance puts scenarios of one kind."""

from __future__ import annotations

import itertools
import math
from typing import Final

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.stats import gamma

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.clustering.spanning_tree import find_tree

LEAST_MEMBERS: Final = 4
# Scenarios that a gap may hold: few show small kinds that stand clear, many show kinds with some on the way between.
NEIGHBOURS: Final = (3, 6, 12, 24)
# A gap below this share of the median distance is no difference in kind, however clear: scenarios that are alike but
# for an instant of the simulation make such gaps. Set by looking at the T-intersection (0.02 and less between
# instants, 0.37 between outcomes) and at the twelve kinds of benchmarks/kinds.py (0.11).
LEAST_GAP: Final = 0.05
# Strength that one split in ten sets without structure exceeds, of one, two and three dimensions: factor of ln(n),
# constant, and for each neighbour beyond six. Set by looking at uniform and normal points, n from 60 to 1,000.
CHANCE: Final = ((4.5, -3.0, 1.0), (1.6, 1.5, 0.5), (1.2, 1.0, 0.4))
# Smooth families of trajectories are not as even as such points; a split must be stronger by CLEAR, or by FAIR where
# it is STANDS_OUT times as strong as the next. Set by looking at sets of benchmarks/kinds.py with odd seeds.
CLEAR, FAIR, STANDS_OUT = 1.4, 1.15, 2.0
# Members nearest to the other group that are asked, at least, and what their neighbours count. Set by looking at the
# T-intersection, and at braking of benchmarks/kinds.py with odd seeds.
LEAST_AT_SEAM, SEAM_SHARE = 10, 1.15
# Splits are judged together of so many scenarios at most, and leave no smaller groups: among more, each kind of some
# size shows by itself, and three that lie together by accident are frequent. Set by looking at two rings of 300 points.
FEW, FEWEST = 100, 3
# Probability below which gaps are no accident. Set by looking at smooth families and kinds of sixty scenarios, drawn by
# benchmarks/kinds.py with odd seeds.
RARE: Final = 0.001
_MOST_CENTRES: Final = 300
_DIMENSION_NEIGHBOURS: Final = 6
# Where kinds have a handful of members, the sixth neighbour would be one of another kind.
_NEAREST_NEIGHBOURS: Final = 2


def find_kinds(distances: FloatArray) -> IntArray:
    """Divide scenarios into kinds where there is evidence for it.

    Parameters
    ----------
    distances : ndarray of float64, shape (n, n)
        Symmetric, zero on the diagonal, in any unit. Where several distances are equal, the order of the scenarios
        may matter.

    Returns
    -------
    ndarray of int64, shape (n,)
        Kind of each scenario; all 0 where there is no structure.

    Notes
    -----
    The minimum spanning tree of mutual reachability (Campello et al. 2013) merges scenarios from the nearest on. Where
    two groups merge at a length r, the split between them has a strength: how many neighbours a typical member has
    within r, of the group that has fewer. A place between the groups has hardly more than the `k` scenarios that
    mutual reachability allows. So the strength over `k` is the ratio of densities, in any number of dimensions. Where r
    reaches all members, as in a small group that is far away, the strength goes on growing with r over the extent of
    the group. If a split is not stronger than chance makes it, the weaker group becomes part of the other.

    How strong chance makes the strongest of all splits depends on the number of scenarios and on their dimension,
    which is estimated from distances to neighbours (Levina and Bickel 2005). Kinds are divided again until none
    divides.

    Among few scenarios no split may be clear by itself, though together they are: nine gaps of about one length, with
    nothing between these and the steps within ten groups. So the gaps of up to a hundred scenarios are judged together
    first. Gaps between points on a line that come by chance are exponential, and in `d` dimensions so is the gap to the
    power of `d`. For each number of groups, the sum of the logarithms of the gaps, as multiples of the longest step
    within a group, then follows a gamma distribution at most. Where one of these sums is too rare to be chance, that
    number is taken for which the sum times the silhouette is largest.
    """
    n = len(distances)
    labels = np.zeros(n, dtype=np.int64)
    positive = distances[distances > 0.0]
    if not len(positive):
        return labels
    least_gap = LEAST_GAP * float(np.median(positive))
    together = _judged_together(distances, least_gap)
    waiting, count = [np.flatnonzero(together == group) for group in range(int(together.max()), -1, -1)], 0
    while waiting:
        members = waiting.pop()
        parts = _divided(distances[np.ix_(members, members)] if len(members) < n else distances, least_gap)
        if parts.max() > 0:
            waiting.extend(members[parts == part] for part in range(int(parts.max()), -1, -1))
        else:
            labels[members] = count
            count += 1
    return labels


def _judged_together(distances: FloatArray, least_gap: float) -> IntArray:
    """Groups of all scenarios between which the gaps, taken together, are longer than chance makes them."""
    n = len(distances)
    whole = found = np.zeros(n, dtype=np.int64)
    if not 2 * FEWEST <= n <= FEW:
        return whole
    # Scikit-learn takes as long to import as many a command does: who does not need it does not wait for it.
    from sklearn.metrics import silhouette_score

    dimension = min(max(_dimension(distances, _NEAREST_NEIGHBOURS), 1.0), float(len(CHANCE)))
    ends, lengths = np.empty((2, n - 1), dtype=np.int64), np.empty(n - 1)
    find_tree(distances, ends, lengths)
    falling = np.argsort(-lengths, kind="stable")
    # The steps between scenarios that are the same have no logarithm.
    ends, lengths = ends[:, falling], np.maximum(lengths[falling], 1e-12 * lengths.max())
    most, rarest = 0.0, 1.0
    for count in range(2, n // FEWEST + 1):
        gaps, longest = lengths[: count - 1], lengths[count - 1]
        if gaps[-1] < least_gap:
            break
        # Where two lengths are the same, nothing but their order would divide here.
        if longest >= (1.0 - 1e-9) * gaps[-1]:
            continue
        within = coo_matrix((np.ones(n - count), ends[:, count - 1 :]), shape=(n, n))
        groups = connected_components(within, directed=False)[1].astype(np.int64)
        if np.bincount(groups).min() < FEWEST:
            continue
        evidence = dimension * math.log(n / count) * float(np.log(gaps / longest).sum())
        rarest = min(rarest, float(gamma.sf(evidence, count - 1)))
        # One wide gap lends its evidence to any further division, but not its silhouette.
        worth = evidence * float(silhouette_score(distances, groups, metric="precomputed"))
        if worth > most:
            found, most = groups, worth
    return found if rarest < RARE else whole


def _divided(distances: FloatArray, least_gap: float) -> IntArray:
    """Parts that some scenarios divide into with the fewest neighbours that divide them, from 0 on."""
    n = len(distances)
    if n >= 2 * LEAST_MEMBERS:
        dimension = _dimension(distances, _DIMENSION_NEIGHBOURS)
        for needed in NEIGHBOURS:
            if 4 * needed > n:
                break
            chance = _by_chance(n, needed, dimension)
            hierarchy = _Hierarchy(distances, needed, least_gap)
            clear = CLEAR * chance
            found, strengths = hierarchy.divide(clear)
            fair = _standing_out(strengths, FAIR * chance, clear)
            if fair < clear:
                found, _ = hierarchy.divide(fair)
            names, parts = np.unique(found, return_inverse=True)
            if len(names) > 1:
                return parts.astype(np.int64)
    return np.zeros(n, dtype=np.int64)


def _by_chance(n: int, needed: int, dimension: float) -> float:
    """Strength of the strongest split of scenarios that are of one kind, at least that of twice the density."""
    strengths = [a * math.log(n) + b + c * max(needed - 6, 0) for a, b, c in CHANCE]
    return max(float(np.exp(np.interp(dimension, [1.0, 2.0, 3.0], np.log(strengths)))), 2.0 * needed)


def _standing_out(strengths: list[float], fair: float, clear: float) -> float:
    """Least strength that is accepted: below `clear` where a split stands out from all that are weaker."""
    accepted = clear
    falling = [*sorted(strengths, reverse=True), 0.0]
    for strength, weaker in itertools.pairwise(falling):
        if fair <= strength < clear and strength >= STANDS_OUT * weaker:
            accepted = strength
    return accepted


def _dimension(distances: FloatArray, neighbours: int) -> float:
    """Intrinsic dimension after Levina and Bickel; that of a line where scenarios are the same."""
    k = min(neighbours, len(distances) - 2)
    near = np.sort(np.partition(distances, k, axis=1)[:, : k + 1], axis=1)[:, 1:]
    near = near[near[:, 0] > 0.0]
    growth = np.log(near[:, -1:] / near[:, :-1]).mean() if len(near) else 0.0
    return float(1.0 / growth) if growth > 0.0 else 1.0


class _Hierarchy:
    """Scenarios that merge from the nearest on, by mutual reachability with `needed` neighbours."""

    def __init__(self, distances: FloatArray, needed: int, least_gap: float) -> None:
        n = len(distances)
        core = np.partition(distances, needed - 1, axis=1)[:, needed - 1]
        # Many reaches are equal where one core distance decides them. The small term lets the nearer merge first.
        reach = np.maximum(distances, np.maximum(core[:, None], core)) + 1e-6 * distances
        ends, lengths = np.empty((2, n - 1), dtype=np.int64), np.empty(n - 1)
        find_tree(reach, ends, lengths)
        rising = np.argsort(lengths, kind="stable")
        self._edges = list(zip(*ends[:, rising].tolist(), lengths[rising].tolist(), strict=True))
        self._distances, self._least_gap = distances, least_gap
        self._least = max(LEAST_MEMBERS, needed)

    def divide(self, accepted: float) -> tuple[IntArray, list[float]]:
        """Groups between which all splits are of a strength, and the strengths of all splits that were judged."""
        n = len(self._distances)
        label, tree = np.arange(n), np.arange(n)
        members = {i: np.array([i]) for i in range(n)}
        branches = {i: np.array([i]) for i in range(n)}
        # Trees that hold several groups: what these are is settled, since they only grow.
        divided: BoolArray = np.zeros(n, dtype=np.bool_)
        strengths: list[float] = []
        for a, b, length in self._edges:
            one, two = int(tree[a]), int(tree[b])
            large, small = int(label[a]), int(label[b])
            settled, small_settled = bool(divided[one]), bool(divided[two])
            if len(members[large]) < len(members[small]):
                large, small, settled, small_settled = small, large, small_settled, settled
            apart = length >= self._least_gap and settled and small_settled
            if not (settled and small_settled):
                of_small = of_large = 0.0
                if len(members[small]) >= self._least and length >= self._least_gap:
                    of_small, of_large = self._strengths(members[small], members[large], length)
                    strengths.append(min(of_small, of_large))
                apart = (small_settled or of_small >= accepted) and of_large >= accepted
                if not apart:
                    if small_settled or (not settled and of_small >= accepted):
                        large, small = small, large
                    label[members[small]] = large
                    members[large] = np.concatenate((members[large], members.pop(small)))
            if len(branches[one]) < len(branches[two]):
                one, two = two, one
            tree[branches[two]] = one
            divided[one] = divided[one] or divided[two] or apart
            branches[one] = np.concatenate((branches[one], branches.pop(two)))
        return label, strengths

    def _strengths(self, small: IntArray, large: IntArray, length: float) -> tuple[float, float]:
        """Neighbours within the length of a split, of the smaller group and of the other."""
        return self._neighbours(small, large, length), self._neighbours(large, small, length)

    def _neighbours(self, members: IntArray, others: IntArray, length: float) -> float:
        """Members within a length of a typical one; beyond the extent of all or half of them as if there were more.

        And of those nearest to the others: where a dense part meets a sparse one, or a few lie apart at a sparse edge,
        there is no gap between two kinds, though most members of one lie close together.
        """
        between = self._distances[np.ix_(_some(members), members)]
        around = float(np.median((between <= length).sum(axis=1)))
        for count in {math.ceil(len(members) / 2), len(members)}:
            extent = float(np.median(np.partition(between, count - 1, axis=1)[:, count - 1]))
            if extent <= length:
                around = max(around, count * length / max(extent, 1e-12 * length))
        seam = max(LEAST_AT_SEAM, min(2 * len(others), len(members) // 10))
        if seam >= len(members):
            return around
        away = self._distances[np.ix_(members, others)].min(axis=1)
        near = members[np.argsort(away, kind="stable")[:seam]]
        at_seam = float(np.median((self._distances[np.ix_(near, members)] <= length).sum(axis=1)))
        return around if at_seam >= len(members) else min(around, SEAM_SHARE * at_seam)


def _some(members: IntArray) -> IntArray:
    return members[:: math.ceil(len(members) / _MOST_CENTRES)]
