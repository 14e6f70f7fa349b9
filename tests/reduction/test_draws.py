"""Random selections that influence the reduced set do not evaluate it."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from cornercase._common.errors import InputError
from cornercase.reduction import _baselines as baselines
from cornercase.reduction import _coverage as coverage
from cornercase.reduction._coverage import measure_coverage, measure_nearest_distances
from cornercase.reduction._critical_coverage import measure_critical_coverage
from cornercase.reduction._random_selections import distances_to_nearest_per_selection, draw_random_selections
from cornercase.reduction.selection._greedy import select_scenarios
from cornercase.scenario import ParameterSpace
from cornercase.study._criterion import Criterion

SPACE = ParameterSpace.from_ranges(["a=0:1", "b=0:1"])


def as_sets(choices):
    return {frozenset(one) for one in choices.tolist()}


@pytest.mark.parametrize("seed", [0, 1, 7])
def test_a_set_is_graded_by_draws_that_it_was_not_chosen_with(seed, monkeypatch):
    drawn: dict[ModuleType, set[frozenset[int]]] = {baselines: set(), coverage: set()}
    for module, seen in drawn.items():

        def spy(*arguments, seen=seen, **options):
            choices = draw_random_selections(*arguments, **options)
            seen |= as_sets(choices)
            return choices

        monkeypatch.setattr(module, "draw_random_selections", spy)
    points = np.random.default_rng(seed).random((60, 2))
    distances, labels = cdist(points, points), (points[:, 0] > 0.5).astype(int)
    kept = np.array([one.index for one in select_scenarios(points, [distances], labels, size=6)])
    measure_coverage(distances, kept, seed=seed)
    measure_coverage(distances, kept)
    measure_critical_coverage(
        SPACE,
        points,
        points[:, 0],
        Criterion(0.1),
        measure_nearest_distances(distances, kept, seed=seed),
        0.2,
        seed=seed,
    )
    assert len(drawn[baselines]) >= 100
    assert len(drawn[coverage]) >= 100
    assert not drawn[baselines] & drawn[coverage]


def test_streams_and_seeds_share_nothing_and_each_is_the_same_each_time():
    drawn = [
        draw_random_selections(60, 6, stream=stream, seed=seed)
        for stream in ("choosing", "grading")
        for seed in (0, 1, 2)
    ]
    for k, one in enumerate(drawn):
        assert one.shape == (100, 6)
        assert all(len(set(each)) == 6 for each in one.tolist())
        assert not any(as_sets(one) & as_sets(other) for other in drawn[:k])
    np.testing.assert_array_equal(drawn[3], draw_random_selections(60, 6, stream="grading"))


def test_the_nearest_one_of_each_choice():
    distances = np.abs(np.subtract.outer(np.arange(5.0), np.arange(5.0)))
    assert distances_to_nearest_per_selection(distances, np.array([[0, 4], [2, 2]])).tolist() == [
        [0, 1, 2, 1, 0],
        [2, 1, 0, 1, 2],
    ]
    with pytest.raises(InputError, match="`draws` 0"):
        draw_random_selections(5, 2, stream="grading", draws=0)
