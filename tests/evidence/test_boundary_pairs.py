"""Pairs of scenarios that are near each other and end differently."""

from __future__ import annotations

import numpy as np
from scipy.spatial.distance import cdist

from cornercase.evidence._boundary_pairs import find_boundary_pairs


def test_the_nearest_pair_is_that_of_a_search_of_all_pairs():
    rng = np.random.default_rng(3)
    points, weights = rng.random((80, 3)), np.array([0.9, 0.2, 0.0])
    outcomes = [("hit", "first", "second")[int(3 * point[0])] for point in points]
    pairs = find_boundary_pairs(points, outcomes, weights)
    distances = cdist(points * np.maximum(weights, 1e-3), points * np.maximum(weights, 1e-3))
    distances[np.equal.outer(np.array(outcomes), np.array(outcomes))] = np.inf
    assert pairs[0][2] == distances.min()
    assert all(outcomes[first] != outcomes[second] for first, second, _ in pairs)
    assert all(distance == distances[first, second] for first, second, distance in pairs)
    # Five different places, nearest first.
    assert len({index for first, second, _ in pairs for index in (first, second)}) == 10
    assert [distance for *_, distance in pairs] == sorted(distance for *_, distance in pairs)


def test_where_all_end_alike_there_is_no_boundary():
    assert find_boundary_pairs(np.zeros((3, 2)), ["hit"] * 3) == []
    assert find_boundary_pairs(np.zeros((0, 2)), []) == []
