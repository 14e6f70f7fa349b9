"""Estimates of critical sets, compared with known sets."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import qmc

from cornercase._common.errors import InputError
from cornercase.evidence._critical_set_estimate import CriticalSet
from cornercase.evidence.gp._gaussian_process import GaussianProcess
from cornercase.metrics import Feature
from cornercase.optimizers import LevelSet, Sobol
from cornercase.scenario import Constraint, Parameter, ParameterDeclaration, ParameterSpace
from cornercase.stop._stop_rules import StopCriterion
from cornercase.study._criterion import Criterion
from helpers.search_cases import CUBE, EVERYWHERE, THRESHOLD, explored, two_regions

TRUE = two_regions(EVERYWHERE) <= THRESHOLD


def estimates(known):
    return (
        known.critical_fraction,
        known.missed_fraction,
        known.p_overlooked_region(),
        known.unexplored_fraction(),
    )


def slab(points):
    """Critical in a slanted slab of the cube, with a jump of the score at one of its sides."""
    along = points @ (0.8, 0.5, 0.1)
    return np.where(along > 0.9, 3.0, np.abs(along - 0.75)) - 0.1


def test_leaving_one_out_is_learning_from_the_others():
    rng = np.random.default_rng(0)
    points, values = rng.random((30, 3)), rng.normal(size=30)
    process = GaussianProcess().fit(points, values)
    means, deviations = process.leave_one_out()
    for i in (0, 7, 29):
        others = np.delete(np.arange(30), i)
        apart = np.linalg.norm((points[:, None] - points) / process.kernel.length_scales, axis=-1) * np.sqrt(5)
        kernel = process.kernel.signal**2 * (1 + apart + apart**2 / 3) * np.exp(-apart)
        within = kernel[np.ix_(others, others)] + process.kernel.noise**2 * np.eye(29)
        weights = np.linalg.solve(within, kernel[others, i])
        expected = values.mean() + weights @ (values[others] - values.mean())
        variance = kernel[i, i] + process.kernel.noise**2 - weights @ kernel[others, i]
        assert means[i] == pytest.approx(expected, abs=1e-6)
        assert deviations[i] == pytest.approx(np.sqrt(variance), rel=1e-4)


@pytest.mark.slow
def test_the_intervals_hold_the_truth_about_as_often_as_they_say():
    within = {"share": 0, "missed": 0}
    runs = 0
    for function, threshold in ((two_regions, THRESHOLD), (slab, 0.0)):
        true = function(EVERYWHERE) <= threshold
        for seed in range(8):
            for count in (60, 120):
                points = qmc.Sobol(3, seed=seed).random(128)[:count]
                known = CriticalSet(CUBE, points, function(points), Criterion(threshold), seed)
                missed = (true & ~known.predict(EVERYWHERE)).sum() / true.sum()
                within["share"] += known.critical_fraction.low <= true.mean() <= known.critical_fraction.high
                within["missed"] += missed <= known.missed_fraction.high
                runs += 1
    # Of 32 with a probability of 0.9, 25 to 32 in all but one of a hundred cases.
    assert runs == 32
    assert within["share"] >= 25
    # One end of the interval: with a probability of 0.95.
    assert within["missed"] >= 27


def test_less_is_missed_and_more_is_known_the_longer_it_goes_on():
    points = explored(LevelSet().start(CUBE, 1, threshold=THRESHOLD), 200, function=two_regions)
    early, late = (CriticalSet(CUBE, points[:n], two_regions(points[:n]), Criterion(THRESHOLD)) for n in (50, 200))
    assert late.missed_fraction.high < 0.5 * early.missed_fraction.high
    assert late.critical_fraction.high - late.critical_fraction.low < 0.5 * (
        early.critical_fraction.high - early.critical_fraction.low
    )
    assert late.critical_fraction.value == pytest.approx(TRUE.mean(), rel=0.03)
    assert late.p_overlooked_region() < 0.02


def test_a_region_in_which_nothing_was_run_is_reckoned_with():
    points = qmc.Sobol(3, seed=3).random(128)
    ball = np.linalg.norm(points - (0.8, 0.75, 0.5), axis=1) < 0.3
    known, blind = (CriticalSet(CUBE, p, two_regions(p), Criterion(THRESHOLD)) for p in (points, points[~ball]))
    # A ball of 0.3 is 11 % of the cube.
    assert known.unexplored_fraction(0.02) < 0.04
    assert known.unexplored_fraction(0.02) + 0.01 < blind.unexplored_fraction(0.02) < 0.11
    assert blind.unexplored_fraction(0.005) > blind.unexplored_fraction(0.02) > blind.unexplored_fraction(0.12)


def test_on_a_line_a_region_in_which_something_was_run_is_not_overlooked():
    line = ParameterSpace.from_ranges(["a=0:1"])
    points = Sobol().start(line, 0).ask(80)
    known = CriticalSet(line, points, np.abs(points[:, 0] - 0.55), Criterion(0.2))
    assert known.critical_fraction.value == pytest.approx(0.4, abs=0.01)
    assert known.p_overlooked_region() == 0.0


def test_a_region_that_the_process_foretells_is_overlooked_until_something_is_run_there():
    def waves(points):
        return np.cos(4 * np.pi * points[:, 0]) + 0.5

    points = qmc.Sobol(3, seed=3).random(128)
    apart = np.abs(points[:, 0] - 0.75) > 0.12
    known, blind = (CriticalSet(CUBE, p, waves(p), Criterion(0.0)) for p in (points, points[apart]))
    assert known.p_overlooked_region(0.02) < 0.05
    assert blind.p_overlooked_region(0.02) > known.p_overlooked_region(0.02)


def test_of_a_space_that_was_run_whole_all_is_known():
    space = ParameterSpace(
        [Parameter("a", 0, 9, 1.0), Parameter("kind", 0, 2, None, ("x", "y", "z")), Parameter("b", 0, 4, 1.0)]
    )
    points = space.full_factorial()
    scores = np.abs(points[:, 0] - points[:, 2]) + (space.parameters[1].level_indices(points[:, 1]) == 1)
    known = CriticalSet(space, points, scores, Criterion(0.25))
    assert (
        known.critical_fraction.low == known.critical_fraction.high == pytest.approx((scores <= 0.25).mean(), abs=1e-3)
    )
    assert known.missed_fraction.high < 0.05
    assert known.p_overlooked_region() == 0.0


@pytest.mark.parametrize(("threshold", "share"), [(0.5, 1 / 12), (-1.0, 0.0), (99.0, 1.0)])
def test_of_few_scenarios_that_were_all_run_all_is_known(threshold, share):
    space = ParameterSpace([Parameter("a", 0, 3, 1.0), Parameter("b", 0, 2, 1.0)])
    points = space.full_factorial()
    scores = np.arange(12.0)
    # The search chose the least scores first; that does not matter once all scenarios were run.
    known = CriticalSet(space, points, scores, Criterion(threshold), initial_design=np.zeros(12, dtype=np.bool_))
    assert known.interval_unavailable is known.missed_interval_unavailable is None
    assert (known.critical_fraction.low, known.critical_fraction.value, known.critical_fraction.high) == pytest.approx(
        (share, share, share)
    )
    assert (known.missed_fraction.value, known.missed_fraction.high) == (0.0, 0.0)
    scores[0] = np.nan
    assert "only 0" in (
        CriticalSet(
            space, points, scores, Criterion(threshold), initial_design=np.zeros(12, dtype=np.bool_)
        ).interval_unavailable
        or ""
    )


@pytest.mark.parametrize("seed", [0, 1])
def test_constraints_that_leave_little_leave_enough_places(seed):
    strip = ((Constraint("greaterThan", "0.49"), Constraint("lessThan", "0.51")),)
    declarations = [ParameterDeclaration("x", "double", "0.5", strip), ParameterDeclaration("y", "double", "0.5", ())]
    space = ParameterSpace.from_ranges(["x=0:1", "y=0:1"]).with_constraints(declarations)
    points = Sobol().start(space, seed).ask(60)
    known = CriticalSet(space, points, points.sum(axis=1), Criterion(0.7), seed)
    assert known.critical_fraction.value == pytest.approx(0.2, abs=0.001)


def test_no_more_can_be_critical_than_what_was_not_run():
    space = ParameterSpace([Parameter("a", 0, 4, 1.0), Parameter("b", 0, 5, 1.0)])
    points = Sobol().start(space, 0).ask(29)
    scores = points.sum(axis=1)
    none, every = (CriticalSet(space, points, scores, Criterion(threshold)) for threshold in (-1.0, 9.0))
    assert none.critical_fraction.high == pytest.approx(1 / 30)
    assert every.critical_fraction.low == pytest.approx(29 / 30)


def test_failed_scenarios_do_not_count_and_too_few_say_nothing():
    points = qmc.Sobol(3, seed=0).random(64)
    scores = two_regions(points)
    failed = np.where(points[:, 2] > 0.7, np.nan, scores)
    kept = np.isfinite(failed)
    with_failed, without = (
        CriticalSet(CUBE, points, failed, Criterion(THRESHOLD)),
        CriticalSet(CUBE, points[kept], scores[kept], Criterion(THRESHOLD)),
    )
    assert estimates(with_failed) == estimates(without)
    for few in (scores[:9], np.ones(20)):
        with pytest.raises(ValueError, match="10 scores that are not all the same"):
            CriticalSet(CUBE, points[: len(few)], few, Criterion(THRESHOLD))


def test_no_critical_scenario_at_all_leaves_a_small_share():
    points = qmc.Sobol(3, seed=0).random(128)
    known = CriticalSet(CUBE, points, two_regions(points) + 3.0, Criterion(THRESHOLD))
    assert known.critical_fraction.high < 0.05
    assert known.missed_fraction.low == 1.0


@pytest.mark.parametrize("threads", [1, 2])
def test_it_says_the_same_again_whatever_the_number_of_threads(monkeypatch, threads):
    points = qmc.Sobol(3, seed=0).random(64)
    expected = estimates(CriticalSet(CUBE, points, two_regions(points), Criterion(THRESHOLD), 5))
    monkeypatch.setattr("cornercase.evidence.gp._gaussian_process.count_available_cpus", lambda: threads)
    assert estimates(CriticalSet(CUBE, points, two_regions(points), Criterion(THRESHOLD), 5)) == expected


def test_criteria_are_read():
    assert StopCriterion.parse("missed<0.01") == StopCriterion("missed", 0.01)
    assert StopCriterion.parse("overlooked( 0.02 ) < 0.05") == StopCriterion("overlooked", 0.05, 0.02)
    for text in (
        "missed",
        "missed<",
        "missed<1.5",
        "lost<0.1",
        "missed(1.1)<0.2",
        "missed()<0.2",
        "overlooked()<0.2",
        "missed(0)<0.2",
        "interval(0.1)<0.2",
        "interval<-1",
        "missed<nan",
        "__import__<1",
    ):
        with pytest.raises(InputError, match="`stop_when`"):
            StopCriterion.parse(text)


def test_before_anything_critical_was_met_the_share_is_bounded_by_what_was_run():
    points = qmc.Sobol(3, seed=0).random(64)[:40]
    known = CriticalSet(CUBE, points, two_regions(points) + 3.0, Criterion(THRESHOLD))
    # The rule of three.
    assert known.critical_fraction.low == 0.0
    assert known.critical_fraction.high == pytest.approx(3 / 40, rel=0.05)
    # Scenarios chosen by scores give no interval.
    blindly = np.arange(40) < 20
    fewer = CriticalSet(CUBE, points, two_regions(points) + 3.0, Criterion(THRESHOLD), initial_design=blindly)
    assert fewer.critical_fraction.high == pytest.approx(3 / 20, rel=0.1)
    assert known.p_overlooked_region() == known.unexplored_fraction() > 0.2
    for text in ("interval<0.05", "overlooked<0.05", "missed<0.05"):
        one = StopCriterion.parse(text)
        assert one.evaluate(known) >= one.bound


def test_while_all_that_was_met_is_critical_the_share_is_bounded_by_what_was_run():
    # Everything is critical except a corner of 3 % of the cube that no score points to.
    points = Sobol().start(CUBE, 0).ask(40)
    known = CriticalSet(CUBE, points, points.sum(axis=1), Criterion(9.0))
    assert known.critical_fraction.value == known.critical_fraction.high == 1.0
    assert known.critical_fraction.low == pytest.approx(1.0 - 3 / 40, rel=0.05)
    assert StopCriterion.parse("interval<0.05").evaluate(known) >= 0.05


def test_two_sets_are_drawn_independently():
    points = qmc.Sobol(3, seed=0).random(64)
    rng = np.random.default_rng(3)
    scores = rng.normal(size=(2, 64))
    one, other = (CriticalSet(CUBE, points, each, Criterion(0.0)) for each in scores)
    # For noise, the fraction of one set in another is the size of the other.
    assert one.fraction_inside(other).value == pytest.approx(other.critical_fraction.value, abs=0.03)
    # Also for the same scores, drawn twice: nothing predicts where they are critical.
    assert one.fraction_inside(one).value < 0.7


def test_a_scenario_of_a_finite_space_is_critical_or_not_in_one_draw():
    space = ParameterSpace([Parameter("a", 0, 4, 1.0), Parameter("b", 0, 5, 1.0)])
    points = space.full_factorial()
    known = CriticalSet(space, points[::2], np.random.default_rng(0).normal(size=15), Criterion(0.0))
    (at, weights), drawn = known._joint_points, known._samples.joint_draws
    places = known._sample.points[at]
    assert len(np.unique(places, axis=0)) == len(places) == len(drawn) == 30
    assert weights.sum() == pytest.approx(1.0)
    # Scenarios that were run are known: the fractions differ by whole other scenarios.
    shares = known._samples.critical_fraction * 30
    assert shares.min() >= known._critical.sum() - 0.5
    assert shares.max() <= known._critical.sum() + 15.5


@pytest.mark.parametrize("seed", [3, 7, 8])
def test_draws_without_a_critical_place_do_not_count_as_nothing_missed(seed):
    rng = np.random.default_rng(seed)
    points, scores = rng.random((60, 3)), rng.normal(size=60)
    # One scenario is critical, by noise: nearly the whole critical set is missed.
    known = CriticalSet(CUBE, points, scores, Criterion(float(np.sort(scores)[:2].mean())))
    assert known.predict(EVERYWHERE).mean() < 0.01
    assert known.missed_fraction.low > 0.5


def test_a_ball_keeps_to_the_space_in_ten_dimensions():
    space = ParameterSpace.from_ranges([f"p{k}=0:1" for k in range(10)])
    points = qmc.Sobol(10, seed=1).random(128)
    known = CriticalSet(space, points, points.sum(axis=1), Criterion(4.0))
    rng = np.random.default_rng(0)
    for size in (0.01, 0.05):
        # Balls around random places, as large as the share of the space that they really take.
        at, around = rng.random((300, 10)), rng.random((4000, 10))
        apart = np.sort(np.linalg.norm(at[:, None] - around, axis=2), axis=1)[:, int(size * 4000)]
        met = (np.linalg.norm(at[:, None] - points, axis=2) <= apart[:, None]).any(axis=1)
        assert known.unexplored_fraction(size) == pytest.approx(1.0 - met.mean(), abs=0.08)


def test_audits_correct_what_is_said_and_never_say_what_is_found():
    points = qmc.Sobol(3, seed=3).random(64)
    audits = np.random.default_rng(5).random((200, 3))
    alone = CriticalSet(CUBE, points, two_regions(points), Criterion(THRESHOLD))
    known = CriticalSet(CUBE, points, two_regions(points), Criterion(THRESHOLD), audits=(audits, two_regions(audits)))
    np.testing.assert_array_equal(known.predict(EVERYWHERE), alone.predict(EVERYWHERE))
    missed = (TRUE & ~known.predict(EVERYWHERE)).sum() / TRUE.sum()
    assert (
        known.missed_fraction.high - known.missed_fraction.low < alone.missed_fraction.high - alone.missed_fraction.low
    )
    assert known.missed_fraction.low - 0.02 <= missed <= known.missed_fraction.high + 0.02
    assert (
        known.audited_missed_fraction.low
        <= missed
        <= known.audited_missed_fraction.high
        < known.audited_missed_upper_bound
    )
    hits = (two_regions(audits) <= THRESHOLD).sum()
    assert known.audited_critical_fraction.value == hits / 200


def test_where_too_little_was_chosen_blindly_no_interval_is_given_and_it_says_why():
    points = qmc.Sobol(3, seed=3).random(64)
    scores, first = two_regions(points), np.arange(64)
    known = CriticalSet(CUBE, points, scores, Criterion(THRESHOLD), initial_design=first < 15)
    assert known.interval_unavailable is not None
    assert "only 15" in known.interval_unavailable
    assert known.missed_interval_unavailable == known.interval_unavailable
    assert (
        StopCriterion.parse("interval<0.5").evaluate(known) == StopCriterion.parse("missed<0.9").evaluate(known) == 1.0
    )
    none = CriticalSet(CUBE, points, scores, Criterion(-1.0))
    assert none.interval_unavailable is None
    assert none.missed_interval_unavailable == "no critical scenario besides audits was run"
    assert (none.missed_fraction.value, none.missed_upper_bound()) == (1.0, 1.0)
    # A single critical scenario is enough, also if the search chose it.
    one = np.where(np.arange(64) == np.argmin(scores), scores, scores + 2.0)
    found = CriticalSet(CUBE, points, one, Criterion(THRESHOLD), initial_design=one > THRESHOLD)
    assert found.missed_interval_unavailable is None
    assert 0.0 <= found.missed_fraction.low <= found.missed_fraction.high <= 1.0
    audits = np.random.default_rng(5).random((60, 3))
    both = (audits, two_regions(audits))
    assert (
        CriticalSet(
            CUBE, points, scores, Criterion(THRESHOLD), initial_design=first < 0, audits=both
        ).missed_interval_unavailable
        is None
    )


def test_where_nothing_was_missed_yet_the_interval_reaches_to_0():
    line, points = ParameterSpace.from_ranges(["x=0:1"]), qmc.Sobol(1, seed=0).random(64)
    everywhere = np.linspace(0.0, 1.0, 20001)[:, None]

    def wave(at):
        return np.cos(7.0 * at[:, 0]) + 0.2

    known = CriticalSet(line, points, wave(points), Criterion(0.0))
    missed = (~known.predict(everywhere[wave(everywhere) <= 0.0])).mean()
    assert missed < 1e-3
    assert known.missed_fraction.low == 0.0
    assert missed <= known.missed_fraction.high < 0.01


def test_hidden_is_the_ball_that_escapes_one_time_in_twenty():
    points = qmc.Sobol(3, seed=3).random(128)
    known = CriticalSet(CUBE, points, two_regions(points), Criterion(THRESHOLD))
    centres = np.random.default_rng(0).random((400, 3))
    ball = (
        known.max_fraction_in_empty_region * known.critical_fraction.value / (1.0 - known.max_fraction_in_empty_region)
    )
    assert known.unexplored_fraction(ball) == pytest.approx(0.05, abs=0.01)
    apart = np.sort(np.linalg.norm(centres[:, None] - EVERYWHERE[:4096], axis=2), axis=1)[:, round(ball * 4096)]
    escapes = ~(np.linalg.norm(centres[:, None] - points, axis=2) < apart[:, None]).any(axis=1)
    assert escapes.mean() < 0.1


@pytest.mark.parametrize("count", [64, 256])
def test_what_is_missed_at_most_counts_a_region_that_no_score_points_to(count):
    points = qmc.Sobol(3, seed=3).random(count)
    # So smooth that of what scores point to nothing is missed: what is left is one more ball, with even odds.
    known = CriticalSet(CUBE, points, points @ (0.8, 0.5, 0.1), Criterion(0.4))
    assert known.missed_fraction.high < 0.01
    rng = np.random.default_rng(0)
    centres, sizes = rng.random((3000, 3)), 0.3 * 0.5 ** rng.integers(9, size=3000)
    apart = np.sort(np.linalg.norm(centres[:, None] - EVERYWHERE[:2048], axis=2), axis=1)
    radii = apart[np.arange(3000), (sizes * 2048).astype(int)]
    escapes = np.linalg.norm(centres[:, None] - points, axis=2).min(axis=1) >= radii
    # As many draws without a ball, which are never rejected.
    fractions = np.concatenate([np.zeros(3000), sizes[escapes] / (known.critical_fraction.value + sizes[escapes])])
    assert known.missed_upper_bound() == pytest.approx(np.quantile(fractions, 0.95), abs=0.012)
    assert StopCriterion.parse("missed<0.1").evaluate(known) == known.missed_upper_bound()
    assert StopCriterion.parse("missed(0.7)<0.1").evaluate(known) == known.missed_upper_bound(0.7)
    assert known.missed_upper_bound(0.7) < known.missed_upper_bound()


def test_a_bound_of_what_is_missed_falls_to_0_once_all_was_run():
    few = ParameterSpace.from_ranges(["x=0:1:0.1", "y=0:1:0.1"])
    points = few.full_factorial()
    scores = np.where(np.linalg.norm(points - 0.5, axis=1) < 0.3, 0.0, 1.0)
    part = np.random.default_rng(0).permutation(len(points))[:60]
    assert CriticalSet(few, points[part], scores[part], Criterion(0.5)).missed_upper_bound() > 0.02
    assert CriticalSet(few, points, scores, Criterion(0.5)).missed_upper_bound() == 0.0


def jumping(points):
    """Scores that jump where the other goes first, and features that show it; a thin sheet at the jump is critical."""
    a, b, c = points.T
    gap = a + 0.3 * np.sin(4 * b) - 0.6
    first = gap > 0.0
    near = 2.0 * np.abs(gap) + 0.4 * np.abs(c - 0.5)
    return np.where(first, 5.0 + near, near + 0.6), np.stack([np.where(first, 3.0 + near, near), gap], axis=1)


def test_features_of_the_recordings_find_what_one_process_of_the_scores_cannot():
    columns = (Feature("least", "m"), Feature("gap", "s", branch=True))
    points, everywhere = Sobol().start(CUBE, 1).ask(200), EVERYWHERE
    scores, features = jumping(points)
    scores[7], features[7] = np.nan, np.nan
    true = jumping(everywhere)[0] <= 1.0
    plain = CriticalSet(CUBE, points, scores, Criterion(1.0), 3).predict(everywhere)
    known = CriticalSet(CUBE, points, scores, Criterion(1.0), 3, features=(columns, features))
    found = known.predict(everywhere)
    assert known.uses_committee
    assert (found == true).mean() > (plain == true).mean() + 0.03
    missed = (true & ~found).sum() / true.sum()
    assert missed < 0.15
    assert known.missed_fraction.low <= missed <= known.missed_fraction.high
    assert known.critical_fraction.low <= true.mean() <= known.critical_fraction.high


@pytest.mark.parametrize("search", [Sobol(), LevelSet()])
def test_a_plateau_of_scores_at_the_threshold_is_critical_inside(search):
    """As collisions are, whose times to collision are all 0: the score says nothing of how deep they lie."""

    def distance_to_ball(points):
        return np.maximum(np.linalg.norm(points - 0.6, axis=1) - 0.3, 0.0)

    criterion = Criterion(0.0)
    options = {"threshold": 0.0} if "threshold" in search.requires else {}
    optimizer = search.start(CUBE, 0, **options)
    points = np.zeros((0, CUBE.dimension))
    while len(points) < 120:
        new = optimizer.ask(10)
        optimizer.tell(new, distance_to_ball(new))
        points = np.concatenate([points, new])
    known = CriticalSet(CUBE, points, distance_to_ball(points), criterion, initial_design=np.arange(120) < 24)
    places = qmc.Sobol(CUBE.dimension, seed=1).random(4096)
    truth = distance_to_ball(places) == 0.0
    told = known.predict(places)
    assert (told & truth).sum() >= 0.85 * truth.sum()
    assert (told & truth).sum() >= 0.85 * told.sum()
    assert known.critical_fraction.value == pytest.approx(truth.mean(), rel=0.3)
