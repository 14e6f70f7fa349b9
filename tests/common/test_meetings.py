import numpy as np
import pytest
from scipy.ndimage import label

from conftest import at_night
from cornercase._common.geometry.aabb_tree import build_aabb_tree, next_overlapping_leaf, node_after_subtree
from cornercase._common.geometry.overlap_runs import OverlapRuns


def runs_of(meets):
    """Runs of a dense table of pairs."""
    found = []
    for i, row in enumerate(meets):
        ends = np.flatnonzero(np.diff(np.concatenate([[0], row.astype(int), [0]])))
        found += [(i, first, after - 1) for first, after in ends.reshape(-1, 2)]
    return np.array(found, dtype=np.int64).reshape(-1, 3)


@pytest.mark.parametrize("share", [0.0, 0.05, 0.2, 0.4, 0.7, 1.0])
@pytest.mark.parametrize("shape", at_night([(1, 1), (1, 9), (9, 1), (12, 17), (40, 30)], {(40, 30)}))
def test_places_are_those_of_the_table_of_all_pairs(shape, share):
    rng = np.random.default_rng(0)
    for _ in range(20):
        meets = rng.random(shape) < share
        labels, count = label(meets, structure=np.ones((3, 3)))
        places = OverlapRuns(runs_of(meets), shape).connected_components()
        assert len(places) == count
        for k, place in enumerate(places, start=1):
            table = labels == k
            np.testing.assert_array_equal(place.steps_of_first_path(), np.flatnonzero(table.any(1)))
            np.testing.assert_array_equal(place.steps_of_second_path(), np.flatnonzero(table.any(0)))
            np.testing.assert_array_equal([place.overlaps_of_step(i) for i in range(shape[0])], table)
            np.testing.assert_array_equal([place.overlaps_of_other_step(j) for j in range(shape[1])], table.T)


def test_a_diagonal_is_one_place_and_a_gap_of_a_step_makes_two():
    diagonal = np.array([[0, 0, 0], [1, 1, 1], [2, 2, 2]])
    assert len(OverlapRuns(diagonal, (3, 3)).connected_components()) == 1
    assert len(OverlapRuns(diagonal[[0, 2]], (3, 3)).connected_components()) == 2


@pytest.mark.parametrize("count", [1, 2, 3, 8, 33])
def test_the_tree_finds_each_box_that_shares_a_point_in_order(count):
    rng = np.random.default_rng(count)
    low = np.cumsum(rng.normal(size=(count, 2)), axis=0)
    bounds = np.hstack([low, low + rng.uniform(0.0, 2.0, (count, 2))])
    tree = build_aabb_tree(bounds)
    for x, y in np.concatenate([rng.uniform(-4.0, 4.0, (40, 2)), bounds[:, 2:]]):
        found, node = [], next_overlapping_leaf(tree, 1, x, y, x + 0.5, y + 0.5)
        while node > 0:
            found.append(node - len(tree) // 2)
            node = next_overlapping_leaf(tree, node_after_subtree(node), x, y, x + 0.5, y + 0.5)
        shares = (bounds[:, 0] <= x + 0.5) & (x <= bounds[:, 2]) & (bounds[:, 1] <= y + 0.5) & (y <= bounds[:, 3])
        np.testing.assert_array_equal(found, np.flatnonzero(shares))
