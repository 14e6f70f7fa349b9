"""Following, braking, steering, encounters, exposure, severity and safe distances: oracle and closed forms."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from cornercase._common.errors import InputError
from cornercase._common.geometry.boxes import box_corners, box_distance
from cornercase.metrics import (
    METRICS,
    Btn,
    Clearance,
    ConflictSeverity,
    Dce,
    DeltaV,
    Drac,
    Dst,
    EncroachmentTime,
    GapTime,
    Headway,
    LateralAcceleration,
    LongitudinalAcceleration,
    Mdrac,
    Pet,
    Pttc,
    Rss,
    Spret,
    Stn,
    StoppingDistance,
    Tet,
    Thw,
    Tit,
    Ttc,
    Ttce,
)
from cornercase.metrics._rss import min_lateral_gap, min_longitudinal_gap, min_oncoming_gap
from helpers.oracle import actor, agrees, cases, follows, recorded
from helpers.random_scenes import TIME, quick, same, scenes

EXACT = 1e-6


def now(metric, *actors) -> float:
    """Value for two boxes at t = 0, on turned axes, so that nothing leans on +x."""
    turn = 0.7
    cos, sin = math.cos(turn), math.sin(turn)
    turned = [
        {**a, "x": cos * a["x"] - sin * a["y"], "y": sin * a["x"] + cos * a["y"], "yaw": a["yaw"] + turn}
        for a in actors
    ]
    return float(metric.course(recorded(turned, [0.0]), "0", "1")[0])


def close(found, expected) -> None:
    if math.isnan(expected):
        assert math.isnan(found)
    else:
        assert found == pytest.approx(expected, rel=EXACT, abs=1e-9)


FOLLOWER = actor(v=20)
LEADER = actor(x=34, v=10)
BESIDE = actor(x=34, y=2.5, v=10)
BEHIND = actor(x=-34, v=30)
TOUCHING = actor(x=3.9, v=10)
ONCOMING = actor(x=34, yaw=math.pi, v=10)
STANDING = actor(x=34)
# Closed form of the first contact with a box of 4 m x 2 m that stands at 45 degrees on the ego's line: its
# nearest corner lies (2 + 1) / sqrt(2) before its centre and off the middle by less than the ego's half width.
OBLIQUE = actor(x=30, yaw=math.pi / 4)


# --- oracle -------------------------------------------------------------------------------------------------


def options(case, **names):
    return {ours: case["params"][theirs] for ours, theirs in names.items() if theirs in case["params"]}


@pytest.mark.parametrize("case", [*cases("DCE"), *cases("TTCE")])
def test_oracle_closest_encounter(case):
    centers = case["variant"].startswith("centre")
    scene = recorded(case["actors"], [0.0])
    when = Ttce(centers).course(scene, "0", "1")[0]
    if case["metric"] == "TTCE":
        agrees(when, case["expected"], case["tol"])
        return
    agrees(Dce(centers).course(scene, "0", "1")[0], case["expected"], case["tol"])
    if "time_of_closest_encounter" in case["params"]:
        agrees(when, case["params"]["time_of_closest_encounter"], case["tol"])


@pytest.mark.parametrize("case", [*cases("THW"), *cases("HW")])
def test_oracle_headway(case):
    metric = Headway() if case["metric"] == "HW" else Thw(accelerating="accelerating" in case["variant"])
    follows(lambda t: metric.course(recorded(case["actors"], t), "0", "1"), case)


@pytest.mark.parametrize("case", cases("ET"))
def test_oracle_encroachment_time(case):
    area = None
    if "lane area" in case["variant"] or case["source"].startswith("commonroad"):
        west, south, east, north = case["params"]["conflict_area"]
        area = ((west + east) / 2, (south + north) / 2, 0.0, east - west, north - south)
    course = EncroachmentTime(area=area).course(recorded(case["actors"], np.arange(0, 20, 0.05)), "0", "1")
    agrees(course[0], case["expected"], case["tol"])


@pytest.mark.parametrize("case", [*cases("gap_time"), *cases("SPrET")])
def test_oracle_gap_time(case):
    metric = GapTime() if case["metric"] == "gap_time" else Spret()
    follows(lambda t: metric.course(recorded(case["actors"], t), "0", "1"), case)


@pytest.mark.parametrize("case", cases("PTTC"))
def test_oracle_pttc(case):
    follows(lambda t: Pttc().course(recorded(case["actors"], t), "0", "1"), case)


@pytest.mark.parametrize(
    "case", [c for name in ("DRAC", "MDRAC", "DST", "a_long_req", "ALongReq", "BTN", "MSD") for c in cases(name)]
)
def test_oracle_deceleration(case):
    metric = {
        "DRAC": lambda: Drac(),
        "MDRAC": lambda: Mdrac(**options(case, reaction_time="reaction_time")),
        "DST": lambda: Dst(**options(case, safety_time="t_s")),
        "a_long_req": LongitudinalAcceleration,
        "ALongReq": LongitudinalAcceleration,
        "BTN": lambda: Btn(**options(case, deceleration="a_max")),
        "MSD": lambda: StoppingDistance(**options(case, deceleration="a_max")),
    }[case["metric"]]()
    follows(lambda t: metric.course(recorded(case["actors"], t), "0", "1"), case)


@pytest.mark.parametrize("case", [*cases("a_lat_req"), *cases("ALatReq"), *cases("STN")])
def test_oracle_lateral(case):
    metric = Stn(**options(case, acceleration="a_lat_max")) if case["metric"] == "STN" else LateralAcceleration()
    follows(lambda t: metric.course(recorded(case["actors"], t), "0", "1"), case)


@pytest.mark.parametrize("case", [*cases("TET"), *cases("TIT")])
def test_oracle_exposure(case):
    """Rows that are sampled, and those of a library that samples, take the rule of samples."""
    begin, end = case["params"]["interval"]
    sampled = "sampled" in case["variant"] or case["source"].startswith("commonroad")
    metric = {"TET": Tet, "TIT": Tit}[case["metric"]](case["params"]["tau"], "samples" if sampled else "linear")
    scene = recorded(case["actors"], np.linspace(begin, end, round((end - begin) / 0.1) + 1))
    agrees(metric.score(metric.course(scene, "0", "1")), case["expected"], case["tol"])


RSS = {
    "response_time": "rho",
    "acceleration": "a_accel_max",
    "min_braking": "b_min",
    "max_braking": "b_max",
    "correct_braking": "b_min_correct",
    "lateral_acceleration": "a_lat_max",
    "lateral_braking": "b_lat_min",
    "lateral_margin": "mu",
}


@pytest.mark.parametrize("case", [*cases("RSS_d_long"), *cases("RSS_d_lat"), *cases("RSS_DS")])
def test_oracle_rss(case):
    """The minima by themselves; the surplus is what the gap exceeds them by, and below 0 it is dangerous."""
    scene, given_ = recorded(case["actors"], [0.0]), options(case, **RSS)
    if case["metric"] == "RSS_DS":
        agrees(float(Rss(**given_).course(scene, "0", "1")[0] < 0.0), case["expected"], 0.0)
        return
    lateral = case["metric"] == "RSS_d_lat"
    axis, size = (scene.y, 2.0) if lateral else (scene.x, 4.0)
    surplus = Rss(**given_, term="lateral" if lateral else "longitudinal").course(scene, "0", "1")[0]
    agrees(abs(axis[1, 0] - axis[0, 0]) - size - surplus, case["expected"], case["tol"])


@pytest.mark.parametrize("case", [*cases("delta_v"), *cases("conflict_severity")])
def test_oracle_severity(case):
    masses = {str(i): float(a["mass"]) for i, a in enumerate(case["actors"])}
    severity = case["metric"] == "conflict_severity"
    metric = ConflictSeverity(case["params"]["a_evasive"], masses) if severity else DeltaV(masses)
    follows(lambda t: metric.course(recorded(case["actors"], t), "0", "1"), case)


# --- following ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("other", "gap"),
    [
        (LEADER, 30.0),
        (ONCOMING, 30.0),
        (TOUCHING, 0.0),
        (BESIDE, math.nan),
        (BEHIND, math.nan),
        (OBLIQUE, 30.0 - 3.0 / math.sqrt(2.0) - 2.0),
        (actor(x=34, y=1.999), 30.0),
    ],
)
def test_headway_is_the_way_until_the_boxes_touch(other, gap):
    close(now(Headway(), FOLLOWER, other), gap)
    close(now(Thw(), FOLLOWER, other), gap / 20.0)
    close(now(Headway(), actor(), other), gap)


def test_headway_of_one_who_reverses_is_behind_it():
    close(now(Headway(), actor(v=-5), actor(x=-34)), 30.0)
    close(now(Thw(), actor(v=-5), actor(x=-34)), 6.0)
    close(now(Headway(), actor(v=-5), actor(x=34)), math.nan)


def test_time_headway_with_and_without_acceleration():
    """gap = v t + a t²/2; an ego that brakes at 5 m/s² from 20 m/s stands after 40 m, at 7 m/s² after 28.6 m."""
    close(now(Thw(), actor(), LEADER), math.inf)
    close(now(Thw(accelerating=True), actor(v=20, a=-5), LEADER), (20 - math.sqrt(400 - 300)) / 5)
    close(now(Thw(accelerating=True), actor(v=20, a=-7), LEADER), math.inf)
    close(now(Thw(accelerating=True), actor(a=2), LEADER), math.sqrt(30.0))


def test_pttc_closed_forms():
    """A leader that brakes from 10 m/s at 5 m/s² stands after 2 s and 10 m; an oncoming one closes faster."""
    close(now(Pttc(), actor(v=20), actor(x=34, v=10, a=-5)), 2.0 * 30 / (10 + math.sqrt(100 + 300)))
    close(now(Pttc(), actor(v=12), actor(x=34, v=10, a=-5)), (30 + 10) / 12)
    close(now(Pttc(), actor(v=10), actor(x=34, v=10)), math.inf)
    close(now(Pttc(), actor(v=10), STANDING), 3.0)
    close(now(Pttc(), actor(v=10), actor(x=34, a=-4)), 3.0)
    close(now(Pttc(), actor(), actor(x=34, v=10, a=-5)), math.inf)
    close(now(Pttc(), FOLLOWER, ONCOMING), 1.0)
    # An oncoming one that brakes at 10 m/s² stands after 5 m, when the ego has done 20 of the 25 that are left.
    close(now(Pttc(), FOLLOWER, actor(x=34, yaw=math.pi, v=10, a=-10)), 1.25)
    close(now(Pttc(), FOLLOWER, TOUCHING), 0.0)


# --- braking and steering -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("other", "closing"), [(LEADER, 10.0), (STANDING, 20.0), (ONCOMING, 30.0), (actor(x=34, v=25), 0.0)]
)
def test_decelerations_of_a_gap_of_30_m(other, closing):
    """Δv² / 60; with 1 s of reaction Δv² / (2 (30 - Δv)); with a safety time of 1 s Δv² / (2 (30 - v_other))."""
    leader = 20.0 - closing
    close(now(Drac(), FOLLOWER, other), closing**2 / 60.0)
    close(now(Mdrac(), FOLLOWER, other), closing**2 / (2 * (30 - closing)) if closing < 30 else math.inf)
    close(now(Dst(0.0), FOLLOWER, other), closing**2 / 60.0)
    if closing:
        close(now(Dst(1.0), FOLLOWER, other), closing**2 / (2 * (30 - leader)))
        close(now(LongitudinalAcceleration(), FOLLOWER, other), -(closing**2) / 60.0)
        close(now(Btn(5.0), FOLLOWER, other), closing**2 / 300.0)
    else:
        assert now(Dst(), FOLLOWER, other) == now(LongitudinalAcceleration(), FOLLOWER, other) == 0.0
        assert now(Btn(), FOLLOWER, other) == 0.0


@pytest.mark.parametrize("name", ["drac", "mdrac", "dst", "a-long-req", "btn", "a-lat-req", "stn"])
def test_at_contact_no_braking_or_steering_is_enough_and_beside_none_is_asked_for(name):
    metric: Any = METRICS.create(name)
    assert abs(now(metric, FOLLOWER, TOUCHING)) == math.inf
    assert now(metric, FOLLOWER, actor(x=3.9, v=20)) == 0.0
    assert math.isnan(now(metric, FOLLOWER, BESIDE))
    assert math.isnan(now(metric, FOLLOWER, BEHIND))
    course = metric.course(recorded([FOLLOWER, TOUCHING], [0.0]), "0", "1")
    assert metric.clip_course(course)[0] == metric.bound == metric.score(course)


def test_deceleration_to_safety_time_is_infinite_where_the_time_gap_is_gone():
    assert now(Dst(3.0), FOLLOWER, LEADER) == math.inf
    close(now(Dst(2.9), FOLLOWER, LEADER), 100.0 / (2 * (30 - 29)))


@quick
@given(
    gap=st.floats(1, 80),
    ego=st.floats(0, 40),
    leader=st.floats(0, 40),
    rate=st.sampled_from([-9.0, -4.0, -1.0, 0.0, 1.0]),
)
def test_required_braking_just_avoids_the_contact(gap, ego, leader, rate):
    """Driven out in small steps: with the value the smallest gap is 0, with less the boxes meet."""
    needed = now(LongitudinalAcceleration(), actor(v=ego), actor(x=gap + 4, v=leader, a=rate))
    times = np.linspace(0, 300, 300_001)

    def smallest(braking):
        stop_ego = ego / braking if braking > 0 else np.inf
        stop_leader = -leader / rate if rate < 0 else np.inf
        t_e, t_l = np.minimum(times, stop_ego), np.minimum(times, stop_leader)
        return (gap + leader * t_l + rate * t_l**2 / 2 - ego * t_e + braking * t_e**2 / 2).min()

    assert smallest(-needed) > -0.02
    if needed < -0.05:
        assert smallest(-needed * 0.9) < 0.0


def test_lateral_acceleration_closed_forms():
    """Half the widths are 2 m; gap 30 m at 10 m/s takes 3 s, and a drift of 0.2 m/s is 0.6 m by then."""
    close(now(LateralAcceleration(), FOLLOWER, LEADER), 2 * 2 / 9)
    close(now(LateralAcceleration(), FOLLOWER, actor(x=34, y=-1.5, v=10)), 2 * 0.5 / 9)
    drifting = actor(x=34, y=1.0, yaw=math.atan2(0.2, 10), v=math.hypot(0.2, 10), length=0.0, width=0.0)
    close(now(LateralAcceleration(), actor(v=20, length=8), drifting), 2 * (2 / 2 - 1.0 - 0.6 + 1.2) / 9)
    close(now(LateralAcceleration(), FOLLOWER, actor(x=34, v=30)), 0.0)
    close(now(Stn(4.0), FOLLOWER, LEADER), 1 / 9)
    # A box across the way is as wide as it is long.
    close(now(LateralAcceleration(), FOLLOWER, actor(x=33, yaw=math.pi / 2)), 2 * 3 / 1.5**2)


def test_stopping_distance_closed_forms():
    close(now(StoppingDistance(), FOLLOWER, BEHIND), 25.0)
    close(now(StoppingDistance(4.0), actor(v=-4), BEHIND), 2.0)
    close(now(StoppingDistance(), actor(), BEHIND), 0.0)


# --- encounters ---------------------------------------------------------------------------------------------


def test_closest_encounter_closed_forms():
    """Beside each other 3 m apart in y the gap is 1 m from when the fronts meet, (34 - 4) / 20 s on."""
    passing = actor(x=34, y=3, yaw=math.pi, v=10)
    close(now(Dce(), actor(v=10), passing), 1.0)
    close(now(Ttce(), actor(v=10), passing), 1.5)
    close(now(Dce(centers=True), actor(v=10), passing), 3.0)
    close(now(Ttce(centers=True), actor(v=10), passing), 1.7)
    close(now(Dce(), LEADER, BEHIND), 0.0)
    close(now(Ttce(), FOLLOWER, LEADER), 3.0)
    close(now(Dce(), actor(v=10), actor(x=34, v=20)), 30.0)
    close(now(Ttce(), actor(v=10), actor(x=34, v=20)), 0.0)
    close(now(Dce(), actor(), actor(x=7, y=6)), 5.0)
    close(now(Dce(), actor(v=3), actor(x=1, v=8)), 0.0)
    # Exactly grazing: the sides slide along each other.
    close(now(Dce(), actor(v=10), actor(x=34, y=2, yaw=math.pi, v=10)), 0.0)


@quick
@given(scenes)
def test_closest_encounter_is_the_smallest_gap_on_the_way(scene):
    gaps, times = Dce().course(scene, "0", "1"), Ttce().course(scene, "0", "1")
    same(np.isfinite(Ttc().course(scene, "0", "1")), gaps == 0.0)
    for t in (0, 11):
        centers = [scene.box_center(name)[t] for name in ("0", "1")]
        heading, speed = scene.heading[:, t], scene.speed[:, t]
        way = np.stack([speed * np.cos(heading), speed * np.sin(heading)], -1)

        def gap(time, centers=centers, way=way, heading=heading):
            places = [centers[k] + time * way[k] for k in (0, 1)]
            a, b = (box_corners(x, y, heading[k], scene.length[k], scene.width[k]) for k, (x, y) in enumerate(places))
            return float(box_distance(a, b))

        found = minimize_scalar(gap, bounds=(0, 60), method="bounded", options={"xatol": 1e-9}).fun
        assert gaps[t] <= min(found, gap(0)) + 1e-6
        assert gap(times[t]) == pytest.approx(gaps[t], abs=1e-6)


@pytest.mark.parametrize(("angle", "speed"), [(90.0, 10.0), (60.0, 8.0), (120.0, 12.0)])
def test_encroachment_time_of_straight_tracks(angle, speed):
    """(L + 2 h) / v with h = (w_o / 2 + w / 2 |cos θ|) / sin θ on the part that the boxes share."""
    theta = math.radians(angle)
    other = actor(x=-80 * math.cos(theta), y=-80 * math.sin(theta), yaw=theta, v=10, length=5, width=1.8)
    scene = recorded([actor(x=-40, v=speed), other], np.arange(0, 16, 0.1))
    half = (0.9 + 1.0 * abs(math.cos(theta))) / math.sin(theta)
    close(EncroachmentTime().course(scene, "0", "1")[0], (4.0 + 2.0 * half) / speed)


def test_encroachment_time_of_one_who_stays_and_one_who_is_cut_off():
    crossing = actor(y=-50, yaw=math.pi / 2, v=10)
    stays = recorded([actor(x=-30, v=10, a=-100 / 60), crossing], np.arange(0, 10, 0.05))
    assert EncroachmentTime().course(stays, "0", "1")[0] == math.inf
    assert EncroachmentTime().score(EncroachmentTime().course(stays, "0", "1")) == EncroachmentTime.bound
    close(EncroachmentTime().course(stays, "1", "0")[0], 0.6)
    cut = recorded([actor(x=-30, v=5), crossing], np.arange(0, 6.01, 0.05))
    assert np.isnan(EncroachmentTime().course(cut, "0", "1")).all()
    assert np.isnan(EncroachmentTime().course(recorded([FOLLOWER, LEADER], [0, 1, 2]), "0", "1")).all()
    with pytest.raises(InputError, match="encroachment-time cannot take"):
        EncroachmentTime(area=(0, 0, 0, -1, 2))


def test_pet_of_two_areas_of_one_symmetric_crossing_is_the_gap_time_less_both_encroachment_times():
    scene = recorded([actor(x=-30, v=10), actor(y=-50, yaw=math.pi / 2, v=10)], np.arange(0, 9, 0.1))
    gap = GapTime().course(scene, "0", "1")[0]
    half = (EncroachmentTime().course(scene, "0", "1")[0] + EncroachmentTime().course(scene, "1", "0")[0]) / 2
    close(Pet().course(scene, "0", "1")[0], gap - half)


def test_gap_time_closed_forms():
    cross = actor(y=-40, yaw=math.pi / 2, v=8)
    close(now(GapTime(), actor(x=-30, v=10), cross), 2.0)
    close(now(Spret(), actor(x=-30, v=10), cross), 16.0)
    close(now(GapTime(), actor(x=-30), actor(y=-40, yaw=math.pi / 2)), math.inf)
    close(now(GapTime(), actor(x=-50, v=10), cross), 0.0)
    close(now(GapTime(), actor(x=3, v=10), cross), math.nan)
    close(now(GapTime(), actor(v=10), actor(y=8, v=10)), math.nan)
    close(now(GapTime(), actor(v=10), actor(y=-40, yaw=math.pi / 2, v=8)), 5.0)
    # Who stands on the crossing has arrived, also if it is a rounding error ahead.
    close(now(GapTime(), actor(x=-1e-9), cross), 5.0)
    close(now(Spret(), actor(x=-1e-9), cross), 25.0)


# --- exposure -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("step", [0.1, 0.25, 0.5])
def test_exposure_to_a_time_to_collision_that_falls_to_nothing(step):
    """TTC = 3 - t falls below 2 at t = 1: exposed for 2 s, and the integral is 2² / 2, at any time step."""
    scene = recorded([FOLLOWER, LEADER], np.arange(0, 3 + 1e-9, step))
    close(Tet(2.0).score(Tet(2.0).course(scene, "0", "1")), 2.0)
    close(Tit(2.0).score(Tit(2.0).course(scene, "0", "1")), 2.0)
    # Between the instants the line crosses the threshold at its place.
    close(Tet(1.9).score(Tet(1.9).course(scene, "0", "1")), 1.9)
    close(Tit(1.9).score(Tit(1.9).course(scene, "0", "1")), 1.9**2 / 2)


def test_exposure_of_two_that_never_close_and_of_one_instant():
    apart = recorded([actor(v=10), actor(x=34, v=12)], np.arange(0, 5, 0.1))
    for metric in (Tet(), Tit(), Tet(rule="samples"), Tit(rule="samples")):
        assert (metric.course(apart, "0", "1") == 0).all()
        assert metric.course(recorded([FOLLOWER, LEADER], [0.0]), "0", "1")[0] == 0
    touching = recorded([actor(v=10), actor(x=3, v=10)], np.arange(0, 2.01, 0.1))
    close(Tet().course(touching, "0", "1")[-1], 2.0)
    close(Tit().course(touching, "0", "1")[-1], 3.0)


@quick
@given(scenes, st.floats(0.1, 5))
def test_exposure_keeps_its_bounds_and_never_falls(scene, threshold):
    exposed, integral = Tet(threshold).course(scene, "0", "1"), Tit(threshold).course(scene, "0", "1")
    assert (np.diff(exposed) >= 0).all()
    assert (np.diff(integral) >= 0).all()
    assert exposed[-1] <= TIME[-1] - TIME[0] + 1e-9
    assert (integral <= threshold * exposed + 1e-9).all()
    assert Tet(2 * threshold).course(scene, "0", "1")[-1] >= exposed[-1]


# --- severity -----------------------------------------------------------------------------------------------


def test_delta_v_closed_forms():
    """Rear end 10 m/s between equals: 5; head-on 30 m/s: 15; with a truck of 12 t: 12 / 13.5 of it."""
    close(now(DeltaV(), FOLLOWER, TOUCHING), 5.0)
    close(now(DeltaV(), FOLLOWER, actor(x=3.9, yaw=math.pi, v=10)), 15.0)
    close(now(DeltaV(), FOLLOWER, actor(x=3.9, yaw=math.pi, v=10, cls="truck")), 30 * 12 / 13.5)
    close(now(DeltaV({"truck": 1500.0}), FOLLOWER, actor(x=3.9, v=10, cls="truck")), 5.0)
    close(now(DeltaV({"0": 500.0}), FOLLOWER, TOUCHING), 7.5)
    close(now(DeltaV(), FOLLOWER, LEADER), math.nan)
    close(now(DeltaV(predicted=True), FOLLOWER, LEADER), 5.0)
    close(now(DeltaV(), actor(), actor(x=3.9)), 0.0)


def test_delta_v_is_that_of_the_first_touch():
    """The gap of 30 m is closed after 3 s; later speeds do not count."""
    scene = recorded([FOLLOWER, LEADER], np.arange(0, 3.6, 0.1))
    scene = replace(scene, speed=np.where(scene.time > 3.05, 0.0, scene.speed))
    course = DeltaV().course(scene, "0", "1")
    assert np.isnan(course[:30]).all()
    assert course[31:] == pytest.approx(5.0)


def test_conflict_severity_closed_forms():
    """5 m/s less half of what braking takes off in 3 s: nothing at 8 m/s², 2.5 m/s at 5 / 3 m/s²."""
    close(now(ConflictSeverity(), FOLLOWER, LEADER), 0.0)
    close(now(ConflictSeverity(5 / 3), FOLLOWER, LEADER), 2.5)
    close(now(ConflictSeverity(), FOLLOWER, TOUCHING), 5.0)
    close(now(ConflictSeverity(), actor(v=10), actor(x=34, v=20)), 0.0)


@quick
@given(scenes)
def test_momentum_is_kept(scene):
    one, two = DeltaV(predicted=True), DeltaV(predicted=True)
    masses = {"0": 700.0, "1": 2100.0}
    one, two = DeltaV(masses, predicted=True), DeltaV(masses, predicted=True)
    same(700.0 * one.course(scene, "0", "1"), 2100.0 * two.course(scene, "1", "0"))


@pytest.mark.parametrize("mass", [0.0, -1.0, math.inf, math.nan])
def test_masses_are_above_zero(mass):
    with pytest.raises(InputError, match="delta-v cannot take a mass"):
        DeltaV({"car": mass})


# --- responsibility-sensitive safety ------------------------------------------------------------------------


def test_rss_closed_forms():
    """20 + 1.75 + 23.5² / 8 - 100 / 16 to be kept behind the leader; who is in front needs what the rear needs."""
    rear = 20 + 1.75 + 23.5**2 / 8 - 100 / 16
    close(now(Rss(term="longitudinal"), FOLLOWER, LEADER), 30 - rear)
    close(now(Rss(term="longitudinal"), LEADER, FOLLOWER), 30 - rear)
    close(now(Rss(term="lateral"), FOLLOWER, BESIDE), 0.5 - 0.35)
    close(now(Rss(), FOLLOWER, BESIDE), 0.5 - 0.35)
    close(now(Rss(), FOLLOWER, LEADER), 30 - rear)
    close(now(Rss(term="lateral"), FOLLOWER, LEADER), -2 - 0.35)
    close(now(Rss(), actor(v=5), actor(x=104, y=2.5, v=5)), 100 - (5 + 1.75 + 8.5**2 / 8 - 25 / 16))
    # Two that stand may both start: 1.75 + 3.5² / 8 for the one behind.
    close(now(Rss(term="longitudinal"), actor(), STANDING), 30 - 1.75 - 3.5**2 / 8)
    # The one behind stands, the one in front drives away.
    close(now(Rss(term="longitudinal"), actor(), actor(x=34, v=20)), 30.0)
    ways = [(v + 1.75) + (v + 3.5) ** 2 / (2 * b) for v, b in ((20, 3), (10, 4))]
    close(now(Rss(term="longitudinal"), FOLLOWER, ONCOMING), 30 - sum(ways))


def test_rss_minima_grow_with_speed_and_response():
    speeds = np.linspace(0, 40, 41)
    fixed = (1.0, 3.5, 4.0, 8.0)
    assert (np.diff(min_longitudinal_gap(speeds, np.full(41, 10.0), *fixed)) >= 0).all()
    assert (np.diff(min_longitudinal_gap(np.full(41, 20.0), speeds, *fixed)) <= 0).all()
    assert (np.diff(min_oncoming_gap(speeds, speeds, 1.0, 3.5, 3.0, 4.0)) > 0).all()
    towards = np.linspace(-3, 3, 41)
    assert (np.diff(min_lateral_gap(towards, towards, 1.0, 0.2, 0.8, 0.1)) >= 0).all()
    assert min_lateral_gap(towards, towards, 1.0, 0.2, 0.8, 0.1).min() == 0.1


@pytest.mark.parametrize(
    "options_",
    [{"response_time": -1}, {"min_braking": 0}, {"lateral_margin": math.nan}, {"term": "sideways"}],
)
def test_rss_refuses_options_that_make_no_sense(options_):
    with pytest.raises(InputError, match="rss"):
        Rss(**options_)


# --- properties of all --------------------------------------------------------------------------------------

FAMILY = sorted(set(METRICS.names()) - {"pet", "trajectory-distance"})
SYMMETRIC = ("clearance", "dce", "ttce", "gap-time", "spret", "tet", "tit")


@quick
@given(scenes, st.floats(-3, 3), st.floats(-500, 500), st.floats(-500, 500))
def test_turning_and_moving_the_scene_changes_no_metric(scene, angle, east, north):
    # Of two tracks that are one, any point is the crossing.
    assume(max(np.abs(scene.x[0] - scene.x[1]).max(), np.abs(scene.y[0] - scene.y[1]).max()) > 1e-6)
    cos, sin = math.cos(angle), math.sin(angle)
    moved = replace(
        scene,
        x=cos * scene.x - sin * scene.y + east,
        y=sin * scene.x + cos * scene.y + north,
        heading=scene.heading + angle,
    )
    for name in FAMILY:
        metric = METRICS.create(name)
        here, there = (metric.clip_course(metric.course(one, "0", "1")) for one in (scene, moved))
        # Where a contact just grazes, or a gap just closes, rounding decides; that is a matter of 1e-9 m.
        differs = ~np.isclose(here, there, rtol=1e-6, atol=1e-6)
        assert differs.mean() <= 0.1, name


@quick
@given(scenes)
def test_symmetric_metrics_take_the_two_in_any_order(scene):
    for name in SYMMETRIC:
        metric = METRICS.create(name)
        same(metric.course(scene, "0", "1"), metric.course(scene, "1", "0"), 1e-6)


@quick
@given(scenes)
def test_relations_between_metrics(scene):
    ttc, gap = Ttc().course(scene, "0", "1"), Clearance().course(scene, "0", "1")
    dce, headway = Dce().course(scene, "0", "1"), Headway().course(scene, "0", "1")
    assert (dce <= gap + 1e-9).all()
    known = ~np.isnan(headway)
    assert (headway[known] >= gap[known] - 1e-7).all()
    assert (Mdrac(0.0).course(scene, "0", "1")[known] >= 0).all()
    same(Mdrac(0.0).course(scene, "0", "1"), Drac().course(scene, "0", "1"))
    same(Dst(0.0).course(scene, "0", "1"), Drac().course(scene, "0", "1"))
    assert (ttc[gap == 0.0] == 0.0).all()


# --- names --------------------------------------------------------------------------------------------------
