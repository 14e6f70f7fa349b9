from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform
from sklearn.datasets import make_blobs, make_circles, make_moons
from sklearn.metrics import adjusted_rand_score

from conftest import at_night
from cornercase._common.errors import InputError
from cornercase.clustering import ScenarioClustering, cluster
from cornercase.clustering._validity import ValidityScorer, dbcv
from cornercase.dtw import distance_matrix


def between(points):
    return squareform(pdist(np.asarray(points, dtype=float)))


def drive(gap, start, crash_at=None):
    """Ego that brakes before a junction, waits `gap` seconds and turns right; 10 positions a second."""
    time_ = np.arange(0.0, 14.0, 0.1)
    travelled = np.where(
        time_ < 3,
        8 * time_,
        np.where(time_ < 3 + gap, 24.0, 24.0 + 3 * np.maximum(time_ - 3 - gap, 0) ** 1.2),
    )
    along = travelled - 24.0 - start
    turned = np.clip(along / 8.0, 0.0, np.pi / 2)
    x = 8 * (1 - np.cos(turned)) + np.maximum(along - 4 * np.pi, 0)
    y = np.where(along < 0, along, 8 * np.sin(turned))
    path = np.stack([x, y], axis=1)
    return path[:crash_at]


def test_accidents_are_a_cluster_of_their_own():
    rng = np.random.default_rng(0)
    outcomes, paths = [], []
    for _ in range(200):
        outcome = rng.choice(["ego first", "other first", "accident"], p=[0.5, 0.3, 0.2])
        gap = {"ego first": 0.0, "other first": 4.0, "accident": 0.5}[outcome] + rng.uniform(0, 0.6)
        crash = int(rng.integers(38, 48)) if outcome == "accident" else None
        outcomes.append(str(outcome))
        paths.append(drive(gap, rng.uniform(0, 2), crash))
    crashed = np.array(outcomes) == "accident"
    found = cluster(distance_matrix(paths))
    assert 2 <= found.n_clusters <= 4
    home = np.bincount(found.labels[crashed & (found.labels >= 0)]).argmax()
    assert np.mean(found.labels[crashed] == home) > 0.9
    assert np.mean(crashed[found.labels == home]) > 0.95


def test_courses_of_criticality_separate_high_from_low():
    # Worst-time-to-collision of two entities that meet closely, or with a large margin.
    rng = np.random.default_rng(1)
    margin = np.concatenate((rng.normal(0, 0.6, 150), rng.choice([-1.0, 1.0], 150) * rng.uniform(4, 6, 150)))
    when = rng.uniform(4, 6, 300)
    instants = np.arange(0.0, 12.0, 0.1)
    distance = np.sqrt((4 * (instants - when[:, None])) ** 2 + (4 * margin[:, None]) ** 2)
    courses = np.minimum(np.maximum(distance - 2.0, 0.0) / 9.5, 3.0)
    score = courses.min(axis=1)
    found = cluster(distance_matrix(list(courses)))
    assert found.n_clusters == 2
    assert found.noise <= 0.05
    medians = [np.median(score[found.labels == name]) for name in range(found.n_clusters)]
    highest, lowest = int(np.argmin(medians)), int(np.argmax(medians))
    assert score[found.labels == highest].max() < score[found.labels == lowest].min()
    assert np.sum(found.labels == highest) > 140


def blobs_with_bridges(seed):
    """Three blobs with six scenarios between two of them, twice; -1 belongs to none."""
    rng = np.random.default_rng(seed)
    centres = np.array([[0.0, 0.0], [8.0, 0.0], [4.0, 7.0]])
    points = [centre + 0.7 * rng.normal(size=(80, 2)) for centre in centres]
    for a, b in ((0, 1), (1, 2)):
        along = rng.uniform(0.25, 0.75, 6)[:, None]
        points.append(centres[a] + along * (centres[b] - centres[a]) + 0.1 * rng.normal(size=(6, 2)))
    return np.concatenate(points), np.repeat([0, 1, 2, -1], [80, 80, 80, 12])


def horseshoe_around_a_blob(seed):
    rng = np.random.default_rng(seed)
    angle = np.linspace(-0.3 * np.pi, 1.3 * np.pi, 200) + 0.01 * rng.normal(size=200)
    shoe = np.stack([np.cos(angle), np.sin(angle)], axis=1) * (1 + 0.05 * rng.normal(size=200))[:, None]
    return np.concatenate([shoe, 0.12 * rng.normal(size=(80, 2))]), np.repeat([0, 1], [200, 80])


def known_sets(seed):
    shoe, of_shoe = horseshoe_around_a_blob(seed)
    # An entity that stands for twenty instants: DTW distances are twenty times the distances of the positions.
    return {
        "moons": (between(make_moons(300, noise=0.05, random_state=seed)[0]), make_moons(300, random_state=seed)[1]),
        "rings": (
            between(make_circles(300, noise=0.04, factor=0.4, random_state=seed)[0]),
            make_circles(300, random_state=seed)[1],
        ),
        "blobs": (
            between(make_blobs(300, centers=[[0, 0], [8, 0], [3, 7]], cluster_std=0.8, random_state=seed)[0]),
            make_blobs(300, centers=[[0, 0], [8, 0], [3, 7]], random_state=seed)[1],
        ),
        "bridges": (between(blobs_with_bridges(seed)[0]), blobs_with_bridges(seed)[1]),
        "horseshoe": (distance_matrix([np.repeat(place[None], 20, axis=0) for place in shoe]), of_shoe),
    }


SHAPES = ["moons", "rings", "blobs", "bridges", "horseshoe"]


@pytest.mark.filterwarnings("ignore:Conversion of an array:DeprecationWarning")
@pytest.mark.parametrize("method", at_night(["dbscan", "hdbscan"], {"hdbscan"}))
@pytest.mark.parametrize("name", at_night(SHAPES, SHAPES[2:]))
@pytest.mark.parametrize("seed", at_night(range(3), {1, 2}))
def test_known_shapes(seed, name, method):
    distances, truth = known_sets(seed)[name]
    found = cluster(distances, method=method)
    one = truth >= 0
    assert adjusted_rand_score(truth[one], found.labels[one]) >= 0.95
    assert found.noise < 0.06
    assert found.stability is not None
    assert 0.5 < found.stability <= 1.0


@pytest.mark.parametrize("name", at_night(SHAPES, SHAPES[:3]))
def test_a_tenth_more_scenarios_or_another_order_change_few_labels(name):
    distances, _ = known_sets(3)[name]
    found = cluster(distances)
    rng = np.random.default_rng(0)
    fewer = np.sort(rng.permutation(len(distances))[: round(len(distances) / 1.1)])
    assert adjusted_rand_score(cluster(distances[np.ix_(fewer, fewer)]).labels, found.labels[fewer]) >= 0.9
    order = rng.permutation(len(distances))
    assert adjusted_rand_score(cluster(distances[np.ix_(order, order)]).labels, found.labels[order]) >= 0.9


def test_landmarks_find_the_same_and_say_what_they_lose():
    points, truth = make_moons(900, noise=0.05, random_state=0)
    distances = between(points)
    errors = []
    for count in (10, 60, 300):
        found = cluster(distances, landmarks=count)
        assert len(found.landmarks) == count == len(set(found.landmarks.tolist()))
        errors.append(found.error)
    assert adjusted_rand_score(truth, found.labels) >= 0.95
    assert found.embedding.shape == (900, 3)
    assert 0.0 < errors[2] < errors[1] < errors[0] < 0.5
    few = distances[:200, :200]
    assert len(cluster(few, landmarks=200).landmarks) == len(cluster(few).landmarks) == 0
    assert cluster(few).error == 0.0


def test_many_scenarios_take_landmarks_by_themselves():
    model = ScenarioClustering()
    assert [model._choose_n_landmarks(count) for count in (5000, 5001, 100_000)] == [5000, 2000, 2000]


def test_scenarios_that_are_no_landmarks_join_the_clusters_of_landmarks():
    points, truth = make_circles(700, noise=0.04, factor=0.4, random_state=1)
    distances = between(points)
    model = ScenarioClustering(landmarks=300).fit(distances)
    assert len(model.result_.landmarks) == 300
    assert adjusted_rand_score(truth, model.labels_) >= 0.95
    np.testing.assert_allclose(model.transform(distances), model.embedding_, atol=1e-9)
    assert (model.predict(distances) == model.labels_).mean() > 0.97


def test_the_error_of_landmarks_is_that_of_the_kernel():
    distances, _ = known_sets(2)["moons"]
    found = cluster(distances, landmarks=40, gamma=2.0, eps=0.3)
    kernel = np.exp(-2.0 * (distances / found.scale) ** 2)
    some, others = found.landmarks, np.setdiff1d(np.arange(300), found.landmarks)
    built = kernel[:, some] @ np.linalg.pinv(kernel[np.ix_(some, some)], rcond=1e-10) @ kernel[some]
    lost = np.linalg.norm((kernel - built)[np.ix_(others, others)]) / np.linalg.norm(kernel[np.ix_(others, others)])
    assert found.error == pytest.approx(lost, rel=0.05)


@pytest.mark.parametrize("seed", range(3))
def test_what_has_no_structure_is_one_cluster(seed):
    found = cluster(between(np.random.default_rng(seed).normal(size=(300, 3))))
    assert found.n_clusters == 1
    assert found.noise == 0.0


def test_the_unit_does_not_matter_and_neither_does_the_order():
    points, _ = make_blobs(200, centers=[[0, 0], [8, 0], [3, 7]], random_state=0)
    distances = between(points)
    once = cluster(distances)
    assert np.array_equal(cluster(distances * 1024.0).labels, once.labels)
    order = np.random.default_rng(0).permutation(200)
    again = cluster(distances[np.ix_(order, order)])
    assert adjusted_rand_score(again.labels, once.labels[order]) == 1.0


def test_the_stability_is_that_of_the_embedding_that_was_chosen():
    rng = np.random.default_rng(0)
    found = cluster(between(rng.normal(size=(30, 2)) + np.repeat([[0.0, 0.0], [20.0, 0.0]], 15, axis=0)))
    assert found.labels.max() == 1
    tried = next(one for one in found.candidates if one.eps == found.eps and one.gamma == found.gamma)
    other = replace(tried, n_components=12, stability=0.3)
    both = replace(found, candidates=(other, replace(tried, n_components=3, stability=0.9)))
    assert both.stability == 0.9


@pytest.mark.parametrize(("apart", "seed"), [(4.0, 503), (6.0, 500), (4.0, 1), (5.0, 2)])
def test_kinds_that_touch_are_the_same_in_any_order(apart, seed):
    rng = np.random.default_rng(seed)
    distances = between(rng.normal(size=(150, 2)) + np.repeat([[0.0, 0.0], [apart, 0.0]], 75, axis=0))
    once = ScenarioClustering().fit(distances)
    order = rng.permutation(150)
    again = ScenarioClustering().fit(distances[np.ix_(order, order)])
    assert np.array_equal(again.labels_, once.labels_[order])
    assert np.array_equal(again.embedding_, once.embedding_[order])
    assert np.array_equal(again.predict(distances[:9][:, order]), once.predict(distances[:9]))


def test_same_bytes_each_time():
    distances = between(np.random.default_rng(0).normal(size=(250, 3)) + np.repeat([0, 6], 125)[:, None])
    first, second = cluster(distances), cluster(distances)
    assert first.embedding.tobytes() == second.embedding.tobytes()
    assert first.labels.tobytes() == second.labels.tobytes()
    assert np.array_equal(
        [list(vars(one).values()) for one in first.candidates],
        [list(vars(one).values()) for one in second.candidates],
        equal_nan=True,
    )


def test_embedding_is_kernel_pca():
    distances = between(np.random.default_rng(5).normal(size=(40, 2)))
    found = cluster(distances, gamma=2.0, eps=0.3)
    kernel = np.exp(-2.0 * (distances / np.median(distances[np.triu_indices(40, 1)])) ** 2)
    middle = np.eye(40) - 1 / 40
    values, vectors = np.linalg.eigh(middle @ kernel @ middle)
    expected = vectors[:, ::-1][:, :3] * np.sqrt(values[::-1][:3])
    np.testing.assert_allclose(np.abs(found.embedding), np.abs(expected), atol=1e-9)
    for axis in found.embedding.T:
        assert axis[np.abs(axis).argmax()] > 0
    assert found.explained == pytest.approx(values[::-1][:3].sum() / values.sum())


def test_settings_by_hand_are_used():
    points, truth = make_blobs(90, centers=[[0, 0], [9, 0], [3, 8]], random_state=2)
    found = cluster(between(points), gamma=1.0, eps=0.2, min_samples=4)
    assert (found.gamma, found.eps, found.min_samples) == (1.0, 0.2, 4)
    assert len(found.candidates) == 1
    assert adjusted_rand_score(truth, found.labels) > 0.95
    assert cluster(between(points), gamma=1.0, eps=1e-6, min_samples=4).labels.tolist() == [-1] * 90
    some = cluster(between(points), gamma=4.0)
    assert {one.gamma for one in some.candidates} == {4.0}
    assert {one.eps for one in cluster(between(points), eps=0.25).candidates} == {0.25}


def test_the_choice_can_be_read_from_the_candidates():
    points, truth = make_blobs(120, centers=[[0, 0], [9, 0], [3, 8]], random_state=2)
    found = cluster(between(points))
    judged = [one for one in found.candidates if not np.isnan(one.stability)]
    best = max(judged, key=lambda one: one.score)
    assert (best.gamma, best.eps) == (found.gamma, found.eps)
    assert (best.n_components, best.min_samples) == (found.embedding.shape[1], found.min_samples)
    assert best.clusters == found.n_clusters == 3
    assert best.noise == found.noise
    assert best.agreement == 1.0
    assert adjusted_rand_score(truth, found.labels) == 1.0
    whole = [one for one in judged if one.clusters == 1]
    assert whole
    assert max(one.agreement for one in whole) <= 0.5
    assert np.bincount(found.labels[found.labels >= 0]).tolist() == sorted(
        np.bincount(found.labels[found.labels >= 0]), reverse=True
    )


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("n", range(1, 11))
def test_few_scenarios(n):
    found = cluster(between(np.random.default_rng(n).random((n, 2))))
    assert found.labels.shape == (n,)
    assert found.embedding.shape == (n, 3)
    assert np.isfinite(found.embedding).all()
    if n < 5:
        assert found.labels.tolist() == [0] * n


@pytest.mark.filterwarnings("error")
def test_scenarios_that_are_all_the_same():
    found = cluster(np.zeros((20, 20)))
    assert found.labels.tolist() == [0] * 20
    assert not found.embedding.any()
    assert found.scale == 0.0


@pytest.mark.filterwarnings("error")
def test_scenarios_that_are_the_same_in_groups():
    truth = np.repeat([0, 1, 2], [25, 20, 15])
    found = cluster(between(np.array([[0.0, 0.0], [1.0, 0.2], [0.3, 2.0]])[truth]))
    assert found.labels.tolist() == truth.tolist()


def test_validity_index_by_hand():
    # Two lines of 4 equidistant points each, by hand after Moulavi et al. with one dimension. The core
    # distance of an inner point is (mean of 1, 1, 1/2)^-1 = 6/5, of an outer one 18/11.
    line = np.array([0.0, 1.0, 2.0, 3.0])
    distances = between(np.concatenate((line, line + 103.0))[:, None])
    labels = np.repeat([0, 1], 4)
    # Sparseness is the inner edge of the tree; separation is between the inner points, 104 - 2 apart.
    expected = (102.0 - 1.2) / 102.0
    assert dbcv(distances, labels, dimensions=1.0) == pytest.approx(expected, rel=1e-5)
    noisy = between(np.concatenate((line, line + 103.0, [1000.0, 2000.0]))[:, None])
    assert dbcv(noisy, np.append(labels, [-1, -1]), dimensions=1.0) == pytest.approx(expected * 0.8, rel=1e-5)


def test_validity_of_a_sample_that_misses_a_cluster():
    # Every second scenario is in the sample, none of cluster 1.
    points, labels = np.arange(12.0)[:, None] + np.repeat([0.0, 30.0], 6)[:, None], np.array([0, 1] * 3 + [2, 1] * 3)
    in_sample = np.arange(0, 12, 2)
    expected = ValidityScorer(between(points[in_sample]), np.arange(6)).dbcv_and_silhouette(np.repeat([0, 1], 3))
    assert ValidityScorer(between(points), in_sample).dbcv_and_silhouette(labels) == expected > (0.5, 0.5)


@pytest.mark.parametrize(
    ("distances", "options", "words"),
    [
        (np.zeros((2, 3)), {}, "is not square"),
        (np.zeros((0, 0)), {}, "is not square"),
        ([[0.0, np.nan], [np.nan, 0.0]], {}, "The distance of scenarios 0 and 1 is nan"),
        ([[0.0, -1.0], [-1.0, 0.0]], {}, "The distance of scenarios 0 and 1 is -1.0"),
        ([[0.0, 1.0], [2.0, 0.0]], {}, "has to be symmetric"),
        ([[1.0, 1.0], [1.0, 0.0]], {}, "zeros on its diagonal"),
        ([[0.0, 1.0], [1.0, 0.0]], {"gamma": 0.0}, "`gamma` 0.0"),
        ([[0.0, 1.0], [1.0, 0.0]], {"gamma": "wide"}, "`gamma` 'wide'"),
        ([[0.0, 1.0], [1.0, 0.0]], {"eps": -1}, "`eps` -1"),
        ([[0.0, 1.0], [1.0, 0.0]], {"min_samples": 0}, "`min_samples` 0"),
        ([[0.0, 1.0], [1.0, 0.0]], {"n_components": 0}, "`n_components` 0"),
    ],
)
def test_refuses_in_one_sentence(distances, options, words):
    with pytest.raises(InputError, match=words):
        cluster(distances, **options)


def test_last_digits_of_distances_do_not_decide():
    # A radius may equal the distance to a neighbour; for 61 scenarios most radii do. A factor that is not a power of
    # two, removed again by the scale, changes only the last digits, as another machine does.
    for seed in range(3):
        distances = between(np.random.default_rng(seed).gamma(2.0, size=(61, 2)))
        held, found = cluster(distances), cluster(distances * 1.1)
        assert [one.clusters for one in found.candidates] == [one.clusters for one in held.candidates]
        assert [one.noise for one in found.candidates] == [one.noise for one in held.candidates]
        assert np.array_equal(found.labels, held.labels)
