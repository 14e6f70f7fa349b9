"""Tracks as compiled code evaluates them, compared with plain definitions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import examples
from cornercase._common.typing import FloatArray
from cornercase.roads._kernels.heading import build_road_tables, reference_heading
from cornercase.roads._lane_path import LanePath
from cornercase.roads._network import RoadNetwork
from cornercase.simulators.builtin.track_kernels import _polyline_track as polyline_track
from cornercase.simulators.builtin.track_kernels import _track_layout as track_layout
from cornercase.simulators.builtin.track_kernels._track_dispatch import pose_on_track
from cornercase.simulators.builtin.track_kernels._track_layout import ALONG_SEGMENTS, AT_CORNERS, AT_VERTICES
from cornercase.simulators.builtin.tracks import _track_pool as track_pool
from cornercase.simulators.builtin.tracks._lane import LaneTrack
from cornercase.simulators.builtin.tracks._polyline import Polyline
from helpers import road_networks as rn

_coordinate = st.one_of(st.integers(-5, 5).map(float), st.floats(-200.0, 200.0))


@st.composite
def _lines(draw: st.DrawFn) -> Polyline:
    scenarios, vertices = draw(st.integers(1, 3)), draw(st.integers(2, 6))

    def table(values: st.SearchStrategy[float]) -> FloatArray:
        return np.array(draw(st.lists(values, min_size=scenarios * vertices, max_size=scenarios * vertices))).reshape(
            scenarios, vertices
        )

    time = np.sort(table(st.one_of(st.integers(0, 4).map(float), st.floats(0.0, 20.0))), axis=1)
    heading = table(st.one_of(st.just(np.nan), st.floats(-7.0, 7.0)))
    begin = np.full(scenarios, draw(st.floats(0.0, 20.0))) if draw(st.booleans()) else None
    timed = draw(st.booleans())
    turning = draw(st.sampled_from([ALONG_SEGMENTS, AT_CORNERS, AT_VERTICES]))
    closed = not timed and draw(st.booleans())
    return Polyline(table(_coordinate), table(_coordinate), heading, time if timed else None, closed, turning, begin)


def _wrap(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def _vertex_heading(line: Polyline, n: int, k: int) -> float:
    """Heading of a vertex: as given, or the direction of the segment that begins there; the last segment ends there."""
    first = min(k, line.x.shape[1] - 2)
    direction = np.arctan2(line.y[n, first + 1] - line.y[n, first], line.x[n, first + 1] - line.x[n, first])
    return float(direction if np.isnan(line.heading[n, k]) else line.heading[n, k])


@given(_lines(), st.lists(st.floats(0.01, 0.99), min_size=1, max_size=4), st.sampled_from([0.0, 1.5, -3.0]))
@settings(max_examples=examples(200), deadline=None)
def test_a_line_goes_straight_from_vertex_to_vertex(line: Polyline, shares: list[float], offset: float) -> None:
    for n in range(len(line.x)):
        lengths = np.hypot(np.diff(line.x[n]), np.diff(line.y[n]))
        ends = np.concatenate([[0.0], np.cumsum(lengths)])
        for k in np.flatnonzero(lengths > 1e-2).tolist():
            for share in shares:
                point = line.evaluate(np.array([ends[k] + share * lengths[k]]), np.array([offset]), np.array([n]))
                across = np.array([line.y[n, k] - line.y[n, k + 1], line.x[n, k + 1] - line.x[n, k]]) / lengths[k]
                x = line.x[n, k] + share * (line.x[n, k + 1] - line.x[n, k]) + offset * across[0]
                y = line.y[n, k] + share * (line.y[n, k + 1] - line.y[n, k]) + offset * across[1]
                np.testing.assert_allclose((point.x[0], point.y[0]), (x, y), rtol=0.0, atol=1e-9)
                direction = np.arctan2(line.y[n, k + 1] - line.y[n, k], line.x[n, k + 1] - line.x[n, k])
                assert abs(_wrap(point.direction[0] - direction)) < 1e-9
                assert point.has_heading[0] == (not np.isnan(line.heading[n, k]))
                begin, turn = _vertex_heading(line, n, k), 0.0
                if line.heading_interpolation == ALONG_SEGMENTS:
                    turn = _wrap(_vertex_heading(line, n, k + 1) - begin)
                given = lengths[min(k + 1, lengths.size - 1)] > 1e-2
                if line.heading_interpolation != AT_CORNERS and given and abs(turn) < 3.14:
                    assert abs(_wrap(point.heading[0] - begin - share * turn)) < 1e-9


@given(_lines())
@settings(max_examples=examples(100), deadline=None)
def test_beyond_its_ends_a_line_goes_on_straight(line: Polyline) -> None:
    for n in range(len(line.x)):
        lengths = np.hypot(np.diff(line.x[n]), np.diff(line.y[n]))
        if line.closed or lengths[0] < 1e-2 or lengths[-1] < 1e-2:
            continue
        for distance, at, k in ((-3.0, 0, 0), (lengths.sum() + 3.0, -1, lengths.size - 1)):
            x, y, _ = line.pose_at(np.array([distance]), np.zeros(1), np.array([n]))
            along = np.array([line.x[n, k + 1] - line.x[n, k], line.y[n, k + 1] - line.y[n, k]]) / lengths[k]
            onward = np.sign(distance) * 3.0 * along
            np.testing.assert_allclose((x[0] - line.x[n, at], y[0] - line.y[n, at]), onward, rtol=0.0, atol=1e-9)


@given(_lines())
@settings(max_examples=examples(100), deadline=None)
def test_times_of_a_line_are_those_of_its_vertices(line: Polyline) -> None:
    tracks, times = line.table, line.times
    if times is None:
        return
    for n in range(len(line.x)):
        assert polyline_track.polyline_end_time(tracks, 0, n) == times[n, -1]
        lengths = np.hypot(np.diff(line.x[n]), np.diff(line.y[n]))
        if (lengths < 1e-2).any() or (np.diff(times[n]) < 1e-2).any():
            continue
        for k in range(times.shape[1]):
            found = polyline_track.polyline_distance_at_time(tracks, 0, n, times[n, k])
            assert found == pytest.approx(line.distance[n, k], abs=1e-6)
        if line.accelerations is not None and not line.accelerations.any():
            for time in np.linspace(times[n, 0], times[n, -1], 7):
                distance = np.interp(time, times[n], line.distance[n])
                found = polyline_track.polyline_distance_at_time(tracks, 0, n, time)
                assert found == pytest.approx(distance, rel=1e-12, abs=1e-9)
                point = line.evaluate(np.array([distance]), np.zeros(1), np.array([n]))
                assert point.time[0] == pytest.approx(time, abs=1e-5)


_ROOT = Path(__file__).parents[2]
_FILES = ("examples/x_intersection/x_intersection.xodr", "tests/data/everything/road.xodr")
_SPIRAL, _BARELY = '<spiral curvStart="-0.01" curvEnd="0.05"/>', '<spiral curvStart="0.01" curvEnd="0.01"/>'
_CURVE = '<paramPoly3 pRange="{}" aU="0" bU="{}" cU="1e-3" dU="-1e-5" aV="0" bV="0.2" cV="2e-3" dV="3e-5"/>'


def _tracks_of(network: RoadNetwork) -> list[LaneTrack]:
    """A track along each lane in both directions."""
    found = [
        LaneTrack.from_lane(network, k, lane, start + 1e-3, along, ())
        for k, road in enumerate(network.roads)
        for start, lanes in road.sections
        for lane in lanes
        for along in (True, False)
    ]
    return [track for track in found if track is not None]


def test_beside_a_bend_a_lane_is_a_circle(tmp_path: Path) -> None:
    network = rn.network(tmp_path, rn.road("bend", 25.0, shape='<arc curvature="0.05"/>', right=rn.lane(-1)))
    track = LaneTrack.from_lane(network, 0, -1, 1.0, True, ())
    assert track is not None
    # The reference line has a radius of 20 m, the centre of the lane 22 m.
    distance, offset = np.linspace(0.5, track.length - 0.5, 300), np.linspace(-4.0, 4.0, 300)
    x, y, heading = track.pose_at(distance, offset, np.arange(300))
    np.testing.assert_allclose(np.hypot(x, y - 20.0), 22.0 - offset, atol=2e-5)
    np.testing.assert_allclose(heading, np.arctan2(x, 20.0 - y), atol=1e-4)
    np.testing.assert_allclose(heading, distance / 22.0, atol=1e-4)
    assert np.isnan(track.pose_at(np.array([np.nan]), np.zeros(1), np.zeros(1, dtype=np.int64))).all()


def test_directions_of_roads_are_the_same_compiled(tmp_path: Path) -> None:
    shapes = {
        "<line/>": True, '<arc curvature="-0.02"/>': True, _SPIRAL: True, _BARELY: True,
        _CURVE.format("arcLength", 1): True, _CURVE.format("normalized", 30.0): True,
        '<poly3 a="0" b="0" c="0.001" d="0"/>': False,
    }  # fmt: skip
    roads = rn.network(tmp_path, *(rn.road(str(k), 30.0, shape=shape) for k, shape in enumerate(shapes))).roads
    several = [road for file in _FILES for road in RoadNetwork.read(_ROOT / file).roads]
    tables = build_road_tables([*roads, *several])
    assert tables.heading_known[: len(roads)].tolist() == list(shapes.values())
    for k, road in enumerate([*roads, *several]):
        seams = [geometry.s for geometry in road.geometries]
        s = np.concatenate([np.linspace(-3.0, road.length + 3.0, 15), seams])
        for at, heading in zip(s, road.reference_pose(s)[2], strict=True):
            if tables.heading_known[k]:
                assert reference_heading(tables, k, at) == pytest.approx(heading, rel=1e-14, abs=1e-15)


def test_tables_follow_what_comes_and_changes() -> None:
    def line(y: float) -> Polyline:
        return Polyline(np.array([[0.0, 10.0]] * 2), np.full((2, 2), y), np.full((2, 2), np.nan))

    one, two = line(0.0), line(5.0)
    held = track_pool.TrackPool()
    tracks = held.update([[one], []])
    assert tracks.rows.tolist() == [[0], [-1]]
    assert held.update([[one], []]) is tracks
    tracks = held.update([[one], [two, one]])
    assert tracks.rows.tolist() == [[0, -1], [1, 0]]
    one.copy_scenarios_from(line(3.0), np.array([False, True]))
    tracks = held.update([[one], [two, one]])
    assert [pose_on_track(tracks, 0, n, 4.0, 0.0)[:2] for n in range(2)] == [(4.0, 0.0), (4.0, 3.0)]
    assert pose_on_track(tracks, 1, 1, 4.0, 1.0)[:2] == (4.0, 6.0)


def test_the_columns_of_a_path_are_where_kernels_look_for_them(tmp_path: Path) -> None:
    path = _tracks_of(rn.network(tmp_path, rn.road("one", 30.0)))[0].path
    named = {
        track_layout.DISTANCE: "distance", track_layout.X: "x", track_layout.Y: "y", track_layout.HEADING: "heading", track_layout.CURVATURE: "curvature",
        track_layout.S: "s", track_layout.ROAD: "road", track_layout.LANE_NUMBER: "lane", track_layout.RUNS_ALONG_S: "forward", track_layout.REFERENCE_DISTANCE: "reference_distance",
        track_layout.CENTER_OFFSET: "center_offset", track_layout.CURVATURE_DISTANCE: "curvature_distance", track_layout.REFERENCE_CURVATURE: "reference_curvature",
    }  # fmt: skip
    assert len(path.arrays) == track_layout.N_COLUMNS
    for column, name in named.items():
        assert path.arrays[column] is getattr(path, name)


def _nearest(path: LanePath, x: float, y: float, after: float) -> float:
    """Reference: nearest point of a path among its 16 nearest samples, on the first of several passes."""
    if not (abs(x) < 1e12 and abs(y) < 1e12):
        x, y = path.x[0], path.y[0]
    gaps = np.sqrt((path.x - x) ** 2 + (path.y - y) ** 2)
    samples = np.argsort(gaps, kind="stable")[:16]
    samples = samples[gaps[samples] <= gaps.min() + 0.3]
    ahead = samples[path.distance[samples] >= after - 1.0]
    samples = ahead if ahead.size else samples
    at = path.distance[samples]
    distance = at[at < at.min() + 16 * path.distance[1]][0]
    place = np.array([distance])
    at_x, at_y, heading = (float(part[0]) for part in LaneTrack(path).pose_at(place, np.zeros(1), np.array([0])))
    beyond = (x - at_x) * np.cos(heading) + (y - at_y) * np.sin(heading)
    return float(distance + np.clip(beyond, -path.distance[1], path.distance[1]))


def test_the_nearest_points_of_lanes_are_found_without_looking_at_all_samples(tmp_path: Path) -> None:
    links = rn.linked("predecessor", "ring", "end") + rn.linked("successor", "ring", "start")
    ring = rn.network(tmp_path, rn.road("ring", 40 * np.pi, shape='<arc curvature="0.05"/>', links=links))
    lanes = [*_tracks_of(ring), *_tracks_of(RoadNetwork.read(_ROOT / _FILES[0]))[::9]]
    assert lanes[0].path.goals_passed.size > 2 * 400 * np.pi
    random = np.random.default_rng(3)
    for lane in lanes:
        distance = random.uniform(-20.0, lane.length + 20.0, 60)
        offset = random.normal(0.0, 1.0, 60) * random.choice([0.0, 0.5, 5.0, 50.0], 60)
        x, y, _ = lane.pose_at(distance, offset, np.arange(60))
        x[0], y[1], x[2:10] = np.nan, 1e15, x[2:10] + random.normal(0.0, 30.0, 8)
        after = np.where(random.random(60) < 0.3, -np.inf, distance + random.normal(0.0, 20.0, 60))
        found = lane.nearest_distance(x, y, np.arange(60), after)
        for i in range(60):
            assert found[i] == pytest.approx(_nearest(lane.path, x[i], y[i], after[i]), abs=1e-9)
