"""Compiled intersection of swept hulls, compared with plain NumPy."""

import numpy as np

from cornercase._common.geometry.aabb_tree import build_aabb_tree
from cornercase._common.geometry.boxes import box_axes, box_corners, separating_gap
from cornercase._common.geometry.overlap_runs import OverlapRuns
from cornercase.metrics._geometry.swept_hulls import (
    compute_hull_bounds,
    compute_separating_axes,
    find_overlapping_hulls,
    gap_to_nearest_hull,
)


def moved(rng, count):
    """Corners of boxes before and after a step, (count, 8, 2)."""
    x, y = rng.uniform(-6.0, 6.0, (2, count, 2))
    return box_corners(x, y, rng.uniform(-3.0, 3.0, (count, 2)), 4.0, 2.0).reshape(count, 8, 2)


def axes_of(corners):
    before, after = corners[:, :4], corners[:, 4:]
    way = after - before
    square = np.stack([-way[..., 1], way[..., 0]], -1) / np.hypot(way[..., 0], way[..., 1])[..., None]
    return np.concatenate([box_axes(before), box_axes(after), square], -2)


def test_hulls_meet_where_no_axis_separates_them():
    rng = np.random.default_rng(0)
    a, b = moved(rng, 30), moved(rng, 40)
    axes_a, axes_b = np.empty_like(a), np.empty_like(b)
    compute_separating_axes(a, axes_a)
    compute_separating_axes(b, axes_b)
    np.testing.assert_allclose(axes_a, axes_of(a), rtol=0.0, atol=1e-14)
    gap = separating_gap(a[:, None], axes_a[:, None], b, axes_b)
    bounds = np.empty((40, 4))
    compute_hull_bounds(b, bounds)
    tree = build_aabb_tree(bounds)
    far = np.full(30, 100.0), np.full(40, 100.0)

    def meeting(reach):
        found = OverlapRuns(
            find_overlapping_hulls(a, axes_a, a.mean(1), reach[0], b, axes_b, b.mean(1), reach[1], tree), (30, 40)
        )
        return np.array([found.overlaps_of_step(i) for i in range(30)])

    meets = meeting(far)
    assert 0 < meets.sum() < meets.size
    np.testing.assert_array_equal(meets, gap <= 0.0)
    # Hulls in disjoint circles do not intersect.
    assert not meeting((0.0 * far[0], 0.0 * far[1])).any()


def test_gap_to_the_nearest_hull_on_the_way():
    rng = np.random.default_rng(1)
    a, b = moved(rng, 1)[0], moved(rng, 10) + np.array([15.0, 0.0])
    axes = axes_of(b)
    for share in (0.3, 1.0):
        reached = np.concatenate([a[:4], a[:4] + share * (a[4:] - a[:4])])
        expected = separating_gap(reached, axes_of(reached[None])[0], b, axes).min()
        assert gap_to_nearest_hull(a[:4], a[4:] - a[:4], share, b, axes) == expected


def test_a_box_that_stands_has_axes_too():
    box = box_corners(1.0, 2.0, 0.3, 4.0, 2.0)
    axes = np.empty((1, 8, 2))
    compute_separating_axes(np.concatenate([box, box])[None], axes)
    np.testing.assert_array_equal(axes[0, :2], box_axes(box))
    np.testing.assert_array_equal(axes[0, 4:], np.tile([1.0, 0.0], (4, 1)))
