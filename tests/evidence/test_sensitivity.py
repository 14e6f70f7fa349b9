"""Sensitivity indices, compared with closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import qmc

from conftest import at_night
from cornercase.evidence._sensitivity import estimate_sensitivity
from cornercase.scenario import Parameter, ParameterSpace
from helpers.search_cases import CUBE


def test_the_indices_are_those_of_ishigamis_function():
    """T. Ishigami, T. Homma (1990), with a = 7 and b = 0.1."""
    a, b = 7.0, 0.1
    points = qmc.Sobol(3, seed=0).random(512)
    x, y, z = (2 * np.pi * points - np.pi).T
    found = estimate_sensitivity(CUBE, points, np.sin(x) + a * np.sin(y) ** 2 + b * z**4 * np.sin(x))
    variance = a**2 / 8 + b * np.pi**4 / 5 + b**2 * np.pi**8 / 18 + 0.5
    both = b**2 * np.pi**8 * 8 / 225
    first = np.array([0.5 * (1 + b * np.pi**4 / 5) ** 2, a**2 / 8, 0.0])
    np.testing.assert_allclose(found.first, first / variance, atol=0.04)
    np.testing.assert_allclose(found.total, (first + np.array([both, 0.0, both])) / variance, atol=0.04)
    assert found.predicted > 0.95
    assert found.uninfluential_parameters == ()


def test_a_parameter_that_does_nothing_is_named_and_choices_count():
    space = ParameterSpace([*CUBE.parameters, Parameter("kind", 0, 2, choices=("x", "y", "z"))])
    points = space.snap(qmc.Sobol(4, seed=1).random(256))
    kind = space.parameters[3].level_indices(points[:, 3])
    found = estimate_sensitivity(space, points, points[:, 0] + np.array([0.0, 1.0, 0.5])[kind])
    assert found.uninfluential_parameters == ("b", "c")
    # Variances of 1/12 and 1/6.
    np.testing.assert_allclose(np.array(found.total)[[0, 3]], [1 / 3, 2 / 3], atol=0.04)


def test_a_parameter_is_of_little_influence_only_where_trees_agree():
    points = qmc.Sobol(3, seed=0).random(128)
    found = estimate_sensitivity(CUBE, points, 2.0 * points[:, 0] + np.sign(points[:, 1] - 0.5))
    assert found.uninfluential_parameters == ("c",)
    # Variances of 4/12 and 1.
    np.testing.assert_allclose(found.total_by_trees, [0.25, 0.75, 0.0], atol=0.06)
    # A process can take a parameter by which the score jumps for one without influence.
    assert replace(found, total_by_trees=(0.25, 0.75, 0.06)).uninfluential_parameters == ()


def test_nothing_is_said_of_too_few_or_of_one_score():
    points = qmc.Sobol(3, seed=0).random(32)
    for scores in (np.where(np.arange(32) < 9, np.arange(32.0), np.nan), np.ones(32)):
        with pytest.raises(ValueError, match="10 scores that are not all the same"):
            estimate_sensitivity(CUBE, points, scores)


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_said_to_matter_or_not_of_pure_noise(seed):
    points = qmc.Sobol(3, seed=seed).random(64)
    found = estimate_sensitivity(CUBE, points, np.random.default_rng(seed).normal(size=64))
    assert not found.is_meaningful
    assert found.uninfluential_parameters == ()
    widths = [high - low for low, high in (*found.first_interval, *found.total_interval)]
    assert max(widths) > 0.3


@pytest.mark.parametrize("seeds", at_night([2, 5], {5}))
def test_intervals_hold_the_truth_and_narrow_with_what_is_known(seeds):
    truth = np.array([4.0, 1.0, 0.0]) / 5.0
    widths = []
    for count in (20, 200):
        held = []
        for seed in range(seeds):
            points = qmc.Sobol(3, seed=seed).random(256)[:count]
            noise = 0.1 * np.random.default_rng(seed).normal(size=count)
            found = estimate_sensitivity(CUBE, points, 2.0 * points[:, 0] + points[:, 1] + noise, seed)
            held += [
                low - 0.02 <= true <= high + 0.02
                for true, (low, high) in zip(
                    [*truth, *truth], (*found.first_interval, *found.total_interval), strict=True
                )
            ]
        widths.append(np.mean([high - low for low, high in found.total_interval]))
        assert np.mean(held) >= 0.8
    assert widths[1] < widths[0]
