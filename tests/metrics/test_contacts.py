"""No collision is less critical than a near miss, and collisions have different scores."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from conftest import at_night
from cornercase.metrics import METRICS
from cornercase.metrics._measure import evaluate_metrics
from cornercase.recordings import Collision, Recording

TIME = np.arange(0.0, 8.0, 0.05)


def recording(ways, speeds, headings, stops=False):
    """Two cars on paths (2, T, 2) of their centres; optionally it ends with the first contact."""
    ways, speeds = np.asarray(ways, dtype=np.float64), np.asarray(speeds, dtype=np.float64)
    found = Recording(
        time=TIME, names=("Ego", "Other"), object_types=("car", "car"), x=ways[..., 0], y=ways[..., 1],
        heading=np.repeat(np.asarray(headings, dtype=np.float64)[:, None], len(TIME), 1), speed=speeds,
        acceleration=np.gradient(speeds, TIME, axis=1), length=np.full(2, 4.5), width=np.full(2, 1.8),
        center_x=np.zeros(2),
    )  # fmt: skip
    touching = np.flatnonzero(METRICS.create("clearance").course(found, "Ego", "Other") == 0.0)
    if not len(touching):
        return found, False
    last = touching[0] + 1 if stops else len(TIME)
    parts = {name: getattr(found, name)[:, :last] for name in ("x", "y", "heading", "speed", "acceleration")}
    return Recording(
        time=TIME[:last], names=found.names, object_types=found.object_types, length=found.length, width=found.width,
        center_x=found.center_x, collisions=(Collision(float(TIME[touching[0]]), ("Ego", "Other")),), **parts,
    ), True  # fmt: skip


def crossing(delay, stops):
    """Both at 8 and 6 m/s; the other reaches the crossing this many seconds after the ego."""
    still = np.zeros_like(TIME)
    ways = [np.stack([still, 8.0 * (TIME - 4.0)], -1), np.stack([6.0 * (TIME - 4.0 - delay), still], -1)]
    return recording(ways, [still + 8.0, still + 6.0], [np.pi / 2, 0.0], stops)


def following(deceleration, stops):
    """The ego comes at 12 m/s and brakes 20 m behind a car that stands."""
    still = np.zeros_like(TIME)
    braking = np.maximum(TIME - 1.0, 0.0)
    speed = np.maximum(12.0 - deceleration * braking, 0.0)
    along = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(TIME))) - 36.5
    return recording([np.stack([along, still], -1), np.zeros((len(TIME), 2))], [speed, still], [0.0, 0.0], stops)


def oncoming(offset, stops):
    """At 10 m/s towards each other, with this lateral offset in m."""
    still = np.zeros_like(TIME)
    ways = [np.stack([10.0 * (TIME - 4.0), still], -1), np.stack([-10.0 * (TIME - 4.0), still + offset], -1)]
    return recording(ways, [still + 10.0, still + 10.0], [0.0, np.pi], stops)


ENCOUNTERS: dict[str, tuple[Callable[[float, bool], tuple[Recording, bool]], list[float]]] = {
    "crossing": (crossing, [-1.6, -1.2, -0.9, -0.6, -0.3, 0.0, 0.3, 0.6, 0.9, 1.2, 1.6]),
    "following": (following, [2.5, 3.0, 3.4, 3.8, 4.1, 4.4, 4.8]),
    "oncoming": (oncoming, [0.2, 1.0, 1.6, 1.9, 2.2, 2.6]),
}


@cache
def met(encounter: str, how: float, stops: bool) -> tuple[Recording, bool]:
    """An encounter, which all metrics look at, and whether the cars collide."""
    make, _ = ENCOUNTERS[encounter]
    return make(how, stops)


def oriented(name, found):
    metric = METRICS.create(name)
    return metric.to_minimize(evaluate_metrics([metric], found, "Ego", "Other")[metric.name][1])


@pytest.mark.parametrize("stops", at_night([True, False], {True}), ids=["stop", "continue"])
@pytest.mark.parametrize("name", METRICS.names())
@pytest.mark.parametrize("encounter", ENCOUNTERS)
def test_no_collision_counts_as_less_critical_than_a_near_miss(encounter, name, stops):
    scores: dict[bool, list[float]] = {True: [], False: []}
    for how in ENCOUNTERS[encounter][1]:
        found, collides = met(encounter, how, stops)
        scores[collides].append(oriented(name, found))
    assert scores[True]
    assert scores[False]
    assert max(scores[True]) <= min(scores[False]) + 1e-9


@pytest.mark.parametrize("name", ["ttc", "wttc", "clearance", "distance", "dce", "pet"])
def test_among_collisions_the_score_follows_how_hard_they_are(name):
    """A later and harder braking leaves less of 12 m/s, of which two cars of one mass take half each."""
    impacts = [2.5, 3.0, 3.4]
    found = [following(one, stops=True)[0] for one in impacts]
    severe, hard = (np.array([oriented(f"{name}{option}", one) for one in found]) for option in (":severity=true", ""))
    left = np.array([one.speed[0, -1] for one in found])
    assert (np.diff(left) < -0.5).all()
    np.testing.assert_allclose(severe, -0.1 * 0.5 * left, rtol=1e-12)
    assert np.ptp(hard) == 0.0 == hard[0]
    # Recordings without contact keep their scores, so thresholds of 0 and more separate as before.
    for braking in (4.1, 4.8):
        passing = following(braking, stops=True)[0]
        assert oriented(f"{name}:severity=true", passing) == oriented(name, passing) >= 0.0


def test_a_recorded_contact_counts_between_two_instants_too():
    found, _ = following(3.0, stops=False)
    touching = METRICS.create("clearance").course(found, "Ego", "Other") == 0.0
    first = int(np.argmax(touching))
    early = {one: getattr(found, one)[:, :first] for one in ("x", "y", "heading", "speed", "acceleration")}
    without = Recording(
        time=TIME[:first], names=found.names, object_types=found.object_types, length=found.length, width=found.width,
        center_x=found.center_x, **early,
    )  # fmt: skip
    told = Recording(**{**vars(without), "collisions": (Collision(float(TIME[first]), ("Ego", "Other")),)})
    assert oriented("pet", without) == 10.0
    assert oriented("pet", told) == 0.0
