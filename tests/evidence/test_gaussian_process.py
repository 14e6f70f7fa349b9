"""Gaussian processes conditioned step by step, and with many values."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr
from scipy.stats import qmc

from conftest import examples
from cornercase.evidence._critical_set_estimate import CriticalSet
from cornercase.evidence.gp._gaussian_process import (
    GaussianProcess,
    fit_boundary_process,
    squash_around_threshold,
    squash_scale,
)
from cornercase.evidence.gp._matern_kernel import MaternKernel, indices_with_rare_values
from cornercase.evidence.gp._posterior import ExactPosterior, SparsePosterior
from cornercase.study._criterion import Criterion
from helpers.search_cases import CUBE, EVERYWHERE, THRESHOLD, two_regions

kernels = st.builds(
    lambda width, signal, noise: MaternKernel(np.array([width, 1.5 * width]), signal, noise),
    st.floats(0.1, 2.0),
    st.floats(0.3, 3.0),
    st.floats(0.01, 0.5),
)
seeds, counts = st.integers(0, 1000), st.integers(1, 40)


def drawn(count: int, seed: int):
    points = np.random.default_rng(seed).random((count, 2))
    return points, np.sin(7 * points[:, 0]) + points[:, 1]


def told(kernel: MaternKernel, known, places):
    """Mean and variance at points."""
    cross = kernel.covariance(places, known.points)
    return cross @ known.weights, kernel.signal**2 - ((cross @ known.inverse_factor.T) ** 2).sum(axis=1)


def same(kernel, a, b, places):
    for one, other in zip(told(kernel, a, places), told(kernel, b, places), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6 * kernel.signal)
    for one, other in zip(a.leave_one_out(), b.leave_one_out(), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6 * kernel.signal)


@settings(max_examples=examples(40), deadline=None)
@given(kernels, counts, counts, counts, seeds)
def test_taking_values_in_step_by_step_is_taking_them_all_at_once(kernel, first, second, third, seed):
    points, values = drawn(first + second + third, seed)
    parts = np.split(np.arange(len(points)), [first, first + second])
    steps = ExactPosterior(kernel, points[parts[0]], values[parts[0]])
    for part in parts[1:]:
        steps = steps.with_more_values(points[part], values[part])
    same(kernel, steps, ExactPosterior(kernel, points, values), EVERYWHERE[:50, :2])


@settings(max_examples=examples(10), deadline=None)
@given(kernels, st.integers(100, 200), counts, counts, seeds)
def test_so_it_is_where_some_points_stand_for_all(kernel, first, second, third, seed):
    points, values = drawn(first + second + third, seed)
    start = SparsePosterior(kernel, points[:first], values[:first], n_inducing=64)
    middle = first + second
    steps = start.with_more_values(points[first:middle], values[first:middle]).with_more_values(
        points[middle:], values[middle:]
    )
    assert steps.points.shape == (64, 2)
    same(kernel, steps, start.with_more_values(points[first:], values[first:]), EVERYWHERE[:50, :2])


@settings(max_examples=examples(10), deadline=None)
@given(kernels, st.integers(100, 200), seeds)
def test_points_that_stand_for_all_make_the_process_of_the_equations(kernel, count, seed):
    """Snelson and Ghahramani's, with matrices as large as there are values."""
    points, values = drawn(count, seed)
    found = SparsePosterior(kernel, points, values, n_inducing=64)
    places = EVERYWHERE[:50, :2]
    prior = kernel.covariance(found.points, found.points) + 1e-7 * kernel.signal**2 * np.eye(64)
    whole, there = kernel.covariance(points, found.points), kernel.covariance(places, found.points)
    within, across = whole @ np.linalg.solve(prior, whole.T), there @ np.linalg.solve(prior, whole.T)
    left = np.maximum(kernel.signal**2 - np.diag(within), 1e-7 * kernel.signal**2) + kernel.noise**2
    inverse = np.linalg.inv(within - np.diag(np.diag(within)) + np.diag(np.diag(within) + left))
    mean, variance = told(kernel, found, places)
    np.testing.assert_allclose(mean, across @ inverse @ values, atol=1e-5 * kernel.signal)
    expected = kernel.signal**2 - np.einsum("ij,jk,ik->i", across, inverse, across)
    np.testing.assert_allclose(variance, expected, atol=1e-5 * kernel.signal**2)
    without, deviation = found.leave_one_out()
    precision = np.diag(inverse)
    np.testing.assert_allclose(without, values - inverse @ values / precision, atol=1e-5)
    np.testing.assert_allclose(deviation, 1 / np.sqrt(precision), rtol=1e-5)


def test_points_that_stand_for_all_tell_nearly_as_much():
    points, criterion = qmc.Sobol(3, seed=4).random(1024), Criterion(THRESHOLD)
    few = fit_boundary_process(points, two_regions(points), criterion)
    values = squash_around_threshold(two_regions(points), criterion, few.squash_scale)
    every = few.condense(points, values, max_points=1024)
    true = two_regions(EVERYWHERE) <= THRESHOLD
    told = [known.predict(EVERYWHERE)[0] < 0.0 for known in (few, every)]
    wrong = [(one != true).mean() for one in told]
    assert wrong[0] < 1.3 * wrong[1] < 0.01
    assert told[0].mean() == pytest.approx(told[1].mean(), rel=0.01)
    fraction = CriticalSet(CUBE, points, two_regions(points), criterion).critical_fraction
    assert abs(fraction.value - true.mean()) < fraction.high - fraction.low


@pytest.mark.parametrize("noise", [1e-6, 1.0])
@pytest.mark.parametrize("width", [0.01, 10.0])
def test_extreme_kernels_are_borne(noise, width):
    points = np.random.default_rng(0).random((700, 1))
    known = SparsePosterior(MaternKernel(np.array([width]), 30.0, noise), points, np.sign(points[:, 0] - 0.5))
    for number in (*told(known._kernel, known, points), *known.leave_one_out()):
        assert np.isfinite(number).all()


def test_more_values_change_neither_the_kernel_nor_the_process_before():
    points = qmc.Sobol(3, seed=2).random(128)
    values = two_regions(points)
    process = GaussianProcess().fit(points[:96], values[:96])
    before = process.predict(EVERYWHERE[:100])
    more = process.with_more_values(points[96:], values[96:])
    assert more.kernel is process.kernel
    np.testing.assert_array_equal(process.predict(EVERYWHERE[:100]), before)
    anew = process.condition_on(points, values).predict(EVERYWHERE[:100])
    np.testing.assert_allclose(more.predict(EVERYWHERE[:100]), anew, atol=2e-3)


def test_the_level_of_groups_is_that_of_all_places():
    points = qmc.Sobol(3, seed=3).random(64)
    known = CriticalSet(CUBE, points, two_regions(points), Criterion(THRESHOLD))
    among = known._is_found
    every = known._samples._critical_deviate_limits(np.arange(len(known._z)))
    (at, weights), drawn = known._joint_points, known._samples.joint_draws
    expected = (known._sample.weights * among) @ ndtr(every)
    expected += (weights * among[at]) @ (drawn - ndtr(every[at]))
    np.testing.assert_allclose(known._samples.critical_fraction_within(among), expected, atol=1e-4)


def test_widths_are_learned_from_rare_values_too():
    rare = np.zeros(3000, dtype=np.bool_)
    rare[[5, 1201, 1202, 2999]] = True
    picked = indices_with_rare_values(3000, 160, rare)
    assert len(picked) == 160 == len(np.unique(picked))
    assert rare[picked].sum() == 4
    # Many values of one class do not displace the others.
    assert rare[indices_with_rare_values(3000, 160, ~rare)].sum() == 4
    np.testing.assert_array_equal(indices_with_rare_values(100, 160, rare[:100]), np.arange(100))


def test_a_rare_region_that_was_met_is_not_lost_among_more_scenarios():
    """Seven of 1,000 scenarios lie in a ball of 0.65 % of the cube, on a score that is the same everywhere else."""
    points = qmc.Sobol(3, seed=2).random(1024)
    depth = np.linalg.norm(points - (0.7, 0.3, 0.6), axis=1) - 0.116
    known = fit_boundary_process(points, np.minimum(depth, 0.05), Criterion(0.0))
    critical = np.linalg.norm(EVERYWHERE - (0.7, 0.3, 0.6), axis=1) <= 0.116
    found = known.predict(EVERYWHERE)[0] <= 0.0
    assert (found & critical).sum() > 0.5 * critical.sum()


@pytest.mark.parametrize("dimension", [4, 8])
def test_what_lies_far_from_the_threshold_counts_where_the_function_is_smooth(dimension):
    """A wave of which 5 % are critical; drawn together at half a standard deviation most of it says nothing."""
    points, places = (qmc.Sobol(dimension, seed=seed).random(256 if seed else 4096) for seed in (1, 0))
    phases = np.linspace(0.0, 5.0, dimension)
    scores, true = (np.sin(4.0 * one + phases).sum(axis=1) for one in (points, places))
    threshold = float(np.quantile(true, 0.05))
    process = fit_boundary_process(points, scores, Criterion(threshold))
    near = GaussianProcess().fit(points, squash_around_threshold(scores, Criterion(threshold), squash_scale(scores)))
    wrong = [((one.predict(places)[0] <= 0.0) != (true <= threshold)).mean() for one in (process, near)]
    assert wrong[0] < 0.8 * wrong[1]


def test_scores_at_the_threshold_lie_between_those_beyond_it_and_the_others():
    criterion, levels = Criterion(2.0), np.repeat([0.0, 1.0, 2.0, 3.0, 5.0], 3)
    values = squash_around_threshold(levels, criterion, 4.0).reshape(5, 3)[:, 0]
    assert (np.diff(values) >= 0.0).all()
    assert values[2] < 0.0 < values[3]
    # Without lower ones they are as far as the scale; a single one is where a smooth score meets the threshold.
    assert squash_around_threshold(np.array([2.0, 2.0, 3.0]), criterion, 4.0)[0] == pytest.approx(np.tanh(-1.0))
    assert squash_around_threshold(np.array([2.0, 3.0]), criterion, 4.0)[0] == 0.0
