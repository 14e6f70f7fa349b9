"""Compiled DBSCAN, spanning tree and Rand index, compared with scikit-learn and SciPy."""

import numpy as np
import pytest
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.distance import cdist
from sklearn.cluster import DBSCAN
from sklearn.metrics import adjusted_rand_score

from cornercase.clustering._density import cluster_by_density, renumber_by_size
from cornercase.clustering._kernels.spanning_tree import fill_spanning_tree
from cornercase.clustering._stability import _adjusted_rand_index


@pytest.mark.parametrize("seed", range(40))
def test_dense_regions_are_those_of_scikit_learn(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 200))
    points = rng.normal(size=(count, 3)) * rng.uniform(0.1, 2.0)
    # On a grid, distances equal the radius exactly, and some points are identical.
    points = np.round(points, 1) if seed % 2 else points
    for eps in (0.1, 0.3, 1.0):
        for needed in (1, 3, 8):
            expected = renumber_by_size(DBSCAN(eps=eps, min_samples=needed).fit_predict(points))
            np.testing.assert_array_equal(cluster_by_density(points, eps, needed, "dbscan"), expected)


@pytest.mark.parametrize("count", [2, 3, 50])
def test_spanning_tree_is_as_short_as_that_of_scipy(count):
    points = np.random.default_rng(count).normal(size=(count, 2))
    between = cdist(points, points)
    ends, lengths = np.empty((2, count - 1), dtype=np.int64), np.empty(count - 1)
    fill_spanning_tree(between, ends, lengths)
    np.testing.assert_allclose(np.sort(lengths), np.sort(minimum_spanning_tree(between).data))
    np.testing.assert_array_equal(lengths, between[tuple(ends)])
    assert set(ends.ravel().tolist()) == set(range(count))


@pytest.mark.parametrize("seed", range(20))
def test_agreement_is_that_of_scikit_learn(seed):
    rng = np.random.default_rng(seed)
    one = rng.integers(-1, seed % 5, 60)
    two = np.where(rng.random(60) < 0.7, one, rng.integers(-1, 3, 60))
    assert _adjusted_rand_index(one, two) == adjusted_rand_score(one, two)
