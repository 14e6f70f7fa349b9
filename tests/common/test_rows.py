"""Rows of arrays as dictionary keys."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import examples
from cornercase._common.row_keys import no_duplicates, row_keys

# Few distinct values, so that rows repeat; rows of a lattice differ in few bits.
_VALUES = st.sampled_from([0.0, -0.0, 0.25, 0.5, 1.0, float(np.nextafter(0.5, 1.0))])


@settings(deadline=None, max_examples=examples(200))
@given(st.lists(st.tuples(_VALUES, _VALUES), max_size=12), st.sets(st.tuples(_VALUES, _VALUES), max_size=4))
def test_rows_that_are_there_twice_are_never_taken_for_distinct(rows, others):
    points = np.array(rows).reshape(-1, 2)
    keys = set(row_keys(np.array(sorted(others)).reshape(-1, 2)))
    twice = len({*row_keys(points), *keys}) < len(points) + len(keys)
    assert no_duplicates(points, keys) != twice


@pytest.mark.parametrize(("side", "dimension"), [(200_000, 1), (512, 2), (64, 3), (8, 6), (2, 17)])
def test_the_points_of_a_lattice_are_told_apart(side, dimension):
    lattice = np.stack(np.meshgrid(*[np.arange(side) / side] * dimension), axis=-1).reshape(-1, dimension)
    assert no_duplicates(lattice, ())
