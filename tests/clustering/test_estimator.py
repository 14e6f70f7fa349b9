"""`ScenarioClustering` as a scikit-learn estimator."""

from __future__ import annotations

import doctest

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from sklearn.base import clone
from sklearn.datasets import make_moons
from sklearn.metrics import adjusted_rand_score

import cornercase.clustering._scenario_clustering
from conftest import at_night
from cornercase._common.errors import InputError
from cornercase.clustering import ScenarioClustering, cluster


def moons(count, seed):
    return make_moons(count, noise=0.04, random_state=seed)


def test_it_finds_what_the_function_finds_and_has_the_manners():
    points, _ = moons(150, 0)
    distances = cdist(points, points)
    model = ScenarioClustering(gamma=4.0, eps=0.2, min_samples=4)
    assert clone(model).get_params() == {
        "gamma": 4.0, "eps": 0.2, "min_samples": 4, "n_components": "auto", "method": "dbscan", "landmarks": "auto"
    }  # fmt: skip
    expected = cluster(distances, gamma=4.0, eps=0.2, min_samples=4)
    np.testing.assert_array_equal(model.fit_predict(distances), expected.labels)
    np.testing.assert_array_equal(model.embedding_, expected.embedding)
    assert (model.gamma_, model.eps_, model.min_samples_) == (4.0, 0.2, 4)
    assert model.candidates_ == model.result_.candidates
    assert "150 scenarios, " in repr(model.result_)
    assert doctest.testmod(cornercase.clustering._scenario_clustering).failed == 0


@pytest.mark.parametrize("method", ["dbscan", "hdbscan"])
def test_new_scenarios_join_the_clusters_that_are_there(method):
    points, true = moons(300, 1)
    model = ScenarioClustering(method=method).fit(cdist(points, points))
    assert adjusted_rand_score(true, model.labels_) > 0.95
    new, new_true = moons(100, 2)
    found = model.predict(cdist(new, points))
    assert adjusted_rand_score(new_true[found >= 0], found[found >= 0]) > 0.95
    assert (found < 0).mean() < 0.1
    assert (model.predict(cdist([[50.0, 50.0]], points)) == -1).all()


def test_hdbscan_with_one_neighbour_finds_its_own_scenarios_again():
    points = np.repeat([[0.0], [30.0]], 10, axis=0) + np.tile(np.arange(10.0), 2)[:, None]
    distances = cdist(points, points)
    model = ScenarioClustering(method="hdbscan", min_samples=1, gamma=1.0, eps=0.0).fit(distances)
    assert (model.labels_ >= 0).any()
    np.testing.assert_array_equal(model.predict(distances), model.labels_)


def test_who_was_clustered_is_placed_where_it_is():
    points, _ = moons(80, 3)
    distances = cdist(points, points)
    model = ScenarioClustering().fit(distances)
    np.testing.assert_allclose(model.transform(distances), model.embedding_, atol=1e-9)
    kept = model.labels_ >= 0
    # A border point of two clusters belongs to the one that DBSCAN finds first.
    assert (model.predict(distances)[kept] == model.labels_[kept]).mean() > 0.97


@pytest.mark.parametrize("seed", at_night(range(3), {1, 2}))
def test_a_tenth_more_scenarios_or_another_order_change_few_labels(seed):
    points, _ = moons(330, seed)
    few, many = (ScenarioClustering().fit(cdist(p, p)) for p in (points[:300], points))
    assert adjusted_rand_score(few.labels_, many.labels_[:300]) >= 0.9
    order = np.random.default_rng(seed).permutation(300)
    shuffled = ScenarioClustering().fit(cdist(points[:300][order], points[:300][order]))
    assert adjusted_rand_score(few.labels_[order], shuffled.labels_) >= 0.9


def test_scenarios_that_are_all_the_same_are_one_cluster_and_so_is_a_new_one():
    model = ScenarioClustering().fit(np.zeros((20, 20)))
    assert model.labels_.tolist() == [0] * 20
    assert model.predict(np.zeros((2, 20))).tolist() == [0, 0]


def test_refuses_in_one_sentence():
    points = np.random.default_rng(0).random((12, 2))
    model = ScenarioClustering().fit(cdist(points, points))
    for distances, words in ((np.zeros((2, 5)), "do not fit the 12"), (np.full((1, 12), np.nan), "not finite")):
        with pytest.raises(InputError, match=words):
            model.predict(distances)
    with pytest.raises(InputError, match="did you mean 'hdbscan'"):
        ScenarioClustering(method="hdbscn").fit(np.zeros((3, 3)))  # type: ignore[arg-type]
