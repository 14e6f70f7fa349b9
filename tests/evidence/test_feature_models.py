"""Features predicted from the parameters."""

import numpy as np
from scipy.stats import qmc

from cornercase.evidence._feature_models import FeatureModels, PerBranchFeatureModels


def test_smooth_features_are_foretold_without_rounding_errors():
    def features(points):
        x, y = points.T
        return np.stack([np.sin(3.0 * x) + y**2, np.exp(-x) * y], axis=1)

    known = qmc.Sobol(2, seed=1).random(512)
    others = 0.05 + 0.9 * qmc.Sobol(2, seed=2).random(256)
    of_known = features(known)
    expected = (features(others) - of_known.mean(axis=0)) / of_known.std(axis=0)
    # Weights of 1e5 and more cancel: in single precision this was off by 0.1.
    np.testing.assert_allclose(FeatureModels(known, of_known).predict_features(others), expected, atol=2e-3)


def jumping(points):
    """A feature that jumps between branches along a line across the square, and the branch."""
    x, y = points.T
    ways = (x + 0.5 * y > 0.7).astype(np.int64)
    return np.where(ways == 1, 4.0 + np.cos(2.0 * y), np.sin(3.0 * x))[:, None], ways


def test_processes_of_one_way_follow_a_feature_that_jumps_between_ways():
    points, others = qmc.Sobol(2, seed=1).random(128), 0.02 + 0.96 * qmc.Sobol(2, seed=2).random(256)
    (features, ways), (expected, other_ways) = jumping(points), jumping(others)
    found = PerBranchFeatureModels(points, features, ways).predict_features(others)
    assert found.shape == (256, 3)
    by_all = found[:, 0] * features.std() + features.mean()
    for way in (0, 1):
        mine, here = features[ways == way], other_ways == way
        by_way = found[here, 1 + way] * mine.std() + mine.mean()
        off = np.abs(by_way - expected[here, 0])
        assert off.mean() < 0.01
        assert off.mean() < 0.2 * np.abs(by_all[here] - expected[here, 0]).mean()


def test_a_scenario_is_foretold_by_others_only():
    points = qmc.Sobol(2, seed=3).random(64)
    features, ways = jumping(points)
    every = PerBranchFeatureModels(points, features, ways)
    for k in (5, 40):
        rest = np.delete(np.arange(64), k)
        scaled = (features - features.mean()) / features.std()
        others = FeatureModels(points[rest], features[rest], every.kernels[None])
        mine = others.predict_features(points[[k]])[0, 0] * features[rest].std() + features[rest].mean()
        # It is scaled by all, so a little of itself is in there.
        assert abs(every.leave_one_out[k, 0] * features.std() + features.mean() - mine) < 0.05
        assert abs(every.leave_one_out[k, 0] - scaled[k, 0]) > 1e-6


def test_too_few_of_a_way_have_no_processes_of_their_own():
    points = qmc.Sobol(2, seed=4).random(32)
    features, ways = jumping(points)
    few = np.where(np.arange(32) < 7, 5, 0)
    assert set(PerBranchFeatureModels(points, features, few).kernels) == {None, 0}
    assert set(PerBranchFeatureModels(points, features, np.zeros(32, dtype=np.int64)).kernels) == {None}
    again = PerBranchFeatureModels(points, features, ways, PerBranchFeatureModels(points, features, ways).kernels)
    np.testing.assert_array_equal(again.leave_one_out, PerBranchFeatureModels(points, features, ways).leave_one_out)


def test_of_many_scenarios_the_processes_know_some_in_each_way():
    points = qmc.Sobol(2, seed=5).random(128)
    features, ways = jumping(points)
    known = np.arange(0, 128, 2)
    found = PerBranchFeatureModels(points, features, ways, subset=known)
    alone = PerBranchFeatureModels(points[known], features[known], ways[known], found.kernels)
    # The same processes, but for what the features are scaled by.
    for got, expected in zip(
        found.predict_features(points[1::2]).T, alone.predict_features(points[1::2]).T, strict=True
    ):
        assert np.corrcoef(got, expected)[0, 1] > 0.999
