"""A process of scores, and its short form for programs in other languages."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import qmc

from cornercase.evidence._score_surrogate import fit_surrogate
from helpers.search_cases import CUBE


def wave(points):
    return np.sin(5.0 * points[:, 0]) + points[:, 1] * points[:, 2]


@pytest.mark.parametrize("count", [100, 600])
def test_few_points_predict_what_all_do(count):
    points = qmc.Sobol(3, seed=0).random(1024)[:count]
    surrogate = fit_surrogate(CUBE, points, wave(points))
    condensed = surrogate.condense(192)
    assert len(condensed.process.closed_form().points) == min(count, 192)
    assert abs(condensed.predicted - surrogate.predicted) < 0.01
    assert condensed.predicted > 0.95
    new = np.random.default_rng(1).random((200, 3))
    (mean, _), (all_mean, _) = (one.process.predict(new) for one in (condensed, surrogate))
    np.testing.assert_allclose(mean, all_mean, atol=0.05)


def test_the_closed_form_predicts_what_the_process_does():
    points = qmc.Sobol(3, seed=0).random(256)[:250]
    process = fit_surrogate(CUBE, points, wave(points)).condense(64).process
    form = process.closed_form()
    new = np.random.default_rng(1).random((50, 3))
    covariances = form.kernel.covariance(new, form.points)
    rows = covariances @ np.tril(form.inverse_factor).T
    mean, deviation = process.predict(new)
    np.testing.assert_allclose(form.mean + covariances @ form.weights, mean, atol=1e-4)
    np.testing.assert_allclose(np.sqrt(form.kernel.signal**2 - (rows**2).sum(axis=1)), deviation, atol=1e-2)


def test_the_short_form_of_many_values_needs_no_neighbours():
    points = qmc.Sobol(3, seed=0).random(8192)[:4500]
    condensed = fit_surrogate(CUBE, points, wave(points)).condense(64)
    form = condensed.process.closed_form()
    mean, _ = condensed.process.predict(points[:20])
    covariances = form.kernel.covariance(points[:20], form.points)
    np.testing.assert_allclose(form.mean + covariances @ form.weights, mean, atol=1e-3)
    assert condensed.predicted > 0.9
