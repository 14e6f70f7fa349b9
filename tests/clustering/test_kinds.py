"""Automatic settings find the clusters that exist, and none in data without structure."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform
from sklearn.metrics import adjusted_rand_score

from conftest import at_night
from cornercase.clustering import ASPECTS, cluster
from cornercase.clustering._n_clusters import estimate_clusters
from cornercase.dtw import distance_matrix
from helpers.synthetic_clusters import ASPECTS_OF, SETS, WITHOUT


def between(points):
    return squareform(pdist(np.asarray(points, dtype=float)))


def staged(name, count, seed, aspect):
    """Distances and true clusters of a newly drawn set."""
    recordings, truth = {**SETS, **WITHOUT}[name](count, np.random.default_rng(seed))
    chosen = ASPECTS.create(aspect)
    return distance_matrix([chosen.series(one, "Ego", "Other") for one in recordings]), truth


def apart(kinds, each, seed, dimensions=3, step=8.0):
    """Clusters of equal size on a lattice; the step is in standard deviations."""
    rng = np.random.default_rng(seed)
    places = np.stack(np.meshgrid(*[np.arange(4)] * dimensions), axis=-1).reshape(-1, dimensions)
    centres = step * rng.permutation(places)[:kinds]
    truth = np.repeat(np.arange(kinds), each)
    return between(centres[truth] + rng.normal(size=(len(truth), dimensions))), truth


@pytest.mark.parametrize("method", ["dbscan", "hdbscan"])
@pytest.mark.parametrize("kinds", at_night([2, 9, 16], {2, 16}))
@pytest.mark.filterwarnings("ignore:Conversion of an array:DeprecationWarning")
def test_as_many_kinds_as_there_are(kinds, method):
    distances, truth = apart(kinds, 30, kinds)
    found = cluster(distances, method=method)
    assert found.n_clusters == kinds
    assert adjusted_rand_score(truth, found.labels) > 0.95


@pytest.mark.parametrize("seed", at_night(range(6), range(2, 6)))
def test_five_far_away_are_a_kind_of_their_own(seed):
    rng = np.random.default_rng(seed)
    distances = between(np.concatenate((rng.normal(size=(295, 3)), 15.0 + rng.normal(size=(5, 3)))))
    found = cluster(distances)
    assert np.bincount(found.labels).tolist() == [295, 5]
    assert (found.labels[-5:] == 1).all()


@pytest.mark.parametrize("n", at_night([60, 300], {300}))
@pytest.mark.parametrize("draw", at_night(["line", "square", "cube", "normal"], {"line", "cube"}))
def test_what_has_no_structure_is_one_kind(n, draw):
    rng = np.random.default_rng(n)
    sizes = []
    for _ in range(10):
        points = (
            rng.normal(size=(n, 3)) if draw == "normal" else rng.random((n, ["line", "square", "cube"].index(draw) + 1))
        )
        sizes.append(cluster(between(points)).n_clusters)
    assert np.sum(np.array(sizes) == 1) >= 9


def test_kinds_of_ten_are_found_among_twelve():
    distances, truth = apart(12, 10, 5, dimensions=2, step=12.0)
    assert adjusted_rand_score(truth, cluster(distances).labels) > 0.95


def test_a_step_of_density_is_no_gap():
    # Evenly spread scenarios, denser on one side, without a gap.
    for seed in range(5):
        rng = np.random.default_rng(seed)
        sparse, dense = rng.random((150, 3)) * [6.0, 3.0, 3.0], rng.random((100, 3)) * [1.0, 1.5, 1.5]
        assert estimate_clusters(between(np.concatenate((sparse - [6.0, 0.0, 0.0], dense)))).max() == 0


def test_a_kernel_that_is_not_positive_ends_no_clustering():
    # Like DTW distances, which violate the triangle inequality, too.
    rng = np.random.default_rng(0)
    apart = np.abs(rng.normal(size=(40, 40))) + 3.0
    distances = np.triu(apart, 1) + np.triu(apart, 1).T
    found = cluster(distances, gamma=0.1, eps=0.3, n_components=39)
    assert found.embedding.shape == (40, 39)
    assert not found.embedding[:, -1].any()


def test_scenarios_alike_but_for_the_last_digits_are_no_kinds():
    # Collisions at one of a few instants: groups of identical scenarios with tiny gaps; those that pass are far off.
    rng = np.random.default_rng(0)
    collide = np.repeat(np.arange(6) * 0.01, 25)[:, None] * [1.0, 0.0] + [10.0, 0.0]
    distances = between(np.concatenate((rng.normal(size=(150, 2)), collide)))
    assert np.bincount(cluster(distances).labels).tolist() == [150, 150]


def test_clusters_that_are_not_found_again_are_not_told(monkeypatch):
    distances, _ = apart(3, 20, 0)
    assert cluster(distances).n_clusters == 3
    monkeypatch.setattr(
        "cornercase.clustering._stability.StabilityScorer.mean_rand_index", lambda self, one, labels: 0.12
    )
    assert cluster(distances).n_clusters == 1


def test_kinds_of_other_dimensions_and_densities_stay_apart():
    rng = np.random.default_rng(4)
    line = np.c_[rng.uniform(0.0, 20.0, 150), np.zeros((150, 2))]
    ball = rng.normal(loc=(10.0, 9.0, 0.0), size=(100, 3))
    kinds = estimate_clusters(between(np.concatenate((line, ball))))
    assert adjusted_rand_score(np.repeat([0, 1], [150, 100]), kinds) > 0.95


BY_DAY = {"lane changes", "5 % crashes"}


@pytest.mark.parametrize("name", at_night(sorted(SETS), SETS.keys() - BY_DAY))
def test_kinds_of_scenarios_are_found(name):
    # Seeds with which no constant was calibrated; benchmarks/kinds.py draws more of them.
    found = []
    for seed in (1000, 1002):
        distances, truth = staged(name, 240, seed, ASPECTS_OF[name][0])
        found.append(adjusted_rand_score(truth, cluster(distances).labels))
    assert np.mean(found) >= 0.9


@pytest.mark.parametrize("name", at_night(["5 % crashes", "ten kinds", "unequal"], {"ten kinds", "unequal"}))
def test_kinds_of_three_to_six_scenarios_are_found_among_sixty(name):
    # No single gap between them is clear.
    found = []
    for seed in range(1000, 1010, 2):
        distances, truth = staged(name, 60, seed, "ego-motion")
        found.append(adjusted_rand_score(truth, cluster(distances).labels))
    assert np.median(found) >= 0.9


def test_gaps_that_are_judged_together_are_the_same_in_any_order():
    distances, _ = staged("ten kinds", 60, 1002, "ego-motion")
    kinds, order = estimate_clusters(distances), np.random.default_rng(0).permutation(60)
    assert kinds.max() == 9
    assert adjusted_rand_score(estimate_clusters(distances[np.ix_(order, order)])[np.argsort(order)], kinds) == 1.0
    # Integers, so that many distances are equal.
    places = np.repeat([0.0, 40.0, 80.0], 20) + np.tile(np.arange(20), 3)
    kinds, shuffled = estimate_clusters(between(places[:, None])), estimate_clusters(between(places[order, None]))
    assert adjusted_rand_score(kinds[order], shuffled) == 1.0


@pytest.mark.parametrize("count", [3, 4])
def test_a_wide_gap_makes_no_others(count):
    # Clusters along a line have gaps by chance; the gap to a distant one must not count for them.
    kinds = []
    for seed in range(10):
        places = np.random.default_rng(seed).random((60, 1)) + 50.0 * (np.arange(60) % count)[:, None]
        kinds.append(estimate_clusters(between(places)).max() + 1)
    assert np.sum(np.array(kinds) == count) >= 9


@pytest.mark.parametrize("draw", ["exponential", "lognormal", "standard_cauchy"])
def test_a_few_at_a_sparse_edge_are_no_kind(draw):
    kinds = [
        estimate_clusters(between(getattr(np.random.default_rng(seed), draw)(size=(60, 2)))).max() for seed in range(20)
    ]
    assert np.sum(np.array(kinds) == 0) >= 18


@pytest.mark.parametrize("name", at_night(sorted(WITHOUT), sorted(WITHOUT)[1:]))
def test_a_family_that_varies_smoothly_is_one_kind(name):
    kinds = [estimate_clusters(staged(name, 60, seed, "interaction")[0]).max() + 1 for seed in range(1000, 1020, 2)]
    assert np.sum(np.array(kinds) == 1) >= 9
