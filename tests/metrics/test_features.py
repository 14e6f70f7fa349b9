"""Features of recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cornercase._common.errors import InputError
from cornercase.metrics import FEATURES, Clearance, Feature, FeatureGroup, compute_features, registered_features
from cornercase.recordings import Collision, Recording

TIME = np.arange(0.0, 10.05, 0.1)


def meeting(late=2.0, ego_speed=8.0, slow=None, collisions=()):
    """The ego drives along x through the origin at 5 s, the other along y, `late` seconds before it."""
    still = np.zeros_like(TIME)
    speed = np.full_like(TIME, ego_speed) if slow is None else np.where(slow > TIME, ego_speed, 2.0)
    x = np.append(0.0, np.cumsum(speed[:-1] * 0.1))
    x -= np.interp(5.0, TIME, x)
    return Recording(
        time=TIME,
        names=("Ego", "B"),
        object_types=("car", "car"),
        x=np.stack([x, still]),
        y=np.stack([still, 5.0 * (TIME - 5.0 + late)]),
        heading=np.stack([still, still + 0.5 * np.pi]),
        speed=np.stack([speed, still + 5.0]),
        acceleration=np.zeros((2, len(TIME))),
        length=np.array([4.0, 4.0]),
        width=np.array([2.0, 2.0]),
        center_x=np.zeros(2),
        collisions=collisions,
    )


def told(recording, ego="Ego", other="B"):
    return dict(
        zip([one.name for one in registered_features()], compute_features([recording], ego, other)[0], strict=True)
    )


def test_the_features_say_what_happens():
    recording = meeting(late=2.0)
    found = told(recording)
    clearance = Clearance().course(recording, "Ego", "B")
    k = int(np.argmin(clearance))
    assert found["least-clearance"] == pytest.approx(clearance[k])
    assert found["nearest-time"] == pytest.approx(TIME[k])
    assert found["nearest-ahead"] == pytest.approx(-recording.x[0, k])
    assert found["nearest-left"] == pytest.approx(recording.y[1, k])
    assert (found["nearest-cos"], found["nearest-sin"]) == pytest.approx((0.0, 1.0))
    assert (found["nearest-ego-speed"], found["nearest-other-speed"]) == (8.0, 5.0)
    assert found["nearest-way"] == pytest.approx(0.8 * k)
    # The other is at the crossing 2 s before the ego.
    assert found["crossing-gap"] == pytest.approx(2.0, abs=0.11)
    assert found["crossing-distance"] == pytest.approx(0.0, abs=0.3)
    assert (found["duration"], found["way"], found["contact"]) == pytest.approx((10.0, 80.0, 0.0))
    assert (found["turn-time"], found["turn-way"]) == (0.0, 0.0)


@pytest.mark.parametrize("seed", range(40))
def test_the_least_clearance_is_that_of_the_metric(seed):
    rng = np.random.default_rng(seed)
    motion = {name: rng.normal(0.0, 4.0, (2, len(TIME))) for name in ("x", "y", "heading")}
    boxes = {"length": rng.uniform(0.0, 6.0, 2), "width": rng.uniform(0.0, 3.0, 2), "center_x": rng.normal(0.0, 1.0, 2)}
    # Few instants, so that in some of the recordings they never touch.
    some = slice(0, 2 + seed % 7)
    motion |= {name: np.zeros((2, len(TIME))) for name in ("speed", "acceleration")}
    short = {name: values[:, some] for name, values in motion.items()}
    recording = replace(meeting(), time=TIME[some], **short, **boxes)
    clearance = Clearance().course(recording, "Ego", "B")
    found = told(recording)
    assert found["least-clearance"] == pytest.approx(clearance.min(), abs=1e-12)
    assert found["nearest-time"] == TIME[int(np.argmin(clearance))]
    assert found["contact"] == float(clearance.min() == 0.0)


def test_the_gap_says_who_is_first():
    assert told(meeting(late=-2.0))["crossing-gap"] == pytest.approx(-2.0, abs=0.11)


def test_the_slowest_instant_is_the_first_of_them():
    found = told(meeting(slow=6.0))
    assert (found["lowest-speed"], found["lowest-speed-time"]) == pytest.approx((2.0, 6.0))
    assert found["lowest-speed-way"] == pytest.approx(48.0)
    # At 6 s the ego is 8 m beyond the crossing, where the other went 2 s before it, at 5 m/s.
    assert (found["lowest-speed-ahead"], found["lowest-speed-left"]) == pytest.approx((-8.0, 15.0))
    assert found["lowest-speed-other-speed"] == 5.0


def test_the_approach_begins_within_40_m():
    recording = meeting()
    found = told(recording)
    apart = np.hypot(recording.x[1] - recording.x[0], recording.y[1] - recording.y[0])
    k = int(np.argmax(apart < 40.0))
    assert 0 < k < len(TIME)
    assert found["approach-time"] == pytest.approx(TIME[k])
    assert found["approach-ahead"] == pytest.approx(-recording.x[0, k])
    assert found["approach-other-speed"] == 5.0
    # If they never come that near, the nearest instant counts.
    far = told(replace(recording, y=recording.y + np.array([[0.0], [100.0]])))
    apart = np.hypot(recording.x[1] - recording.x[0], recording.y[1] + 100.0 - recording.y[0])
    assert far["approach-time"] == pytest.approx(TIME[int(np.argmin(apart))])


def test_braking_begins_with_nine_tenths_of_the_strongest():
    recording = meeting()
    ego, other = -np.minimum(TIME, 3.0), np.where(TIME > 4.05, -2.0, 0.0)
    found = told(replace(recording, acceleration=np.stack([ego, other])))
    assert found["braking-way"] == pytest.approx(8.0 * 2.7)
    assert found["braking-speed"] == 8.0
    assert found["other-braking-way"] == pytest.approx(5.0 * 4.1)
    # No braking: the whole distance.
    assert told(recording)["braking-way"] == pytest.approx(80.0)
    assert told(recording)["other-braking-way"] == pytest.approx(50.0)


def test_braking_in_reverse_is_braking():
    recording = meeting()
    speed = np.minimum(-6.0 + 3.0 * np.maximum(TIME - 2.0, 0.0), 0.0)
    slows = np.where((TIME > 2.05) & (TIME < 4.05), 3.0, 0.0)
    x = np.append(0.0, np.cumsum(speed[:-1] * 0.1))
    found = told(
        replace(
            recording,
            x=np.stack([x, x + 50.0]),
            y=np.zeros((2, len(TIME))),
            speed=np.stack([speed, speed]),
            acceleration=np.stack([slows, slows]),
        )
    )
    assert [found["braking-way"], found["other-braking-way"]] == pytest.approx([12.6, 12.6])
    assert found["braking-speed"] == pytest.approx(5.7)


def test_the_other_is_fastest_where_it_first_is():
    recording = meeting()
    found = told(replace(recording, speed=np.stack([recording.speed[0], np.minimum(5.0 + TIME, 9.0)])))
    assert (found["other-highest-speed"], found["other-highest-speed-time"]) == pytest.approx((9.0, 4.0))


def test_a_turn_begins_before_it_is_fastest():
    recording = meeting()
    heading = np.where(TIME < 1.95, 0.0, np.where(TIME < 2.95, 0.1, 0.5))
    found = told(replace(recording, heading=np.stack([heading, recording.heading[1]])))
    assert found["turn-time"] == pytest.approx(3.0)
    # At 2 s the ego is 24 m before the crossing, the other 5 m.
    assert found["turn-begin-left"] == pytest.approx(-5.0 * np.cos(0.1) - 24.0 * np.sin(0.1))
    assert found["turn-begin-other-speed"] == 5.0


def test_a_turn_is_found_also_where_the_heading_goes_round():
    recording = meeting()
    heading = np.where(TIME < 3.0, np.pi - 0.01, -np.pi + 0.3)
    found = told(replace(recording, heading=np.stack([heading, recording.heading[1]])))
    assert found["turn-time"] == pytest.approx(3.0)
    # A heading that stays on the other side of the cut does not turn.
    flips = np.where(TIME < 3.0, np.pi, -np.pi)
    assert told(replace(recording, heading=np.stack([flips, recording.heading[1]])))["turn-time"] == 0.0


@pytest.mark.parametrize(("late", "collisions", "contact"), [
    (0.0, (), 1.0), (3.0, (), 0.0), (3.0, (Collision(4.0, ("Ego", "B")),), 1.0), (3.0, (Collision(4.0, ("B", "C")),), 0.0),
])  # fmt: skip
def test_contact_is_touching_or_a_collision_of_both(late, collisions, contact):
    assert told(meeting(late, collisions=collisions))["contact"] == contact


def test_one_car_behind_another_keeps_its_time_gap():
    recording = meeting()
    behind = np.stack([10.0 * TIME, 10.0 * TIME + 15.0])
    still = np.zeros((2, len(TIME)))
    found = told(replace(recording, x=behind, y=still, heading=still, speed=still + 10.0))
    # 15 m at 10 m/s, wherever they are: the other is first.
    assert found["crossing-gap"] == pytest.approx(1.5, abs=0.11)
    assert found["nearest-ahead"] == pytest.approx(15.0)


@pytest.mark.parametrize("gone", [slice(None), slice(0, 40), slice(60, None), slice(0, -1)])
@pytest.mark.parametrize("who", [[0], [1], [0, 1]])
def test_an_entity_that_is_not_there_leaves_nothing_unknown(gone, who):
    recording = meeting()
    motion = {}
    for name in ("x", "y", "heading", "speed", "acceleration"):
        motion[name] = getattr(recording, name).copy()
        motion[name][np.ix_(who, np.arange(len(TIME))[gone])] = np.nan
    found = told(replace(recording, **motion))
    assert np.isfinite(list(found.values())).all()
    if gone == slice(None):
        assert (found["least-clearance"], found["crossing-gap"], found["contact"]) == (100.0, 0.0, 0.0)


def test_failed_scenarios_have_no_features():
    rows = compute_features([None, meeting()], "Ego", "B")
    assert rows.shape == (2, len(registered_features()))
    assert np.isnan(rows[0]).all()
    assert np.isfinite(rows[1]).all()
    assert compute_features([], "Ego", "B").shape == (0, len(registered_features()))


class Broken(FeatureGroup):
    """Lists two features, and returns one."""

    name, features = "broken", (Feature("one", "1"), Feature("two", "1"))

    def values(self, encounter):
        return np.array([1.0])


def test_a_group_that_gives_something_else_is_refused(monkeypatch):
    monkeypatch.setattr(FEATURES, "_factories", {**FEATURES._factories, "broken": (Broken, {})})
    with pytest.raises(InputError, match=r"'broken' returned \[1\.0\]"):
        compute_features([meeting()], "Ego", "B")
    with pytest.raises(InputError, match="no entity 'C'"):
        compute_features([meeting()], "Ego", "C")


def test_names_of_features_are_different():
    names = [one.name for one in registered_features()]
    assert len(set(names)) == len(names)
