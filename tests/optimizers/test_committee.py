"""The search by a committee, and the committee behind it."""

from __future__ import annotations

import numpy as np
import pytest

from conftest import at_night
from cornercase.evidence._committee import CommitteeModel
from cornercase.evidence.gp._gaussian_process import fit_boundary_process
from cornercase.optimizers import Committee, LevelSet, Sobol
from cornercase.scenario import Parameter, ParameterSpace
from cornercase.study._criterion import Criterion
from helpers.search_cases import CUBE, EVERYWHERE, FEATURES, THRESHOLD, explored, two_regions, wall


def search(optimizer, budget=100, function=wall, batch=10):
    points = np.zeros((0, 3))
    while len(points) < budget:
        new = optimizer.ask(batch)
        optimizer.tell(new, *function(new))
        points = np.concatenate([points, new])
    return points


def agreement(told, true):
    return (told & true).sum() / true.sum(), (told & true).sum() / max(told.sum(), 1)


@pytest.mark.parametrize("by", at_night(["sobol", "search"], {"search"}))
def test_it_follows_a_score_that_jumps_where_one_process_cannot(by):
    def chosen(optimizer, function):
        return Sobol().start(CUBE, 1).ask(200) if by == "sobol" else search(optimizer, 200, function)

    true = wall(EVERYWHERE)[0] <= THRESHOLD
    points = chosen(Committee().start(CUBE, 2, threshold=THRESHOLD, features=FEATURES), wall)
    scores, told = wall(points)
    critical, branch = CommitteeModel(Criterion(THRESHOLD), FEATURES).fit(points, scores, told).predict(EVERYWHERE)
    recall, precision = agreement(critical > 0.5, true)
    assert recall > 0.8
    assert precision > 0.85
    # The branch is certain, except at the edge.
    sure = np.abs(wall(EVERYWHERE)[1][:, 1]) > 0.1
    assert (branch[sure] > 0.8).mean() > 0.95
    others = chosen(LevelSet().start(CUBE, 2, threshold=THRESHOLD), lambda at: wall(at)[:1])
    alone = fit_boundary_process(others, wall(others)[0], Criterion(THRESHOLD)).predict(EVERYWHERE)[0] < 0.0
    assert recall > agreement(alone, true)[0] + 0.09


@pytest.mark.slow
def test_of_many_scenarios_its_processes_know_those_that_tell_most():
    class Limited(CommitteeModel):
        max_process_scenarios = 150

    points = Sobol().start(CUBE, 1).ask(300)
    scores, features = wall(points)
    every = CommitteeModel(Criterion(THRESHOLD), FEATURES).fit(points, scores, features).predict(EVERYWHERE)[0]
    some = Limited(Criterion(THRESHOLD), FEATURES).fit(points, scores, features)
    true = wall(EVERYWHERE)[0] <= THRESHOLD
    for critical in (every, some.predict(EVERYWHERE)[0]):
        recall, precision = agreement(critical > 0.5, true)
        assert recall > 0.75
        assert precision > 0.75
    # Out-of-fold predictions exist for all scenarios, used by the processes or not.
    wrong = (some.out_of_fold_probability() > 0.5) != (scores <= THRESHOLD)
    assert wrong.shape == (300,)
    assert wrong.mean() < 0.1


@pytest.mark.slow
def test_of_many_scenarios_its_trees_know_those_that_tell_most():
    class Limited(CommitteeModel):
        max_tree_scenarios = 200

    points = Sobol().start(CUBE, 1).ask(400)
    scores, features = wall(points)
    some = Limited(Criterion(THRESHOLD), FEATURES).fit(points, scores, features)
    recall, precision = agreement(some.predict(EVERYWHERE)[0] > 0.5, wall(EVERYWHERE)[0] <= THRESHOLD)
    assert recall > 0.75
    assert precision > 0.75
    wrong = (some.out_of_fold_probability() > 0.5) != (scores <= THRESHOLD)
    assert wrong.shape == (400,)
    assert wrong.mean() < 0.1
    # Further scenarios use the same kernels.
    some.condition_on(points[:300], scores[:300], features[:300])
    wrong = (some.out_of_fold_probability() > 0.5) != (scores[:300] <= THRESHOLD)
    assert wrong.shape == (300,)
    assert wrong.mean() < 0.1


def test_a_branch_that_the_processes_of_features_leave_out_is_learned_nevertheless():
    class Limited(CommitteeModel):
        max_process_scenarios = 20
        n_trees = n_trees_per_fold = 8

    points = Sobol().start(CUBE, 1).ask(120)
    scores, features = wall(points)
    branches = [k for k, feature in enumerate(FEATURES) if feature.branch]
    model = Limited(Criterion(THRESHOLD), FEATURES)
    # Of a rare branch, far from the threshold, no scenario is among those that the processes use.
    used = model._select_process_scenarios(scores)
    assert used is not None
    rare = np.setdiff1d(np.argsort(np.abs(scores - THRESHOLD))[-40:], used)[:9]
    features[:, branches] = -1.0
    features[rare, branches[0]] = 1.0
    model.fit(points, scores, features)
    assert np.isfinite(model.out_of_fold_probability()).all()
    assert ((model.predict(points)[0] > 0.5) == (scores <= THRESHOLD)).mean() > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("budget", at_night([100, 150], {150}))
def test_without_features_it_finds_both_regions(budget):
    points = explored(Committee().start(CUBE, 0, threshold=THRESHOLD, features=()), budget, function=two_regions)
    critical, _ = CommitteeModel(Criterion(THRESHOLD)).fit(points, two_regions(points)).predict(EVERYWHERE)
    recall, precision = agreement(critical > 0.5, two_regions(EVERYWHERE) <= THRESHOLD)
    assert recall > 0.93
    assert precision > 0.93
    assert len(np.unique(points, axis=0)) == budget


def test_it_goes_on_as_if_it_had_never_stopped():
    whole = search(Committee().start(CUBE, 5, threshold=THRESHOLD, features=FEATURES), 50)
    again = Committee().start(CUBE, 5, threshold=THRESHOLD, features=FEATURES)
    for first in range(0, 40, 10):
        again.tell(whole[first : first + 10], *wall(whole[first : first + 10]))
    np.testing.assert_array_equal(again.ask(10), whole[40:])
    np.testing.assert_array_equal(again.ask(10), whole[40:])


@pytest.mark.slow
def test_it_looks_for_low_scores_while_nothing_is_critical():
    def bowl(points):
        return THRESHOLD + np.linalg.norm(points - (0.83, 0.17, 0.61), axis=1) - 0.06

    points = explored(Committee().start(CUBE, 2, threshold=THRESHOLD, features=()), 100, function=bowl)
    # 0.09 % of the cube: of a Sobol' sequence hardly one in ten such searches meets it.
    assert (bowl(points) <= THRESHOLD).sum() >= 5
    assert not (bowl(Sobol().start(CUBE, 2).ask(100)) <= THRESHOLD).any()


@pytest.mark.slow
def test_it_asks_little_where_scenarios_fail():
    def fails(points):
        scores, told = wall(points)
        failed = points[:, 1] > 0.8
        return np.where(failed, np.nan, scores), np.where(failed[:, None], np.nan, told)

    points = search(Committee().start(CUBE, 0, threshold=THRESHOLD, features=FEATURES), 160, fails)
    # A fifth of the space fails.
    assert (points[:, 1] > 0.8).mean() < 0.2


@pytest.mark.parametrize("scores", [np.full(10, np.nan), np.zeros(10), np.full(10, 3.0), np.arange(10.0)])
def test_it_stands_scores_of_one_kind(scores):
    optimizer = Committee().start(CUBE, 0, threshold=THRESHOLD, features=FEATURES)
    for _ in range(5):
        points = optimizer.ask(10)
        assert points.shape == (10, 3)
        told = np.where(np.isnan(scores)[:, None], np.nan, np.ones((10, 3)))
        optimizer.tell(points, scores, told)


def test_choices_and_finite_spaces_are_run_whole():
    space = ParameterSpace(
        [
            Parameter("a", 0, 4, 1.0),
            Parameter("kind", 0, 2, None, ("car", "truck", "bicycle")),
            Parameter("b", 0, 3, 1.0),
        ]
    )

    def scores(points):
        return np.where(space.parameters[1].level_indices(points[:, 1]) == 1, points[:, 0] + points[:, 2], 3.0)

    optimizer, every = Committee().start(space, 0, threshold=0.6, features=()), []
    while len(points := optimizer.ask(10)):
        optimizer.tell(points, scores(points))
        every.append(points)
    assert len(np.unique(np.concatenate(every), axis=0)) == len(np.concatenate(every)) == 60


def test_what_is_told_out_of_fold_is_as_good_as_it_says():
    points = Sobol().start(CUBE, 3).ask(300)
    scores, told = wall(points)
    committee = CommitteeModel(Criterion(2.0), FEATURES).fit(points, scores, told)
    outside, inside = committee.out_of_fold_probability(), committee.predict(points)[0]
    critical = scores <= 2.0
    assert ((outside > 0.5) == critical).mean() > 0.9
    # Scenarios it was trained on are reproduced, left-out ones are not.
    assert np.abs(inside - critical).mean() < 0.5 * np.abs(outside - critical).mean()
    new = Sobol().start(CUBE, 9).ask(2000)
    wrong = np.abs(committee.predict(new)[0] - (wall(new)[0] <= 2.0)).mean()
    assert np.abs(outside - critical).mean() == pytest.approx(wrong, rel=0.35)
