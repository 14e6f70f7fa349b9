"""Choices have no order for the process of `bayes`."""

from __future__ import annotations

import numpy as np

from cornercase.optimizers import Bayes
from cornercase.scenario import Parameter, ParameterSpace
from helpers.search_cases import explored


def test_names_are_equally_alike_whatever_their_order():
    space = ParameterSpace([Parameter("a", 0, 1), Parameter("kind", 0, 2, choices=("x", "y", "z"))])

    def function(points):
        return points[:, 0] + 2.0 * np.array([0.0, 1.0, 0.0])[space.parameters[1].level_indices(points[:, 1])]

    optimizer = Bayes(features=4000).start(space, 0)
    explored(optimizer, 30, function=function)
    every = space.snap(np.array([[0.5, k / 2] for k in range(3)]))
    rows = optimizer._process.random_features(optimizer._process_coordinates(every))
    alike = rows @ rows.T / (rows**2).sum(axis=1)
    # Random features know the covariance to a few hundredths.
    np.testing.assert_allclose(alike[[0, 0, 1], [1, 2, 2]], alike[0, 1], atol=0.08)
    # Numeric coordinates are unchanged.
    numbers = ParameterSpace.from_ranges(["a=0:1", "b=0:1"])
    points = np.random.default_rng(0).random((5, 2))
    np.testing.assert_array_equal(Bayes().start(numbers, 0)._process_coordinates(points), 2.0 * points - 1.0)
