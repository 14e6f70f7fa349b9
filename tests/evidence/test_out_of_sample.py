"""Out-of-sample predictions, compared with scenarios that were never run."""

from __future__ import annotations

import numpy as np

from cornercase.evidence._out_of_sample import cross_validate_scores
from cornercase.evidence.gp._gaussian_process import fit_boundary_process, squash_around_threshold
from cornercase.study._criterion import Criterion


def bumps(rng, dims):
    centres, sizes = rng.random((24, dims)), rng.normal(size=24)
    return lambda points: -np.exp(-((points[:, None] - centres) ** 2).sum(axis=2) / (0.0625 * dims)) @ sizes


def off(values, mean, deviation):
    """Root mean square of errors in standard deviations."""
    return np.sqrt(np.mean(((values - mean) / deviation) ** 2))


def test_in_many_dimensions_it_is_as_far_off_as_where_nothing_was_run():
    alone, honest, fresh = [], [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        function = bumps(rng, 10)
        points, others = rng.random((80, 10)), rng.random((2000, 10))
        scores, threshold = function(points), np.quantile(function(others), 0.2)
        process = fit_boundary_process(points, scores, Criterion(threshold))
        values, elsewhere = (
            squash_around_threshold(function(at), Criterion(threshold), process.squash_scale) for at in (points, others)
        )
        mean, deviation = process.predict(others)
        fresh.append(off(elsewhere, mean, np.hypot(deviation, process.kernel.noise)))
        alone.append(off(values, *process.leave_one_out()))
        honest.append(off(values, *cross_validate_scores(process, points, scores, Criterion(threshold))))
    # With a kernel that was learned from it, a score is predicted too well.
    assert np.median(alone) < 0.9 * np.median(fresh)
    assert 0.9 < np.median(honest) / np.median(fresh) < 1.2


def test_with_many_scores_for_each_dimension_one_kernel_is_enough():
    rng = np.random.default_rng(0)
    points = rng.random((90, 2))
    scores = bumps(rng, 2)(points)
    process = fit_boundary_process(points, scores, Criterion(0.0))
    assert np.array_equal(cross_validate_scores(process, points, scores, Criterion(0.0)), process.leave_one_out())
