from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import qmc
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern

from cornercase.evidence._critical_set_estimate import CriticalSet
from cornercase.evidence.gp._gaussian_process import GaussianProcess, fit_boundary_process
from cornercase.evidence.gp._matern_kernel import MaternKernel
from cornercase.evidence.gp._neighbour_posterior import NearestPosterior
from cornercase.scenario import ParameterSpace
from cornercase.study._criterion import Criterion

KERNEL = MaternKernel(np.array([0.3, 0.5, 2.0]), 1.5, 0.1)
CUBE = ParameterSpace.from_ranges(["a=0:1", "b=0:1", "c=0:1"])


def waved(points):
    """Critical is where a side of the cube is below waves that 512 points cannot follow."""
    return points[:, 0] - 0.5 - 0.1 * np.sin(25.0 * points[:, 1]) * np.sin(15.0 * points[:, 2])


def told_by(points, values, place):
    """Prediction by scikit-learn from the 36 nearest values."""
    near = np.argsort(np.linalg.norm((points - place) / KERNEL.length_scales, axis=1))[:36]
    kernel = ConstantKernel(KERNEL.signal**2) * Matern(KERNEL.length_scales, nu=2.5)
    process = GaussianProcessRegressor(kernel, alpha=KERNEL.noise**2, optimizer=None).fit(points[near], values[near])
    mean, deviation = process.predict(place[None], return_std=True)
    return mean[0], deviation[0]


def test_a_place_is_told_by_the_values_that_are_nearest_to_it():
    rng = np.random.default_rng(0)
    points, places = rng.random((500, 3)), rng.random((20, 3))
    values = np.sin(points @ (5.0, 3.0, 1.0)) + 0.1 * rng.normal(size=500)
    expected = [told_by(points, values, place) for place in places]
    np.testing.assert_allclose(np.transpose(NearestPosterior(KERNEL, points, values).predict(places)), expected, 1e-5)


def test_a_value_is_told_by_others_also_where_two_are_at_the_same_place():
    rng = np.random.default_rng(1)
    points = rng.random((400, 3))
    points[1] = points[0]
    values = np.sin(points @ (5.0, 3.0, 1.0)) + 0.1 * rng.normal(size=400)
    some = np.array([0, 1, 7, 399])
    mean, deviation = NearestPosterior(KERNEL, points, values).leave_one_out(some)
    expected = [told_by(np.delete(points, k, axis=0), np.delete(values, k), points[k]) for k in some]
    np.testing.assert_allclose(mean, [one for one, _ in expected], rtol=1e-5)
    np.testing.assert_allclose(deviation, np.hypot([one for _, one in expected], KERNEL.noise), rtol=1e-5)


@pytest.fixture(scope="module")
def many():
    points = qmc.Sobol(3, seed=np.random.default_rng(2)).random(4096)
    return points, waved(points)


def test_of_many_scenarios_the_nearest_follow_a_boundary_that_few_points_smooth_away(many, monkeypatch):
    places = np.random.default_rng(3).random((3000, 3))
    true = waved(places) <= 0.0
    points, scores = many

    def wrong(most_together):
        monkeypatch.setattr(GaussianProcess, "max_induced_values", most_together)
        mean, deviation = fit_boundary_process(points, scores, Criterion(0.0)).predict(places)
        # Errors are where the process is uncertain.
        assert (np.abs(mean / deviation)[(mean <= 0.0) != true] < 4.0).mean() > 0.9
        return ((mean <= 0.0) != true).mean()

    by_nearest = wrong(4000)
    assert by_nearest < 0.01
    assert by_nearest < 0.7 * wrong(4096)


@pytest.mark.slow
def test_what_is_said_of_the_critical_set_of_many_scenarios_holds(many):
    points, scores = many
    known = CriticalSet(CUBE, points, scores, Criterion(0.0))
    dense = qmc.Sobol(3, seed=np.random.default_rng(4)).random(1 << 17)
    true = waved(dense) <= 0.0
    assert known.critical_fraction.low < true.mean() < known.critical_fraction.high
    assert known.critical_fraction.high - known.critical_fraction.low < 0.01
    missed = (true & ~known.predict(dense)).sum() / true.sum()
    assert known.missed_fraction.low - 0.001 < missed < known.missed_fraction.high
    assert known.missed_fraction.high < 0.03
