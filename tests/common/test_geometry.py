"""Distances and contact times of boxes, compared with closed forms and numerical search."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree

from conftest import examples
from cornercase._common.geometry.boxes import box_corners, box_distance, boxes_overlap, time_to_contact

coordinate = st.floats(-30, 30)
angle = st.floats(-7, 7)
size = st.floats(0.3, 8)
box = st.tuples(coordinate, coordinate, angle, size, size).map(lambda b: box_corners(*b))
# Below 1e-6 m/s, contacts are years away, and rounding is larger than the boxes.
vector = st.tuples(st.floats(-20, 20), st.floats(-20, 20)).map(lambda v: np.round(v, 6))


def outline(corners, n=400):
    share = np.linspace(0, 1, n)[:, None]
    return np.concatenate([a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)])


def test_distance_of_faces_corners_and_turned_boxes():
    here = box_corners(0, 0, 0, 4, 2)
    cases = {
        (10, 0, 0, 4.5, 1.8): 10 - 2 - 2.25,
        (10, 8, 0, 4.5, 1.8): np.hypot(10 - 4.25, 8 - 1.9),
        (10, 0, np.pi / 4, 4, 2): 10 - 3 / np.sqrt(2) - 2,
        (0, 6, np.pi / 2, 4, 2): 6 - 2 - 1,
        (4, 0, 0, 4, 2): 0.0,
        (1, 0.5, 0.7, 4, 2): 0.0,
        (0, 0, 0, 0.5, 0.2): 0.0,
    }
    there = box_corners(*np.array(list(cases)).T)
    np.testing.assert_allclose(box_distance(here, there), list(cases.values()), atol=1e-12)


def test_boxes_that_cross_without_a_corner_inside_overlap():
    assert box_distance(box_corners(0, 0, 0, 10, 1), box_corners(0, 0, np.pi / 2, 10, 1)) == 0


def test_segments_and_points_have_distances():
    segment, beside = box_corners(0, 0, 0.3, 4, 0), box_corners(-3 * np.sin(0.3), 3 * np.cos(0.3), 0.3, 4, 0)
    assert box_distance(segment, beside) == pytest.approx(3)
    assert box_distance(box_corners(0, 0, 0, 0, 0), box_corners(3, 4, 1, 0, 0)) == pytest.approx(5)


def test_segments_and_points_overlap_only_where_they_touch():
    here = box_corners(0, 0, 0, 4, 2)
    assert not boxes_overlap(here, box_corners(2.2, 1.2, np.pi / 4, 0, 1))
    assert not boxes_overlap(box_corners(0, 0, 0, 0, 2), box_corners(10, 0, 0, 0, 2))
    sizes = np.array([(4.0, 2.0), (3.0, 0.0), (0.0, 3.0), (0.0, 0.0)])
    x, y, heading = np.random.default_rng(0).uniform(-2.5, 2.5, (3, 400))
    others = box_corners(x[:, None], y[:, None], heading[:, None], *sizes.T)
    overlap = boxes_overlap(others[:, :, None], others[:1])
    np.testing.assert_array_equal(overlap, box_distance(others[:, :, None], others[:1]) < 1e-9)
    assert overlap[:, 0, 1:].any(0).all()
    assert boxes_overlap(box_corners(1, 1, 0, 0, 0), here)
    assert boxes_overlap(box_corners(2, 1, 0, 0, 0), box_corners(2, 1, 1, 0, 0))


def test_unknown_boxes_have_no_distance_and_no_contact():
    here, nowhere = box_corners(0, 0, 0, 4, 2), box_corners(np.nan, 0, 0, 4, 2)
    assert np.isnan(box_distance(here, nowhere))
    assert np.isnan(time_to_contact(here, nowhere, np.array([1.0, 0.0])))
    assert np.isnan(time_to_contact(here, here + 10, np.array([np.nan, 0.0])))


@settings(deadline=None, max_examples=examples(150))
@given(box, box)
def test_distance_is_that_of_the_nearest_outline_points(a, b):
    found = float(box_distance(a, b))
    if boxes_overlap(a, b):
        assert found == 0
        return
    gaps = np.min(KDTree(outline(b)).query(outline(a))[0])
    spacing = 8 / 399
    assert gaps - 2 * spacing <= found <= gaps + 1e-9
    assert box_distance(b, a) == pytest.approx(found, rel=1e-12)


@settings(deadline=None, max_examples=examples(150))
@given(box, box, vector, st.none() | vector.map(lambda v: v / 4))
@example(box_corners(0, 0, 0, 1, 1), box_corners(0, 2, 0, 1, 1), np.array([0.0, 1.0]), np.array([0.0, -3.5e-46]))
def test_first_contact_is_the_first_time_that_boxes_overlap(a, b, velocity, acceleration):
    def touch(t):
        bend = 0 if acceleration is None else 0.5 * acceleration * np.asarray(t)[..., None] ** 2
        return boxes_overlap(a, b + (velocity * np.asarray(t)[..., None] + bend)[..., None, :])

    found = float(time_to_contact(a, b, velocity, acceleration))
    grid = np.linspace(0, 20, 4001)
    assert not touch(grid[grid < found - 1e-9]).any()
    if np.isfinite(found):
        assert found >= 0
        move = velocity * found + (0 if acceleration is None else 0.5 * acceleration * found**2)
        assert box_distance(a, b + move) == pytest.approx(0, abs=1e-7 * (1 + np.abs(move).max()))


def test_contact_up_to_the_horizon_only():
    here, there = box_corners(0, 0, 0, 4, 2), box_corners(14, 0, 0, 4, 2)
    closing = np.array([-5.0, 0.0])
    assert time_to_contact(here, there, closing) == pytest.approx(2)
    assert time_to_contact(here, there, closing, horizon=1.9) == np.inf
    assert time_to_contact(here, there, closing, horizon=2.0) == pytest.approx(2)


def test_contact_under_acceleration_takes_the_earlier_root_and_keeps_small_accelerations_exact():
    """Gap 10 closed at 5 m/s: 10 = 5 t + a t²/2, so t = (sqrt(25 + 20 a) - 5) / a."""
    here, there = box_corners(0, 0, 0, 4, 2), box_corners(14, 0, 0, 4, 2)
    for gain in (3.0, -1.0, -1.25, 1e-3):
        expected = (np.sqrt(25 + 20 * gain) - 5) / gain
        found = time_to_contact(here, there, np.array([-5.0, 0.0]), np.array([-gain, 0.0]))
        assert found == pytest.approx(expected, rel=1e-9)
    tiny = time_to_contact(here, there, np.array([-5.0, 0.0]), np.array([-1e-14, 0.0]))
    assert tiny == pytest.approx(2, rel=1e-12)
    assert time_to_contact(here, there, np.array([-5.0, 0.0]), np.array([1.3, 0.0])) == np.inf


@settings(max_examples=examples(100), deadline=None)
@given(box, box, st.floats(1, 10), vector)
def test_contact_comes_nearer_as_time_goes_on_and_sees_relative_motion_only(a, b, until_centres_meet, drift):
    velocity = (a.mean(0) - b.mean(0)) / until_centres_meet
    start = float(time_to_contact(a, b, velocity))
    assert 0 <= start <= until_centres_meet
    later = 0.7 * start
    moved = time_to_contact(a + drift * later, b + (drift + velocity) * later, velocity)
    assert moved == pytest.approx(start - later, abs=1e-7)
