from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtri
from scipy.stats import binom, chi2, norm

from conftest import at_night
from cornercase.evidence._mixture import TMixture
from cornercase.evidence._probability import (
    conditional_probability,
    probability_from_counts,
    probability_from_enumeration,
    probability_from_weights,
)
from cornercase.evidence._rare_events import ImportanceSampling, fit_initial_proposal
from cornercase.scenario import Constraint, Parameter, ParameterDeclaration, ParameterSpace
from cornercase.study._criterion import Criterion


def space_of(dimension):
    return ParameterSpace.from_ranges([f"x{axis}=0:1" for axis in range(dimension)])


def estimated(space, score, runs, seed, guess=None, limits=(0.0,)):
    """Probability that the score is at most the last limit, from this many runs; each limit is that of an event."""
    sampling, spent = ImportanceSampling(space, len(limits), int(0.4 * runs), seed, guess), 0
    while sampling.next_stage != "estimate":
        points = sampling.draw_round(runs)
        scores = score(points)
        sampling.record_round(points, scores, scores[:, None] <= np.array(limits))
        spent += len(points)
    points = sampling.draw_round(runs - spent)
    return probability_from_weights(
        sampling.importance_weights(points), score(points) <= limits[-1], sampling.common_weight_error
    ), sampling


def two_tails(points):
    """Beyond 4.5 on one axis, or beyond 4.4 on the other side of another."""
    places = ndtri(np.clip(points, 1e-16, 1 - 2e-16))
    return np.minimum(4.5 - places[:, 0], 4.4 + places[:, 1])


TWO_TAILS = 1.0 - (1.0 - norm.sf(4.5)) * (1.0 - norm.sf(4.4))


@pytest.mark.parametrize("seeds", at_night([2, 5], {5}))
def test_two_far_regions_of_one_in_a_hundred_thousand_are_told_within_a_fifth(seeds):
    found = [estimated(space_of(3), two_tails, 4000, seed)[0] for seed in range(seeds)]
    assert all(abs(one.value / TWO_TAILS - 1.0) < 0.2 for one in found)
    assert all(one.error < 0.1 for one in found)
    assert sum(one.low <= TWO_TAILS <= one.high for one in found) >= seeds - 1
    # Plain Monte Carlo needs millions for what 4,000 scenarios say.
    assert all(one.equivalent_monte_carlo_scenarios > 1e6 for one in found)


def test_what_is_frequent_is_told_too():
    found, _ = estimated(space_of(2), lambda points: points[:, 0] - 0.3, 1000, 0)
    assert found.low <= 0.3 <= found.high
    assert found.error < 0.1


def test_a_plateau_gives_no_way_but_what_is_met_counts():
    def score(points):
        return np.minimum(np.abs(points - 0.7).max(1) - 0.01, 0.1)

    found, _ = estimated(space_of(2), score, 4000, 1)
    assert found.low <= 4e-4 <= found.high


def test_choices_steps_and_distributions_count_as_probable_as_they_are():
    space = ParameterSpace(
        [
            Parameter("kind", 0.0, 2.0, choices=("a", "b", "c"), distribution=law("set", 0.0, 2.0, 90.0, 9.0, 1.0)),
            Parameter("number", 0.0, 9.0, step=1.0),
            Parameter("speed", 0.5, 20.0, distribution=law("lognormal", 0.5, 20.0, 1.0, 0.4)),
        ]
    )

    def score(points):
        values = space.values(points)
        return np.array(
            [6.0 - float(one["speed"]) + 4.0 * (one["kind"] != "c") + abs(float(one["number"]) - 3.0) for one in values]
        )

    truth = 0.0
    cut = norm.cdf((np.log([0.5, 20.0]) - 1.0) / 0.4)
    for kind, probable in (("a", 0.9), ("b", 0.09), ("c", 0.01)):
        for count in range(10):
            least = 6.0 + 4.0 * (kind != "c") + abs(count - 3.0)
            truth += probable * 0.1 * (cut[1] - norm.cdf((np.log(min(least, 20.0)) - 1.0) / 0.4)) / (cut[1] - cut[0])
    found, _ = estimated(space, score, 3000, 2)
    assert found.low <= truth <= found.high
    assert found.error < 0.2


def law(kind, low, high, *numbers):
    return ParameterSpace.from_json(
        {
            "parameters": [
                {
                    "name": "p", "low": low, "high": high, "step": None, "choices": [], "unit": "", "sets": [],
                    "distribution": {"kind": kind, "low": low, "high": high, "numbers": list(numbers)},
                }
            ],
            "declarations": [],
        }
    ).parameters[0].distribution  # fmt: skip


def test_the_probability_is_that_within_the_constraints():
    """Of x + y <= 1.2 at most 0.68 is left, in which the corner x > 0.99 is rarer than in the square."""
    declarations = [
        ParameterDeclaration("x", "double", "0.5", ()),
        ParameterDeclaration("y", "double", "0.5", ((Constraint("lessOrEqual", "${1.2 - $x}"),),)),
    ]
    space = ParameterSpace.from_ranges(["x=0:1", "y=0:1"]).with_constraints(declarations)
    found, _ = estimated(space, lambda points: 0.99 - points[:, 0], 2000, 0)
    # The strip is cut at y = 1.2 - x.
    truth = (0.01 * (1.2 - 0.995)) / (1.0 - 0.5 * 0.8**2)
    assert found.low <= truth <= found.high
    assert found.error < 0.15


def test_told_again_it_goes_on_as_if_nothing_had_happened():
    first = ImportanceSampling(space_of(3), 1, 600, 5)
    rounds = []
    for _ in range(20):
        points = first.draw_round(100)
        rounds.append(points)
        first.record_round(points, two_tails(points), (two_tails(points) <= 0.0)[:, None])
    assert first.next_stage == "estimate"
    second = ImportanceSampling(space_of(3), 1, 600, 5)
    for points in rounds:
        second.record_round(points, two_tails(points), (two_tails(points) <= 0.0)[:, None])
    np.testing.assert_array_equal(first.draw_round(50), second.draw_round(50))
    np.testing.assert_array_equal(first.importance_weights(rounds[-1]), second.importance_weights(rounds[-1]))


def test_failed_scenarios_stop_nothing():
    sampling = ImportanceSampling(space_of(2), 1, 300, 0)
    while sampling.next_stage != "estimate":
        points = sampling.draw_round(100)
        scores = np.where(points[:, 0] > 0.5, np.nan, 1.0 + points[:, 1])
        sampling.record_round(points, scores, np.zeros((len(points), 1), dtype=np.bool_))
    assert len(sampling.draw_round(100)) == 100


def test_scores_without_direction_are_drawn_from_the_distribution_itself():
    sampling, met = ImportanceSampling(space_of(2), 1, 300, 0), []
    for count in (60, 400, 400):
        assert sampling.next_stage == "law"
        points = sampling.draw_round(400)
        assert len(points) == count
        is_met = points[:, 0] < 0.1
        met += is_met.tolist()
        sampling.record_round(points, np.where(is_met, np.nan, 1.0), np.zeros((count, 1), dtype=np.bool_))
    assert sampling.is_plain
    assert 0.07 < np.mean(met) < 0.13
    # A first guess gives a direction.
    guess = TMixture.normal_around_zero(2)
    guided = ImportanceSampling(space_of(2), 1, 300, 0, guess)
    points = guided.draw_round(400)
    guided.record_round(points, np.ones(len(points)), np.zeros((len(points), 1), dtype=np.bool_))
    assert guided.next_stage == "learn"


def decoy(points):
    """In a small box at 0.75; elsewhere scores fall towards 0.2, where nothing is."""
    away = np.linalg.norm(points - 0.2, axis=1) + 0.1
    return np.where(np.abs(points - 0.75).max(axis=1) < 0.05, -0.1, away)


def test_where_scores_lead_elsewhere_an_estimate_is_no_worse_than_plain_draws():
    truth, runs, found = 1e-3, 4000, []
    for seed in range(16):
        estimate, sampling = estimated(space_of(3), decoy, runs, seed)
        found.append((estimate.value / truth, sampling.is_plain_after_learning))
        if sampling.is_plain_after_learning:
            points = sampling.draw_round(2000)
            assert sampling.importance_weights(points).tolist() == [1.0] * 2000
            assert np.abs(points.mean(axis=0) - 0.5).max() < 0.03
    ratios, plain = map(np.array, zip(*found, strict=True))
    assert 4 < plain.sum() < 16
    # Without plain draws, the error is three times as large as this.
    assert np.sqrt(np.mean((ratios - 1.0) ** 2)) < 1.4 * np.sqrt(1.0 / (truth * runs))


def test_scores_that_lead_to_the_event_are_trusted():
    for seed in range(4):
        for score in (two_tails, lambda points: points[:, 0] - 0.3, lambda points: np.abs(points - 0.9).max(1) - 0.03):
            assert not estimated(space_of(3), score, 2000, seed)[1].is_plain_after_learning


def test_a_frequent_event_does_not_end_the_search_for_a_rare_one():
    """The score leads to both, a large ball and a tiny one within it."""
    reaches = np.sqrt(chi2.ppf([0.95, 1e-4], 3))

    def score(points):
        return np.linalg.norm(ndtri(np.clip(points, 1e-16, 1 - 2e-16)), axis=1)

    for seed in range(3):
        found, _ = estimated(space_of(3), score, 2000, seed, limits=reaches)
        assert found.value == pytest.approx(1e-4, rel=0.5)


@pytest.mark.parametrize("seeds", at_night([1, 4], {4}))
def test_ten_dimensions_are_told_too(seeds):
    def score(points):
        return -norm.ppf(1e-5) - ndtri(np.clip(points, 1e-16, 1 - 2e-16)).sum(1) / np.sqrt(10)

    found = [estimated(space_of(10), score, 5000, seed)[0] for seed in range(seeds)]
    assert all(abs(one.value / 1e-5 - 1.0) < 0.3 for one in found)


@pytest.mark.parametrize("seeds", at_night([2, 6], {6}))
def test_in_twenty_dimensions_a_linear_model_leads_to_the_event(seeds):
    """The event, of probability 1e-5, lies beyond a plane."""
    reach = -norm.ppf(1e-5)

    def score(points):
        return reach - ndtri(np.clip(points, 1e-16, 1 - 2e-16)).sum(axis=1) / np.sqrt(20.0)

    found = [estimated(space_of(20), score, 5000, seed)[0] for seed in range(seeds)]
    assert all(abs(one.value / 1e-5 - 1.0) < 0.6 for one in found)
    assert np.mean([one.value for one in found]) == pytest.approx(1e-5, rel=0.3)
    assert sum(one.low <= 1e-5 <= one.high for one in found) >= seeds - 1


def test_a_guess_from_a_study_leads_to_the_region():
    def score(points):
        return np.abs(points - 0.9).max(1) - 0.03

    space, rng = space_of(2), np.random.default_rng(0)
    known = rng.random((150, 2))
    guess = fit_initial_proposal(space, known, score(known), Criterion(0.0), 0)
    assert guess is not None
    near = np.abs(norm.cdf(guess.draw_points(500, rng)) - 0.9).max(1)
    assert np.median(near) < 0.1
    found, _ = estimated(space, score, 600, 0, guess)
    assert found.low <= 0.06**2 <= found.high
    assert fit_initial_proposal(space, known, np.ones(150), Criterion(0.0), 0) is None


def test_a_mixture_finds_groups_and_has_the_density_it_draws_from():
    rng = np.random.default_rng(1)
    points = np.concatenate([rng.normal(-3.0, 0.5, (300, 2)), rng.normal(4.0, 0.3, (300, 2))])
    weights = np.repeat([1.0, 3.0], 300)
    mixture = TMixture.fit(points, weights, rng)
    heavy = mixture.means[:, 0] > 0.0
    assert mixture.weights[heavy].sum() == pytest.approx(0.75, abs=0.05)
    drawn = mixture.draw_points(20_000, rng)
    # Importance sampling distinguishes the area of a square from its density.
    inside = np.abs(drawn - 4.0).max(1) < 0.5
    area = (inside / np.exp(mixture.log_density(drawn))).mean()
    assert area == pytest.approx(1.0, rel=0.05)


def test_intervals_of_counts_are_those_of_clopper_and_pearson():
    found = probability_from_counts(3, 50)
    assert binom.sf(2, 50, found.low) == pytest.approx(0.025)
    assert binom.cdf(3, 50, found.high) == pytest.approx(0.025)
    assert binom.cdf(3, 50, found.high_90) == pytest.approx(0.05)
    assert (probability_from_counts(0, 50).low, probability_from_counts(0, 50).error) == (0.0, None)
    assert probability_from_counts(0, 50).high == pytest.approx(1.0 - 0.025 ** (1 / 50))


def test_equal_weights_are_plain_monte_carlo():
    met = np.arange(400) < 100
    found = probability_from_weights(np.ones(400), met)
    assert found.value == 0.25
    assert found.effective == pytest.approx(100.0)
    assert found.equivalent_monte_carlo_scenarios == pytest.approx(400, rel=0.01)
    assert found.low == pytest.approx(probability_from_counts(100, 400).low, abs=0.01)


def test_all_scenarios_of_a_space_leave_no_error():
    found = probability_from_enumeration(np.array([0.5, 0.25, 0.25]), np.array([False, True, False]))
    assert (found.value, found.low, found.high, found.error) == (0.25, 0.25, 0.25, 0.0)


def test_some_scenarios_of_a_space_bound_what_all_of_them_would_say():
    found = probability_from_enumeration(np.array([1.0, 0.5]), np.array([False, True]), total=2.0)
    assert (found.low, found.high, found.error) == (0.25, 0.5, None)


def test_scenarios_without_the_event_are_counted():
    found = probability_from_weights(np.ones(50), np.zeros(50, dtype=np.bool_))
    assert (found.value, found.low, found.high, found.error) == (0.0, 0.0, 1.0, None)
    assert (found.scenarios, found.met) == (50, 0)
    assert found.method.startswith("importance sampling")


def test_an_interval_begins_below_one_where_weights_make_more_than_certainty():
    found = probability_from_weights(np.full(100, 1.3), np.ones(100, dtype=np.bool_))
    assert found.low <= found.value == found.high == 1.0


def test_a_quotient_is_as_unsure_as_both():
    found = conditional_probability(probability_from_counts(10, 1000), probability_from_counts(100, 1000))
    assert found is not None
    assert found.value == pytest.approx(0.1)
    assert found.error == pytest.approx(np.hypot(np.sqrt(0.99 / 10), np.sqrt(0.9 / 100)))
    assert conditional_probability(probability_from_counts(10, 1000), probability_from_counts(0, 1000)) is None
