"""Predictions of smooth functions, compared with scikit-learn's Gaussian process."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import qmc
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

from conftest import at_night
from cornercase.evidence._critical_set_estimate import CriticalSet
from cornercase.evidence.gp._gaussian_process import (
    GaussianProcess,
    fit_boundary_process,
    squash_around_threshold,
    squash_scale,
)
from cornercase.scenario import ParameterSpace
from cornercase.study._criterion import Criterion


def vee(points):
    return np.linalg.norm(points - np.linspace(0.5, 0.6, points.shape[1]), axis=1)


def bowl(points):
    return vee(points) ** 2


def wave(points):
    return np.sin(9 * points[:, 0]) + points.sum(axis=1)


FUNCTIONS = pytest.mark.parametrize("function", [vee, bowl, wave], ids=lambda one: one.__name__)
LINE = ParameterSpace.from_ranges(["a=0:1"])


def sobol(dimension, count, seed=0):
    # The first so many of a power of two.
    return qmc.Sobol(dimension, seed=seed).random(1 << (count - 1).bit_length())[:count]


def values_of(function, points, share=0.15):
    """Values for a process, with the threshold at 0, and the threshold."""
    threshold = float(np.quantile(function(sobol(points.shape[1], 4096, 9)), share))
    scores = function(points)
    return squash_around_threshold(scores, Criterion(threshold), squash_scale(scores)), threshold


@FUNCTIONS
@pytest.mark.parametrize("count", [64, 400])
@pytest.mark.parametrize("dimension", [1, 2, 3, 6])
def test_predictions_are_those_of_scikit_learn(dimension, count, function):
    points, places = sobol(dimension, count), sobol(dimension, 1024, 5)
    values, _ = values_of(function, points)
    process = GaussianProcess().fit(points, values)
    kernel = process.kernel
    peer = GaussianProcessRegressor(
        ConstantKernel(kernel.signal**2) * Matern(kernel.length_scales, nu=2.5),
        alpha=kernel.noise**2 + 1e-10 * kernel.signal**2, optimizer=None,
    ).fit(points, values - values.mean())  # fmt: skip
    mean, deviation = process.predict(places)
    expected, other = peer.predict(places, return_std=True)
    scale = np.hypot(other, kernel.noise)
    # In single precision a tenth of a standard deviation may be lost; in double it is much less.
    assert np.quantile(np.abs(mean - values.mean() - expected) / scale, 0.9) < 0.1
    assert np.quantile(np.abs(np.hypot(deviation, kernel.noise) - scale) / scale, 0.9) < 0.1
    np.testing.assert_allclose(mean, values.mean() + expected, atol=2e-3)


@FUNCTIONS
@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")
@pytest.mark.parametrize("dimension", at_night([1, 2, 3, 6], {1, 3, 6}))
def test_as_much_is_found_as_by_a_process_that_scikit_learn_learns(dimension, function):
    points, places = sobol(dimension, 150), sobol(dimension, 4096, 5)
    values, threshold = values_of(function, points)
    critical = function(places) <= threshold

    def wrong(mean):
        return ((mean <= 0) != critical).sum() / critical.sum()

    kernel = ConstantKernel() * Matern(np.full(dimension, 0.5), nu=2.5) + WhiteKernel(1e-3, (1e-8, 1.0))
    peer = GaussianProcessRegressor(kernel, normalize_y=True).fit(points, values)
    ours = fit_boundary_process(points, function(points), Criterion(threshold)).predict(places)[0]
    assert wrong(ours) <= wrong(peer.predict(places)) + 0.02


@pytest.mark.parametrize("spread", ["sobol", "even"])
@pytest.mark.parametrize("count", at_night([50, 400, 600], {400, 600}))
def test_more_scenarios_of_one_parameter_never_tell_less(count, spread):
    points = sobol(1, count) if spread == "sobol" else np.linspace(0, 1, count)[:, None]
    places = np.random.default_rng(1).random((4000, 1))
    for function, threshold in ((vee, 0.1), (bowl, 0.01), (wave, 0.0)):
        known = CriticalSet(LINE, points, function(points), Criterion(threshold))
        critical, found = function(places) <= threshold, known.predict(places)
        assert (found != critical).sum() <= 0.01 * critical.sum()
        share = (function(np.linspace(0, 1, 100_001)[:, None]) <= threshold).mean()
        # A place in 1,500 more or less.
        assert known.critical_fraction.low - 1e-3 <= share <= known.critical_fraction.high + 1e-3
