"""Cross-validated coverage holds for further scenarios."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from conftest import at_night
from cornercase.reduction._coverage import measure_coverage
from cornercase.reduction._held_out_coverage import (
    draw_folds,
    measure_held_out_distances,
    summarize_held_out,
    summarize_held_out_critical,
)
from cornercase.reduction._random_selections import distances_to_nearest_per_selection, draw_random_selections
from cornercase.reduction.selection._select import SelectionInput, SelectionRequest, cross_validate, select_reduced_set

TWENTY = SelectionRequest(20, None, None, "auto")


def drawn(count, rng):
    """Scenarios of two clusters, and three outliers."""
    half = (count - 3) // 2
    points = np.concatenate([0.3 * rng.random((half, 3)), 0.7 + 0.3 * rng.random((half, 3)), rng.random((3, 3))])
    return points, np.repeat([0, 1, -1], [half, half, 3])


def material(count, rng):
    points, labels = drawn(count, rng)
    return SelectionInput(points, [cdist(points, points)], labels, points, (), np.zeros(len(labels), dtype=bool))


@pytest.mark.parametrize("count", [0, 9, 10, 57, 600, 601, 3000])
def test_each_scenario_judges_once_and_chooses_nothing_that_it_judges(count):
    parts = draw_folds(count)
    assert len(parts) == (0 if count < 10 else 5 if count <= 600 else 1)
    judging = np.concatenate(parts) if parts else np.zeros(0)
    assert len(np.unique(judging)) == len(judging) == (0 if count < 10 else count if count <= 600 else -(-count // 5))
    found = material(57, np.random.default_rng(0))
    for trial in cross_validate(found, TWENTY):
        assert not set(trial.held_out.tolist()) & set(trial.training.tolist())
        assert set(trial.selected.tolist()) <= set(trial.training.tolist())
        assert len(trial.selected) == 20


@pytest.mark.parametrize("sets", at_night([3, 8], {8}))
def test_what_is_said_of_others_is_what_further_scenarios_find(sets):
    told, alike, further = [], [], []
    for seed in range(sets):
        rng = np.random.default_rng(seed)
        found = material(203, rng)
        kept = [one.index for one in select_reduced_set(found, TWENTY)[0]]
        others, _ = drawn(2003, rng)
        held_out = summarize_held_out(measure_held_out_distances(found.distances[0], cross_validate(found, TWENTY)))
        assert held_out is not None
        told.append(held_out.mean)
        alike.append(measure_coverage(found.distances[0], kept).mean)
        further.append(cdist(others, found.points[kept]).min(axis=1).mean())
    # Sets of folds come from four fifths, so they leave a little more.
    assert 1.0 <= np.mean(told) / np.mean(further) < 1.1
    # In-sample distances are smaller.
    assert np.mean(alike) / np.mean(further) < 0.9


def test_a_set_leaves_less_of_further_scenarios_than_random_choices_do_in_the_mean():
    for seed in range(5):
        rng = np.random.default_rng(100 + seed)
        found = material(303, rng)
        kept = [one.index for one in select_reduced_set(found, SelectionRequest(30, None, None, "auto"))[0]]
        others, _ = drawn(2003, rng)
        away = cdist(found.points, others)
        random = distances_to_nearest_per_selection(
            away, draw_random_selections(303, 30, stream="grading", draws=200, seed=seed)
        ).mean(axis=1)
        # Not the largest: no selection can know outliers among further scenarios.
        assert (random > away[kept].min(axis=0).mean()).mean() >= 0.9


@pytest.mark.parametrize("sets", at_night([3, 8], {8}))
def test_critical_scenarios_are_like_a_kept_one_as_often_as_is_said_of_others(sets):
    told, itself, further = [], [], []
    for seed in range(sets):
        rng = np.random.default_rng(seed)
        found = material(203, rng)
        distances, points = found.distances[0], found.points
        kept = np.array([one.index for one in select_reduced_set(found, TWENTY)[0]])
        gaps = measure_held_out_distances(distances, cross_validate(found, TWENTY))
        critical = points.sum(axis=1) <= 0.4
        found_so = summarize_held_out_critical(gaps, critical, critical, 0.08)
        others, _ = drawn(4003, rng)
        others = others[others.sum(axis=1) <= 0.4]
        assert found_so is not None
        assert found_so.scenarios == critical.sum()
        told.append(found_so.critical)
        itself.append((distances[critical][:, kept].min(axis=1) <= 0.08).mean())
        further.append((cdist(others, points[kept]).min(axis=1) <= 0.08).mean())
    assert np.mean(told) == pytest.approx(np.mean(further), abs=0.1)
    # A selected scenario is similar to itself.
    assert np.mean(itself) > np.mean(further) + 0.1


def test_a_few_scenarios_are_judged_by_nobody():
    few = material(9, np.random.default_rng(0))
    assert (
        measure_held_out_distances(few.distances[0], cross_validate(few, SelectionRequest(3, None, None, "auto")))
        is None
    )
    assert summarize_held_out(None) is None


def test_the_same_scenarios_are_judged_the_same_each_time():
    found = material(61, np.random.default_rng(3))
    for wish in (TWENTY, SelectionRequest(None, 0.3, None, "auto"), SelectionRequest(None, None, 4, "hull")):
        first, second = (
            summarize_held_out(measure_held_out_distances(found.distances[0], cross_validate(found, wish)))
            for _ in range(2)
        )
        assert first is not None
        assert second is not None
        assert asdict(first) == asdict(second)
        assert first.scenarios == 61
