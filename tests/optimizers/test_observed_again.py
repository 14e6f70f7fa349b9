"""Optimizers that observe the same points again, failures, or all of a small space."""

from __future__ import annotations

import numpy as np
import pytest

from cornercase.optimizers import OPTIMIZERS
from cornercase.scenario import ParameterSpace

SPACE = ParameterSpace.from_ranges(["a=0:1:0.02", "b=0:1:0.02", "c=0:1"])


def ridge(points):
    return np.minimum(5 * np.abs(points[:, 0] - points[:, 1]), 1.0)


@pytest.mark.parametrize("name", ["bayes", "sobol", "random", "grid"])
def test_an_optimizer_that_is_told_again_asks_the_same(name):
    first = OPTIMIZERS.create(name).start(SPACE, 3, budget=3375)
    rounds = []
    for _ in range(4):
        points = first.ask(10)
        first.tell(points, ridge(points))
        rounds.append(points)
    second = OPTIMIZERS.create(name).start(SPACE, 3, budget=3375)
    for points in rounds:
        np.testing.assert_array_equal(second.ask(10), points)
        second.tell(points, ridge(points))
    every = np.concatenate(rounds)
    assert len(np.unique(every, axis=0)) == len(every)
    np.testing.assert_array_equal(SPACE.snap(every), every)


@pytest.mark.parametrize("name", ["bayes", "sobol", "random", "grid"])
def test_a_small_space_is_run_whole_and_then_over(name):
    space = ParameterSpace.from_ranges(["a=0:3:1", "b=0:7:1"])
    optimizer, every = OPTIMIZERS.create(name).start(space, 1, budget=3375), []
    while len(points := optimizer.ask(5)):
        optimizer.tell(points, ridge(points))
        every.append(points)
    assert len(np.unique(np.concatenate(every), axis=0)) == len(np.concatenate(every)) == 32


def test_bayes_finds_the_ridge_from_end_to_end():
    optimizer = OPTIMIZERS.create("bayes").start(SPACE, 2)
    every = []
    for _ in range(16):
        points = optimizer.ask(10)
        optimizer.tell(points, ridge(points))
        every.append(points)
    found = np.concatenate(every)
    critical = found[ridge(found) < 0.25]
    assert len(critical) > 2 * 160 * 0.1
    assert critical[:, 0].min() < 0.2
    assert critical[:, 0].max() > 0.8


def test_bayes_stands_failures_and_equal_scores():
    optimizer = OPTIMIZERS.create("bayes").start(SPACE, 2)
    for scores in (np.zeros(10), np.full(10, np.nan), np.zeros(10), np.ones(10)):
        points = optimizer.ask(10)
        assert len(points) == 10
        optimizer.tell(points, scores)
