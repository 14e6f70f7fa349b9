"""Analysis of many scenarios with landmarks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform
from sklearn.metrics import adjusted_rand_score

from cornercase._common.errors import InputError
from cornercase._common.memory import MemoryLimit
from cornercase.clustering import ScenarioClustering, analyze, read_analysis, read_distances
from cornercase.clustering import _analyze as analyze_module
from cornercase.clustering import _landmarks as landmarks
from cornercase.clustering._analyze import _read_inputs
from cornercase.clustering._anchors import N_ANCHORS, LandmarkDistanceEstimator
from cornercase.clustering._assign import assign_to_clusters
from cornercase.clustering._embedding import EmbeddedDistances, LandmarkMDS
from cornercase.clustering._k_means import find_k_means
from cornercase.clustering._landmarks import PairwiseComparer, cluster_by_landmarks
from cornercase.clustering._series import read_series
from cornercase.dtw import distance_matrix
from cornercase.reduction._coverage import measure_nearest_distances
from cornercase.study import StudyFile
from cornercase.study._scenario_digest import downsample, downsampling_stride
from helpers.synthetic_study import explorer, opened


def courses(count, rng):
    """Courses of two clusters, falling early or late, with true labels."""
    late = rng.random(count) < 0.3
    at = np.where(late, 40.0, 15.0) + rng.normal(0.0, 2.0, count)
    deep = rng.uniform(3.0, 5.0, count)
    time = np.arange(60.0)
    return [
        np.column_stack([depth * np.exp(-(((time - one) / 6.0) ** 2)), time * (0.5 if kind else 0.2)])
        for one, depth, kind in zip(at, deep, late, strict=True)
    ], late


@pytest.fixture
def many(monkeypatch):
    monkeypatch.setattr(analyze_module, "MAX_ALL_PAIRS", 30)
    monkeypatch.setattr(landmarks, "N_LANDMARKS", 24)


@pytest.fixture
def path(tmp_path):
    with opened(tmp_path / "s.db") as study:
        explorer(study, metrics=("distance", "wttc"), optimizer="sobol", budget=47).run()
    return tmp_path / "s.db"


def test_places_of_squares_give_squares_back():
    rng = np.random.default_rng(1)
    true = squareform(pdist(rng.normal(size=(80, 5)), "sqeuclidean"))
    placed = EmbeddedDistances(LandmarkMDS(true[:30, :30]).embed(true[:, :30]))
    np.testing.assert_allclose(placed[:], true, atol=1e-9)
    np.testing.assert_allclose(placed[[3, 70]], true[[3, 70]], atol=1e-9)
    np.testing.assert_allclose(placed[np.ix_([1, 2], [40, 9])], true[np.ix_([1, 2], [40, 9])], atol=1e-9)
    assert (placed.shape, len(placed)) == ((80, 80), 80)


def test_distances_to_all_landmarks_follow_from_those_to_anchors():
    points = np.random.default_rng(1).normal(size=(400, 7))
    true = squareform(pdist(points, "sqeuclidean"))[:, :300]
    completion = LandmarkDistanceEstimator(true[:300])
    assert len(completion.anchors) == N_ANCHORS
    # Far from one another: the nearest two are farther apart than in a random choice.
    among = true[np.ix_(completion.anchors, completion.anchors)] + np.where(np.eye(N_ANCHORS), np.inf, 0.0)
    assert among.min() > 2.0 * np.sort(true[:N_ANCHORS, :N_ANCHORS], axis=1)[:, 1].min()
    completed = completion.estimate_to_all_landmarks(true[300:, completion.anchors])
    np.testing.assert_allclose(completed, true[300:], atol=1e-9)
    assert np.array_equal(completed[:, completion.anchors], true[300:, completion.anchors])


def test_few_landmarks_are_all_anchors_even_if_they_are_equal():
    completion = LandmarkDistanceEstimator(np.zeros((4, 4)))
    assert completion.anchors.tolist() == [0, 1, 2, 3]
    assert completion.estimate_to_all_landmarks(np.array([[1.0, 2.0, 3.0, 4.0]])).tolist() == [[1.0, 2.0, 3.0, 4.0]]


def test_what_is_asked_of_places_is_what_the_matrix_says():
    places = np.random.default_rng(2).normal(size=(400, 3))
    placed, matrix = EmbeddedDistances(places), squareform(pdist(places, "sqeuclidean"))
    assert placed.max() == pytest.approx(matrix.max())
    some = np.arange(50, 90)
    assert placed.medoid(some) == some[matrix[np.ix_(some, some)].sum(axis=1).argmin()]
    drawn = [
        np.array([np.random.default_rng(k).choice(400, size, replace=False) for k in range(7)]) for size in (5, 60)
    ]
    # For most scenarios, this choice has none of the nearest ones.
    for choices in (*drawn, places[:, 0].argsort()[None, -60:]):
        expected = np.array([matrix[one].min(axis=0) for one in choices])
        np.testing.assert_allclose(placed.distances_to_nearest_per_choice(choices), expected, atol=1e-12)
    part = placed.subset(np.arange(10), np.arange(100, 130))
    np.testing.assert_allclose(part[:], matrix[:10, 100:130], atol=1e-12)


def test_places_are_indexed_like_a_matrix():
    places = np.random.default_rng(6).normal(size=(9, 3))
    placed, matrix = EmbeddedDistances(places), squareform(pdist(places, "sqeuclidean"))
    few, mask = [4, 0, 8], places[:, 0] > 0
    indices: tuple[Any, ...] = (
        2, -1, few, mask, slice(2, 5), (0, 1), (0, [1, 2]), ([1, 2], 0), (slice(None), 0), (np.int64(3), mask),
        (slice(1, 3), few), (few, slice(None)), np.ix_(few, [1, 2]), np.ix_(mask, mask), np.ix_([0], [1]),
    )  # fmt: skip
    for which in indices:
        assert placed[which].shape == matrix[which].shape
        np.testing.assert_allclose(placed[which], matrix[which], atol=1e-12)
    for pairs in (([0, 1], [2, 3]), (mask, mask), matrix > 1):
        with pytest.raises(IndexError, match="cannot be indexed by pairs"):
            placed[pairs]


def test_medoids_of_places_leave_less_than_random_choices():
    rng = np.random.default_rng(3)
    gaps = measure_nearest_distances(EmbeddedDistances(rng.normal(size=(500, 2))), np.arange(25))
    assert gaps.to_medoids.mean() < gaps.to_random.mean(axis=1).min()


def test_the_same_scenario_again_and_again_has_as_many_medoids_as_asked_for():
    found = EmbeddedDistances(np.zeros((9, 2))).medoids(4)
    assert len(set(found.tolist())) == 4


def test_clusters_by_landmarks_are_those_of_all_pairs():
    series, late = courses(700, np.random.default_rng(4))
    found = cluster_by_landmarks(PairwiseComparer(series, 1, None), ScenarioClustering())
    assert adjusted_rand_score(late, found.clustering.labels) > 0.98
    # Distances of 200 other scenarios, which were not used to find anything.
    assert found.embedding_error < 0.05
    true = distance_matrix(series[:100])
    told = EmbeddedDistances(found.embedding[:100])[:]
    assert np.abs(true - told).mean() < 0.05 * true.mean()


def test_distances_of_thinned_series_have_the_size_of_those_of_all_instants():
    series, _ = courses(30, np.random.default_rng(5))
    fine = [np.repeat(one, 6, axis=0) for one in series]
    every = downsampling_stride([len(one) for one in fine])
    assert every == 4
    thin = [downsample(one, every) for one in fine]
    assert max(map(len, thin)) <= 100 + 1
    assert all((one[-1] == two[-1]).all() for one, two in zip(fine, thin, strict=True))
    rough = every * distance_matrix(thin)
    assert rough.sum() == pytest.approx(distance_matrix(fine).sum(), rel=0.1)


def test_a_study_of_many_is_analysed_the_same_again_and_stores_no_pairs(path, many):
    found = analyze(path)["distance"]
    with StudyFile.open(path, readonly=True) as study:
        arrays, _ = study.read_analysis("distance")
        again, distances = read_analysis(study, "distance"), read_distances(study, "distance")
        true = distance_matrix(read_series(study, "distance"))
    assert "distances" not in arrays
    assert arrays["between"].shape == (24, 24)
    assert len(again.clustering.landmarks) == 24
    assert again.embedding_error == found.embedding_error
    assert np.abs(np.asarray(distances) - true).mean() < 0.1 * true.mean()
    assert analyze(path)["distance"].labels.tolist() == found.labels.tolist()


def test_scenarios_join_the_clusters_of_landmarks(path, many):
    first = analyze(path, "distance")["distance"]
    with opened(path) as study:
        explorer(study, metrics=("distance", "wttc"), optimizer="sobol", budget=60).run()
    later = analyze(path, "distance", keep_clusters=True)["distance"]
    assert later.labels[: len(first.labels)].tolist() == first.labels.tolist()
    assert len(later.labels) > len(first.labels)
    with StudyFile.open(path, readonly=True) as study:
        joined = assign_to_clusters(study, later, study, later.ids.tolist())
    others = np.setdiff1d(np.arange(len(later.ids)), later.clustering.landmarks)
    assert joined[others].tolist() == later.labels[others].tolist()


def test_clusters_of_all_pairs_are_kept_when_there_are_many(path, monkeypatch):
    first = analyze(path, "distance")["distance"]
    with opened(path) as study:
        explorer(study, metrics=("distance", "wttc"), optimizer="sobol", budget=60).run()
    monkeypatch.setattr(analyze_module, "MAX_ALL_PAIRS", 50)
    later = analyze(path, "distance", keep_clusters=True)["distance"]
    assert later.embedding_error is not None
    assert later.labels[: len(first.labels)].tolist() == first.labels.tolist()


def test_what_does_not_fit_is_refused_ahead(path):
    limit, ids = MemoryLimit.from_value("1 GB"), np.arange(1, 100_001)
    with (
        StudyFile.open(path, readonly=True) as study,
        pytest.raises(InputError, match=r"the series of 100000 scenarios need .* more than `memory` 1 GB"),
    ):
        # After ten recordings, as if there were many more to read.
        _read_inputs(study, ids, {"distance": 1}, limit, None, with_times=False, n_sampled=10)


@pytest.mark.parametrize(("n", "k", "axes"), [(400, 40, 48), (300, 300, 3), (333, 17, 8), (200, 1, 1)])
def test_k_means_by_neighbours_finds_what_scikit_learn_finds(n, k, axes):
    from sklearn.cluster import KMeans

    rng = np.random.default_rng(n)
    points = rng.normal(size=(n, axes)) * 0.7 ** np.arange(axes) + 5.0 * rng.integers(3, size=(n, 1))
    labels, centers = find_k_means(points, k)
    model = KMeans(k, n_init=1, max_iter=30, random_state=0).fit(points)
    np.testing.assert_array_equal(labels, model.labels_)
    np.testing.assert_allclose(centers, model.cluster_centers_, atol=1e-9)


def test_k_means_of_identical_points_leaves_clusters_empty():
    labels, centers = find_k_means(np.repeat([[1.0, 2.0], [3.0, 4.0]], 20, axis=0), 5)
    assert len(np.unique(labels)) == 2
    np.testing.assert_allclose(centers[labels], np.repeat([[1.0, 2.0], [3.0, 4.0]], 20, axis=0))


def test_a_landmark_far_away_does_not_hide_the_others():
    rng = np.random.default_rng(2)
    points = rng.normal(size=(300, 3))
    points[7] = 5e6
    squared = squareform(pdist(points, "sqeuclidean")).astype(np.float32).astype(np.float64)
    completion = LandmarkDistanceEstimator(squared)
    new = rng.normal(size=(50, 3))
    truth = ((new[:, None] - points[None]) ** 2).sum(axis=2)
    found = completion.estimate_to_all_landmarks(truth[:, completion.anchors])
    near = np.arange(300) != 7
    assert np.median(np.abs(found - truth)[:, near]) < 0.1 * np.median(truth[:, near])
