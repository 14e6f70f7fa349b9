"""Estimate of the clusters in distances: groups with wider gaps between them than chance leaves in a single cluster."""

from __future__ import annotations

import itertools
import math
from typing import Final

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.stats import gamma

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.clustering._kernels.spanning_tree import fill_spanning_tree

MIN_MEMBERS: Final = 4
# Numbers of neighbours for mutual reachability: few reveal small clusters, many reveal clusters with points in between.
NEIGHBOUR_COUNTS: Final = (3, 6, 12, 24)
# A gap below this share of the median distance separates no clusters, however clear: scenarios that differ by one time
# step have such gaps. Calibrated on the T-intersection (at most 0.02 between time steps, 0.37 between outcomes) and on
# the twelve clusters of benchmarks/kinds.py (0.11).
MIN_GAP: Final = 0.05
# Strength that one of ten data sets without structure exceeds, for 1, 2 and 3 dimensions: factor of ln(n), constant,
# and increase per neighbour beyond six. Calibrated on uniform and normal points, n from 60 to 1,000.
CHANCE_STRENGTH: Final = ((4.5, -3.0, 1.0), (1.6, 1.5, 0.5), (1.2, 1.0, 0.4))
# Families of trajectories are less even than such points: a split must be stronger than chance by CLEAR_FACTOR, or by
# FAIR_FACTOR if it is STANDOUT_RATIO times as strong as the next split. Calibrated on benchmarks/kinds.py with odd
# seeds.
CLEAR_FACTOR, FAIR_FACTOR, STANDOUT_RATIO = 1.4, 1.15, 2.0
# Smallest number of members at the seam (those nearest to the other group), and factor for the number of their
# neighbours. Calibrated on the T-intersection and on braking of benchmarks/kinds.py with odd seeds.
MIN_SEAM_MEMBERS, SEAM_FACTOR = 10, 1.15
# Splits are tested together for at most MAX_JOINT_TEST scenarios, with groups of at least MIN_JOINT_MEMBERS: with more
# scenarios, large clusters show without this test, and three points that are close by accident are frequent. Calibrated
# on two rings of 300 points.
MAX_JOINT_TEST, MIN_JOINT_MEMBERS = 100, 3
# Significance level of the joint test. Calibrated on families and clusters of sixty scenarios of benchmarks/kinds.py
# with odd seeds.
SIGNIFICANCE_LEVEL: Final = 0.001
_MAX_SAMPLED_MEMBERS: Final = 300
_DIMENSION_NEIGHBOURS: Final = 6
# Two, since in clusters of a handful of members the sixth neighbour belongs to another cluster.
_JOINT_TEST_NEIGHBOURS: Final = 2


def estimate_clusters(distances: FloatArray) -> IntArray:
    """Divide scenarios into clusters if there is evidence for more than one; otherwise all labels are 0.

    `distances`, shape (n, n), may have any unit. If some distances are equal, the result may depend on the order of the
    scenarios.

    The minimum spanning tree of mutual reachability with k neighbours (Campello et al. 2013) merges scenarios into
    groups, the nearest first. When two groups merge over an edge of length r, there is a gap of width r between them,
    and the strength of this split says how clear the gap is. For each group, count the neighbours that a typical member
    has within r; the strength is the smaller of the two counts. A point in the gap has hardly more than k neighbours
    within r, so strength divided by k compares the density in the groups to the density in the gap, in any number of
    dimensions. If r is larger than a group, as for a small group far away, the count is multiplied by r divided by the
    extent of the group. A split that is no stronger than chance separates nothing: its weaker group becomes part of the
    stronger group. Each cluster is then divided in the same way, until no cluster divides.

    How strong a split can be by chance depends on the number of scenarios and on their intrinsic dimension. This
    dimension is estimated from distances to neighbours (Levina and Bickel 2005).

    Among few scenarios, each single split may be unclear although all splits together are clear. So for up to a hundred
    scenarios all gaps are first tested together. By chance, gaps between points on a line have an exponential
    distribution; in d dimensions the gap to the power of d has this distribution. Each number of groups is tested: each
    gap is divided by the longest step within a group, and the logarithms of these ratios are added up. By chance this
    sum, suitably scaled, is hardly larger than a gamma distribution allows. If at least one number of groups has a sum
    that is too large for chance, the scenarios are divided. The number of groups is then the one with the largest
    product of sum and silhouette.
    """
    n = len(distances)
    labels = np.zeros(n, dtype=np.int64)
    positive = distances[distances > 0.0]
    if not len(positive):
        return labels
    least_gap = MIN_GAP * float(np.median(positive))
    initial = _test_gaps_jointly(distances, least_gap)
    queue, count = [np.flatnonzero(initial == group) for group in range(int(initial.max()), -1, -1)], 0
    while queue:
        members = queue.pop()
        parts = _split_by_density(distances[np.ix_(members, members)] if len(members) < n else distances, least_gap)
        if parts.max() > 0:
            queue.extend(members[parts == part] for part in range(int(parts.max()), -1, -1))
        else:
            labels[members] = count
            count += 1
    return labels


def _test_gaps_jointly(distances: FloatArray, min_gap: float) -> IntArray:
    """Divide up to a hundred scenarios into groups if all gaps between groups together are too wide for chance."""
    n = len(distances)
    undivided = best = np.zeros(n, dtype=np.int64)
    if not 2 * MIN_JOINT_MEMBERS <= n <= MAX_JOINT_TEST:
        return undivided
    # Imported here, since importing scikit-learn takes as long as many commands.
    from sklearn.metrics import silhouette_score

    dimension = min(max(_intrinsic_dimension(distances, _JOINT_TEST_NEIGHBOURS), 1.0), float(len(CHANCE_STRENGTH)))
    ends, lengths = np.empty((2, n - 1), dtype=np.int64), np.empty(n - 1)
    fill_spanning_tree(distances, ends, lengths)
    order = np.argsort(-lengths, kind="stable")
    # Steps between identical scenarios have no logarithm.
    ends, lengths = ends[:, order], np.maximum(lengths[order], 1e-12 * lengths.max())
    best_worth, p_value = 0.0, 1.0
    for count in range(2, n // MIN_JOINT_MEMBERS + 1):
        gaps, longest = lengths[: count - 1], lengths[count - 1]
        if gaps[-1] < min_gap:
            break
        # A split between two equal lengths would depend only on their order.
        if longest >= (1.0 - 1e-9) * gaps[-1]:
            continue
        within = coo_matrix((np.ones(n - count), ends[:, count - 1 :]), shape=(n, n))
        groups = connected_components(within, directed=False)[1].astype(np.int64)
        if np.bincount(groups).min() < MIN_JOINT_MEMBERS:
            continue
        evidence = dimension * math.log(n / count) * float(np.log(gaps / longest).sum())
        p_value = min(p_value, float(gamma.sf(evidence, count - 1)))
        # One wide gap counts as evidence for every further division, but does not improve its silhouette.
        quality = evidence * float(silhouette_score(distances, groups, metric="precomputed"))
        if quality > best_worth:
            best, best_worth = groups, quality
    return best if p_value < SIGNIFICANCE_LEVEL else undivided


def _split_by_density(distances: FloatArray, min_gap: float) -> IntArray:
    """Split scenarios into groups with sparse gaps between them; return the group of each scenario, from 0.

    Mutual reachability is tried with several numbers of neighbours, the smallest first, until one gives several groups.
    """
    n = len(distances)
    if n >= 2 * MIN_MEMBERS:
        dimension = _intrinsic_dimension(distances, _DIMENSION_NEIGHBOURS)
        for n_neighbours in NEIGHBOUR_COUNTS:
            if 4 * n_neighbours > n:
                break
            chance = _split_strength_by_chance(n, n_neighbours, dimension)
            hierarchy = _ReachabilityHierarchy(distances, n_neighbours, min_gap)
            required = CLEAR_FACTOR * chance
            groups, strengths = hierarchy.split(required)
            relaxed = _lowest_accepted_strength(strengths, FAIR_FACTOR * chance, required)
            if relaxed < required:
                groups, _ = hierarchy.split(relaxed)
            names, parts = np.unique(groups, return_inverse=True)
            if len(names) > 1:
                return parts.astype(np.int64)
    return np.zeros(n, dtype=np.int64)


def _split_strength_by_chance(n: int, n_neighbours: int, dimension: float) -> float:
    """Return the strength of the strongest split that is expected by chance within a single cluster.

    The result is at least ``2 * n_neighbours``: a clear group must be at least twice as dense as the gap beside it.
    """
    by_dimension = [a * math.log(n) + b + c * max(n_neighbours - 6, 0) for a, b, c in CHANCE_STRENGTH]
    return max(float(np.exp(np.interp(dimension, [1.0, 2.0, 3.0], np.log(by_dimension)))), 2.0 * n_neighbours)


def _lowest_accepted_strength(strengths: list[float], fair: float, clear: float) -> float:
    """Return the smallest strength at which a split is accepted.

    `strengths` are those of all splits. The result is `clear`. Exception: if a split has at least the strength `fair`
    and is at least twice as strong as the next weaker split, its strength is the result.
    """
    accepted = clear
    descending = [*sorted(strengths, reverse=True), 0.0]
    for strength, weaker in itertools.pairwise(descending):
        if fair <= strength < clear and strength >= STANDOUT_RATIO * weaker:
            accepted = strength
    return accepted


def _intrinsic_dimension(distances: FloatArray, n_neighbours: int) -> float:
    """Estimate the intrinsic dimension of scenarios (Levina and Bickel 2005); 1 if scenarios are identical."""
    k = min(n_neighbours, len(distances) - 2)
    neighbour_distances = np.sort(np.partition(distances, k, axis=1)[:, : k + 1], axis=1)[:, 1:]
    neighbour_distances = neighbour_distances[neighbour_distances[:, 0] > 0.0]
    growth = (
        np.log(neighbour_distances[:, -1:] / neighbour_distances[:, :-1]).mean() if len(neighbour_distances) else 0.0
    )
    return float(1.0 / growth) if growth > 0.0 else 1.0


class _ReachabilityHierarchy:
    """Single-linkage hierarchy of scenarios by mutual reachability with `n_neighbours` neighbours."""

    def __init__(self, distances: FloatArray, n_neighbours: int, min_gap: float) -> None:
        n = len(distances)
        core = np.partition(distances, n_neighbours - 1, axis=1)[:, n_neighbours - 1]
        # One core distance makes many values equal; the small term lets the nearer pair merge first.
        reachability = np.maximum(distances, np.maximum(core[:, None], core)) + 1e-6 * distances
        edges, lengths = np.empty((2, n - 1), dtype=np.int64), np.empty(n - 1)
        fill_spanning_tree(reachability, edges, lengths)
        order = np.argsort(lengths, kind="stable")
        self._edges = list(zip(*edges[:, order].tolist(), lengths[order].tolist(), strict=True))
        self._distances, self._least_gap = distances, min_gap
        self._least = max(MIN_MEMBERS, n_neighbours)

    def split(self, min_strength: float) -> tuple[IntArray, list[float]]:
        """Return the group of each scenario, shape (n,), and the strengths of all splits.

        Groups are separated by splits with a strength of at least `min_strength`.
        """
        n = len(self._distances)
        label, tree = np.arange(n), np.arange(n)
        members = {i: np.array([i]) for i in range(n)}
        branches = {i: np.array([i]) for i in range(n)}
        # Trees that contain several groups; these are final, since they only grow.
        divided: BoolArray = np.zeros(n, dtype=np.bool_)
        strengths: list[float] = []
        for a, b, length in self._edges:
            tree_a, tree_b = int(tree[a]), int(tree[b])
            large, small = int(label[a]), int(label[b])
            settled, small_settled = bool(divided[tree_a]), bool(divided[tree_b])
            if len(members[large]) < len(members[small]):
                large, small, settled, small_settled = small, large, small_settled, settled
            is_split = length >= self._least_gap and settled and small_settled
            if not (settled and small_settled):
                of_small = of_large = 0.0
                if len(members[small]) >= self._least and length >= self._least_gap:
                    of_small = self._estimate_typical_members_within(members[small], members[large], length)
                    of_large = self._estimate_typical_members_within(members[large], members[small], length)
                    strengths.append(min(of_small, of_large))
                is_split = (small_settled or of_small >= min_strength) and of_large >= min_strength
                if not is_split:
                    if small_settled or (not settled and of_small >= min_strength):
                        large, small = small, large
                    label[members[small]] = large
                    members[large] = np.concatenate((members[large], members.pop(small)))
            if len(branches[tree_a]) < len(branches[tree_b]):
                tree_a, tree_b = tree_b, tree_a
            tree[branches[tree_b]] = tree_a
            divided[tree_a] = divided[tree_a] or divided[tree_b] or is_split
            branches[tree_a] = np.concatenate((branches[tree_a], branches.pop(tree_b)))
        return label, strengths

    def _estimate_typical_members_within(self, members: IntArray, others: IntArray, radius: float) -> float:
        """Estimate the number of members within `radius` of a typical member.

        If `radius` exceeds the extent of the members, the number is extrapolated. The number is limited to about what
        the members nearest to the `others` have within `radius`. Without this limit, a dense part that touches a sparse
        part would count as a cluster of its own, since most members of a dense part lie close together; so would a few
        points at a sparse edge.
        """
        distances = self._distances[np.ix_(members[:: math.ceil(len(members) / _MAX_SAMPLED_MEMBERS)], members)]
        typical = float(np.median((distances <= radius).sum(axis=1)))
        for count in {math.ceil(len(members) / 2), len(members)}:
            extent = float(np.median(np.partition(distances, count - 1, axis=1)[:, count - 1]))
            if extent <= radius:
                typical = max(typical, count * radius / max(extent, 1e-12 * radius))
        seam = max(MIN_SEAM_MEMBERS, min(2 * len(others), len(members) // 10))
        if seam >= len(members):
            return typical
        to_others = self._distances[np.ix_(members, others)].min(axis=1)
        seam_members = members[np.argsort(to_others, kind="stable")[:seam]]
        at_seam = float(np.median((self._distances[np.ix_(seam_members, members)] <= radius).sum(axis=1)))
        return typical if at_seam >= len(members) else min(typical, SEAM_FACTOR * at_seam)
