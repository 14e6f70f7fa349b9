"""The reference drivers of UN Regulation No. 157, by themselves, as drivers, and in scenario files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from conftest import at_night
from cornercase._common.errors import InputError
from cornercase.drivers import DrivenPath, ReferenceDriver, Situation, drive_cut_in, drive_cut_out, drive_deceleration
from cornercase.drivers._resolve import driver_by_name
from cornercase.drivers.references.r157._fuzzy_metrics import critical_metric, is_laterally_safe, proactive_metric
from cornercase.drivers.references.r157._models import REFERENCES, rss_lateral_distance, rss_longitudinal_distance
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin
from helpers.closed_loop import Other, Run, straight

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples" / "r157"
NAMES = {"CC_human_driver": "cc-human", "FSM": "fsm", "RSS": "rss", "Reg157": "reg157"}
FILES = ("cut_in", "cut_out", "deceleration")
CASES = [(file, name) for file in FILES for name in NAMES.values() if file == "cut_in" or name != "reg157"]


def rows_of(file, name):
    rows = pd.read_csv(ROOT / "tests" / "data" / "r157" / f"{file}.csv")
    return rows[rows.model.map(NAMES) == name].reset_index(drop=True)


def by_itself(file, name, rows):
    if file == "deceleration":
        return drive_deceleration(name, rows.speed_kmh.to_numpy() / 3.6, rows.deceleration_g.to_numpy())
    lateral = np.round(10.0 * rows.lateral_m_s.abs().to_numpy()) * 0.1
    if file == "cut_out":
        return drive_cut_out(name, rows.speed_kmh.to_numpy() / 3.6, rows.front_gap_m.to_numpy(float), lateral)
    speeds = rows.ego_kmh.to_numpy() / 3.6, rows.other_kmh.to_numpy() / 3.6
    return drive_cut_in(name, *speeds, rows.gap_m.to_numpy(float), lateral)


@pytest.mark.parametrize(("file", "name"), CASES)
def test_prevents_what_the_implementation_of_the_commission_prevents(file, name):
    rows = rows_of(file, name)
    outcome = by_itself(file, name, rows)
    # Of all rows 0 to 0.4 % differ; `benchmarks/reference_drivers.py` counts them.
    assert (outcome.crash != (rows.crash > 0)).sum() <= 2
    if file != "cut_in":
        np.testing.assert_allclose(outcome.gap, rows.initial_gap_m, atol=1e-6)


@pytest.mark.parametrize("file", FILES)
def test_finds_the_fuzzy_metrics_of_the_implementation_of_the_commission(file):
    rows = rows_of(file, "fsm")
    outcome = by_itself(file, "fsm", rows)
    np.testing.assert_allclose(outcome.proactive, rows.pfs, atol=1e-6)
    np.testing.assert_allclose(outcome.critical, rows.cfs, atol=1e-6)


def test_formulas_give_what_is_computed_by_hand():
    at = np.array
    # 20 m/s behind 10 m/s: 15 + 1.6875/2 + 22.25²/12 - 100/12; beside 0.5 m/s: 0.3 + 0.65625 + 0.78125.
    assert rss_longitudinal_distance(at([20.0]), at([10.0]))[0] == pytest.approx(15.0 + 0.84375 + 41.255208 - 8.333333)
    assert rss_lateral_distance(at([0.5]))[0] == pytest.approx(0.3 + 0.65625 + 0.78125)
    # Safe from 15 + 50 - 7.142857 + 2 m on, unsafe below 15 + 33.333333 - 7.142857 m, each without the margin of 2 m.
    gaps = at([61.857143 + 1e-6, 43.190476 - 1e-5, (61.857143 + 43.190476) / 2])
    np.testing.assert_allclose(proactive_metric(gaps, 20.0 + 0 * gaps, 10.0 + 0 * gaps), [0.0, 1.0, 0.5], atol=1e-6)
    # Safe from 7.5 + 12.5 m on, unsafe below 7.5 + 8.333333 m; braking with 8 counts as 4 and leaves 7 m/s.
    gaps, zero = at([20.0, 15.8333, 17.916667]), np.zeros(3)
    critical = critical_metric(gaps, 20.0 + zero, 10.0 + zero, zero)
    np.testing.assert_allclose(critical, [0.0, 1.0, 0.5], atol=1e-5)
    unsafe = 6.375 + 49.0 / 12.0
    assert critical_metric(at([unsafe]), at([20.0]), at([10.0]), at([-8.0]))[0] == pytest.approx(1.0)
    assert critical_metric(at([1.0]), at([10.0]), at([10.0]), at([0.0]))[0] == 0.0
    # 1.6 m at 1 m/s, before 8.6 m and 10 m are passed at 12 m/s, and after.
    beside, inward, closing = at([1.6, 1.7, 1.6, -0.1]), at([1.0, 1.0, 0.0, 0.0]), at([12.0, 12.0, 12.0, 12.0])
    clear = is_laterally_safe(at([10.0] * 4), beside, inward, closing, at([8.6] * 4))
    assert clear.tolist() == [False, True, True, False]


@pytest.mark.parametrize(
    ("file", "name"), [("cut_in", "cc-human"), ("cut_in", "reg157"), ("cut_out", "fsm"), ("deceleration", "rss")]
)
def test_prevents_the_same_in_a_scenario_file(file, name):
    rows = rows_of(file, name)
    if file != "deceleration":
        rows = rows[rows.lateral_m_s.abs() > 0.4]
    if file == "cut_in":
        values = {"ego_kmh": rows.ego_kmh, "other_kmh": rows.other_kmh, "gap": rows.gap_m}
        values["lateral_speed"] = rows.lateral_m_s
    else:
        values = {"ego_kmh": rows.speed_kmh, "gap": REFERENCES[name].following_gap(rows.speed_kmh / 3.6)}
        if file == "cut_out":
            values |= {"front_gap": rows.front_gap_m, "lateral_speed": -rows.lateral_m_s}
        else:
            values["deceleration"] = rows.deceleration_g
    table = [dict(zip(values, map(float, one), strict=True)) for one in zip(*values.values(), strict=True)]
    simulator = Builtin(time_step=0.1, duration=15.0, drivers={"Ego": name})
    runs = list(simulator.run([ConcreteScenario(EXAMPLES / f"{file}.xosc", one) for one in table]))
    recordings = [run for run in runs if isinstance(run, Recording)]
    assert len(recordings) == len(rows)
    crashes = np.array([any("Ego" in one.entities for one in run.collisions) for run in recordings])
    # If the careful and competent human has enough time at the intrusion, the rows end there.
    assert (crashes & (rows.crash == 0)).sum() <= (8 if name == "cc-human" else 4)
    assert (~crashes & (rows.crash > 0)).sum() <= 4


@pytest.mark.parametrize("name", at_night(REFERENCES, {"fsm", "cc-human"}))
def test_goes_at_the_speed_asked_for_past_who_is_not_in_its_way(name):
    beside = Other("car", 60.0, 3.5, speed=5.0)
    ahead_and_faster = Other("car", 100.0, 0.0, speed=20.0)
    behind = Other("car", -20.0, 0.0, speed=9.0)
    run = Run(driver_by_name(name), straight(900.0), (beside, ahead_and_faster, behind), speed=10.0, target=14.0)
    assert run.acceleration.max() == pytest.approx(2.0)
    assert run.speed[-1, 0] == pytest.approx(14.0)
    assert run.acceleration.min() >= -1e-9


def test_a_careful_human_takes_its_foot_off_decides_and_brakes_within_0_6_s():
    run = Run(driver_by_name("cc-human"), straight(400.0), (Other("car", 150.0, 0.0),), speed=20.0, target=20.0)
    given, full = run.acceleration[:, 0], 0.774 * 9.81
    np.testing.assert_allclose(given[:15], -0.4)
    np.testing.assert_allclose(given[15:26], -12.65 * 0.05 * np.arange(1, 12))
    np.testing.assert_allclose(given[28:40], -full)
    assert run.speed[-1, 0] == 0.0
    assert not run.touched.any()


@pytest.mark.parametrize("name", REFERENCES)
def test_brakes_for_who_stands_in_a_bend(name):
    """On a left-hand bend of 100 m, where the middle of the other is beside the driver's heading."""
    angle = np.linspace(0.0, 2.0, 1001)
    path = DrivenPath(100.0 * angle, 100.0 * np.sin(angle), 100.0 * (1.0 - np.cos(angle)), angle, np.full(1001, 0.01))
    other = Other("car", 100.0 * np.sin(1.2), 100.0 * (1.0 - np.cos(1.2)), heading=1.2)
    run = Run(driver_by_name(name), path, (other,), speed=15.0, target=15.0, duration=16.0)
    assert run.distance[-1, 0] < 120.0
    assert run.speed[-1, 0] < 0.1
    assert not run.touched.any()


@pytest.mark.parametrize("name", REFERENCES)
def test_takes_a_path_that_runs_otherwise_in_each_scenario(name):
    """One straight path and one slightly rotated; an entity on it is equally far in both."""
    s, turned = np.arange(0.0, 300.0, 0.5), np.array([0.0, 0.1])
    x, y = s * np.cos(turned)[:, None], s * np.sin(turned)[:, None]
    path = DrivenPath(np.tile(s, (2, 1)), x, y, np.tile(turned[:, None], len(s)), np.zeros((2, len(s))))
    driver, zero, one = driver_by_name(name), np.zeros((2, 1)), np.ones(1)
    driver.start(2, 1)
    given = [
        driver.acceleration(
            Situation(
                0.05 * k, 0.05, path, zero[:, 0], zero[:, 0], zero[:, 0], turned, np.full(2, 20.0), zero[:, 0],
                length=4.3, width=1.9, center_x=1.4,
                target_speed=np.full(2, 20.0), others_x=25.0 * np.cos(turned)[:, None],
                others_y=25.0 * np.sin(turned)[:, None], others_heading=turned[:, None], others_speed=zero,
                others_length=4.3 * one, others_width=1.9 * one, others_center_x=1.4 * one, others_object_type=("car",),
                active=np.ones(2, dtype=np.bool_),
            )
        )
        for k in range(30)
    ]  # fmt: skip
    np.testing.assert_allclose([one[0] for one in given], [one[1] for one in given], atol=1e-6)
    assert given[-1][0] < -3.9


@pytest.mark.parametrize("name", at_night(REFERENCES, {"reg157", "rss"}))
def test_decides_the_same_alone_and_among_others(name):
    gaps, options = np.array([20.0, 35.0, 60.0, 90.0]), {"speed": 18.0, "target": 18.0, "duration": 5.0}
    together = Run(driver_by_name(name), straight(900.0), (Other("car", gaps, 0.0, speed=6.0),), scenarios=4, **options)
    for k, gap in enumerate(gaps):
        alone = Run(driver_by_name(name), straight(900.0), (Other("car", gap, 0.0, speed=6.0),), **options)
        assert (alone.acceleration[:, 0] == together.acceleration[:, k]).all()


def test_whoever_hides_behind_the_one_ahead_is_seen_when_that_leaves_the_middle_of_the_lane():
    def run(aside):
        others = (Other("car", 50.0, aside, speed=15.0), Other("misc", 220.0, 0.0))
        return Run(driver_by_name("cc-human"), straight(900.0), others, speed=15.0, target=15.0, duration=2.0)

    assert (run(0.37).acceleration == 0.0).all()
    assert run(0.38).acceleration[0, 0] == pytest.approx(-0.4)


def test_a_name_or_a_delay_that_cannot_be_is_named():
    with pytest.raises(InputError, match=r"no reference driver 'cc-humn'; did you mean 'cc-human'"):
        ReferenceDriver("cc-humn")
    with pytest.raises(InputError, match=r"`delay` of the driver 'rss' is -1"):
        ReferenceDriver("rss", delay=-1)
    assert ReferenceDriver("rss", delay=1.5).settings == {"driver": "rss", "delay": 1.5}
    assert [driver_by_name(name).settings["driver"] for name in REFERENCES] == list(REFERENCES)
