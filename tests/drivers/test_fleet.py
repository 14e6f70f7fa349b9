"""Drivers in a fleet, with compiled decisions for one scenario at a time."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import at_night, examples
from cornercase.drivers import DRIVERS, NORMAL, BehaviourDriver, DrivenPath, Driver, SimpleDriver, Situation
from cornercase.drivers._compiled import build_fleet, compile_fleet_kernels, set_route
from cornercase.drivers._kernels.conflict import contact_interval, find_first_contact_row
from cornercase.drivers._kernels.decide import compute_accelerations, find_route_row
from cornercase.drivers._kernels.lookahead import MAX_SAMPLES, LookaheadPath, arrival_time, earliest_arrival_time
from cornercase.drivers._kernels.structs import BEHAVIOUR, NOT_COMPILED, SIMPLE
from cornercase.drivers._route import plan_route
from helpers.closed_loop import BOXES, DT, right_turn, straight

KINDS = ("car", "truck", "pedestrian", "car")
LENGTH, WIDTH, CENTER_X = np.array([BOXES[kind] for kind in KINDS]).T
SCENARIOS = 5


class Own(Driver):
    def acceleration(self, situation):
        return np.zeros(len(situation.x))


class Reluctant(BehaviourDriver):
    def acceleration(self, situation):
        return super().acceleration(situation) - 1.0


def wandering(seed, steps=60):
    """Motion of all entities near a junction, (steps, 4, N, E): now fast, now at rest, now away."""
    random = np.random.default_rng(seed)
    shape = (SCENARIOS, len(KINDS))
    x, y = random.uniform(-25.0, 25.0, shape), random.uniform(20.0, 75.0, shape)
    heading, speed = random.uniform(-4.0, 4.0, shape), random.uniform(0.0, 12.0, shape)
    turn = random.choice([0.0, 0.0, 0.4, -0.3], shape)
    states = np.empty((steps, 4, *shape))
    for state in states:
        speed = np.where(random.random(shape) < 0.02, random.choice([0.0, 3.0, 9.0], shape), speed)
        heading = heading + turn * DT
        x, y = x + speed * np.cos(heading) * DT, y + speed * np.sin(heading) * DT
        state[:] = x, y, heading, speed
        state[:, random.random(shape) < 0.03] = np.nan
    return states


def situation(state, e, time, path, distance):
    """Input of the driver of entity `e`."""
    others = [a for a in range(len(KINDS)) if a != e]
    x, y, heading, speed = np.nan_to_num(state[:, :, e])
    seen_x, seen_y, seen_heading, seen_speed = state[:, :, others]
    return Situation(
        time, DT, path, distance, x, y, heading, speed, 0.0 * speed, float(LENGTH[e]), float(WIDTH[e]),
        float(CENTER_X[e]), 0.0 * x + 11.0, seen_x, seen_y, seen_heading, seen_speed, LENGTH[others], WIDTH[others],
        CENTER_X[others], tuple(KINDS[a] for a in others), np.ones(SCENARIOS, dtype=bool),
    )  # fmt: skip


def each(fleet, d, told):
    """Decisions of a fleet's driver in all scenarios."""
    own = told.distance, told.x, told.y, told.heading, told.speed, told.target_speed
    others = told.others_x, told.others_y, told.others_heading, told.others_speed
    compile_fleet_kernels(fleet)
    inputs = [np.ascontiguousarray(np.stack(arrays, axis=1)) for arrays in (own, others)]
    return compute_accelerations(fleet, d, 1, told.time, told.time_step, *inputs, told.active)


@pytest.mark.parametrize("seed", at_night(range(4), {1, 2, 3}))
def test_gathered_drivers_decide_as_each_alone_does_and_remember_the_same(seed):
    names, path = ("normal", "simple", "cautious"), right_turn()
    fleet_drivers = [DRIVERS.create(name) for name in names]
    alone = [DRIVERS.create(name) for name in names]
    for driver in (*fleet_drivers, *alone):
        driver.start(SCENARIOS, len(KINDS) - 1)
    fleet = build_fleet(fleet_drivers, [0, 3, 1], SCENARIOS, LENGTH, WIDTH, CENTER_X, KINDS)
    for d in range(3):
        fleet = set_route(fleet, d, 1, path)
    distance, braked = np.linspace(0.0, 90.0, SCENARIOS), 0
    for step, state in enumerate(wandering(seed)):
        distance = distance + 0.3
        for d, e in enumerate((0, 3, 1)):
            told = situation(state, e, step * DT, path, distance)
            # Alternate between the driver's own method and compiled code.
            found = fleet_drivers[d].acceleration(told) if step % 3 == 2 else each(fleet, d, told)
            assert found.tobytes() == alone[d].acceleration(told).tobytes()
            braked += np.count_nonzero(found < -0.5)
    for one, other in zip(fleet_drivers, alone, strict=True):
        if isinstance(one, BehaviourDriver) and isinstance(other, BehaviourDriver):
            assert one.known_mask.any()
            assert np.array_equal(one.known_mask, other.known_mask)
            assert np.array_equal(one.yielding_mask, other.yielding_mask)
    assert braked > 20


def test_only_drivers_that_decide_as_compiled_are_compiled():
    drivers = [Own(), Reluctant(), DRIVERS.create("simple"), DRIVERS.create("aggressive")]
    for driver in drivers:
        driver.start(SCENARIOS, 3)
    fleet = build_fleet(drivers, range(4), SCENARIOS, LENGTH, WIDTH, CENTER_X, KINDS)
    assert fleet.kind.tolist() == [NOT_COMPILED, NOT_COMPILED, SIMPLE, BEHAVIOUR]
    assert [find_route_row(fleet, d, 7, 0) for d in (2, 3)] == [0, -1]


def sampled(lengths, radius):
    """A path for each scenario: a circle and straight on."""
    s = np.tile(np.arange(0.0, max(lengths) + 0.1, 0.5), (len(lengths), 1))
    heading = np.minimum(s, np.array(lengths)[:, None] / 2) / radius
    x, y = (np.cumsum(0.5 * f(heading), axis=1) for f in (np.cos, np.sin))
    return DrivenPath(s, x, y, heading, np.gradient(heading, axis=1) / 0.5)


def planned(fleet, d, track, n):
    """Points of a route as stored in a fleet."""
    routes, row = fleet.routes, find_route_row(fleet, d, track, n)
    begin = routes.begin[row]
    return routes.points[begin : begin + routes.samples[row]], routes.measures[row]


def agrees(fleet, d, track, path):
    plan = plan_route(
        path, lateral_acceleration=NORMAL.lateral_acceleration, deceleration=NORMAL.comfortable_deceleration
    )
    for n in range(SCENARIOS):
        points, measures = planned(fleet, d, track, n)
        row = n if len(plan.x) > 1 else 0
        expected = (plan.x, plan.y, plan.cos, plan.sin, plan.max_speed_squared, plan.straight_count)
        assert np.array_equal(points, np.stack([one[row] for one in expected], axis=-1))
        assert np.array_equal(measures, [plan.step[row], plan.max_spacing[row], plan.max_turn[row]])


def test_routes_stand_beside_each_other_and_are_replaced():
    drivers = [DRIVERS.create("normal"), DRIVERS.create("normal")]
    for driver in drivers:
        driver.start(SCENARIOS, 3)
    fleet = build_fleet(drivers, [0, 1], SCENARIOS, LENGTH, WIDTH, CENTER_X, KINDS)
    paths = {(0, 0): straight(60.0), (0, 2): sampled([40.0] * SCENARIOS, 20.0), (1, 1): right_turn()}
    for (d, track), path in paths.items():
        fleet = set_route(fleet, d, track, path)
    assert [find_route_row(fleet, *one) for one in ((0, 1, 3), (1, 0, 0), (1, 9, 0))] == [-1, -1, -1]
    changes = {(0, 2): sampled([70.0, 50.0, 60.0, 20.0, 30.0], 30.0), (0, 0): straight(80.0), (1, 1): straight(10.0)}
    for change in (None, *changes):
        if change is not None:
            paths[change] = changes[change]
            fleet = set_route(fleet, *change, changes[change])
        for (d, track), path in paths.items():
            agrees(fleet, d, track, path)
    assert len(fleet.routes.points) == fleet.routes.samples.sum()


def test_a_route_of_the_same_size_is_replaced_in_place():
    driver = DRIVERS.create("normal")
    driver.start(SCENARIOS, 3)
    fleet = build_fleet([driver], [0], SCENARIOS, LENGTH, WIDTH, CENTER_X, KINDS)
    before, after = sampled([60.0] * SCENARIOS, 20.0), sampled([60.0] * SCENARIOS, 40.0)
    fleet = set_route(fleet, 0, 0, before)
    changed = set_route(fleet, 0, 0, after)
    assert changed.routes.points is fleet.routes.points
    agrees(changed, 0, 0, after)


def keeps(driver, ahead_for, s):
    """`SimpleDriver` in arrays over all scenarios and others, and how long each has been ahead."""
    p = driver.settings
    most, braking = p["acceleration"], p["comfortable_deceleration"]
    wanted = np.where(np.isfinite(s.target_speed), s.target_speed, s.speed)
    free = np.clip((wanted - s.speed) / s.time_step, -braking, most)
    cos, sin = np.cos(s.heading)[:, None], np.sin(s.heading)[:, None]
    x = s.others_x + s.others_center_x * np.cos(s.others_heading) - s.x[:, None] - s.center_x * cos
    y = s.others_y + s.others_center_x * np.sin(s.others_heading) - s.y[:, None] - s.center_x * sin
    along, across = cos * x + sin * y, np.abs(cos * y - sin * x)
    turn_cos = np.cos(s.others_heading - s.heading[:, None])
    turn_sin = np.abs(np.sin(s.others_heading - s.heading[:, None]))
    reach = 0.5 * (s.others_length * np.abs(turn_cos) + s.others_width * turn_sin)
    half = 0.5 * (s.others_length * turn_sin + s.others_width * np.abs(turn_cos))
    gap = along - reach - 0.5 * s.length
    inside = (across < half + 0.5 * s.width) & (along > 0.0) & (gap < p["sight_range"])
    ahead_for = np.where(inside, ahead_for + s.time_step, 0.0)
    speed = s.speed[:, None]
    closing = speed - s.others_speed * turn_cos
    dynamic = speed * p["time_headway"] + speed * closing / (2.0 * np.sqrt(most * braking))
    kept = p["min_gap"] + np.maximum(0.0, dynamic)
    following = most * (1.0 - (speed / np.maximum(wanted, 0.1)[:, None]) ** 4 - (kept / np.maximum(gap, 0.1)) ** 2)
    slowest = np.where(inside & (ahead_for > p["reaction_time"]), following, np.inf).min(axis=1)
    return np.clip(np.minimum(free, slowest), -p["max_deceleration"], most), ahead_for


def test_keeping_a_distance_is_the_same_in_arrays():
    driver, reacted = SimpleDriver(reaction_time=0.1), 0
    for seed in range(6):
        driver.start(SCENARIOS, 3)
        ahead_for = np.zeros((SCENARIOS, 3))
        for step, state in enumerate(wandering(seed)):
            told = situation(state, 0, step * DT, straight(), np.zeros(SCENARIOS))
            expected, ahead_for = keeps(driver, ahead_for, told)
            assert driver.acceleration(told) == pytest.approx(expected, abs=1e-12)
            reacted += np.count_nonzero(ahead_for > 0.1)
    assert reacted > 20


@given(
    bends=st.lists(st.tuples(st.integers(2, 30), st.sampled_from([0.0, 0.0, 0.1, -0.2])), min_size=1, max_size=5),
    other=st.tuples(st.floats(-10, 60), st.floats(-25, 25), st.floats(-4, 4)),
    turn=st.floats(-0.8, 0.8),
    offset=st.floats(-2, 2),
    speed=st.floats(-3, 15),
)
@settings(max_examples=examples(200), deadline=None)
def test_straight_stretches_that_are_passed_over_hold_no_contact(bends, other, turn, offset, speed):
    curvature = np.repeat([bend for _, bend in bends], [count for count, _ in bends])
    heading = np.concatenate([[0.0], np.cumsum(0.5 * curvature)])
    x, y = (np.concatenate([[0.0], np.cumsum(0.5 * f(heading[:-1]))]) for f in (np.cos, np.sin))
    path = DrivenPath(0.5 * np.arange(len(x)), x, y, heading, np.append(curvature, 0.0))
    plan = plan_route(path, lateral_acceleration=3.0, deceleration=2.0)
    points = np.stack(
        [one[0] for one in (plan.x, plan.y, plan.cos, plan.sin, plan.max_speed_squared, plan.straight_count)], axis=-1
    )
    places = np.zeros((MAX_SAMPLES, 6))
    most = float(plan.max_spacing[0] + (1.4 + abs(offset)) * plan.max_turn[0])
    way = LookaheadPath(
        places, np.zeros(3), np.zeros((1, 6)), len(x), most, points, 0, 0, float(plan.step[0]), 0.0, offset, 1.4,
        (2.3, 0.9), 5.0, 10.0,
    )  # fmt: skip
    all_places = np.column_stack(
        [
            path.distance, x + 1.4 * points[:, 2] - offset * points[:, 3],
            y + 1.4 * points[:, 3] + offset * points[:, 2], points[:, 2], points[:, 3], 0.0 * x,
        ]
    )  # fmt: skip
    a, b, towards = other
    legs = np.empty((3, 6))
    for k in range(3):
        cos, sin = math.cos(towards + k * turn), math.sin(towards + k * turn)
        legs[k] = a, b, cos, sin, 2.0 * k, 2.0 * k + (2.0 if k < 2 else 4.0)
        a, b = a + 2.0 * speed * cos, b + 2.0 * speed * sin
    for horizon in (0.0, 8.0):
        for them in ((legs, 2.0, 0.8, speed), (legs[:1], 2.0, 0.8, speed)):
            touched = [
                k
                for k in range(1, len(x))
                if contact_interval(all_places, k, (2.3, 0.9), 0.35, them, horizon)[0] <= horizon
            ]
            found = find_first_contact_row(places, most, (2.3, 0.9), 0.35, them, horizon, way)
            assert found == (touched[0] if touched else -1)


@given(
    curves=st.lists(st.sampled_from([400.0, 400.0, 64.0, 9.0]), min_size=2, max_size=40),
    speed=st.floats(0, 20),
    wanted=st.floats(0, 20),
    distance=st.floats(0, 0.4),
)
@settings(max_examples=examples(200), deadline=None)
def test_no_place_is_reached_before_the_soonest_instant(curves, speed, wanted, distance):
    points = np.zeros((len(curves), 6))
    points[:, 4] = curves
    way = LookaheadPath(
        np.zeros((MAX_SAMPLES, 6)), np.array([0.0, speed * speed, math.sqrt(speed * speed)]), np.zeros((1, 6)),
        len(curves), 0.5, points, 0, 0, 0.5, distance, 0.0, 1.4, (2.3, 0.9), speed, wanted,
    )  # fmt: skip
    # Each one while no later sample is known.
    earliest = [earliest_arrival_time(NORMAL, way, k) for k in range(1, len(curves))]
    arrivals = [arrival_time(NORMAL, way, k) for k in range(1, len(curves))]
    assert all(one <= two for one, two in zip(earliest, arrivals, strict=True))
    if min(curves) == 400.0 and speed > 0.1:
        steady = way._replace(arrivals=np.array([0.0, speed * speed, speed]), target_speed=speed)
        assert earliest_arrival_time(NORMAL, steady, 1) == pytest.approx(arrival_time(NORMAL, steady, 1))
