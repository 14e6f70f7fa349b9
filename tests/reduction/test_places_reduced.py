"""Reduced sets of scenarios with embedded distances."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform

from conftest import at_night
from cornercase._common.errors import InputError
from cornercase.clustering import _analyze as analyze_module
from cornercase.clustering import _landmarks as landmarks
from cornercase.clustering import analyze
from cornercase.clustering._embedding import EmbeddedDistances
from cornercase.reduction import _reduce as reduce_module
from cornercase.reduction import reduce
from cornercase.reduction._cell_greedy_search import CellGreedySearch
from cornercase.reduction._coverage import measure_coverage
from cornercase.reduction._critical_coverage import max_similar_distance
from cornercase.reduction._held_out_coverage import Fold, measure_held_out_distances
from cornercase.reduction._medoids import find_k_medoids, find_prototype
from cornercase.reduction.selection._greedy import select_scenarios
from helpers.synthetic_study import explorer, opened


@pytest.fixture(scope="module")
def scenarios():
    rng = np.random.default_rng(8)
    points = rng.random((300, 3))
    places = [np.sin(3.0 * points), points[:, :2] ** 2]
    return points, places, [squareform(pdist(one, "sqeuclidean")) for one in places], (points[:, 0] > 0.6).astype(int)


def test_the_choice_by_places_is_that_by_the_matrix(scenarios):
    points, places, matrices, labels = scenarios
    placed = select_scenarios(points, [EmbeddedDistances(one) for one in places], labels, [1], size=30)
    assert {one.index for one in placed} == {
        one.index for one in select_scenarios(points, matrices, labels, [1], size=30)
    }
    placed = select_scenarios(points, [EmbeddedDistances(one) for one in places], labels, cover=0.1)
    assert [one.index for one in placed] == [one.index for one in select_scenarios(points, matrices, labels, cover=0.1)]


@pytest.mark.parametrize("size", at_night([20, 60, 400], {60, 400}))
def test_the_choice_by_cells_is_that_by_the_matrix(scenarios, size):
    points, places, _, labels = scenarios
    # The last cell is not full.
    doubled = [np.concatenate((one, one[:7])) for one in places]
    points, labels = (np.concatenate((one, one[:7])) for one in (points, labels))
    # Distances of 300 scenarios would be kept in memory otherwise.
    embedded = [EmbeddedDistances(one) for one in doubled]
    placed = select_scenarios(points, embedded, labels, [1], size=size, max_in_memory=10)
    whole = select_scenarios(points, [squareform(pdist(one, "sqeuclidean")) for one in doubled], labels, [1], size=size)
    assert [one.index for one in placed] == [one.index for one in whole]
    assert len(placed) == min(size, len({one.index % 300 for one in placed}))


def test_cells_find_what_is_left_in_places_of_any_size():
    rng = np.random.default_rng(4)
    for count, axes, power in ((1, 1, 3), (16, 3, 2), (37, 19, 3), (200, 8, 2)):
        places = [rng.random((count, axes)) * rng.random(axes), rng.random((count, 2))]
        heavy, usual, kept = rng.random((2, count)), [0.3, 0.7], [0, count // 2]
        sums = CellGreedySearch(places, usual, list(heavy), power, kept)
        costs = [
            (squareform(pdist(one, "sqeuclidean")) / unit) ** power * weight
            for one, unit, weight in zip(places, usual, heavy, strict=True)
        ]
        left = [one[kept].min(axis=0) for one in costs]
        gains = sum(np.maximum(now - one, 0.0).sum(axis=1) for now, one in zip(left, costs, strict=True))
        np.testing.assert_allclose(sums.gains, gains, atol=1e-12)
        assert sums.pop_best_candidate() == gains.argmax()
        assert {sums.pop_best_candidate() for _ in range(count - 1)} == {*range(count)} - {gains.argmax()}
        assert sums.pop_best_candidate() is None


def test_grades_by_places_are_those_by_the_matrix(scenarios):
    _, places, (matrix, _), labels = scenarios
    placed = EmbeddedDistances(places[0])
    members = np.flatnonzero(labels)
    assert find_prototype(placed, members) == find_prototype(matrix, members)
    assert max_similar_distance(placed, labels) == pytest.approx(max_similar_distance(matrix, labels))
    one, two = (measure_coverage(each, np.arange(0, 300, 10)) for each in (placed, matrix))
    names = ("largest", "mean", "worst", "largest_relative", "random_largest", "random_mean", "better_mean")
    assert [getattr(one, name) for name in names] == pytest.approx([getattr(two, name) for name in names])
    # Two heuristics; neither is optimal.
    assert one.medoids_mean == pytest.approx(two.medoids_mean, rel=0.15)
    everyone = np.arange(300)
    trials = [Fold(everyone[60:], everyone[60:90], everyone[:60])]
    mine, other = (measure_held_out_distances(each, trials) for each in (placed, matrix))
    assert mine is not None
    assert other is not None
    np.testing.assert_allclose(mine.to_selected, other.to_selected, atol=1e-12)
    np.testing.assert_allclose(mine.to_random, other.to_random, atol=1e-12)


def test_medoids_of_places_are_about_as_good_as_those_of_a_matrix(scenarios):
    _, places, (matrix, _), _ = scenarios
    left = [matrix[:, find_k_medoids(each, 20)].min(axis=1).mean() for each in (EmbeddedDistances(places[0]), matrix)]
    assert left[0] < 1.15 * left[1]


def test_a_study_of_many_is_reduced_within_a_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(analyze_module, "MAX_ALL_PAIRS", 30)
    monkeypatch.setattr(landmarks, "N_LANDMARKS", 24)
    path = tmp_path / "s.db"
    with opened(path) as study:
        explorer(study, metrics=("distance", "wttc"), optimizer="sobol", budget=60).run()
    found = analyze(path)
    assert all(one.embedding_error is not None for one in found.values())
    monkeypatch.setattr(reduce_module, "find_explored_scenario", lambda *given, **options: None)
    reduced = reduce(path, tmp_path / "kept", size=8)
    assert len(reduced) == 8
    assert reduced.coverage["distance"].largest_relative < 0.5
    with pytest.raises(InputError, match=r"distances of \d+ scenarios need .* more than `memory` 500 MB"):
        reduce(path, tmp_path / "kept", size=8, memory="500 MB")


def test_the_first_of_many_scenarios_are_chosen_from_every_fourth_and_represent_about_as_well():
    rng = np.random.default_rng(7)
    points = rng.random((2400, 3))
    distances, labels = [EmbeddedDistances(points)], np.zeros(2400, dtype=int)
    sampled, whole = (
        [one.index for one in select_scenarios(points, distances, labels, size=100, sampled_from=count)]
        for count in (100, 2400)
    )
    assert len(set(sampled)) == len(set(whole)) == 100
    assert sampled != whole
    first, rest = sampled[:75], sampled[75:]
    assert all(index % 4 == 0 for index in first[21:])
    assert any(index % 4 for index in rest)
    left = [distances[0].distances_to_nearest(np.array(chosen)).mean() for chosen in (sampled, whole)]
    assert left[0] < 1.05 * left[1]
    few = [one.index for one in select_scenarios(points, distances, labels, size=10, sampled_from=100)]
    assert len(set(few)) == 10


def test_alike_scenarios_by_one_aspect_are_told_apart_by_another():
    rng = np.random.default_rng(8)
    points = rng.random((300, 2))
    same = EmbeddedDistances(np.zeros((300, 2)))
    chosen = select_scenarios(points, [same, EmbeddedDistances(points)], np.zeros(300, dtype=int), size=30)
    assert len({one.index for one in chosen}) == 30
    assert len(select_scenarios(points, [same], np.zeros(300, dtype=int), size=30)) == 1
