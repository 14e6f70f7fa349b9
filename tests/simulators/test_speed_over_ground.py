"""How far a step along a lane leads over ground."""

from __future__ import annotations

import numpy as np
import pytest

from cornercase.simulators.builtin.tracks._lane import LaneTrack
from helpers.road_networks import WIDTH, lane, network, road

WAY = 0.5
SECTION = '<laneSection s="0"><right>{}</right></laneSection>'


def track(folder, *parts: str) -> LaneTrack:
    path = network(folder, *parts).lane_path_from(0, -1, 0.0, True)
    assert path is not None
    return LaneTrack(path)


def driven(lane_track: LaneTrack, offset: float = 0.0):
    """Way over ground of steps from all along a track, to the left of it, in m."""
    distance = np.arange(0.0, lane_track.length - WAY, 0.25)
    aside = np.full(len(distance), offset)
    after = lane_track.advance(distance, aside, np.full(len(distance), WAY))
    share = np.linspace(0.0, 1.0, 51)
    places = (distance[:, None] + (after - distance)[:, None] * share).ravel()
    x, y, _ = lane_track.pose_at(places, np.full(len(places), offset), np.zeros(len(places), dtype=np.int64))
    x, y = x.reshape(-1, 51), y.reshape(-1, 51)
    return np.hypot(np.diff(x), np.diff(y)).sum(axis=1)


@pytest.mark.parametrize("offset", [0.0, 1.0])
@pytest.mark.parametrize(
    ("shape", "offsets"),
    [
        # Aslant to the reference line by up to 45 degrees.
        ("<line/>", '<laneOffset s="0" a="0" b="0.1" c="0" d="0"/>'),
        ("<line/>", '<laneOffset s="0" a="0" b="1" c="0" d="0"/>'),
        ("<line/>", '<laneOffset s="20" a="0" b="0" c="0.01" d="-0.0001"/>'),
        # A bend that comes within a few metres.
        ('<spiral curvStart="0" curvEnd="0.12"/>', ""),
        ('<spiral curvStart="0.12" curvEnd="-0.12"/>', '<laneOffset s="0" a="0" b="0.05" c="0" d="0"/>'),
    ],
)
def test_43_a_step_is_as_long_over_ground_as_asked_for(tmp_path, shape, offsets, offset):
    sections = offsets + SECTION.format(lane(-1))
    ways = driven(track(tmp_path, road("1", 60.0, shape=shape, sections=sections)), offset)
    np.testing.assert_allclose(ways, WAY, rtol=1.01e-3)


@pytest.mark.parametrize("offset", [-1.5, 0.7, 1.5])
def test_43_beside_a_corner_steps_are_as_long_as_asked_for(tmp_path, offset):
    corner = '<laneOffset s="0" a="0" b="0" c="0" d="0"/><laneOffset s="30" a="0" b="0.5" c="0" d="0"/>'
    lane_track = track(tmp_path, road("1", 60.0, sections=corner + SECTION.format(lane(-1))))
    np.testing.assert_allclose(driven(lane_track, offset), WAY, rtol=1.5e-2)


def test_43_a_jump_aside_takes_no_time(tmp_path):
    narrow = WIDTH.replace('sOffset="0" a="4"', 'sOffset="30" a="2"')
    lane_track = track(tmp_path, road("1", 60.0, sections=SECTION.format(lane(-1, inside=WIDTH + narrow))))
    path = lane_track.path
    # The lane jumps by 1 m to the left, and the entity gets on along the road as if it did not.
    start = np.interp([29.8], path.reference_distance, path.distance)
    after = lane_track.advance(start, np.zeros(1), np.full(1, WAY))
    assert np.interp(after, path.distance, path.reference_distance) == pytest.approx([30.3], abs=1e-6)
