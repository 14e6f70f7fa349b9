"""Criticality metrics against the oracle, closed forms and searching."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from cornercase._common.errors import InputError
from cornercase._common.geometry.boxes import box_corners, box_distance, boxes_overlap
from cornercase.metrics import (
    METRICS,
    Clearance,
    Distance,
    Pet,
    TrafficQuality,
    TrajectoryDistance,
    Ttc,
    Wttc,
)
from cornercase.metrics._wttc import earliest_circle_contact
from cornercase.recordings import Recording
from helpers.oracle import CASES, WITHOUT_TRACKS, actor, agrees, cases, follows, recorded


@pytest.mark.parametrize("case", cases("distance"))
def test_oracle_distance(case):
    """Centres by the metric; the bounding-box rows are the gap between the boxes."""
    scene = recorded(case["actors"], [0.0])
    metric = Distance() if case["variant"] == "centre" else Clearance()
    agrees(metric.course(scene, "0", "1")[0], case["expected"], case["tol"])


@pytest.mark.parametrize("case", cases("trajectory_distance"))
def test_oracle_trajectory_distance(case):
    follows(lambda t: TrajectoryDistance().course(recorded(case["actors"], t), "0", "1"), case)


@pytest.mark.parametrize("case", cases("TTC"))
def test_oracle_ttc(case):
    """Rows with an acceleration are of constant acceleration; the disc row is WTTC without acceleration."""
    disc = case["variant"].startswith("disc")
    metric = Wttc(0.0, 0.0) if disc else Ttc(accelerating=any(a["a"] for a in case["actors"]))
    follows(lambda t: metric.course(recorded(case["actors"], t), "0", "1"), case)


@pytest.mark.parametrize("case", cases("WTTC"))
def test_oracle_wttc(case):
    """Rows with circles of their own get boxes with half diagonals of that size."""
    actors, params = case["actors"], case["params"]
    metric = Wttc()
    if case["source"].startswith("commonroad"):
        actors = [{**a, "length": params["R"], "width": 0.0} for a in actors]
        metric = Wttc(vehicle_acceleration=params["a_max"])
    elif isinstance(params.get("a_max"), int | float):
        metric = Wttc(vehicle_acceleration=params["a_max"])
    follows(lambda t: metric.course(recorded(actors, t), "0", "1"), case)


@pytest.mark.parametrize("case", cases("PET"))
def test_oracle_pet(case):
    """Rows with the area of the lanes are given it; the others have the area that the boxes sweep."""
    area = None
    if "lane area" in case["variant"] or case["source"].startswith("commonroad"):
        west, south, east, north = case["params"]["conflict_area"]
        area = ((west + east) / 2, (south + north) / 2, 0.0, east - west, north - south)
    course = Pet(area=area).course(recorded(case["actors"], np.arange(0, 20, 0.05)), "0", "1")
    assert (course == course[0]).all() or np.isnan(course).all()
    agrees(course[0], case["expected"], case["tol"])


def with_past(case) -> Recording:
    """The scene of a case at t = 0 and the 2 s before it."""
    time = np.arange(-20, 1) / 10
    scene = recorded([{**a, "a": 0.0} for a in case["actors"]], time)
    window = case["params"]["individual_window"]
    if isinstance(window, list):
        ego = case["params"]["ego_id"] - 1
        scene.speed[ego] = window
        scene.acceleration[ego] = np.append(0.0, np.diff(window) / 0.1)
    return scene


@pytest.mark.parametrize("case", cases("TQ"))
def test_oracle_traffic_quality_and_each_of_its_terms(case):
    scene, ego = with_past(case), str(case["params"]["ego_id"] - 1)
    agrees(TrafficQuality().course(scene, ego, "1")[-1], case["expected"], case["tol"])
    for term in ("macro", "micro", "nano", "individual", "penalty"):
        agrees(TrafficQuality(term).course(scene, ego)[-1], case["params"][term], case["tol"])


def test_no_row_is_left_out_but_those_without_tracks():
    tested = [
        "distance",
        "trajectory_distance",
        "TTC",
        "WTTC",
        "PET",
        "TQ",
        "DCE",
        "TTCE",
        "THW",
        "HW",
        "ET",
        "gap_time",
        "SPrET",
        "PTTC",
        "DRAC",
        "MDRAC",
        "a_long_req",
        "ALongReq",
        "BTN",
        "a_lat_req",
        "ALatReq",
        "STN",
        "DST",
        "TET",
        "TIT",
        "RSS_d_long",
        "RSS_d_lat",
        "RSS_DS",
        "delta_v",
        "conflict_severity",
        "MSD",
    ]
    assert {case["metric"] for case in CASES.values()} == set(tested)
    assert sum(len(cases(name)) for name in tested) == len(CASES) - len(WITHOUT_TRACKS)
    assert all(not CASES[name]["actors"] for name in WITHOUT_TRACKS)


# --- all metrics --------------------------------------------------------------------------------------------

CROSSING = [actor(x=-30, v=10), actor(y=-50, yaw=math.pi / 2, v=10)]


AS_A_WHOLE = {"pet", "encroachment-time"}
SUMS = {"tet", "tit"}
AHEAD = {"stl"}


@pytest.mark.parametrize("name", METRICS.names())
def test_each_metric_says_what_it_is_and_takes_odd_recordings(name):
    metric = METRICS.create(name)
    assert metric.name == name
    assert metric.unit in {"m", "s", "1", "m/s", "m/s²", "s²"}
    assert metric.source
    scene = recorded([*CROSSING, actor(x=5, y=5)], np.arange(0, 8, 0.1))
    gone = replace(scene, **{k: getattr(scene, k).copy() for k in ("x", "y", "heading", "speed", "acceleration")})
    for column in (gone.x, gone.y, gone.heading, gone.speed, gone.acceleration):
        column[0, :10] = column[1, 40:45] = column[2] = np.nan
    for odd in (recorded(CROSSING, [0.0]), recorded([actor(), actor(x=20)], [0.0, 0.1, 0.2]), scene, gone):
        course = metric.course(odd, "0", "1")
        assert course.shape == odd.time.shape
        assert course.dtype == np.float64
        assert np.isfinite(metric.clip_course(course)).all()
        assert math.isfinite(metric.score(course))
    if name not in AS_A_WHOLE | SUMS | AHEAD:
        assert np.isnan(metric.course(gone, "0", "1")[:10]).all()
    alone = metric.course(gone, "0", "2")
    if name in SUMS:
        assert (alone == 0.0).all()
    elif name != "msd" and not name.startswith("traffic-quality"):
        assert np.isnan(alone).all()
    assert metric.score(np.full(3, np.nan)) == metric.cap
    with pytest.raises(InputError, match="no entity 'nobody'"):
        metric.course(scene, "nobody", "1")


def test_the_family_is_known_by_name():
    known = (
        "distance clearance trajectory-distance ttc wttc pet encroachment-time gap-time pttc thw drac btn stn tet tit "
        "dst delta-v rss traffic-quality traffic-quality-macro traffic-quality-micro traffic-quality-nano "
        "traffic-quality-individual traffic-quality-penalty"
    )
    assert set(known.split()) <= set(METRICS.names())


def test_metrics_look_at_box_centres_not_reference_points():
    """Rear axles 34 m apart, centres 34 + 1.4 - 1.0."""
    shifted = replace(recorded([actor(v=20), actor(x=34, v=10)], [0.0]), center_x=np.array([1.0, 1.4]))
    assert Distance().course(shifted, "0", "1")[0] == pytest.approx(34.4)
    assert Ttc().course(shifted, "0", "1")[0] == pytest.approx(3.04)


# --- trajectory distance ------------------------------------------------------------------------------------


def along(points, time, heading=None, length=4.0, width=2.0, speed=None):
    """One track over given points, to be put into a recording."""
    points = np.asarray(points, dtype=float)
    if heading is None:
        step = np.gradient(points, time, axis=0)
        heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    speed = np.hypot(*np.gradient(points, time, axis=0).T) if speed is None else speed
    return points, heading, speed, length, width


def together(time, *tracks) -> Recording:
    points, heading, speed, length, width = zip(*tracks, strict=True)
    n = len(tracks)
    return Recording(
        time=np.asarray(time, dtype=float),
        names=tuple(str(i) for i in range(n)),
        object_types=("car",) * n,
        x=np.array([p[:, 0] for p in points]),
        y=np.array([p[:, 1] for p in points]),
        heading=np.array(heading),
        speed=np.array([np.broadcast_to(s, len(time)) for s in speed], dtype=float),
        acceleration=np.zeros((n, len(time))),
        length=np.array(length),
        width=np.array(width),
        center_x=np.zeros(n),
    )


def test_trajectory_distance_along_a_curve():
    """On a circle of radius 20 m from (0, -20) counter-clockwise, crossing y = 0 at (20, 0) after 10π m.

    The other comes along y = 0 from (50, 0): 30 m.
    """
    time = np.linspace(0, 8, 801)
    angle = -np.pi / 2 + np.pi * time / 8
    circle = 20 * np.stack([np.cos(angle), np.sin(angle)], -1)
    straight = np.stack([50 - 5 * time, 0 * time], -1)
    course = TrajectoryDistance().course(together(time, along(circle, time), along(straight, time)), "0", "1")
    passed = time > 4
    expected = 20 * -angle + 30 - 5 * time
    np.testing.assert_allclose(course[~passed], expected[~passed], atol=1e-3)
    assert np.isnan(course[passed & (time > 4.01)]).all()


def test_trajectory_distance_goes_on_to_the_next_crossing():
    """A zigzag over y = 0 with corners at y = ±3 crosses it at x = 3, 9, 15; half a leg is 3√2 m."""
    time = np.arange(7.0)
    zigzag = np.stack([3 * time, 3 * np.array([-1, 0, 1, 0, -1, 0, 1.0])], -1)
    straight = np.stack([2.5 * time, 0 * time], -1)
    course = TrajectoryDistance(ahead=0).course(together(time, along(zigzag, time), along(straight, time)), "0", "1")
    leg = 3 * math.sqrt(2)
    next_crossing = np.array([1, 1, 3, 3, 5, 5, np.nan])
    np.testing.assert_allclose(course, (next_crossing - time) * leg + 3 * next_crossing - 2.5 * time)


def test_trajectory_distance_reaches_beyond_the_recording_as_far_as_told():
    waiting = recorded([actor(x=-30), actor(y=-40, yaw=math.pi / 2, v=8)], np.arange(0, 2, 0.1))
    course = TrajectoryDistance().course(waiting, "0", "1")
    np.testing.assert_allclose(course, 70 - 8 * waiting.time)
    assert np.isnan(TrajectoryDistance(ahead=20).course(waiting, "0", "1")).all()
    assert np.isnan(TrajectoryDistance(ahead=0).course(waiting, "0", "1")).all()
    with pytest.raises(InputError, match="ahead"):
        TrajectoryDistance(ahead=-1)


@pytest.mark.parametrize("stops", [False, True])
def test_the_track_of_an_entity_that_reverses_goes_on_backwards(stops):
    """Backwards at 5 m/s along y = 0 from x = -30, to the end or to a stop at x = -20; the other drives along x = 0."""
    time = np.arange(0, 4, 0.1)
    moving = np.minimum(time, 2.0)
    back = np.stack([5 * moving - 30, 0 * time], -1)
    speed = np.where(stops & (time > 2.0), 0.0, -5.0)
    up = np.stack([0 * time, 2 * time - 40], -1)
    track = along(back, time, speed=speed)
    reversing = (track[0], np.full(len(time), np.pi), *track[2:])
    course = TrajectoryDistance().course(together(time, reversing, along(up, time)), "0", "1")
    np.testing.assert_allclose(course, 70 - 5 * moving - 2 * time)


def test_a_track_that_joins_another_meets_it_where_it_joins():
    """A quarter circle of radius 10 m onto y = 0 at the origin, then along it, in steps of 8 cm; the other is
    on y = 0.
    """
    time = np.linspace(0, 5, 501)
    way = 8 * time
    angle = np.pi + np.minimum(way / 10, np.pi / 2)
    beyond = np.maximum(way - 5 * np.pi, 0)
    joining = np.stack([10 + 10 * np.cos(angle) - 10 + beyond, 10 + 10 * np.sin(angle)], -1)
    straight = np.stack([-30 + 4 * time, 0 * time], -1)
    course = TrajectoryDistance().course(together(time, along(joining, time), along(straight, time)), "0", "1")
    before = way < 5 * np.pi - 1
    np.testing.assert_allclose(course[before], (5 * np.pi + 30 - way - 4 * time)[before], atol=2 * 0.08)
    assert np.isnan(course[way > 5 * np.pi + 0.2]).all()


# --- time to collision --------------------------------------------------------------------------------------


def test_ttc_passing_beside_and_grazing():
    """Two metres wide each: lateral offsets of 2 m touch, of 2.001 m do not."""
    for offset, expected in ((2.0, 0.8), (2.001, np.inf), (-2.0, 0.8), (-2.001, np.inf)):
        scene = recorded([actor(v=15), actor(x=24, y=offset, yaw=math.pi, v=10)], [0.0])
        assert Ttc().course(scene, "0", "1")[0] == pytest.approx(expected)


def test_ttc_stands_before_an_obstacle_and_reverses_into_one():
    standing = recorded([actor(), actor(x=10, v=0)], [0.0])
    assert Ttc().course(standing, "0", "1")[0] == np.inf
    reversing = recorded([actor(v=-3), actor(x=-10)], [0.0])
    assert Ttc().course(reversing, "0", "1")[0] == pytest.approx(2)


def test_ttc_with_accelerations_against_small_steps():
    """Crossing, both braking, the first to a stop: searched with steps of 1 ms over exact positions."""
    rng = np.random.default_rng(3)
    time = np.arange(0, 12, 1e-3)
    hits = 0
    for _ in range(60):
        yaw, reach = rng.uniform(-3, 3), rng.uniform(10, 40)
        actors = [
            actor(v=rng.uniform(3, 15), a=rng.uniform(-4, 2)),
            actor(x=20 - reach * np.cos(yaw), y=-reach * np.sin(yaw), yaw=yaw, v=reach / 2, a=rng.uniform(-4, 2)),
        ]
        scene = recorded(actors, time)
        boxes = [box_corners(scene.x[i], scene.y[i], scene.heading[i], 4, 2) for i in (0, 1)]
        touch = time[boxes_overlap(*boxes)]
        found = Ttc(accelerating=True).course(recorded(actors, [0.0]), "0", "1")[0]
        if len(touch):
            hits += 1
            assert touch[0] - 1e-3 <= found <= touch[0] + 1e-9
        else:
            assert found > 11.9
    assert 10 < hits < 60


# --- worst time to collision --------------------------------------------------------------------------------


def test_wttc_closed_forms_on_one_line():
    """Circles g apart that close at c: g = c t + a t²/2, so t = (sqrt(c² + 2 a g) - c) / a."""
    radius = 2 * math.sqrt(5)
    for speeds in ((20, 10), (10, 20), (0, 0), (15, 15), (-3, 8)):
        scene = recorded([actor(v=speeds[0]), actor(x=34, v=speeds[1])], [0.0])
        closing, gap, growth = speeds[0] - speeds[1], 34 - radius, 13.8
        expected = (math.sqrt(closing**2 + 2 * growth * gap) - closing) / growth
        assert Wttc().course(scene, "0", "1")[0] == pytest.approx(expected, rel=1e-12)


def test_wttc_limits_by_kind():
    """Both stand: t = sqrt(2 (d - R) / a)."""
    for kinds, growth in (
        (("car", "truck"), 13.8),
        (("car", "bicycle"), 9.4),
        (("Pedestrian", "car"), 9.4),
        (("pedestrian", "bicycle"), 5.0),
        (("misc", "car"), 13.8),
    ):
        scene = recorded([actor(cls=kinds[0]), actor(x=20, cls=kinds[1])], [0.0])
        expected = math.sqrt(2 * (20 - 2 * math.sqrt(5)) / growth)
        assert Wttc().course(scene, "0", "1")[0] == pytest.approx(expected)
    with pytest.raises(InputError, match="not negative"):
        Wttc(vehicle_acceleration=-1)


def test_wttc_that_just_grazes():
    """Without growth, a pass at exactly the distance R touches when level, one a little wider never does."""
    moving = np.array([-10.0, 0.0])
    assert earliest_circle_contact(np.array([20.0, 3.0]), moving, 3.0, 0.0) == pytest.approx(2, abs=1e-6)
    assert earliest_circle_contact(np.array([20.0, 3.0 + 1e-9]), moving, 3.0, 0.0) == np.inf
    assert earliest_circle_contact(np.array([20.0, 3.0 - 1e-9]), moving, 3.0, 0.0) == pytest.approx(2, abs=1e-4)
    assert earliest_circle_contact(np.array([3.0, 0.0]), moving, 3.0, 1.0) == 0


def test_wttc_near_double_roots_finds_the_first_of_them():
    """Passing ever closer to touching: the early root appears next to the late one and is not missed."""

    def gap(t, offset):
        return math.hypot(40 - 20 * t, offset) - 2 - 0.25 * t * t

    def nearest(offset):
        t = np.linspace(1.5, 2.5, 200_001)
        return np.min(np.hypot(40 - 20 * t, offset) - 2 - 0.25 * t * t)

    critical = brentq(nearest, 2.5, 3.5, xtol=1e-13)
    for below in (1e-1, 1e-3, 1e-5, 1e-7, 1e-8):
        offset = critical - below
        found = earliest_circle_contact(np.array([40.0, offset]), np.array([-20.0, 0.0]), 2.0, 0.5)
        assert found < 2.1
        assert gap(float(found), offset) == pytest.approx(0, abs=1e-9)
        assert gap(float(found) - 1e-6, offset) > 0
    missed = earliest_circle_contact(np.array([40.0, critical + 1e-3]), np.array([-20.0, 0.0]), 2.0, 0.5)
    assert missed > 10


def test_wttc_is_the_smallest_root_of_the_quartic():
    rng = np.random.default_rng(11)
    position = rng.normal(size=(2000, 2)) * 10 ** rng.uniform(0, 2.5, (2000, 1))
    velocity = rng.normal(size=(2000, 2)) * 10 ** rng.uniform(-1, 1.5, (2000, 1))
    velocity[::2] = -position[::2] / rng.uniform(0.5, 5, (1000, 1)) + rng.normal(size=(1000, 2))
    radius, growth = rng.uniform(0.5, 8, 2000), 10 ** rng.uniform(-2, 1.3, 2000)
    found = earliest_circle_contact(position, velocity, radius, growth)
    several = 0
    for p, v, r, a, t in zip(position, velocity, radius, growth, found, strict=True):
        if np.hypot(*p) <= r:
            assert t == 0
            continue
        roots = np.roots([a * a / 4, 0, r * a - v @ v, -2 * p @ v, r * r - p @ p])
        positive = np.sort(roots[(np.abs(roots.imag) < 1e-7 * np.abs(roots)) & (roots.real > 0)].real)
        several += len(positive) > 1
        assert t == pytest.approx(positive[0], rel=1e-6)
    assert several > 50


# --- post-encroachment time ---------------------------------------------------------------------------------


@pytest.mark.parametrize("step", [0.01, 0.1, 0.37, 1.0])
def test_pet_does_not_depend_on_the_time_step(step):
    """Ego out at (30 + 1 + 2) / 10 s, other in at (50 - 1 - 2) / 10 s, also between instants 10 m apart."""
    scene = recorded(CROSSING, np.arange(0, 9, step))
    np.testing.assert_allclose(Pet().course(scene, "0", "1"), 1.4, rtol=1e-9)
    np.testing.assert_allclose(Pet().course(scene, "1", "0"), 1.4, rtol=1e-9)


def test_pet_oblique():
    """Crossing under θ, each box's corner enters the other's strip h = (w/2 + w/2 cos θ) / sin θ before the
    centre.

    With half a length in front: t_out = (d + h + L/2) / v, t_in = (d - h - L/2) / v.
    """
    angle = math.radians(60)
    h = (1 + math.cos(angle)) / math.sin(angle)
    start = 90.0
    other = actor(x=-start * math.cos(angle), y=-start * math.sin(angle), yaw=angle, v=10)
    scene = recorded([actor(x=-30, v=10), other], np.arange(0, 14, 0.05))
    expected = (start - h - 2) / 10 - (30 + h + 2) / 10
    np.testing.assert_allclose(Pet().course(scene, "0", "1"), expected, rtol=1e-9)


def test_pet_on_a_curved_track():
    """Ego on a circle of radius r around the origin; the other leaves the origin along +x.

    The ego's inner corners are at the radius C = hypot(r - w/2, L/2), ±φ ahead of and behind the centre, with
    tan φ = (L/2) / (r - w/2). They are the first and the last to touch the other's strip |y| <= h, so the ego
    is in it for |θ| <= asin(h / C) + φ. The other's front corners reach the inner edge r - w/2 of the ego's
    ring with the front at sqrt((r - w/2)² - h²).
    """
    r, length, width, h, omega = 12.0, 4.5, 1.8, 0.4, 0.6
    time = np.arange(0, 8, 0.05)
    angle = -np.pi / 2 + omega * time
    circle = r * np.stack([np.cos(angle), np.sin(angle)], -1)
    inner = r - width / 2
    out = math.asin(h / math.hypot(inner, length / 2)) + math.atan2(length / 2, inner)
    leaves = (out + np.pi / 2) / omega
    straight = np.stack([1.5 * time, 0 * time], -1)
    enters = (math.sqrt(inner**2 - h**2) - 0.3) / 1.5
    time_2 = time[time < 2.9 * np.pi / 2 / omega]
    n = len(time_2)
    scene = together(
        time_2,
        along(circle[:n], time_2, angle[:n] + np.pi / 2, length, width, r * omega),
        along(straight[:n], time_2, 0 * time_2, 0.6, 2 * h, 1.5),
    )
    np.testing.assert_allclose(Pet().course(scene, "0", "1"), enters - leaves, atol=4e-3)


def test_pet_takes_the_smaller_of_two_conflict_areas():
    """Ego goes along y = 0 and returns along y = 20; the other goes up x = 0, later through the second area.

    First area: ego out at (30 + 3) / 10 s, other in at (60 - 3) / 10: 2.4 s. On its way back the ego reaches
    x = 3 after 30 + 30 + 20 + 27 m; the other has left y = 20 after 60 + 20 + 3 m: 10.7 - 8.3 = 2.4 s, from 6
    m behind only 1.8 s.
    """
    time = np.arange(0, 16, 0.05)
    for start, expected in ((-60, 2.4), (-66, 1.8)):
        way = 10 * time
        points = np.where(
            (way < 60)[:, None],
            np.stack([-30 + way, 0 * way], -1),
            np.where(
                (way < 80)[:, None],
                np.stack([30 + 0 * way, way - 60], -1),
                np.stack([110 - way, 20 + 0 * way], -1),
            ),
        )
        heading = np.where(way < 60, 0.0, np.where(way < 80, np.pi / 2, np.pi))
        other = np.stack([0 * time, start + way], -1)
        scene = together(
            time,
            along(points, time, heading, speed=10.0),
            along(other, time, 0 * time + np.pi / 2, speed=10.0),
        )
        np.testing.assert_allclose(Pet().course(scene, "0", "1"), expected, atol=1e-6)


def test_pet_when_both_are_in_the_area_at_once():
    """Windows 2.7 .. 3.3 s and 2.8 .. 3.4 s: undefined; signed, the second comes 0.5 s too early."""
    clash = recorded([CROSSING[0], actor(y=-31, yaw=math.pi / 2, v=10)], np.arange(0, 8, 0.05))
    assert np.isnan(Pet().course(clash, "0", "1")).all()
    assert Pet().score(Pet().course(clash, "0", "1")) == Pet.cap
    np.testing.assert_allclose(Pet(signed=True).course(clash, "0", "1"), -0.5)
    clear = recorded(CROSSING, np.arange(0, 8, 0.05))
    np.testing.assert_allclose(Pet(signed=True).course(clear, "0", "1"), 1.4)


def test_pet_of_one_who_waits_and_one_who_stays():
    """The second waits before the area for 10 s; one that stands in the area has not left it."""
    time = np.arange(0, 20, 0.05)
    driven = np.minimum(10 * time, 45) + np.maximum(time - 14.5, 0) * 10
    waits = np.stack([0 * time, -50 + driven], -1)
    crosses = np.stack([-30 + 10 * time, 0 * time], -1)
    moves = (time < 4.5) | (time >= 14.5)
    scene = together(
        time,
        along(crosses, time, 0 * time, speed=10.0),
        along(waits, time, 0 * time + np.pi / 2, speed=10.0 * moves),
    )
    np.testing.assert_allclose(Pet().course(scene, "0", "1"), 14.7 - 3.3, atol=1e-6)
    parked = recorded([CROSSING[0], actor(y=0.5)], time)
    assert np.isnan(Pet().course(parked, "0", "1")).all()
    assert np.isnan(Pet().course(recorded([actor(v=10), actor(x=8, v=10)], time), "0", "1")).all()


def test_pet_refuses_an_area_that_is_none():
    with pytest.raises(InputError, match="x, y, heading"):
        Pet(area=(0, 0, 0, 4, 0))


# --- traffic quality ----------------------------------------------------------------------------------------


def test_traffic_quality_of_five_written_out():
    """Ego at 10 m/s, radius 3.6² + 4 + 10 = 26.96 m: neighbours at 15, 20 and 26 m, one at 80 m."""
    actors = [
        actor(v=10),
        actor(x=15, v=8),
        actor(x=-20, v=0),
        actor(y=26, v=-6, yaw=1.0),
        actor(x=80, v=14),
    ]
    scene = recorded(actors, [0.0])
    speeds = np.array([10, 8, 0, 6, 14.0])
    near = speeds[1:4]
    expected = {
        "macro": speeds.std() / speeds.mean(),
        "micro": 3 / 5,
        "nano": near.std() / near.mean(),
        "individual": 0.5 * 10 / 13.89,
        "penalty": math.exp(-11 / 5),
    }
    found = {term: METRICS.create("traffic-quality", term=term).course(scene, "0", "1")[0] for term in expected}
    assert found == pytest.approx(expected)
    whole = expected.pop("penalty") * math.sqrt(sum(value**2 for value in expected.values()))
    assert TrafficQuality().course(scene, "0", "3")[0] == pytest.approx(whole)
    with pytest.raises(InputError, match="did you mean 'macro'"):
        TrafficQuality("marco")  # type: ignore[arg-type]


@pytest.mark.parametrize("step", [0.04, 0.1, 0.25, 1.0])
def test_traffic_quality_looks_back_two_seconds_at_any_time_step(step):
    """Speed 1 + t and acceleration 0.3 t have their means over [t - 2, t] in its middle, t - 1."""
    time = np.arange(0, 8 + step / 2, step)
    scene = recorded([actor(), actor(x=200)], time)
    scene.speed[0], scene.acceleration[0] = 1 + time, 0.3 * time
    found = TrafficQuality("individual").course(scene, "0")
    middle = np.where(time < 2, time / 2, time - 1)
    np.testing.assert_allclose(found, 0.5 * (0.3 * middle / 1.5 + (1 + middle) / 13.89))


def test_traffic_quality_sees_only_what_exists():
    """The third entity exists in the first half only, and makes all the difference there."""
    time = np.arange(0, 4, 0.5)
    two, three = [actor(v=10), actor(x=20, v=5)], [actor(v=10), actor(x=20, v=5), actor(x=8, y=3, v=1)]
    scene = recorded(three, time)
    for column in (scene.x, scene.y, scene.heading, scene.speed, scene.acceleration):
        column[2, 4:] = np.nan
    for term in ("all", "macro", "micro", "nano", "penalty"):
        metric = TrafficQuality(term)
        found = metric.course(scene, "0")
        np.testing.assert_allclose(found[4:], metric.course(recorded(two, time), "0")[4:])
        np.testing.assert_allclose(found[:4], metric.course(recorded(three, time), "0")[:4])
    assert TrafficQuality().course(recorded([actor(v=10)], [0.0]), "0")[0] == 0


def test_traffic_quality_penalty_is_of_the_nearest_pair_of_the_scene():
    rng = np.random.default_rng(5)
    actors = [actor(x=x, y=y, yaw=yaw, v=3) for x, y, yaw in rng.uniform(-40, 40, (7, 3))]
    scene = recorded(actors, np.arange(0, 5, 0.5))
    corners = [box_corners(scene.x[i], scene.y[i], scene.heading[i], 4, 2) for i in range(7)]
    gaps = [box_distance(corners[i], corners[j]) for i in range(7) for j in range(i)]
    np.testing.assert_allclose(TrafficQuality("penalty").course(scene, "3"), np.exp(-np.min(gaps, 0) / 5))
