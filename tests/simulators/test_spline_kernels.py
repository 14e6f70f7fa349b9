"""Kernels of clothoid splines, compared with the NumPy versions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import examples
from cornercase.simulators.builtin.track_kernels import _clothoid_track as clothoid_track
from cornercase.simulators.builtin.track_kernels import _track_dispatch as kernels
from cornercase.simulators.builtin.track_kernels import _track_layout as track_layout
from cornercase.simulators.builtin.tracks import _track_pool as track_pool
from cornercase.simulators.builtin.tracks._clothoid_spline import ClothoidSpline


@st.composite
def _splines(draw: st.DrawFn) -> ClothoidSpline:
    scenarios, segments = draw(st.integers(1, 3)), draw(st.integers(1, 4))
    random = np.random.default_rng(draw(st.integers(0, 1000)))
    shape = (scenarios, segments)
    length = random.uniform(0.1, draw(st.sampled_from([0.7, 30.0, 4000.0])), shape)
    gaps = random.uniform(0.0, 5.0, (scenarios, segments + 1)) * random.integers(0, 2, (scenarios, segments + 1))
    clock = np.cumsum(gaps, axis=1) if draw(st.booleans()) else None
    x, y, heading = random.normal(0.0, 10.0, (3, scenarios))
    start, end = random.normal(0.0, 0.05, (2, *shape))
    if draw(st.booleans()):
        # Usually all scenarios have the same curve.
        x, y, heading, start, end, length = (
            one[:1].repeat(scenarios, 0) for one in (x, y, heading, start, end, length)
        )
    return ClothoidSpline(x, y, heading, start, end, length, clock)


def _check(tracks: track_pool.TrackTable, spline: ClothoidSpline, offset: float) -> None:
    rows = np.arange(len(spline.lengths))
    ends = [spline.chord_length * k + d for k in (0, 1, 2) for d in (-1e-9, 0.0)]
    for distance in [share * spline.lengths for share in (-0.2, 0.0, 0.31, 0.77, 1.0, 1.1)] + ends:
        same = np.stack(spline.pose_at(distance, np.full(len(rows), offset), rows), axis=1)
        for n in rows.tolist():
            place = kernels.pose_on_track(tracks, 0, n, distance[n], offset)
            np.testing.assert_allclose(place, same[n], rtol=1e-12, atol=1e-12)
            direction = spline.direction_at(distance[n : n + 1], rows[n : n + 1])[0]
            assert kernels.trajectory_direction(tracks, 0, n, distance[n]) == pytest.approx(direction, abs=1e-12)
            assert not kernels.trajectory_has_heading(tracks, 0, n, distance[n])
    for n in rows.tolist():
        assert kernels.trajectory_length(tracks, 0, n) == spline.lengths[n]
    if spline.times is None:
        return
    for time in [spline.times[:, k] + d for k in range(spline.times.shape[1]) for d in (-0.3, 0.0, 0.3)]:
        there = spline.distance_at_time(time)
        for n in rows.tolist():
            assert kernels.trajectory_end_time(tracks, 0, n) == spline.times[n, -1]
            assert kernels.trajectory_distance_at_time(tracks, 0, n, time[n]) == there[n]


@given(_splines(), st.sampled_from([0.0, 1.5, -3.0]))
@settings(max_examples=examples(60), deadline=None)
def test_splines_are_the_same_compiled(spline: ClothoidSpline, offset: float) -> None:
    tracks = track_pool.TrackPool().update([[spline]])
    assert tracks.kind.tolist() == [track_layout.CLOTHOID_TRACK]
    assert tracks.has_times.tolist() == [spline.times is not None]
    _check(tracks, spline, offset)


def test_a_spline_that_is_started_again_shows_at_once() -> None:
    def spline(length: float) -> ClothoidSpline:
        zero, lengths = np.zeros(2), np.full((2, 1), length)
        return ClothoidSpline(zero, zero, zero, 0.0 * lengths, 0.0 * lengths + 0.02, lengths)

    one, held = spline(3.0), track_pool.TrackPool()
    held.update([[one]])
    one.copy_rows_from(spline(40.0), np.array([False, True]))
    tracks = held.update([[one]])
    assert [clothoid_track.spline_length(tracks, 0, n) for n in range(2)] == [3.0, 40.0]
    _check(tracks, one, 1.0)
