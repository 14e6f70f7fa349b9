"""A process of random features conditioned on its own mean at pending points."""

from __future__ import annotations

import numpy as np

from cornercase.optimizers._random_features import RandomFeatureProcess


def posterior(process, points):
    """Mean and variance at points, by the textbook formula of a linear model (Rasmussen and Williams, 2.11)."""
    noise, at = process._noise, process.random_features(points)
    covariance = np.linalg.inv(process._gram / noise**2 + np.eye(len(process._moment)))
    return at @ covariance @ process._moment / noise**2, np.einsum("ij,jk,ik->i", at, covariance, at)


def test_its_own_mean_changes_no_mean_and_makes_sure_where_it_is_taken():
    rng = np.random.default_rng(0)
    empty = RandomFeatureProcess(3.0 * rng.normal(size=(300, 2)), 6.3 * rng.random(300), np.sqrt(2.0 / 300), 0.0, 0.1)
    known, pending = rng.random((12, 2)), rng.random((4, 2)) + 0.5
    process = empty.with_more_values(known, np.sin(5.0 * known[:, 0]))
    expecting = process.conditioned_on_own_mean(pending)
    everywhere = 1.5 * rng.random((200, 2))
    mean, variance = posterior(process, everywhere)
    later, less = posterior(expecting, everywhere)
    np.testing.assert_allclose(later, mean, atol=1e-6)
    assert (less <= variance + 1e-9).all()
    before, after = (posterior(one, pending)[1] for one in (process, expecting))
    # One more value of this noise leaves no more variance than its own.
    assert (after <= 0.1**2).all()
    assert (before > after).all()
    assert before.max() > 10.0 * after.max()
    # So do the samples.
    samples = expecting.draw_weights(4000, rng) @ expecting.random_features(pending).T
    np.testing.assert_allclose(samples.mean(axis=0), posterior(process, pending)[0], atol=0.01)
    np.testing.assert_allclose(samples.var(axis=0), after, rtol=0.15)
