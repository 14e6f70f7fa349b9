"""Clothoid splines, compared with the integral of their curvature."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import examples
from cornercase.simulators.builtin.track_kernels import _track_dispatch as kernels
from cornercase.simulators.builtin.tracks._clothoid_spline import ClothoidSpline
from cornercase.simulators.builtin.tracks._track_pool import TrackPool


@given(st.integers(0, 1000), st.integers(1, 3), st.integers(1, 4), st.booleans())
@settings(max_examples=examples(60), deadline=None)
def test_a_spline_bends_by_its_curvature(seed: int, scenarios: int, segments: int, same: bool) -> None:
    random = np.random.default_rng(seed)
    shape = (1 if same else scenarios, segments)
    length, (x, y, heading) = random.uniform(0.1, 30.0, shape), random.normal(0.0, 10.0, (3, shape[0]))
    start, end = random.normal(0.0, 0.05, (2, *shape))
    x, y, heading, start, end, length = (
        part.repeat(scenarios // shape[0], 0) for part in (x, y, heading, start, end, length)
    )
    spline = ClothoidSpline(x, y, heading, start, end, length)
    for n in range(scenarios):
        # The midpoint rule on short steps.
        count = 4000
        step = np.repeat(length[n] / count, count)
        share = np.tile((np.arange(count) + 0.5) / count, segments)
        bend = np.repeat(start[n], count) + share * np.repeat(end[n] - start[n], count)
        turned = heading[n] + np.concatenate([[0.0], np.cumsum(bend * step)])
        middle = 0.5 * (turned[1:] + turned[:-1])
        gone = np.concatenate([[0.0], np.cumsum(step)])
        expected = (
            np.concatenate([x[n : n + 1], x[n] + np.cumsum(np.cos(middle) * step)]),
            np.concatenate([y[n : n + 1], y[n] + np.cumsum(np.sin(middle) * step)]),
            turned,
        )
        for distance in (*np.arange(0.0, gone[-1], 1.0), gone[-1]):
            found = spline.pose_at(np.array([distance]), np.zeros(1), np.array([n]))
            for value, values in zip(found, expected, strict=True):
                assert value[0] == pytest.approx(np.interp(distance, gone, values), abs=1e-4)
            # Chords of 1 m stay within millimetres.
            between = spline.pose_at(np.array([min(distance + 0.5, gone[-1])]), np.zeros(1), np.array([n]))
            for value, values in zip(between[:2], expected[:2], strict=True):
                assert value[0] == pytest.approx(np.interp(min(distance + 0.5, gone[-1]), gone, values), abs=0.03)
        beside = spline.pose_at(np.zeros(1), np.array([2.0]), np.array([n]))
        assert np.hypot(beside[0][0] - x[n], beside[1][0] - y[n]) == pytest.approx(2.0)
        assert kernels.trajectory_length(spline.table, 0, n) == pytest.approx(length[n].sum())


@given(st.integers(0, 1000), st.integers(1, 4))
@settings(max_examples=examples(40), deadline=None)
def test_each_segment_is_travelled_at_constant_speed(seed: int, segments: int) -> None:
    random = np.random.default_rng(seed)
    length, zero = random.uniform(0.1, 30.0, (1, segments)), np.zeros(1)
    clock = np.cumsum(random.uniform(0.1, 5.0, (1, segments + 1)), axis=1)
    spline = ClothoidSpline(zero, zero, zero, 0.0 * length, 0.0 * length + 0.02, length, clock)
    ends = np.concatenate([[0.0], np.cumsum(length[0])])
    assert kernels.trajectory_end_time(spline.table, 0, 0) == clock[0, -1]
    for time in np.linspace(clock[0, 0], clock[0, -1], 9):
        distance = np.interp(time, clock[0], ends)
        assert kernels.trajectory_distance_at_time(spline.table, 0, 0, time) == pytest.approx(distance)
        point = spline.evaluate(np.array([distance]), np.zeros(1), np.zeros(1, dtype=np.int64))
        assert point.time[0] == pytest.approx(time)
        k = min(int(np.searchsorted(ends, distance, "right")) - 1, segments - 1)
        if min(abs(distance - ends)) > 1e-6:
            assert point.speed[0] == pytest.approx(length[0, k] / (clock[0, k + 1] - clock[0, k]))


def test_a_spline_that_is_started_again_shows_at_once() -> None:
    def spline(length: float) -> ClothoidSpline:
        zero, lengths = np.zeros(2), np.full((2, 1), length)
        return ClothoidSpline(zero, zero, zero, 0.0 * lengths, 0.0 * lengths + 0.02, lengths)

    one, held = spline(3.0), TrackPool()
    held.update([[one]])
    one.copy_scenarios_from(spline(40.0), np.array([False, True]))
    tracks = held.update([[one]])
    assert [kernels.trajectory_length(tracks, 0, n) for n in range(2)] == [3.0, 40.0]
    assert kernels.pose_on_track(tracks, 0, 1, 40.0, 0.0) == tuple(
        part[0] for part in spline(40.0).pose_at(np.array([40.0]), np.zeros(1), np.array([1]))
    )
