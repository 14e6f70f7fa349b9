"""What sensors tell a driver of the traffic: geometry, time, errors, tracks, and several of them together."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import examples
from cornercase._common.errors import InputError
from cornercase.drivers import (
    SENSORS,
    Body,
    Camera,
    Lidar,
    ObjectSensor,
    Radar,
    SensedObjects,
    Sensor,
    Situation,
    Start,
)
from cornercase.drivers.sensors._fusion import SensorFusion
from cornercase.scenario._seeds import ScenarioSeeds
from helpers.closed_loop import BOXES, DT, EGO, looking, straight, who_is_seen

BODY = Body("Ego", "car", **EGO, wheelbase=2.8, max_steering=0.5)


def start_of(kinds=("car",), scenarios=1, seeds=None, time_step=DT, **parameters) -> Start:
    names = tuple(f"{kind} {k}" for k, kind in enumerate(kinds))
    given = {name: np.asarray(values, dtype=np.float64) for name, values in parameters.items()}
    runs = range(scenarios) if seeds is None else seeds
    none = ({},) * scenarios
    return Start(BODY, time_step, given, none, ScenarioSeeds(runs, {}), names, None, np.ones(scenarios))


def situation(time, others, *, kinds=None, scenarios=1, heading=0.0, speed=10.0, active=None, dt=DT) -> Situation:
    """The ego is at the origin; `others` are rows of x, y, heading and speed, the same in all scenarios."""
    kinds = ("car",) * len(others) if kinds is None else kinds
    rows = np.array(others, dtype=np.float64).reshape(-1, 4).T
    x, y, turned, moves = np.repeat(rows[:, None], scenarios, axis=1)
    sizes, full = np.array([BOXES[kind] for kind in kinds]).reshape(-1, 3), np.ones(scenarios)
    return Situation(
        time, dt, straight(), 0.0 * full, 0.0 * full, 0.0 * full, heading * full, speed * full, 0.0 * full, **EGO,
        target_speed=full, others_x=x, others_y=y, others_heading=turned, others_speed=moves,
        others_length=sizes[:, 0], others_width=sizes[:, 1], others_center_x=sizes[:, 2], others_object_type=kinds,
        active=np.ones(scenarios, bool) if active is None else np.array(active),
        others_name=tuple(f"{kind} {k}" for k, kind in enumerate(kinds)),
    )  # fmt: skip


def known(sensor: Sensor, others, kinds=None, **options) -> list[bool]:
    """Who is known after the first measurement of a sensor without delays."""
    sensor.start(start_of(kinds or ("car",) * len(others)), "one")
    return [not math.isnan(x) for x in sensor.perceive(situation(0.0, others, kinds=kinds, **options)).x[0]]


def track(sensor, position, steps, *, scenarios=1, **parameters):
    """x of one object in each step, (steps, N); `position` gives x and y, or None while it is absent."""
    sensor.start(start_of(scenarios=scenarios, **parameters), "one")
    rows = []
    for step in range(steps):
        at = position(step * DT)
        others = [[math.nan] * 4] if at is None else [[*at, 0.0, 5.0]]
        rows.append(sensor.perceive(situation(step * DT, others, scenarios=scenarios)).x[:, 0])
    return np.array(rows)


def test_field_of_view_and_range_count_from_where_the_sensor_is_mounted():
    others = [[30.0, 0.0, 0.0, 0.0], [0.0, 30.0, 0.0, 0.0], [-30.0, 0.0, 0.0, 0.0], [20.0, -20.0, 0.0, 0.0]]
    assert known(ObjectSensor(fov=360), others) == [True] * 4
    assert known(ObjectSensor(fov=60), others) == [True, False, False, False]
    assert known(ObjectSensor(fov=60, yaw=90), others) == [False, True, False, False]
    assert known(ObjectSensor(fov=60, yaw=180), others) == [False, False, True, False]
    assert known(ObjectSensor(fov=60), others, heading=-math.pi / 4) == [False, False, False, True]
    # Its rear bumper is 30.85 m ahead of the origin, 3.7 m less from the front of the ego.
    behind = 30.0 + 1.4 - 2.25
    ahead = EGO["center_x"] + 0.5 * EGO["length"]
    only = [[30.0, 0.0, 0.0, 0.0]]
    corner = math.hypot(behind, 0.9)
    assert known(ObjectSensor(range=corner + 0.01, x=0), only) == [True]
    assert known(ObjectSensor(range=corner - 0.01, x=0), only) == [False]
    front = math.hypot(behind - ahead, 0.9)
    assert known(Radar(range=front + 0.01, latency=0, birth=1), only) == [True]
    assert known(Radar(range=front - 0.01, latency=0, birth=1), only) == [False]
    sideways = math.hypot(behind, 0.9 - 0.5)
    assert known(ObjectSensor(range=sideways + 0.01, x=0, y=0.5), only) == [True]
    assert known(ObjectSensor(range=sideways - 0.01, x=0, y=0.5), only) == [False]


@given(
    poses=st.lists(
        st.tuples(st.floats(4.0, 40.0), st.floats(-20.0, 20.0), st.floats(-3.1, 3.1)), min_size=3, max_size=3
    ),
    kinds=st.lists(st.sampled_from(sorted(BOXES)), min_size=3, max_size=3),
)
@settings(max_examples=examples(60), deadline=None)
def test_who_is_hidden_is_who_a_driver_at_the_same_eye_does_not_see(poses, kinds):
    others, kinds = [[*pose, 0.0] for pose in poses], tuple(kinds)
    eye = EGO["center_x"] + 0.25 * EGO["length"]
    x, y, heading = np.array(poses).T
    seen = who_is_seen(looking(x, y, heading, kinds), sight_range=100.0)
    assert known(ObjectSensor(x=eye), others, kinds) == seen
    assert known(ObjectSensor(x=eye, occlusion=False), others, kinds) == [True] * 3


def test_an_object_behind_another_is_hidden_unless_occlusion_is_off():
    others = [[20.0, 0.0, 0.0, 0.0], [12.0, 0.0, 0.0, 0.0]]
    kinds = ("pedestrian", "truck")
    assert known(ObjectSensor(), others, kinds) == [False, True]
    assert known(ObjectSensor(occlusion=False), others, kinds) == [True, True]
    absent = [others[0], [math.nan] * 4]
    assert known(ObjectSensor(), absent, kinds) == [True, False]


@pytest.mark.parametrize(("latency", "steps"), [(0.0, 0), (0.05, 1), (0.1, 2), (0.12, 3), (0.15, 3), (1.0, 20)])
def test_the_driver_is_given_what_was_known_a_latency_earlier(latency, steps):
    seen = track(ObjectSensor(latency=latency), lambda t: (20.0 + t**2, 0.0), 40)[:, 0]
    assert np.isnan(seen[:steps]).all()
    then = 20.0 + (DT * np.arange(40 - steps)) ** 2
    np.testing.assert_allclose(seen[steps:], then, rtol=1e-12)


def test_between_two_measurements_an_object_goes_on_at_its_speed():
    seen = track(ObjectSensor(period=0.25), lambda t: (20.0 + t**2, 0.0), 11)[:, 0]
    # It measures in the steps 0, 5 and 10, and the object claims to go 5 m/s.
    for step in range(11):
        measured = DT * (step - step % 5)
        assert seen[step] == pytest.approx(20.0 + measured**2 + 5.0 * (step * DT - measured))


def test_a_cycle_that_is_no_multiple_of_the_step_measures_in_the_next_step():
    sensor = ObjectSensor(period=0.07)
    sensor.start(start_of(), "one")
    measured = [sensor.perceive(situation(step * DT, [[20.0, 0.0, 0.0, 0.0]])).measured_at[0, 0] for step in range(8)]
    # Cycles begin at 0, 0.07, 0.14, 0.21, 0.28 and 0.35.
    assert measured == pytest.approx([0.0, 0.0, 0.1, 0.15, 0.15, 0.25, 0.3, 0.35])


@pytest.mark.parametrize(("birth", "death"), [(1, 1), (3, 1), (1, 4), (2, 3)])
def test_tracks_are_born_and_die_after_cycles_in_a_row(birth, death):
    # Hidden in the steps 10 to 19, and for one step at 25.
    def position(t):
        step = round(t / DT)
        return None if 10 <= step < 20 or step == 25 else (20.0, 0.0)

    is_known = ~np.isnan(track(ObjectSensor(birth=birth, death=death), position, 40)[:, 0])
    expected, hits, missed, confirmed = [], 0, 0, False
    for step in range(40):
        present = position(step * DT) is not None
        hits, missed = (hits + 1, 0) if present else (0, missed + 1)
        confirmed = hits >= birth or (confirmed and missed < death)
        expected.append(confirmed)
    assert is_known.tolist() == expected
    assert is_known[birth - 1]
    assert not is_known[: birth - 1].any()
    assert is_known[10 : 10 + death - 1].all()
    assert not is_known[10 + death - 1 : 20].any()


def test_a_lost_object_coasts_until_it_is_forgotten():
    seen = track(ObjectSensor(death=5), lambda t: (20.0 + 5.0 * t, 0.0) if t < 0.49 else None, 20)[:, 0]
    np.testing.assert_allclose(seen[:14], 20.0 + 5.0 * DT * np.arange(14))
    assert np.isnan(seen[14:]).all()


def test_misses_are_binomial_and_independent_of_each_other():
    scenarios, steps, chance = 400, 50, 0.2
    is_known = ~np.isnan(track(ObjectSensor(miss=chance), lambda t: (20.0, 0.0), steps, scenarios=scenarios))
    n, missed = is_known.size, int((~is_known).sum())
    assert abs(missed - n * chance) < 4.0 * math.sqrt(n * chance * (1.0 - chance))
    # Also in a row, and from scenario to scenario.
    pairs = ~is_known[1:] & ~is_known[:-1]
    assert abs(pairs.mean() - chance**2) < 4.0 * math.sqrt(2.0 * chance**2 / pairs.size)
    spread = (~is_known).sum(axis=0).var()
    assert spread == pytest.approx(steps * chance * (1.0 - chance), rel=0.3)


def test_noise_is_normal_with_its_standard_deviation_on_each_axis():
    sensor, scenarios = ObjectSensor(noise=0.5, speed_noise=0.2), 4000
    sensor.start(start_of(scenarios=scenarios), "one")
    sensed = sensor.perceive(situation(0.0, [[20.0, 3.0, 0.1, 5.0]], scenarios=scenarios))
    errors = np.stack((sensed.x[:, 0] - 20.0, sensed.y[:, 0] - 3.0, sensed.speed[:, 0] - 5.0))
    assert (sensed.heading == 0.1).all()
    deviations = np.array([0.5, 0.5, 0.2])
    assert (np.abs(errors.mean(axis=1)) < 4.0 * deviations / math.sqrt(scenarios)).all()
    np.testing.assert_allclose(errors.std(axis=1), deviations, rtol=4.0 / math.sqrt(2.0 * scenarios))
    assert (np.abs(np.corrcoef(errors)[np.triu_indices(3, 1)]) < 4.0 / math.sqrt(scenarios)).all()


def test_false_objects_appear_at_their_rate_in_the_field_of_view():
    scenarios, steps, rate = 300, 100, 0.8
    sensor = ObjectSensor(false_rate=rate, fov=90, range=50, x=0, death=3)
    sensor.start(start_of(scenarios=scenarios), "one")
    appeared, lasted = 0, 0
    for step in range(steps):
        sensed = sensor.perceive(situation(step * DT, [[20.0, 0.0, 0.0, 5.0]], scenarios=scenarios))
        x, y = sensed.x[:, 1:], sensed.y[:, 1:]
        there = ~np.isnan(x)
        new = there & (sensed.measured_at[:, 1:] == step * DT)
        appeared, lasted = appeared + int(new.sum()), lasted + int(there.sum())
        away = np.hypot(x[new], y[new])
        assert (away <= 50.0).all()
        assert (np.abs(np.arctan2(y[new], x[new])) <= math.pi / 4 + 1e-12).all()
    expected = scenarios * steps * -math.expm1(-rate * DT)
    assert abs(appeared - expected) < 4.0 * math.sqrt(expected)
    # Each lasts for three cycles, of which the end of the run cuts some off.
    assert lasted == pytest.approx(3.0 * appeared, rel=0.03)


def test_false_objects_are_others_with_names_of_their_own():
    fusion = SensorFusion([Radar(false_rate=1000.0, latency=0.0), Lidar(), Radar(false_rate=1.0)])
    begun = fusion.start(start_of(scenarios=2))
    assert begun.others[:2] == ("car 0", "false object 1 of radar")
    assert begun.others[-1] == "false object 4 of radar 2"
    assert len(set(begun.others)) == 9
    sensed = fusion.perceive(situation(0.0, [[20.0, 0.0, 0.0, 5.0]], scenarios=2))
    assert sensed.others_name == begun.others
    assert sensed.others_x.shape == sensed.others_speed.shape == (2, 9)
    assert len(sensed.others_length) == len(sensed.others_object_type) == 9
    # One of the first radar; its car is not confirmed yet.
    assert (~np.isnan(sensed.others_x)).tolist() == [[False, True] + [False] * 7] * 2


def test_scenarios_do_not_depend_on_each_other():
    seeds = [11, 5, 7]

    def sense(chosen, is_active):
        sensor = Camera(miss=0.3, noise=0.5, speed_noise=0.1, false_rate=2.0, latency=0.1, birth=2)
        sensor.start(start_of(("car", "truck"), len(chosen), chosen), "one")
        rows = []
        for step in range(60):
            others = [[20.0 + step, 0.0, 0.0, 5.0], [30.0, 4.0, 0.0, 0.0]]
            # As for a driver whose scenarios follow two paths.
            for part in (True, False):
                rows_of_path = np.array([is_active(k) is part for k in range(len(chosen))])
                given = situation(step * DT, others, kinds=("car", "truck"), scenarios=len(chosen), active=rows_of_path)
                sensed = sensor.perceive(given) if rows_of_path.any() else None
                if sensed is not None:
                    rows.append((np.stack([*vars(sensed).values()]), rows_of_path))
        # (N, steps, 5, A + F)
        return [np.array([row[:, k] for row, mask in rows if mask[k]]) for k in range(len(chosen))]

    together = sense(seeds, lambda k: True)
    for k, seed in enumerate(seeds):
        (alone,) = sense([seed], lambda k: True)
        assert alone.tobytes() == together[k].tobytes()
    assert together[0].tobytes() != together[1].tobytes()
    for one, other in zip(together, sense(seeds, lambda k: k != 1), strict=True):
        assert one.tobytes() == other.tobytes()


def test_a_driver_that_pauses_starts_with_nothing():
    sensor = ObjectSensor(latency=0.1, birth=2, death=100)
    sensor.start(start_of(), "one")
    others = [[20.0, 0.0, 0.0, 0.0]]
    steps = [*range(6), *range(20, 26)]
    is_known = [not np.isnan(sensor.perceive(situation(step * DT, others)).x[0, 0]) for step in steps]
    assert is_known == [False, False, False, True, True, True] * 2


def test_options_may_differ_between_scenarios():
    sensor = ObjectSensor(range=100, x=0)
    sensor.start(
        start_of(scenarios=3, range=[10.0, 100.0, 100.0], latency=[0.0, 0.05, 0.0], noise=[0.0, 0.0, 1.0]), "one"
    )
    rows = []
    for step in range(3):
        rows.append(sensor.perceive(situation(step * DT, [[20.0, 0.0, 0.0, 0.0]], scenarios=3)).x[:, 0])
    seen = np.array(rows)
    assert np.isnan(seen[:, 0]).all()
    assert np.isnan(seen[0, 1])
    assert (seen[1:, 1] == 20.0).all()
    assert (seen[:, 2] != 20.0).all()
    # The noise is that of a sensor with this option.
    alone = ObjectSensor(range=100, x=0, noise=1.0)
    alone.start(start_of(seeds=[2]), "one")
    assert alone.perceive(situation(0.0, [[20.0, 0.0, 0.0, 0.0]])).x[0, 0] == seen[0, 2]


class Fixed(Sensor):
    """Knows what it is told."""

    def __init__(self, x, measured_at):
        self._x, self._measured_at = np.array([x], dtype=float), np.array([measured_at], dtype=float)

    def start(self, start, label):
        pass

    def perceive(self, situation):
        unknown = np.where(np.isnan(self._x), np.nan, 0.0)
        return SensedObjects(self._x, unknown, unknown, unknown, self._measured_at)


def test_of_several_sensors_the_newest_measurement_counts():
    nan = math.nan
    fusion = SensorFusion([
        Fixed([1.0, nan, 3.0, 4.0, nan], [0.2, nan, 0.1, 0.3, nan]),
        Fixed([10.0, 20.0, 30.0, nan, nan], [0.2, 0.1, 0.2, 0.9, nan]),
    ])  # fmt: skip
    fusion.start(start_of(("car",) * 5))
    sensed = fusion.perceive(situation(0.3, [[0.0] * 4] * 5))
    np.testing.assert_array_equal(sensed.others_x, [[1.0, 20.0, 30.0, 4.0, nan]])


def test_sensors_of_one_kind_have_random_numbers_of_their_own():
    def sense(body):
        fusion = SensorFusion([Radar(noise=1.0, latency=0, birth=1), Radar(noise=1.0, latency=0, birth=1, range=20)])
        fusion.start(replace(start_of(), body=body))
        return [sensor.perceive(situation(0.0, [[6.0, 0.0, 0.0, 0.0]])).x[0, 0] for sensor in fusion._sensors]

    both = sense(BODY), sense(replace(BODY, name="Other"))
    assert not np.isnan(both).any()
    assert len({*both[0], *both[1]}) == 4


def test_without_sensors_the_driver_is_given_the_truth():
    fusion = SensorFusion([])
    begun = start_of()
    assert fusion.start(begun).others == begun.others
    given = situation(0.0, [[6.0, 0.0, 0.0, 0.0]])
    assert fusion.perceive(given) is given


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("radar:fov=0", r"`fov` 0: give a number above 0\."),
        ("radar:range=-1", r"`range` -1: give a number above 0\."),
        ("camera:miss=1.5", r"`miss` 1\.5: give a number from 0 to 1\."),
        ("lidar:birth=0", r"`birth` 0: give a whole number"),
        ("lidar:noise=-1", r"`noise` -1: give a number of 0 or more\."),
        ("radar:x=front", r"takes a number for 'x', not 'front'\."),
        ("radar:occlusion=7", r"takes true or false for 'occlusion'"),
        ("radar:rang=7", r"has no option 'rang'; did you mean 'range'"),
    ],
)
def test_wrong_options_are_refused_in_a_sentence(text, says):
    with pytest.raises(InputError, match=says):
        SENSORS.create(text)


def test_presets_are_sensors_with_other_defaults():
    assert str(Radar(range=160, fov=60)) == "radar"
    assert str(SENSORS.create("camera:noise=0.3,occlusion=false")) == "camera:noise=0.3,occlusion=false"
    assert not SENSORS.create("lidar").is_random
    assert SENSORS.create("lidar:miss=0.1").is_random
