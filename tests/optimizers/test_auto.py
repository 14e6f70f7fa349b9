"""The search that chooses its models by what it observes."""

from __future__ import annotations

import numpy as np
import pytest

from conftest import at_night
from cornercase._common.errors import InputError
from cornercase.evidence._committee import CommitteeModel
from cornercase.evidence.gp._gaussian_process import fit_boundary_process
from cornercase.exploration._study_critical_set import is_score_independent, uses_features_for_critical_set
from cornercase.optimizers import OPTIMIZERS, Auto, Sobol
from cornercase.scenario import Constraint, Parameter, ParameterDeclaration, ParameterSpace
from cornercase.study._criterion import Criterion
from helpers.search_cases import CUBE, EVERYWHERE, FEATURES, THRESHOLD, explored, two_regions, wall


def islands(points):
    """At most the threshold in two balls far from each other, 0.9 % of the cube each."""
    near = np.min([np.linalg.norm(points - at, axis=1) for at in ((0.2, 0.25, 0.3), (0.8, 0.7, 0.75))], axis=0)
    return THRESHOLD + 5.0 * (near - 0.13)


def search(optimizer, budget, function, batch=10):
    points = np.zeros((0, 3))
    while len(points) < budget:
        new = optimizer.ask(min(batch, budget - len(points)))
        optimizer.tell(new, *function(new))
        points = np.concatenate([points, new])
    return points


def f1(predicted, true):
    return 2.0 * (predicted & true).sum() / (predicted.sum() + true.sum())


def jumping(seed=2):
    return Auto().start(CUBE, seed, threshold=THRESHOLD, features=FEATURES)


def without_features(seed=0, space=CUBE):
    return Auto().start(space, seed, threshold=THRESHOLD, features=())


@pytest.fixture(scope="module")
def along_wall():
    """Points of a search of 70 scenarios, which begins as a shorter one does."""
    return search(jumping(), 70, wall)


def test_it_finds_the_critical_set_along_a_wall_where_the_score_jumps(along_wall):
    points = along_wall
    scores, features = wall(points)
    true = wall(EVERYWHERE)[0] <= THRESHOLD
    predicted = CommitteeModel(Criterion(THRESHOLD), FEATURES).fit(points, scores, features).predict(EVERYWHERE)[0]
    filling = Sobol().start(CUBE, 2).ask(len(points))
    other = CommitteeModel(Criterion(THRESHOLD), FEATURES).fit(filling, *wall(filling)).predict(EVERYWHERE)[0]
    assert f1(predicted > 0.5, true) > max(0.88, f1(other > 0.5, true) + 0.03)


def test_where_the_score_is_smooth_the_process_alone_chooses(along_wall):
    optimizer = without_features()
    points = explored(optimizer, 120, function=two_regions)
    assert optimizer._committee.is_process_alone
    process = fit_boundary_process(points, two_regions(points), Criterion(THRESHOLD))
    assert f1(process.predict(EVERYWHERE)[0] < 0.0, two_regions(EVERYWHERE) <= THRESHOLD) > 0.96
    jumps = jumping()
    jumps.tell(along_wall[:60], *wall(along_wall[:60]))
    np.testing.assert_array_equal(jumps.ask(10), along_wall[60:70])
    assert not jumps._committee.is_process_alone


@pytest.mark.parametrize("seed", at_night(range(3), {1, 2}))
def test_two_islands_are_both_found(seed):
    points = explored(without_features(seed), 120, function=islands)
    critical = points[islands(points) <= THRESHOLD]
    assert (critical[:, 0] < 0.5).sum() >= 3
    assert (critical[:, 0] > 0.5).sum() >= 3


def test_at_least_a_fifth_of_the_points_depends_on_no_score(along_wall):
    assert is_score_independent("auto", CUBE, 2, along_wall).sum() >= 24 + 0.2 * 46 - 1
    more = search(Auto(filling=0.5).start(CUBE, 2, threshold=THRESHOLD, features=FEATURES), 40, wall)
    assert is_score_independent("auto", CUBE, 2, more).sum() >= 24 + 0.5 * 16 - 1


@pytest.mark.parametrize("stops", at_night([(47,), (25, 63)], [(25, 63)]))
def test_it_goes_on_as_if_it_had_never_stopped(stops):
    whole = search(jumping(5), 49 if stops == (47,) else 63, wall, batch=7)
    for n_observed in stops:
        again = jumping(5)
        again.tell(whole[:n_observed], *wall(whole[:n_observed]))
        asked = jumping(5)
        for first in range(0, n_observed, 8):
            part = whole[first : min(first + 8, n_observed)]
            asked.tell(part, *wall(part))
            asked.ask(2)
        np.testing.assert_array_equal(again.ask(6), asked.ask(6))
    again = jumping(5)
    again.tell(whole[:-7], *wall(whole[:-7]))
    np.testing.assert_array_equal(again.ask(7), whole[-7:])


def test_without_rounds_nothing_is_proposed_twice_and_pending_scenarios_are_kept_at_a_distance():
    optimizer, pending, seen = jumping(1), np.zeros((0, 3)), 0
    while seen < 60:
        new = optimizer.ask_async(4 - len(pending), pending)
        seen += len(new)
        pending = np.concatenate([pending, new])
        assert len(np.unique(pending, axis=0)) == len(pending)
        optimizer.tell(pending[:1], *wall(pending[:1]))
        pending = pending[1:]
    assert len(np.unique(np.concatenate([optimizer._points, pending]), axis=0)) == 60


def test_it_looks_for_low_scores_while_nothing_is_critical():
    def bowl(points):
        return THRESHOLD + np.linalg.norm(points - (0.83, 0.17, 0.61), axis=1) - 0.06

    points = explored(without_features(2), 100, function=bowl)
    # 0.09 % of the cube: of a Sobol' sequence hardly one in ten such searches hits it.
    assert (bowl(points) <= THRESHOLD).sum() >= 5


def test_if_everything_is_critical_it_searches_for_what_is_not():
    def bump(points):
        return THRESHOLD - 1.0 + 1.3 * np.exp(-40.0 * ((points - (0.3, 0.6, 0.4)) ** 2).sum(axis=1))

    points = explored(without_features(1), 100, function=bump)
    # 0.2 % of the cube.
    assert (bump(points) > THRESHOLD).sum() >= 5
    assert (bump(Sobol().start(CUBE, 1).ask(100)) > THRESHOLD).sum() <= 1
    assert len(np.unique(points, axis=0)) == 100


@pytest.mark.parametrize("scores", [np.full(10, np.nan), np.zeros(10), np.full(10, 3.0), np.arange(10.0)])
def test_scores_of_one_kind_do_not_stop_it(scores):
    optimizer = jumping(0)
    for _ in range(5):
        points = optimizer.ask(10)
        assert points.shape == (10, 3)
        optimizer.tell(points, scores, np.where(np.isnan(scores)[:, None], np.nan, np.ones((10, 3))))


@pytest.mark.parametrize("by", at_night(["committee", "process"], {"committee"}))
def test_it_asks_little_where_scenarios_fail(by):
    def fails(points):
        scores, features = wall(points) if by == "committee" else (two_regions(points), points)
        failed = points[:, 1] > 0.8
        return np.where(failed, np.nan, scores), np.where(failed[:, None], np.nan, features)

    optimizer = jumping(0) if by == "committee" else without_features(0)
    points = search(optimizer, 120, lambda at: fails(at)[: 2 if by == "committee" else 1])
    # A fifth of the space fails.
    assert (points[:, 1] > 0.8).mean() < 0.2


@pytest.mark.parametrize("n_finished", [3, 4])
def test_it_goes_on_where_nearly_all_scenarios_fail(n_finished):
    optimizer = without_features()
    points = optimizer.ask(24)
    optimizer.tell(points, np.where(np.arange(24) < n_finished, two_regions(points), np.nan))
    assert len(optimizer.ask(10)) == 10


def test_with_many_scenarios_a_proposal_does_not_wait_for_larger_models_of_the_features():
    optimizer, points = jumping(), Sobol().start(CUBE, 5).ask(300)
    optimizer.tell(points, *wall(points))
    assert len(optimizer.ask(10)) == 10
    assert max(len(model._points) for model in optimizer._committee._feature_models._models) <= 256


def test_choices_steps_and_constraints_are_kept_to_the_last_scenario():
    parameters = [
        Parameter("a", 0, 4, 1.0),
        Parameter("kind", 0, 2, None, ("car", "truck", "bicycle")),
        Parameter("b", 0, 3, 1.0),
    ]
    limit = Constraint("lessThan", "${$b + 2}")
    declared = [
        ParameterDeclaration("b", "double", "0"),
        ParameterDeclaration("kind", "string", ""),
        ParameterDeclaration("a", "double", "0", ((limit,),)),
    ]
    space = ParameterSpace(parameters).with_constraints(declared)
    admissible = space.full_factorial()
    admissible = admissible[space.is_admissible(admissible)]

    def scores(points):
        truck = space.parameters[1].level_indices(points[:, 1]) == 1
        return np.where(truck, points[:, 0] + points[:, 2], 3.0)

    optimizer, every = without_features(0, space), []
    while len(points := optimizer.ask(10)):
        optimizer.tell(points, scores(points))
        every.append(points)
    met = np.concatenate(every)
    assert space.is_admissible(met).all()
    assert len(np.unique(met, axis=0)) == len(met) == len(admissible)


def test_its_studies_are_judged_with_features_and_it_is_described_by_its_options():
    assert uses_features_for_critical_set("auto:filling=0.3", 5000)
    assert uses_features_for_critical_set("sobol", 2000)
    assert not uses_features_for_critical_set("sobol", 2001)
    created = OPTIMIZERS.create("auto:filling=0.3")
    assert created == Auto(filling=0.3)
    assert (repr(created), str(created)) == ("Auto(filling=0.3)", "auto:filling=0.3")
    with pytest.raises(InputError, match="needs a threshold"):
        Auto().start(CUBE, 0)
    with pytest.raises(InputError, match="filling"):
        Auto(filling=1.5)


def test_it_looks_for_the_true_threshold_soon_after_the_first_critical_scenario():
    """The critical one comes late: as long as none is known, the lowest score stands in for the threshold."""

    def far_ball(points):
        return np.linalg.norm(points - 0.83, axis=1) - 0.05

    search = Auto().start(CUBE, 0, threshold=0.0, features=())
    points = np.zeros((0, 3))
    while len(points) < 400 and not (far_ball(points) <= 0.0).any():
        search.tell(new := search.ask(10), far_ball(new))
        points = np.concatenate([points, new])
    first = len(points)
    search.ask(1)
    search.tell(new := search.ask(10), far_ball(new))
    search.ask(1)
    assert search._committee._criterion.threshold == 0.0
    assert first < 400


def test_one_after_another_the_process_knows_what_ran_since_it_was_conditioned():
    def disc(points):
        return np.linalg.norm(points - 0.5, axis=1) - 0.3

    search = Auto().start(CUBE, 1, threshold=0.0, features=())
    points = search.ask(40)
    search.tell(points, disc(points))
    assert search.ask(0) is not None
    for _ in range(12):
        new = search.ask(1)
        search.tell(new, disc(new))
        assert np.linalg.norm(points - new, axis=1).min() > 0.01
        points = np.concatenate([points, new])


@pytest.mark.parametrize("name", at_night(["auto", "committee"], {"committee"}))
def test_a_branch_that_appears_between_two_learnings_leads_a_resumed_search_no_elsewhere(name):
    optimizer = OPTIMIZERS.create(name)
    square, rng = ParameterSpace.from_ranges(["x=0:1", "y=0:1"]), np.random.default_rng(3)

    def drawn(count, beyond):
        points = rng.random((count, 2))
        points[:, 0] = np.where(np.arange(count) < beyond, 0.8 + 0.2 * points[:, 0], 0.8 * points[:, 0])
        return points

    def observed(points):
        x, y = points.T
        beyond = x > 0.8
        checks = np.where((np.floor(6 * x) + np.floor(6 * y)) % 2 == 0, 0.05, 0.4) + 0.01 * x
        features = [
            np.where(beyond, np.sin(3 * x) + y, np.sin(5 * x) - y),
            np.where(beyond, 1.0, -1.0),
            np.sin(2 * x) + y,
        ]
        return points, np.where(beyond, 0.1 + y, checks), np.stack(features, axis=1)

    went_on, told = optimizer.start(square, 1, threshold=0.15, features=FEATURES), []
    # The second branch has seven scenarios when the kernels are learned, and eight at the next proposals.
    for points in (drawn(30, 7), drawn(5, 2), drawn(5, 1)):
        told.append(observed(points))
        went_on.tell(*told[-1])
        proposed = went_on.ask(5)
        resumed = optimizer.start(square, 1, threshold=0.15, features=FEATURES)
        for scenarios in told:
            resumed.tell(*scenarios)
        assert np.array_equal(resumed.ask(5), proposed)
