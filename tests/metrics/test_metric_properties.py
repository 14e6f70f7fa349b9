"""Properties that hold for every scene."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import examples
from cornercase._common.geometry.boxes import box_corners, box_distance
from cornercase.metrics import METRICS, Distance, Pet, TrafficQuality, TrajectoryDistance, Ttc, Wttc
from cornercase.recordings import Recording
from helpers.random_scenes import TIME, quick, same, scenes

PAIRWISE = (Distance(), TrajectoryDistance(), Ttc(), Ttc(accelerating=True), Wttc(), Pet(), Pet(signed=True))


@quick
@given(scenes, st.floats(-3, 3), st.floats(-500, 500), st.floats(-500, 500))
def test_turning_and_moving_the_whole_scene_changes_nothing(scene, angle, east, north):
    cos, sin = math.cos(angle), math.sin(angle)
    moved = replace(
        scene,
        x=cos * scene.x - sin * scene.y + east,
        y=sin * scene.x + cos * scene.y + north,
        heading=scene.heading + angle,
    )
    for metric in (Distance(), Ttc(), Wttc(), TrafficQuality()):
        same(metric.course(moved, "0", "1"), metric.course(scene, "0", "1"))
    same(Pet(signed=True).course(moved, "0", "1"), Pet(signed=True).course(scene, "0", "1"), 1e-6)
    same(TrajectoryDistance().course(moved, "0", "1"), TrajectoryDistance().course(scene, "0", "1"), 1e-6)


@quick
@given(scenes)
def test_the_order_of_the_two_does_not_matter(scene):
    for metric in PAIRWISE:
        same(metric.course(scene, "0", "1"), metric.course(scene, "1", "0"))


@quick
@given(scenes)
def test_the_order_in_the_recording_does_not_matter(scene):
    n = len(scene.names)
    columns = ("x", "y", "heading", "speed", "acceleration", "length", "width", "center_x")
    turned = replace(
        scene,
        names=scene.names[::-1],
        object_types=scene.object_types[::-1],
        **{k: getattr(scene, k)[::-1].copy() for k in columns},
    )
    assert turned.entity_index("0") == n - 1
    for metric in (
        *PAIRWISE,
        TrafficQuality("all"),
        TrafficQuality("macro"),
        TrafficQuality("micro"),
        TrafficQuality("nano"),
        TrafficQuality("individual"),
        TrafficQuality("penalty"),
    ):
        same(metric.course(turned, "0", "1"), metric.course(scene, "0", "1"), 1e-9)


@quick
@given(scenes, st.integers(-2, 2), st.integers(0, len(TIME) - 1))
def test_whole_turns_of_a_heading_mean_nothing(scene, turns, since):
    heading = scene.heading.copy()
    heading[0, since:] += turns * 2 * math.pi
    for metric in (*PAIRWISE, TrafficQuality()):
        same(metric.course(replace(scene, heading=heading), "0", "1"), metric.course(scene, "0", "1"))


@quick
@given(scenes)
def test_values_are_finite_after_the_cap_and_never_negative(scene):
    for name in METRICS.names():
        metric = METRICS.create(name)
        course = metric.course(scene, "0", "1")
        assert course.shape == TIME.shape
        known = course[~np.isnan(course)]
        assert name == "rss" or (known <= 0 if name == "a-long-req" else known >= 0).all()
        held = metric.clip_course(course)
        assert np.isfinite(held).all()
        assert metric.score(course) == (held.min() if metric.lower_is_critical else held.max())


@quick
@given(scenes)
def test_worst_time_to_collision_is_the_shorter_one_and_zero_where_circles_touch(scene):
    worst, plain = Wttc().course(scene, "0", "1"), Ttc().course(scene, "0", "1")
    assert np.isfinite(worst).all()
    assert (worst <= plain * (1 + 1e-9) + 1e-9).all()
    assert (Wttc(9, 4).course(scene, "0", "1") <= worst * (1 + 1e-9)).all()
    reach = 0.5 * np.hypot(scene.length[:2], scene.width[:2]).sum()
    centre = Distance().course(scene, "0", "1")
    touch = centre <= reach
    assert (worst[touch] == 0).all()
    assert (worst[~touch] > 0).all()


@quick
@given(scenes)
def test_ttc_is_zero_at_contact_and_takes_at_least_the_gap_over_the_relative_speed(scene):
    boxes = [
        box_corners(x, y, scene.heading[i], scene.length[i], scene.width[i])
        for i, (x, y) in enumerate(scene.box_center(name).T for name in scene.names)
    ]
    gap, ttc = box_distance(boxes[0], boxes[1]), Ttc().course(scene, "0", "1")
    forward = scene.speed[:2, :, None] * np.stack([np.cos(scene.heading[:2]), np.sin(scene.heading[:2])], -1)
    relative = np.linalg.norm(forward[1] - forward[0], axis=-1)
    assert (ttc[gap == 0] == 0).all()
    apart = gap > 1e-6
    assert (ttc[apart] > 0).all()
    moving = apart & (relative > 0)
    assert (ttc[moving] * relative[moving] >= gap[moving] * (1 - 1e-9)).all()
    assert (ttc[apart & (relative == 0)] == np.inf).all()


@quick
@given(scenes)
def test_acceleration_of_zero_is_constant_speed(scene):
    steady = replace(scene, acceleration=0 * scene.acceleration)
    same(Ttc(accelerating=True).course(steady, "0", "1"), Ttc().course(scene, "0", "1"))


@quick
@given(scenes)
def test_trajectory_distance_falls_by_the_ways_driven_and_ends_when_one_has_passed(scene):
    course = TrajectoryDistance().course(scene, "0", "1")
    known = ~np.isnan(course)
    assert (course[known] >= Distance().course(scene, "0", "1")[known] - 1e-5).all()
    driven = sum(np.linalg.norm(np.diff(scene.box_center(name), axis=0), axis=-1) for name in ("0", "1"))
    left = np.diff(course)
    together = ~np.isnan(left)
    # Passing one of several crossings makes the value jump up to the next, never further down.
    assert (left[together] >= -driven[together] - 1e-5).all()
    assert known[: known.sum()].all()


@settings(deadline=None, max_examples=examples(30))
@given(
    st.floats(0.3, 2.8),
    st.floats(25, 60),
    st.floats(25, 60),
    st.floats(4, 14),
    st.floats(4, 14),
    st.sampled_from([0.5, 2, 4.5]),
    st.sampled_from([0.6, 1.9]),
)
def test_pet_of_straight_tracks_is_that_of_the_swept_parallelogram(angle, d1, d2, v1, v2, length, width):
    """Along the strip's normal a box of half sizes l and h reaches l sin θ + h |cos θ| and moves at v sin θ.

    So it touches the other's strip of half width h_other while its centre is at most
    (h_other + l sin θ + h |cos θ|) / sin θ from the crossing.
    """
    time = np.arange(0, 30, 0.1)
    sin, cos = math.sin(angle), abs(math.cos(angle))
    other = (length, width)
    sizes = ((4.0, 2.0), other)
    reach = [(0.5 * sizes[1 - i][1] + 0.5 * sizes[i][0] * sin + 0.5 * sizes[i][1] * cos) / sin for i in (0, 1)]
    windows = [((d - r) / v, (d + r) / v) for d, r, v in zip((d1, d2), reach, (v1, v2), strict=True)]
    rows = []
    for d, v, heading in ((d1, v1, 0.0), (d2, v2, angle)):
        way = v * time - d
        rows.append((way * math.cos(heading), way * math.sin(heading), 0 * time + heading, 0 * time + v, 0 * time))
    x, y, headings, speed, acceleration = (np.array(column) for column in zip(*rows, strict=True))
    scene = Recording(
        time=time,
        names=("0", "1"),
        object_types=("car", "car"),
        x=x,
        y=y,
        heading=headings,
        speed=speed,
        acceleration=acceleration,
        length=np.array([s[0] for s in sizes]),
        width=np.array([s[1] for s in sizes]),
        center_x=np.zeros(2),
    )
    first, second = sorted(windows)
    gap = max(windows[0][0] - windows[1][1], windows[1][0] - windows[0][1])
    found = Pet().course(scene, "0", "1")[0]
    if gap > 1e-6:
        assert gap == pytest.approx(second[0] - first[1])
        assert found == pytest.approx(gap, rel=1e-6, abs=1e-6)
    elif gap < -1e-6:
        assert math.isnan(found)
        assert Pet(signed=True).course(scene, "0", "1")[0] == pytest.approx(gap, rel=1e-6)


@quick
@given(scenes)
def test_traffic_quality_terms_keep_their_bounds(scene):
    n = len(scene.names)
    macro, micro, nano, own, penalty = (
        TrafficQuality(term).course(scene, "0") for term in ("macro", "micro", "nano", "individual", "penalty")
    )
    assert (macro <= math.sqrt(n - 1) + 1e-9).all()
    assert (nano <= math.sqrt(max(n - 2, 0)) + 1e-9).all()
    assert ((micro >= 0) & (micro <= (n - 1) / n)).all()
    assert ((penalty > 0) & (penalty <= 1)).all()
    same(TrafficQuality().course(scene, "0"), penalty * np.sqrt(macro**2 + micro**2 + nano**2 + own**2))
