"""The search for the whole critical set, and the Gaussian process behind it."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.stats import qmc
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern

from conftest import at_night
from cornercase.evidence._critical_set_estimate import CriticalSet
from cornercase.evidence.gp._gaussian_process import GaussianProcess, encode_points, fit_boundary_process
from cornercase.evidence.gp._matern_kernel import _NegativeLogPosterior
from cornercase.metrics import METRICS
from cornercase.optimizers import Bayes, LevelSet, Sobol
from cornercase.optimizers._local_minima import suggest_below_local_minima
from cornercase.scenario import Parameter, ParameterSpace
from cornercase.study import StudyFile
from cornercase.study._criterion import Criterion
from helpers.command_line import SPACE, X, cornercase
from helpers.search_cases import CUBE, EVERYWHERE, THRESHOLD, explored, two_regions


def found(points, scores):
    """Recall and precision of the critical set that a process of these scenarios predicts."""
    told, true = (
        CriticalSet(CUBE, points, scores, Criterion(THRESHOLD)).predict(EVERYWHERE),
        two_regions(EVERYWHERE) <= THRESHOLD,
    )
    return (told & true).sum() / true.sum(), (told & true).sum() / max(told.sum(), 1)


@pytest.mark.slow
def test_it_finds_the_whole_critical_set_with_fewer_scenarios_than_others():
    """A region that no other search meets well: the wall of a tube, 3.6 % of the cube."""

    def tube(points):
        return THRESHOLD + 5 * (np.abs(np.hypot(points[:, 0] - 0.5, points[:, 1] - 0.5) - 0.3) - 0.02)

    true = tube(EVERYWHERE) <= THRESHOLD
    recall = {}
    for optimizer in (
        LevelSet().start(CUBE, 3, threshold=THRESHOLD),
        Bayes().start(CUBE, 3),
        Sobol().start(CUBE, 3),
    ):
        points = explored(optimizer, 200, function=tube)
        told = CriticalSet(CUBE, points, tube(points), Criterion(THRESHOLD)).predict(EVERYWHERE)
        recall[optimizer.name] = (told & true).sum() / true.sum()
        if optimizer.name == "level-set":
            assert (told & true).sum() / told.sum() > 0.9
    assert recall["level-set"] > 0.9
    assert recall["level-set"] > max(recall["bayes"], recall["sobol"])


@pytest.mark.parametrize("seed", at_night(range(3), {1, 2}))
def test_it_finds_both_regions(seed):
    points = explored(LevelSet().start(CUBE, seed, threshold=THRESHOLD), 150, function=two_regions)
    recall, precision = found(points, two_regions(points))
    assert recall > 0.98
    assert precision > 0.98
    assert len(np.unique(points, axis=0)) == 150


def test_it_goes_on_as_if_it_had_never_stopped():
    whole = explored(LevelSet().start(CUBE, 5, threshold=THRESHOLD), 80, function=two_regions)
    again = LevelSet().start(CUBE, 5, threshold=THRESHOLD)
    for first in range(0, 60, 10):
        again.tell(whole[first : first + 10], two_regions(whole[first : first + 10]))
    np.testing.assert_array_equal(again.ask(10), whole[60:70])
    np.testing.assert_array_equal(again.ask(10), whole[60:70])


def test_failed_scenarios_choices_and_finite_spaces():
    space = ParameterSpace(
        [Parameter("a", 0, 9, 1.0), Parameter("kind", 0, 2, None, ("car", "truck", "bicycle")), Parameter("b", 0, 1)]
    )

    def scores(points):
        truck = space.parameters[1].level_indices(points[:, 1]) == 1
        return np.where(points[:, 0] > 0.8, np.nan, np.where(truck, points[:, 2] + points[:, 0], 3.0))

    optimizer = LevelSet().start(space, 0, threshold=0.6)
    points = explored(optimizer, 120, function=scores)
    assert len(np.unique(points, axis=0)) == 120
    later = space.parameters[1].level_indices(points[40:, 1])
    # The boundary lies among the trucks.
    assert (later == 1).mean() > 0.6
    small = ParameterSpace.from_ranges(["a=0:4:1", "b=0:9:1"])
    optimizer = LevelSet().start(small, 0, threshold=0.1)
    assert len(explored(optimizer, 50, function=lambda p: p[:, 0] - p[:, 1])) == 50
    assert len(optimizer.ask(5)) == 0


def ball(points, centre, radius):
    """At most the threshold within the radius, and 2 above it from afar."""
    return THRESHOLD + 2 * np.tanh(4 * (np.linalg.norm(points - np.array(centre), axis=1) - radius))


@pytest.mark.parametrize("seed", at_night(range(3), {1, 2}))
def test_few_scenarios_are_run_where_they_fail(seed):
    """A fifth of the space that fails cuts the critical region."""

    def scores(points):
        return np.where(points[:, 0] > 0.8, np.nan, ball(points, (0.75, 0.5, 0.5), 0.3))

    optimizer = LevelSet().start(CUBE, seed, threshold=THRESHOLD)
    points = explored(optimizer, 200, function=scores)
    assert np.isnan(scores(points)).mean() < 0.25
    recall, precision = found_of(scores, points)
    assert recall > 0.95
    assert precision > 0.95
    again = LevelSet().start(CUBE, seed, threshold=THRESHOLD)
    for first in range(0, 190, 10):
        again.tell(points[first : first + 10], scores(points[first : first + 10]))
    np.testing.assert_array_equal(again.ask(10), points[190:])


def test_failures_at_random_do_not_keep_it_from_the_boundary():
    def scores(points):
        failing = np.sin(1e4 * points.sum(axis=1)) > 0.3
        return np.where(failing, np.nan, ball(points, (0.4, 0.5, 0.5), 0.3))

    points = explored(LevelSet().start(CUBE, 0, threshold=THRESHOLD), 200, function=scores)
    assert np.isnan(scores(points)).mean() > 0.3
    recall, precision = found_of(lambda points: ball(points, (0.4, 0.5, 0.5), 0.3), points, scores(points))
    assert recall > 0.95
    assert precision > 0.95


def found_of(function, points, scores=None):
    """Recall and precision for any function; what fails is not critical."""
    told = CriticalSet(CUBE, points, function(points) if scores is None else scores, Criterion(THRESHOLD)).predict(
        EVERYWHERE
    )
    values = function(EVERYWHERE)
    told, true = told & np.isfinite(values), values <= THRESHOLD
    return (told & true).sum() / true.sum(), (told & true).sum() / told.sum()


@pytest.mark.parametrize("seed", at_night(range(2), {1}))
def test_the_space_is_filled_once_the_boundary_is_found(seed):
    """A further region of 1 %, which no score points to, is found."""

    def scores(points):
        return ball(points, (0.3, 0.35, 0.35), 0.267)

    points = explored(LevelSet().start(CUBE, seed, threshold=THRESHOLD), 300, function=scores)
    known = CriticalSet(CUBE, points, scores(points), Criterion(THRESHOLD))
    assert known.unexplored_fraction(0.01) < 0.2
    recall, precision = found_of(scores, points)
    assert recall > 0.98
    assert precision > 0.98


@pytest.mark.parametrize("seed", at_night(range(3), {1, 2}))
def test_two_islands_of_half_a_percent_are_both_found(seed):
    """Their scores fall from 0.1 above them on, and are flat in most of the space."""
    centres = (0.2, 0.3, 0.75), (0.8, 0.7, 0.25)

    def scores(points):
        away = np.min([np.linalg.norm(points - np.array(one), axis=1) for one in centres], axis=0) - 0.106
        return THRESHOLD + 3 * away / (0.1 + np.abs(away))

    points = explored(LevelSet().start(CUBE, seed, threshold=THRESHOLD), 200, function=scores)
    hits = points[scores(points) <= THRESHOLD]
    assert min(np.sum(np.linalg.norm(hits - np.array(one), axis=1) < 0.106) for one in centres) >= 3


def test_a_slope_far_above_the_threshold_is_followed_before_anything_is_critical():
    """All scores are several of their standard deviations above the threshold."""
    points = qmc.Sobol(3, seed=4).random(64)
    away = np.linalg.norm(points - (0.5, 0.5, 0.5), axis=1)
    scores = THRESHOLD + 3.0 + 0.5 * away
    mean, _ = fit_boundary_process(points, scores, Criterion(THRESHOLD)).predict(EVERYWHERE)
    apart = np.linalg.norm(EVERYWHERE - (0.5, 0.5, 0.5), axis=1)
    assert np.corrcoef(mean, apart)[0, 1] > 0.9
    assert np.ptp(mean) > 0.01


def test_below_a_dip_is_downhill_of_it():
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 6)] * 2), -1).reshape(-1, 2)
    scores = np.minimum(np.linalg.norm(grid - (0.45, 0.63), axis=1), 0.5)
    places = suggest_below_local_minima(grid, scores, Criterion(0.0))
    assert places.shape == (1, 2)
    lowest = grid[np.argmin(scores)]
    assert np.linalg.norm(places[0] - lowest) == pytest.approx(0.1)
    assert np.linalg.norm(places[0] - (0.45, 0.63)) < scores.min()
    # Critical scenarios are no minima, nor are those far from the threshold for their depth; failures are uphill.
    assert len(suggest_below_local_minima(grid, scores, Criterion(0.1))) == 0
    assert len(suggest_below_local_minima(grid, scores + 2.0, Criterion(0.0))) == 0
    failed = np.where(grid[:, 0] > 0.5, np.nan, scores)
    assert suggest_below_local_minima(grid, failed, Criterion(0.0))[0, 0] < lowest[0]


def test_choices_are_as_far_from_each_other():
    space = ParameterSpace([Parameter("kind", 0, 3, None, ("a", "b", "c", "d")), Parameter("x", 0, 1)])
    places = encode_points(space, np.stack([(np.arange(4) + 0.5) / 4, np.full(4, 0.3)], -1))
    apart = np.linalg.norm(places[:, None] - places, axis=-1)
    np.testing.assert_allclose(apart, 1.0 - np.eye(4))


def test_the_process_is_that_of_scikit_learn():
    rng = np.random.default_rng(0)
    points, values = rng.random((60, 3)), rng.normal(size=60)
    process = GaussianProcess().fit(points, values)
    learned = process.kernel
    kernel = ConstantKernel(learned.signal**2) * Matern(learned.length_scales, nu=2.5)
    other = GaussianProcessRegressor(kernel, alpha=learned.noise**2, optimizer=None)
    other.fit(points, values - values.mean())
    new = rng.random((500, 3))
    mean, deviation, rows = process.predict_with_projections(new)
    expected, spread = other.predict(new, return_std=True)
    np.testing.assert_allclose(mean, expected + values.mean(), atol=1e-3)
    np.testing.assert_allclose(deviation, spread, atol=2e-3)
    covariance = other.predict(new, return_cov=True)[1]
    np.testing.assert_allclose(process.covariance_with_point(new, rows, 7), covariance[7], atol=2e-3)


def test_the_gradient_of_the_likelihood_is_its_derivative():
    rng = np.random.default_rng(1)
    points, values = rng.random((20, 2)), rng.normal(size=20)
    squares: Any = ((points.T[:, :, None] - points.T[:, None]) ** 2).reshape(2, -1)
    at = np.log([0.3, 0.8, 1.2, 0.2])
    likelihood = _NegativeLogPosterior(squares, values)

    def loss(place):
        return likelihood(place)[0]

    numeric = approx_fprime(at, loss, 1e-6)
    np.testing.assert_allclose(likelihood(at)[1], numeric, rtol=1e-4, atol=1e-4)


def test_the_number_of_threads_does_not_show(monkeypatch):
    points = qmc.Sobol(3, seed=2).random(128)
    process = GaussianProcess().fit(points, two_regions(points))
    results = []
    for threads in (1, 2, 5):
        monkeypatch.setattr(
            "cornercase.evidence.gp._gaussian_process.count_available_cpus", lambda threads=threads: threads
        )
        results.append(process.predict(EVERYWHERE))
    for mean, deviation in results[1:]:
        np.testing.assert_array_equal(mean, results[0][0])
        np.testing.assert_array_equal(deviation, results[0][1])


def test_on_the_command_line_it_takes_the_threshold_of_the_metric_or_another(tmp_path):
    common = ["explore", X, "--space", SPACE, "--ego", "Ego", "--other", "Pedestrian", "--optimizer", "level-set"]
    own = cornercase(*common, "--metric", "wttc", "--budget", "40", "-o", tmp_path / "own.db")
    assert own.returncode == 0, own.stderr
    with StudyFile.open(tmp_path / "own.db", readonly=True) as study:
        assert study.meta.critical == METRICS.create("wttc").default_threshold == 1.0
        expected = int((study.scores("wttc") <= 1.0).sum())
    shown = json.loads(cornercase("show", tmp_path / "own.db", "--json").stdout)
    assert shown["critical"]["is"] == "wttc <= 1 s"
    assert shown["critical"]["scenarios"] == expected
    other = cornercase(*common, "--metric", "wttc", "--critical", "0.5", "--budget", "40", "-o", tmp_path / "own.db")
    assert other.returncode == 2
    assert "the threshold 1;" in other.stderr
    none = cornercase(*common, "--metric", "distance", "--budget", "40", "-o", tmp_path / "d.db")
    assert none.returncode == 2
    assert "give one with --critical" in none.stderr
    assert not (tmp_path / "d.db").exists()
    high = cornercase(*common, "--metric", "drac", "--critical", "3.4", "--budget", "30", "-o", tmp_path / "h.db")
    assert high.returncode == 0, high.stderr
