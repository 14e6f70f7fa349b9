"""Searches in cells of nearby points, against comparing all points."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from cornercase.clustering._cells import AXES_PER_STAGE, make_cells, pad_axes
from cornercase.clustering._embedding import EmbeddedDistances
from cornercase.clustering._kernels.nearest_rows import fill_nearest_rows


@pytest.mark.parametrize(("n_rows", "n_axes", "n_nearest"), [(1, 1, 1), (37, 3, 37), (500, 20, 5), (333, 8, 64)])
def test_the_nearest_rows_are_those_of_all_pairs(n_rows, n_axes, n_nearest):
    rng = np.random.default_rng(n_rows)
    # Rounded, so that many rows are equally far.
    rows, columns = (np.round(rng.random((count, n_axes)), 1) for count in (n_rows, 50))
    found = np.empty((len(columns), n_nearest), dtype=np.int64)
    padded = pad_axes(columns)
    fill_nearest_rows(padded.reshape(len(columns), -1, AXES_PER_STAGE), make_cells(pad_axes(rows)), found)
    squares = cdist(columns, rows, "sqeuclidean")
    np.testing.assert_allclose(
        np.take_along_axis(squares, found, axis=1), np.sort(squares, axis=1)[:, :n_nearest], atol=1e-12
    )
    assert all(len(set(line)) == n_nearest for line in found.tolist())


def test_the_distance_to_a_neighbour_is_that_of_all_pairs():
    points = np.random.default_rng(1).random((200, 5))
    distances, squares = EmbeddedDistances(points), cdist(points, points, "sqeuclidean")
    rows = np.array([3, 50])
    np.testing.assert_allclose(distances.distances_to_nth_neighbour(rows, 10), np.sort(squares[rows], axis=1)[:, 10])


def test_random_choices_without_any_of_the_nearest_rows_are_measured_too():
    points = np.random.default_rng(2).random((400, 3))
    # The far half, so that none of the nearest rows of the near half is chosen.
    choices = np.argsort(points[:, 0])[None, 200:]
    expected = cdist(points[choices[0]], points, "sqeuclidean").min(axis=0)
    found = EmbeddedDistances(points).distances_to_nearest_per_choice(choices)
    np.testing.assert_allclose(found[0], expected, atol=1e-12)
