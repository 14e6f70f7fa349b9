"""Warm starts from another study."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from conftest import at_night
from cornercase._common.errors import InputError
from cornercase.evidence._committee import CommitteeModel
from cornercase.evidence._critical_set_estimate import CriticalSet
from cornercase.evidence._multi_fidelity import SourceStudyModel
from cornercase.evidence.gp._gaussian_process import fit_boundary_process
from cornercase.exploration._study_critical_set import is_score_independent
from cornercase.optimizers import OPTIMIZERS, LevelSet, Sobol
from cornercase.study._criterion import Criterion
from helpers.search_cases import CUBE, EVERYWHERE, FEATURES, THRESHOLD, explored, two_regions, wall

KNOWN = Sobol().start(CUBE, 100).ask(200)


def moved(points):
    """The two regions, slightly moved and larger, as with another driver."""
    return two_regions(points - (0.03, -0.02, 0.03)) - 0.1


def recall_after(count, seed, function, known=None):
    optimizer = LevelSet().start(CUBE, seed, threshold=THRESHOLD)
    elsewhere = None
    if known is not None:
        optimizer.warm_start(KNOWN, known)
        elsewhere = SourceStudyModel(KNOWN, known, Criterion(THRESHOLD))
    points = explored(optimizer, count, batch=5, function=function)
    found = CriticalSet(CUBE, points, function(points), Criterion(THRESHOLD), seed, source_model=elsewhere)
    told, true = found.predict(EVERYWHERE), function(EVERYWHERE) <= THRESHOLD
    return (told & true).sum() / true.sum()


def test_it_finds_sooner_what_another_study_foretells():
    begun = [recall_after(25, seed, moved, two_regions(KNOWN)) for seed in range(3)]
    cold = [recall_after(25, seed, moved) for seed in range(3)]
    assert np.median(begun) > 0.9
    assert np.mean(begun) > np.mean(cold) + 0.1


def predicted_by_committee(points, prediction=None):
    """Probability of being critical everywhere, by a committee that learned from some points of a score that jumps."""
    scores, features = wall(points)

    def with_prediction(at):
        return at if prediction is None else np.column_stack([at, prediction(at)])

    committee = CommitteeModel(Criterion(THRESHOLD), FEATURES, has_prediction=prediction is not None)
    committee.fit(with_prediction(points), scores, features)
    return committee.predict(with_prediction(EVERYWHERE))[0]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_committee_uses_another_study_only_if_it_predicts_outcomes(seed):
    points = Sobol().start(CUBE, seed).ask(60)
    alone = predicted_by_committee(points)

    def of_no_use(at):
        return np.sin(997.0 * at @ (1.0, 7.0, 31.0))

    assert np.array_equal(predicted_by_committee(points, of_no_use), alone)
    true = wall(EVERYWHERE)[0] <= THRESHOLD
    helped = predicted_by_committee(points, lambda at: wall(at)[0] + 0.02 * np.sin(20.0 * at[:, 0]))
    assert np.abs(helped - true).mean() < 0.7 * np.abs(alone - true).mean()


def test_what_misleads_is_dropped():
    misleading = two_regions(KNOWN[:, ::-1] * (1.0, -1.0, 1.0) + (0.0, 1.0, 0.0))
    assert recall_after(60, 0, moved, misleading) > recall_after(60, 0, moved) - 0.02


def test_a_coordinate_that_says_nothing_is_left_out_of_the_process():
    points = Sobol().start(CUBE, 3).ask(60)
    noise = np.random.default_rng(0).normal(size=(60, 1))
    plain = fit_boundary_process(points, two_regions(points), Criterion(THRESHOLD))
    process = fit_boundary_process(
        np.hstack([points, noise]), two_regions(points), Criterion(THRESHOLD), has_prediction=True
    )
    # Ignored, or with a length scale so large that nothing varies.
    assert process.kernel.length_scales[-1] > 5.0
    for there in (-1.0, 1.0):
        told = process.predict(np.column_stack([EVERYWHERE, np.full(len(EVERYWHERE), there)]))[0] <= 0.0
        assert (told == (plain.predict(EVERYWHERE)[0] <= 0.0)).mean() > 0.97


def test_a_coordinate_that_says_all_is_used():
    points = Sobol().start(CUBE, 3).ask(30)
    told = np.column_stack([points, np.tanh(moved(points) - THRESHOLD)])
    process = fit_boundary_process(told, moved(points), Criterion(THRESHOLD), has_prediction=True)
    at = np.column_stack([EVERYWHERE, np.tanh(moved(EVERYWHERE) - THRESHOLD)])
    right = (process.predict(at)[0] <= 0.0) == (moved(EVERYWHERE) <= THRESHOLD)
    plain = fit_boundary_process(points, moved(points), Criterion(THRESHOLD)).predict(EVERYWHERE)[0] <= 0.0
    assert right.mean() > 0.99 > (plain == (moved(EVERYWHERE) <= THRESHOLD)).mean()


def test_a_coordinate_that_tells_a_little_is_left_out_however_many_scenarios_say_so():
    points = Sobol().start(CUBE, 3).ask(100)
    scores, told = moved(points), np.tanh(two_regions(points - (0.2, -0.2, 0.0)) - THRESHOLD)
    for count in (30, 60, 100):
        process = fit_boundary_process(
            np.column_stack([points, told])[:count], scores[:count], Criterion(THRESHOLD), has_prediction=True
        )
        assert np.isinf(process.kernel.length_scales[-1])


def begun_search(seed, scores):
    optimizer = LevelSet().start(CUBE, seed, threshold=THRESHOLD)
    optimizer.warm_start(KNOWN, scores)
    return optimizer


@pytest.mark.parametrize("batch", [1, 5, 10, 40])
def test_half_of_the_first_ten_are_where_the_other_study_has_the_boundary(batch):
    for seed in range(3):
        points = explored(begun_search(seed, two_regions(KNOWN)), max(batch, 10), batch=batch, function=moved)
        sought = points[~is_score_independent("level-set", CUBE, seed, points)]
        assert len(sought) == 5
        # That near are 26 % of the cube.
        assert (np.abs(two_regions(sought) - THRESHOLD) < 0.4).sum() >= 4
        assert pdist(sought).min() > 0.1


def test_what_the_other_study_chose_is_made_up_for_by_points_that_fill_the_space():
    points = explored(begun_search(0, two_regions(KNOWN)), 24, batch=1, function=moved)
    # Ten and a fifth of the rest; and it had begun before the 24th.
    assert is_score_independent("level-set", CUBE, 0, points).sum() == 12
    missed = explored(begun_search(0, np.random.default_rng(0).normal(size=200)), 24, batch=1, function=moved)
    assert is_score_independent("level-set", CUBE, 0, missed).sum() == 19


@pytest.mark.parametrize("name", at_night(["level-set", "committee", "auto"], {"auto", "committee"}))
def test_a_search_that_is_told_again_asks_the_same(name):
    def begun():
        optimizer = OPTIMIZERS.create(name).start(CUBE, 3, threshold=THRESHOLD, budget=40)
        optimizer.warm_start(KNOWN, two_regions(KNOWN))
        return optimizer

    first, again, rounds = begun(), begun(), []
    for _ in range(4):
        points = first.ask(8)
        first.tell(points, moved(points))
        rounds.append(points)
    for points in rounds:
        np.testing.assert_array_equal(again.ask(8), points)
        again.tell(points, moved(points))
    cold = explored(OPTIMIZERS.create(name).start(CUBE, 3, threshold=THRESHOLD, budget=40), 32, batch=8, function=moved)
    assert not np.array_equal(cold, np.concatenate(rounds))


@pytest.mark.parametrize("name", sorted({*OPTIMIZERS.names()} - {"auto", "level-set", "committee", "optuna"}))
def test_others_refuse_it_by_name(name):
    optimizer = OPTIMIZERS.create(name).start(CUBE, 3, threshold=THRESHOLD, budget=40)
    assert not optimizer.supports_warm_start
    with pytest.raises(InputError, match=f"{name} learns nothing from another study"):
        optimizer.warm_start(KNOWN, two_regions(KNOWN))
