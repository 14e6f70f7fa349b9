"""Kernels of tracks, compared with the NumPy versions."""

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
from cornercase.simulators.builtin.track_kernels import _lane_track as lane_track
from cornercase.simulators.builtin.track_kernels import _polyline_track as polyline_track
from cornercase.simulators.builtin.track_kernels import _track_layout as track_layout
from cornercase.simulators.builtin.track_kernels._track_dispatch import pose_on_track
from cornercase.simulators.builtin.tracks import _track_pool as track_pool
from cornercase.simulators.builtin.tracks._lane import LaneTrack
from cornercase.simulators.builtin.tracks._polyline import Polyline
from cornercase.simulators.builtin.tracks._track import ALONG_SEGMENTS, AT_CORNERS, AT_VERTICES
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


@given(_lines(), st.lists(st.floats(-0.5, 1.5), min_size=1, max_size=8), st.sampled_from([0.0, 1.5, -3.0]))
@settings(max_examples=examples(200), deadline=None)
def test_lines_are_the_same_compiled(line: Polyline, shares: list[float], offset: float) -> None:
    tracks = track_pool.TrackPool().update([[line]])
    assert tracks.kind.tolist() == [track_layout.POLYLINE_TRACK]
    rows = np.arange(len(line.x))
    length = line.distance[:, -1]
    vertices = [line.distance[:, k] + d for k in range(line.x.shape[1]) for d in (-1e-6, 0.0, 5e-7, 1e-6, 3.0)]
    for distance in [*(share * length for share in shares), *vertices]:
        offsets = np.full(len(rows), offset)
        same = np.stack(line.pose_at(distance, offsets, rows), axis=1)
        direction, oriented = line.direction_at(distance, rows), line.has_heading_at(distance, rows)
        for n in rows.tolist():
            place = pose_on_track(tracks, 0, n, distance[n], offset)
            np.testing.assert_allclose(place, same[n], rtol=1e-12, atol=1e-12)
            assert polyline_track.polyline_direction(tracks, 0, n, distance[n]) == direction[n]
            assert polyline_track.polyline_has_heading(tracks, 0, n, distance[n]) == oriented[n]
    for n in rows.tolist():
        assert polyline_track.polyline_length(tracks, 0, n) == line.lengths[n]
    if line.times is None:
        return
    instants = [line.times[:, k] + d for k in range(line.x.shape[1]) for d in (-0.3, 0.0, 0.3)]
    for time in [*instants, *(share * 20.0 + 0.0 * length for share in shares)]:
        there = line.distance_at_time(time)
        for n in rows.tolist():
            assert polyline_track.polyline_end_time(tracks, 0, n) == line.times[n, -1]
            found = polyline_track.polyline_distance_at_time(tracks, 0, n, time[n])
            assert found == pytest.approx(there[n], rel=1e-12, abs=1e-12)


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


def _check_lane(tracks: track_pool.TrackTable, g: int, track: LaneTrack, random: np.random.Generator) -> None:
    path, length = track.path, track.length
    near = path.distance[random.integers(0, path.distance.size, 20)]
    distance = np.concatenate([random.uniform(-10.0, length + 10.0, 60), near, [0.0, length, -0.0, -5.0, length + 5.0]])
    offset, way = random.uniform(-8.0, 8.0, distance.size), random.normal(0.0, 3.0, distance.size)
    offset[::3], way[::4] = 0.0, 0.0
    rows = np.arange(distance.size)
    x, y, heading = track.pose_at(distance, offset, rows)
    onward = track.advance(distance, offset, way)
    sample, s = path.sample_index(distance), path.s_at(distance)
    for i, (d, off, w) in enumerate(zip(distance, offset, way, strict=True)):
        place = pose_on_track(tracks, g, 0, d, off)
        np.testing.assert_allclose(place, (x[i], y[i], heading[i]), rtol=1e-12, atol=1e-12)
        assert lane_track.advance_on_lane(tracks, g, d, off, w) == onward[i]
        where = (path.road[sample[i]], path.lane[sample[i]], s[i], path.forward[sample[i]])
        assert lane_track.road_position_on_lane(tracks, g, d) == where
        assert lane_track.needs_next_lane(tracks, g, d) == (d < track.span[0] or d > track.span[1])
    assert tracks.length[g] == track.length


@pytest.mark.parametrize("file", _FILES)
def test_lanes_are_the_same_compiled(file: str) -> None:
    lanes = _tracks_of(RoadNetwork.read(_ROOT / file))
    tracks = track_pool.TrackPool().update([lanes])
    random = np.random.default_rng(1)
    for g in range(0, len(lanes), max(len(lanes) // 12, 1)):
        _check_lane(tracks, g, lanes[g], random)


def test_lanes_inside_of_narrow_bends_are_the_same_compiled(tmp_path: Path) -> None:
    for shape in ('<arc curvature="0.2"/>', _SPIRAL):
        network = rn.network(tmp_path, rn.road("bend", 25.0, shape=shape, left=rn.lane(1), right=rn.lane(-1)))
        lanes = _tracks_of(network)
        tracks = track_pool.TrackPool().update([lanes])
        for g, lane in enumerate(lanes):
            _check_lane(tracks, g, lane, np.random.default_rng(g))


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
    one.copy_rows_from(line(3.0), np.array([False, True]))
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
    assert len(path.arrays) == track_pool.TrackPool().tracks.addresses.shape[1]
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
    at_x, at_y, heading, _ = (float(part[0]) for part in path.pose_at(place, np.zeros(1)))
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
