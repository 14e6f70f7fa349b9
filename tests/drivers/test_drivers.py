"""The driver model in a closed loop."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import at_night, examples
from cornercase._common.geometry.boxes import box_corners, boxes_overlap
from cornercase.drivers import (
    AGGRESSIVE,
    CAUTIOUS,
    DRIVERS,
    NORMAL,
    BehaviourDriver,
    DrivenPath,
)
from cornercase.drivers._kernels.conflict import (
    contact_interval,
    find_first_contact_row,
    is_first_contact_before,
    last_contact_ending_after,
)
from cornercase.drivers._route import plan_route
from helpers.closed_loop import BOXES, DT, EGO, FRONT, PRESETS, Other, Run, line_is_free, looking, right_turn, straight


@pytest.mark.parametrize("name", PRESETS)
def test_reaches_the_speed_it_wants_and_keeps_it(name):
    behaviour = PRESETS[name]
    run = Run(BehaviourDriver(behaviour), straight(600.0), target=12.0)
    assert run.speed[-1, 0] == pytest.approx(12.0 * behaviour.target_share, abs=1e-9)
    assert run.acceleration.max() <= behaviour.acceleration
    assert (np.diff(run.speed[:, 0]) >= -1e-12).all()


@pytest.mark.parametrize("asked", [np.inf, np.nan])
def test_goes_at_its_own_top_speed_when_none_is_asked(asked):
    run = Run(DRIVERS.create("cautious"), straight(600.0), target=asked)
    assert run.speed[-1, 0] == pytest.approx(40.0 / 3.6)


def test_slows_to_a_lower_target_comfortably_and_stands_at_zero():
    slower = Run(BehaviourDriver(NORMAL), straight(), speed=13.0, target=5.0, duration=8.0)
    assert slower.speed[-1, 0] == pytest.approx(5.0)
    assert slower.acceleration.min() >= -NORMAL.comfortable_deceleration
    stop = Run(BehaviourDriver(NORMAL), straight(), speed=8.0, target=0.0, duration=8.0)
    assert stop.speed[-1, 0] == 0.0
    assert (stop.speed >= 0.0).all()


@pytest.mark.parametrize("name", PRESETS)
def test_takes_a_curve_at_the_lateral_limit(name):
    behaviour, path = PRESETS[name], right_turn()
    run = Run(BehaviourDriver(behaviour), path, speed=11.0, target=14.0, duration=20.0)
    curvature = np.interp(run.distance[:, 0], path.distance, np.abs(path.curvature))
    lateral = run.speed[:, 0] ** 2 * curvature
    assert lateral.max() == pytest.approx(behaviour.lateral_acceleration, rel=0.05)
    assert run.acceleration[run.distance < 60.0].min() >= -1.2 * behaviour.comfortable_deceleration
    assert run.speed[-1, 0] > 1.3 * run.speed[curvature > 0.1, 0].max()


@given(
    curvatures=st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=12),
    lateral=st.floats(1.0, 5.0),
    braking=st.floats(0.5, 5.0),
)
@settings(max_examples=examples(60), deadline=None)
def test_speed_limit_is_the_smallest_that_every_place_ahead_demands(curvatures, lateral, braking):
    s = np.linspace(0.0, 50.0, 101)
    curvature = np.repeat(curvatures, 101)[:: len(curvatures)][:101]
    path = DrivenPath(s, s.copy(), 0 * s, 0 * s, curvature)
    route = plan_route(path, lateral_acceleration=lateral, deceleration=braking)
    for k in range(0, 101, 10):
        demands = [lateral / max(abs(curvature[j]), lateral / 1e4) + 2 * braking * (s[j] - s[k]) for j in range(101)]
        assert route.max_speed_squared[0, k] <= min(demands[k:]) * (1 + 1e-9)
        # Nowhere lower than required by the neighbouring samples.
        assert route.max_speed_squared[0, k] >= min(demands[max(k - 1, 0) :]) - 2 * braking * 0.5 - 1e-9


@given(
    own=st.tuples(st.floats(-10, 10), st.floats(-10, 10), st.floats(-4, 4)),
    heading=st.floats(-4, 4),
    speed=st.floats(-3, 15),
    margin=st.floats(0, 1),
    length=st.floats(0.5, 8),
)
@settings(max_examples=examples(200), deadline=None)
def test_times_of_contact_agree_with_boxes_at_many_instants(own, heading, speed, margin, length):
    x, y, facing = own
    place = np.array([[0.0, x, y, math.cos(facing), math.sin(facing), 0.0]])
    legs = np.array([[0.0, 0.0, math.cos(heading), math.sin(heading), 0.0, 4.0]])
    first, last, _ = contact_interval(place, 0, (2.3, 0.9), margin, (legs, length / 2, 0.8, speed), 4.0)
    time = np.linspace(0.0, 4.0, 2001)
    way = speed * time
    moving = box_corners(way * math.cos(heading), way * math.sin(heading), heading, length, 1.6)
    touching = time[boxes_overlap(box_corners(x, y, facing, 4.6, 1.8 + 2 * margin), moving)]
    if touching.size:
        assert (first, last) == (
            pytest.approx(touching[0], abs=0.002001),
            pytest.approx(touching[-1], abs=0.002001),
        )
    else:
        assert last - first <= 0.002001


@given(
    other=st.tuples(st.floats(-15, 15), st.floats(-15, 15), st.floats(-4, 4)),
    turn=st.floats(-1.5, 1.5),
    legs=st.integers(1, 9),
    speed=st.floats(-3, 12),
    arrives=st.floats(0, 9),
    gaps=st.tuples(st.floats(0, 3), st.floats(0, 3)),
    sooner=st.floats(0, 9),
)
@settings(max_examples=examples(400), deadline=None)
def test_who_is_met_within_gaps_is_met_at_these_times(other, turn, legs, speed, arrives, gaps, sooner):
    place = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]])
    a, b, towards = other
    rows = np.empty((legs, 6))
    for k in range(legs):
        cos, sin, duration = math.cos(towards), math.sin(towards), 0.5 if k < legs - 1 else 8.0
        rows[k] = a, b, cos, sin, 0.5 * k, 0.5 * k + duration
        a, b, towards = a + duration * speed * cos, b + duration * speed * sin, towards + turn
    them = (rows, 2.0, 0.8, speed)
    first, last, _ = contact_interval(place, 0, (2.3, 0.9), 0.35, them, 6.0)
    who = (place, 0, (2.3, 0.9), 0.35, them, 6.0)
    # A later instant excludes whatever an earlier one does.
    found = last_contact_ending_after(*who, min(sooner, arrives), gaps[1])
    if found[0] >= 0:
        assert rows[found[0], 4] + found[2] == last
    ends_late = found[0] >= 0 and rows[found[0], 4] + found[2] + gaps[1] > arrives
    assert ends_late == (first < math.inf and arrives < last + gaps[1])
    if found[0] >= 0:
        assert is_first_contact_before(*who, found, arrives, -gaps[0]) == (first - gaps[0] < arrives)


@given(
    turns=st.lists(st.floats(-0.4, 0.4), min_size=4, max_size=60),
    other=st.tuples(st.floats(-10, 40), st.floats(-25, 25), st.floats(-4, 4)),
    offset=st.floats(-2, 2),
    speed=st.floats(-3, 15),
)
@settings(max_examples=examples(200), deadline=None)
def test_places_that_are_passed_over_hold_no_contact(turns, other, offset, speed):
    heading = np.cumsum(turns)
    cos, sin = np.cos(heading), np.sin(heading)
    x, y = 0.5 * np.cumsum(cos) + 1.4 * cos - offset * sin, 0.5 * np.cumsum(sin) + 1.4 * sin + offset * cos
    places = np.column_stack([0.5 * np.arange(len(x)), x, y, cos, sin, 0.0 * x])
    most = float(np.hypot(np.diff(x), np.diff(y)).max())
    a, b, towards = other
    legs = np.array([[a, b, math.cos(towards), math.sin(towards), 0.0, 8.0]])
    for horizon in (0.0, 8.0):
        them = (legs, 2.0, 0.8, speed)
        touched = [
            k for k in range(1, len(x)) if contact_interval(places, k, (2.3, 0.9), 0.35, them, horizon)[0] <= horizon
        ]
        assert find_first_contact_row(places, most, (2.3, 0.9), 0.35, them, horizon) == (touched[0] if touched else -1)


@pytest.mark.parametrize("name", at_night(PRESETS, {"cautious", "aggressive"}))
def test_stops_behind_a_standing_car(name):
    behaviour = PRESETS[name]
    run = Run(BehaviourDriver(behaviour), straight(), [Other("car", 100.0, 0.0)], speed=12.0, duration=60.0)
    gap = 100.0 + 1.4 - 2.25 - (run.distance[-1, 0] + FRONT)
    assert run.speed[-1, 0] < 0.05
    assert gap == pytest.approx(behaviour.min_gap, abs=0.2)
    assert run.acceleration.min() > -4.5


@pytest.mark.parametrize("name", at_night(PRESETS, {"normal", "cautious"}))
def test_follows_a_slower_leader_at_the_time_headway(name):
    behaviour = PRESETS[name]
    leader = Other("car", 45.0, 0.0, speed=6.0)
    run = Run(BehaviourDriver(behaviour), straight(500.0), [leader], speed=10.0, duration=50.0)
    gap = 45.0 + 6.0 * run.time[-1] - 0.85 - (run.distance[-1, 0] + FRONT)
    assert not run.touched.any()
    assert run.speed[-1, 0] == pytest.approx(6.0, abs=0.05)
    assert gap == pytest.approx(behaviour.min_gap + 6.0 * behaviour.time_headway, abs=0.3)
    assert not run.yielding.any()


def test_brakes_in_an_emergency_for_a_leader_that_stops_dead():
    leader = Other("car", 40.0, 0.0, speed=12.0, until=5.0)
    run = Run(BehaviourDriver(NORMAL), straight(300.0), [leader], speed=12.0, duration=20.0)
    assert not run.touched.any()
    assert -NORMAL.max_deceleration <= run.acceleration.min() < -NORMAL.comfortable_deceleration


def test_follows_in_a_curve_by_the_distance_along_it():
    path = right_turn()
    # Standing on the arm after the curve: 9 m from the end of the arc, which is 60 + 11.78 m from the start.
    car = Other("car", 7.5 + 9.0, 67.5)
    run = Run(BehaviourDriver(NORMAL), path, [car], speed=10.0, duration=40.0)
    assert run.speed[-1, 0] < 0.05
    gap = 60.0 + 7.5 * math.pi / 2 + 9.0 + 1.4 - 2.25 - FRONT - run.distance[-1, 0]
    assert gap == pytest.approx(NORMAL.min_gap, abs=0.3)


def test_lets_parked_cars_and_waiting_pedestrians_be():
    others = [Other("car", 60.0, 2.4), Other("pedestrian", 90.0, -1.9), Other("pedestrian", 120.0, 1.9)]
    free = Run(BehaviourDriver(NORMAL), straight(400.0), speed=10.0)
    for behaviour in (NORMAL, AGGRESSIVE):
        passing = Run(BehaviourDriver(behaviour), straight(400.0), others, speed=10.0)
        alone = Run(BehaviourDriver(behaviour), straight(400.0), speed=10.0)
        assert np.array_equal(passing.speed, alone.speed)
    wary = Run(BehaviourDriver(CAUTIOUS), straight(400.0), others, speed=10.0)
    beside = np.abs(wary.distance + 1.4 - 90.0) < 1.0
    assert wary.speed[beside].max() == pytest.approx(0.5 * 0.8 * 13.9, rel=0.05)
    assert wary.distance[-1, 0] < free.distance[-1, 0]


def crossing(time, at=60.0, speed=1.4, **more) -> Other:
    """Pedestrian from the right whose centre is on the ego's line at `time`."""
    return Other("pedestrian", at, -speed * np.asarray(time), heading=math.pi / 2, speed=speed, **more)


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("time", at_night([4.0, 5.0, 6.0, 7.0], {4.0, 5.0, 6.0}))
def test_stops_for_a_pedestrian_who_crosses_in_view(name, time):
    behaviour = PRESETS[name]
    pedestrian = crossing(time)
    run = Run(
        BehaviourDriver(behaviour),
        straight(400.0),
        [pedestrian],
        speed=10.0,
        target=10.0 / behaviour.target_share,
    )
    assert not run.touched.any()
    over = run.time > time + (0.25 + 0.9) / 1.4
    assert run.distance[~over].max() + FRONT < 60.0 - 0.25
    assert run.acceleration.min() >= -behaviour.comfortable_deceleration * 1.5
    assert run.speed[-1, 0] == pytest.approx(10.0)


def test_goes_first_when_the_pedestrian_is_far_and_after_when_it_has_passed():
    for time in (12.0, 1.0):
        run = Run(BehaviourDriver(NORMAL), straight(400.0), [crossing(time)], speed=10.0, target=10.0, duration=12.0)
        assert run.speed == pytest.approx(10.0)


def test_waits_for_the_last_of_two_and_does_not_flutter():
    others = [crossing(6.0), crossing(9.0, speed=1.2)]
    run = Run(BehaviourDriver(NORMAL), straight(400.0), others, speed=10.0, target=10.0)
    assert not run.touched.any()
    for k in range(2):
        switched = np.count_nonzero(np.diff(run.yielding[:, 0, k].astype(int)))
        assert 1 <= switched <= 2


def test_gives_way_where_paths_merge_and_then_follows():
    path = right_turn(before=40.0)
    # From the left, along the arm that the ego turns into.
    reaches = np.linspace(4.0, 9.0, 11)
    car = Other("car", -9.0 * reaches + 7.5, np.full(11, 47.5), speed=9.0)
    for behaviour in PRESETS.values():
        run = Run(BehaviourDriver(behaviour), path, [car], scenarios=11, speed=8.0, target=12.0, duration=12.0)
        waited = run.yielding.any(axis=(0, 2))
        assert waited.any()
        assert not run.touched[waited].any()


def test_does_not_brake_for_oncoming_traffic_or_for_who_follows():
    others = [
        Other("car", 150.0, 3.5, heading=math.pi, speed=12.0),
        Other("car", -30.0, 0.0, speed=14.0, until=1.5),
    ]
    run = Run(BehaviourDriver(NORMAL), straight(400.0), others, speed=10.0, target=10.0)
    assert run.speed == pytest.approx(10.0)


def test_stops_for_oncoming_traffic_in_its_own_lane():
    others = [Other("car", 150.0, 0.3, heading=math.pi, speed=8.0, until=8.0)]
    run = Run(BehaviourDriver(NORMAL), straight(400.0), others, speed=10.0, target=10.0)
    assert not run.touched.any()
    assert run.speed[-1, 0] < 0.1


def test_follows_who_cuts_in_ahead():
    cut_in = Other("car", 20.0, 3.5, heading=-0.15, speed=9.0, until=2.3)
    run = Run(BehaviourDriver(NORMAL), straight(400.0), [cut_in], speed=10.0, target=10.0, duration=20.0)
    assert not run.touched.any()
    assert run.speed[-1, 0] < 0.1
    before = run.time < 1.3
    assert run.acceleration[before].min() < -0.3
    assert not run.yielding.any()


def hidden_crossing(start):
    """Pedestrian who appears from behind a truck at the roadside."""
    truck = Other("truck", 43.0, -3.2)
    return [truck, Other("pedestrian", 54.0, -4.0, heading=math.pi / 2, speed=1.5, start=start)]


def test_reacts_to_a_hidden_pedestrian_only_once_it_was_seen_for_the_reaction_time():
    path, pedestrian = straight(400.0), 1
    others = hidden_crossing(1.0)
    run = Run(BehaviourDriver(NORMAL), path, others, speed=12.0, target=12.0, start=10.0, duration=8.0)
    in_view = Run(BehaviourDriver(NORMAL), path, others[1:], speed=12.0, target=12.0, start=10.0, duration=8.0)
    seen = [
        line_is_free(np.array([s + 1.4 + 0.25 * EGO["length"], 0.0]), others, pedestrian, t)
        for s, t in zip(run.distance[:, 0], run.time, strict=True)
    ]
    first = run.time[seen.index(True)]
    knows = run.time[run.known[:, 0, pedestrian]][0]
    brakes = run.time[run.acceleration[:, 0] < -0.5][0]
    assert first > 0.5
    assert knows == pytest.approx(first + NORMAL.reaction_time, abs=1e-9)
    assert brakes >= knows
    assert run.time[in_view.acceleration[:, 0] < -0.5][0] < brakes
    assert run.acceleration.min() < in_view.acceleration.min() - 0.5


def test_reacts_to_a_waiting_pedestrian_the_reaction_time_after_it_steps_out():
    for reaction_time in (0.5, 1.0):
        behaviour = NORMAL._replace(reaction_time=reaction_time)
        waiting = Other("pedestrian", 60.0, -2.0, heading=math.pi / 2, speed=1.0, start=2.0)
        run = Run(BehaviourDriver(behaviour), straight(300.0), [waiting], speed=12.0, target=12.0, start=10.0)
        assert run.time[run.acceleration[:, 0] < -0.5][0] == pytest.approx(2.0 + reaction_time, abs=1e-9)


@dataclass
class Circling:
    """Drives at constant speed on a circle about `middle`, clockwise from the angle `begin`."""

    kind: str
    middle: tuple[float, float]
    radius: float
    speed: float
    begin: float

    def at(self, time):
        angle = self.begin - self.speed * time / self.radius
        x = self.middle[0] + self.radius * math.cos(angle)
        y = self.middle[1] + self.radius * math.sin(angle)
        return x, y, angle - math.pi / 2, self.speed


def test_expects_oncoming_traffic_in_a_bend_to_stay_in_its_lane():
    radius = 50.0
    s = np.arange(0.0, 150.0, 0.2)
    path = DrivenPath(
        s, radius * np.sin(s / radius), radius - radius * np.cos(s / radius), s / radius, 0 * s + 1 / radius
    )
    for lane in (-3.5, 3.5):
        car = Circling("car", (0.0, radius), radius + lane, 8.0, math.pi / 2)
        run = Run(BehaviourDriver(NORMAL), path, [car], speed=9.0, target=9.0, duration=12.0)
        angle_of_car = math.pi / 2 - car.speed * run.time[-1] / car.radius
        assert run.distance[-1, 0] / radius - math.pi / 2 > angle_of_car
        assert run.speed == pytest.approx(9.0)


def test_expects_who_turns_to_go_on_turning():
    # Comes from a side road towards the ego's lane, but is turning into the lane beside it, against the ego.
    turning = Circling("car", (52.0, 11.8), 8.0, 5.0, 0.0)
    x, y, heading, _ = turning.at(0.6)
    ahead = Other("car", x, y, heading, speed=5.0)
    for car, brakes in ((turning, False), (ahead, True)):
        run = Run(BehaviourDriver(NORMAL), straight(300.0), [car], speed=9.0, target=9.0, start=27.0, duration=6.0)
        assert (run.speed.min() < 8.5) == brakes


def test_bolder_presets_arrive_earlier_and_keep_smaller_gaps():
    others = [crossing(6.0), Other("car", 130.0, 0.0, speed=5.0)]
    runs = {
        name: Run(BehaviourDriver(b), straight(900.0), others, speed=8.0, duration=40.0) for name, b in PRESETS.items()
    }
    arrival = [run.time[run.distance[:, 0] > 120.0][0] for run in runs.values()]
    assert arrival == sorted(arrival, reverse=True)
    assert len(set(arrival)) == 3
    gaps = [130.0 + 5.0 * run.time[-1] - 0.85 - FRONT - run.distance[-1, 0] for run in runs.values()]
    assert gaps == sorted(gaps, reverse=True)
    assert not any(run.touched.any() for run in runs.values())


def test_one_scenario_is_the_same_alone_and_in_a_batch():
    times = np.linspace(2.5, 9.0, 50)
    path = right_turn()

    def others(rows):
        return [
            Other("truck", 4.0, 56.0, heading=math.pi / 2),
            Other("pedestrian", 14.0, 67.5 + 1.4 * times[rows], heading=-math.pi / 2, speed=1.4),
            Other("car", 60.0 - times[rows], 71.0, heading=math.pi, speed=6.0 + 0.1 * times[rows]),
        ]

    start = np.linspace(0.0, 15.0, 50)
    batch = Run(
        DRIVERS.create("normal"),
        path,
        others(slice(None)),
        scenarios=50,
        start=start,
        speed=8.0,
        duration=12.0,
    )
    assert np.ptp(batch.distance[-1] - start) > 5.0
    for i in (0, 7, 23, 49):
        alone = Run(DRIVERS.create("normal"), path, others([i]), start=start[i], speed=8.0, duration=12.0)
        assert alone.distance[:, 0].tobytes() == batch.distance[:, i].tobytes()
        assert alone.acceleration[:, 0].tobytes() == batch.acceleration[:, i].tobytes()


def test_scenarios_that_are_not_active_keep_their_state():
    driver = BehaviourDriver(NORMAL)
    driver.start(2, 1)
    here = looking([20.0], [0.0], [0.0], ["misc"])
    fields = ("distance", "x", "y", "heading", "speed", "acceleration", "target_speed", "active")
    others = ("others_x", "others_y", "others_heading", "others_speed")
    twice: dict[str, Any] = {field: np.repeat(getattr(here, field), 2, axis=0) for field in (*fields, *others)}
    two = replace(here, **twice)
    for step in range(20):
        driver.acceleration(replace(two, time=step * DT, active=np.array([True, step < 5])))
    assert driver.known_mask[:, 0].tolist() == [True, False]


@given(
    speed=st.floats(0.0, 20.0),
    x=st.floats(-20.0, 80.0),
    y=st.floats(-20.0, 20.0),
    heading=st.floats(-4.0, 4.0),
    other_speed=st.floats(-3.0, 20.0),
    kind=st.sampled_from(sorted(BOXES)),
    preset=st.sampled_from(sorted(PRESETS)),
)
@settings(max_examples=examples(150), deadline=None)
def test_acceleration_is_finite_and_within_limits(speed, x, y, heading, other_speed, kind, preset):
    behaviour = PRESETS[preset]
    driver = BehaviourDriver(behaviour._replace(reaction_time=0.0, field_of_view=2 * math.pi))
    driver.start(1, 1)
    situation = looking([x], [y], [heading], [kind])
    a = driver.acceleration(
        replace(
            situation,
            speed=np.array([speed]),
            others_speed=np.array([[other_speed]]),
            target_speed=np.array([15.0]),
        )
    )[0]
    assert -behaviour.max_deceleration <= a <= behaviour.acceleration
    assert speed + a * DT >= -1e-12


def test_mirrored_scenes_give_mirrored_decisions():
    for time in (3.0, 5.0, 7.0):
        right = crossing(time)
        left = Other("pedestrian", 60.0, 1.4 * time, heading=-math.pi / 2, speed=1.4)
        runs = [Run(BehaviourDriver(NORMAL), straight(300.0), [o], speed=10.0, duration=15.0) for o in (right, left)]
        assert runs[0].distance == pytest.approx(runs[1].distance, abs=1e-6)
