"""Searches of one parameter, whose scenarios soon lie close to each other."""

from __future__ import annotations

import numpy as np
import pytest

from cornercase.optimizers import LevelSet
from cornercase.scenario import ParameterSpace
from helpers.search_cases import explored


@pytest.mark.parametrize("function", [lambda p: np.sin(9 * p[:, 0]), lambda p: np.abs(p[:, 0] - 0.5)])
def test_level_set_goes_on_however_close_the_scenarios_lie(function):
    optimizer = LevelSet().start(ParameterSpace.from_ranges(["a=0:1"]), 0, threshold=0.1)
    points = explored(optimizer, 120, function=function)
    assert len(np.unique(points)) == 120
