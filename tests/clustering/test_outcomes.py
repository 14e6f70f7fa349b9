"""Endings of hand-written recordings."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from cornercase.clustering.naming._predicates import describe_ending
from cornercase.metrics._geometry.conflict_area import area_visits
from cornercase.metrics.ending._ego_features import measure_features
from cornercase.metrics.ending._find_outcome import find_outcome
from cornercase.recordings import Collision
from helpers.encounter_recordings import CROSSES, NORTH, PASSES, TIMES, entity, recording, walker


def test_one_that_slows_down_for_another_yields():
    ego = entity(0.0, 0.0, 0.0, (0, 12), (1, 12), (4, 4), (5, 4), (8, 12))
    outcome = find_outcome(recording(Ego=ego, P=CROSSES), "Ego", "P")
    assert (outcome.text, outcome.first, outcome.collision) == ("P first", "P", None)
    assert (outcome.yields, outcome.waits, outcome.stops) == (True, False, False)
    assert describe_ending(outcome) == ("yields to P", "passes after P", "comes after P")
    # P's rear leaves the ego's 2 m when its centre is 1.3 m beyond the middle.
    assert outcome.encounter.leaves == pytest.approx(7.3 / 1.5, abs=0.01)
    # The front of the ego meets the side of P, which is 0.3 m wide to each side.
    way = 50.0 - 0.3 - 2.0
    at = np.interp(way, ego["x"], TIMES)
    assert outcome.encounter.enters == pytest.approx(at, abs=0.02)
    assert outcome.encounter.gap == pytest.approx(at - 7.3 / 1.5, abs=0.03)


def test_one_that_brakes_for_a_bend_and_comes_later_does_not_yield():
    # It slows down until it has passed the crossing, as before a bend.
    ego = entity(0.0, 0.0, 0.0, (0, 11), (9, 2), (10, 11))
    outcome = find_outcome(recording(Ego=ego, P=CROSSES), "Ego", "P")
    assert outcome.first == "P"
    assert not outcome.yields
    assert describe_ending(outcome) == ("passes after P", "comes after P")


def test_one_that_stands_before_the_other_has_passed_stops_for_it():
    ego = entity(0.0, 0.0, 0.0, (0, 15), (2, 15), (4.2, 0), (5, 0), (8, 12))
    outcome = find_outcome(recording(Ego=ego, P=CROSSES), "Ego", "P")
    assert (outcome.stops, outcome.waits, outcome.yields) == (True, True, True)
    assert describe_ending(outcome)[0] == "stops for P"


def test_one_that_stops_only_behind_the_crossing_stops_for_nobody():
    ego = entity(0.0, 0.0, 0.0, (0, 9), (7, 9), (9, 0))
    outcome = find_outcome(recording(Ego=ego, P=CROSSES), "Ego", "P")
    assert (outcome.first, outcome.stops, outcome.waits) == ("P", True, False)


def test_who_passes_first_does_so_with_a_gap():
    outcome = find_outcome(recording(Ego=PASSES, P=CROSSES), "Ego", "P")
    assert (outcome.text, outcome.first) == ("Ego first", "Ego")
    assert describe_ending(outcome) == ("passes before P",)
    leaves = (50.0 + 0.3 + 2.0) / 20.0
    assert outcome.encounter.gap == pytest.approx((6.0 - 1.0 - 0.3) / 1.5 - leaves, abs=0.02)


def test_without_others_it_ended_the_same():
    many = recording(Ego=PASSES, P=CROSSES, Q=CROSSES)
    whole, short = find_outcome(many, "Ego", "P"), find_outcome(many, "Ego", "P", others=False)
    assert [one.entity for one in whole.others] == ["Q"]
    assert short == replace(whole, others=())
    assert short.text == whole.text == "Ego first"


def test_one_that_waits_before_the_crossing_until_the_end_lets_the_other_cross_alone():
    ego = entity(0.0, 0.0, 0.0, (0, 12), (2, 12), (4.2, 0))
    told = recording(Ego=ego, P=CROSSES, until=9.0)
    outcome = find_outcome(told, "Ego", "P")
    assert (outcome.text, outcome.first) == ("only P crosses", "P")
    assert describe_ending(outcome) == ("stops for P", "yields to P", "comes after P")
    assert math.isnan(outcome.encounter.enters)
    # The same with both exchanged.
    turned = find_outcome(told, "P", "Ego")
    assert (turned.text, describe_ending(turned)[0]) == ("only P crosses", "passes while Ego waits")
    # 40 m before the crossing, its further path is unknown.
    far = entity(-22.0, 0.0, 0.0, (0, 12), (2, 12), (4.2, 0))
    assert find_outcome(recording(Ego=far, P=CROSSES, until=9.0), "Ego", "P").text == "ways do not cross"


def test_ways_that_do_not_meet():
    aside = entity(50.0, 40.0, NORTH, (0, 1.5))
    outcome = find_outcome(recording(Ego=PASSES, P=aside), "Ego", "P")
    assert (outcome.text, outcome.first, outcome.encounter.relation) == ("ways do not cross", None, "apart")
    assert describe_ending(outcome) == ("does not meet P",)


@pytest.mark.parametrize("aside", [0.0, 0.4, 1.2])
@pytest.mark.parametrize(
    ("angle", "speeds"),
    [
        (NORTH, ((0, 10), (20, 10))),
        (NORTH, ((0, 12), (4, 3), (20, 9))),
        (1.2, ((0, 8), (6, 8), (7, 0), (9, 0), (11, 6))),
        (2.4, ((0, 14), (3, 5), (20, 5))),
    ],
)
def test_times_at_a_crossing_are_those_of_the_conflict_area_of_metrics(angle, speeds, aside):
    """Post-encroachment time finds the area independently and exactly."""
    way = 40.0 + aside
    other = entity(50.0 - way * math.cos(angle), -way * math.sin(angle), angle, *speeds, length=4.4, width=1.8)
    told = recording(Ego=entity(0.0, 0.3, 0.05, (0, 9), (5, 7), (20, 9)), P=other)
    ((ego, their),) = area_visits(told, "Ego", "P", None)
    met = find_outcome(told, "Ego", "P").encounter
    assert (met.first == "Ego") == (ego.entry_time < their.entry_time)
    between = their.entry_time - ego.exit_time if met.first == "Ego" else ego.entry_time - their.exit_time
    assert (met.enters, met.leaves, met.gap) == pytest.approx((ego.entry_time, their.exit_time, between), abs=0.01)


@pytest.mark.parametrize(
    ("ego", "other", "text", "ending"),
    [
        ((0.0, 10.0), (30.0, 10.0), "C ahead", "stays behind C"),
        ((30.0, 10.0), (0.0, 10.0), "Ego ahead", "stays ahead of C"),
        ((0.0, 15.0), (30.0, 10.0), "Ego overtakes C", "overtakes C"),
        ((30.0, 10.0), (0.0, 15.0), "C overtakes Ego", "is overtaken by C"),
    ],
)
def test_in_lanes_it_counts_who_is_ahead(ego, other, text, ending):
    scene = {
        "Ego": entity(ego[0], 0.0, 0.0, (0, ego[1])),
        "C": entity(other[0], 3.5, 0.0, (0, other[1])),
    }
    outcome = find_outcome(recording(**scene), "Ego", "C")
    assert (outcome.text, outcome.encounter.relation, describe_ending(outcome)) == (text, "lane", (ending,))


@pytest.mark.parametrize(
    ("collision", "ego", "other", "ending", "speed"),
    [
        # 10 m/s into the rear of an entity at 4 m/s, 20 m ahead.
        (("Ego", "C"), entity(0, 0, 0, (0, 10)), entity(24, 0, 0, (0, 4)), "runs into the rear of C", 6.0),
        (("C", "Ego"), entity(24, 0, 0, (0, 4)), entity(0, 0, 0, (0, 10)), "is hit from behind by C", 6.0),
        (("C", "Ego"), entity(24, 0, 0, (0, 0)), entity(0, 0, 0, (0, 10)), "is hit by C while it stands", 10.0),
        (("Ego", "C"), entity(0, 0, 0, (0, 6)), entity(20, -24, NORTH, (0, 8)), "collides with C", 10.0),
    ],
)
def test_collisions_have_a_manner_and_a_speed(collision, ego, other, ending, speed):
    told = recording(Collision(3.3, collision), Ego=ego, C=other, until=4.0)
    outcome = find_outcome(told, "Ego", "C")
    assert (outcome.text, outcome.collision) == ("Ego and C collide", "C")
    assert ending in describe_ending(outcome)
    assert describe_ending(outcome)[-1] == "collides with C"
    assert outcome.impacts[0].speed == pytest.approx(speed)
    assert measure_features(told, outcome)["impact speed"] == outcome.impacts[0].speed


def test_the_ego_collides_with_whom_it_meets_first_and_others_among_themselves():
    hits = (Collision(1.0, ("B", "C")), Collision(2.0, ("B", "Ego")), Collision(3.0, ("Ego", "C")))
    told = recording(*hits, Ego=PASSES, B=CROSSES, C=CROSSES)
    outcome = find_outcome(told, "Ego", "C")
    assert [one.entity for one in outcome.impacts] == ["B", "C"]
    assert (outcome.collision, outcome.text) == ("B", "Ego and B collide")
    assert outcome.other_collisions == hits[:1]
    alone = find_outcome(replace(told, collisions=hits[:1]), "Ego", "C")
    assert (alone.collision, alone.text) == ("B and C", "Ego first")


def test_further_entities_that_move_are_met_too():
    later = entity(80.0, 20.0, -NORTH, (0, 1.5))
    parked = entity(20.0, 2.5, 0.0, (0, 0))
    lead = entity(60.0, 0.0, 0.0, (0, 30))
    outcome = find_outcome(recording(Ego=PASSES, P=CROSSES, Later=later, Parked=parked, Lead=lead), "Ego", "P")
    assert [(one.entity, one.relation, one.first) for one in outcome.others] == [
        ("Later", "crossing", "Ego"),
        ("Lead", "lane", "Lead"),
    ]


def test_one_that_is_there_only_at_times():
    # It vanishes before it would have crossed.
    gone = walker((0.0, 1.0))
    assert find_outcome(recording(Ego=PASSES, P=gone), "Ego", "P").text == "ways do not cross"
    # It appears after a second, and crosses.
    comes = walker((1.0, 99.0))
    assert find_outcome(recording(Ego=PASSES, P=comes), "Ego", "P").text == "Ego first"
    never = walker((-2.0, -1.0))
    told = recording(Ego=PASSES, P=never)
    outcome = find_outcome(told, "Ego", "P")
    assert outcome.text == "P is never there"
    assert describe_ending(outcome) == ("is there without P", "does not meet P")
    traits = measure_features(told, outcome)
    assert math.isnan(traits["nearest"])
    assert math.isnan(traits["mean speed of the other"])
    assert traits["mean speed"] == pytest.approx(20.0)


def test_an_ego_that_is_never_there():
    told = recording(Ego=entity(0.0, 0.0, 0.0, (0, 20.0), exists=(-2.0, -1.0)), P=CROSSES, Q=PASSES)
    outcome = find_outcome(told, "Ego", "P")
    assert (outcome.exists, outcome.moves, outcome.first) == (False, False, None)
    assert outcome.text == "Ego is never there"
    assert describe_ending(outcome) == ("is never there", "does not meet P")
    assert math.isnan(measure_features(told, outcome)["way"])


def test_who_is_there_only_when_the_other_is_not_does_not_meet_it():
    told = recording(Ego=entity(0.0, 0.0, 0.0, (0, 20.0), exists=(0.0, 2.0)), P=walker((3.0, 99.0)))
    outcome = find_outcome(told, "Ego", "P")
    assert (outcome.text, describe_ending(outcome)) == ("ways do not cross", ("does not meet P",))


def test_an_ego_that_never_moves():
    stands = entity(0.0, 0.0, 0.0, (0, 0.0))
    told = recording(Ego=stands, P=CROSSES)
    outcome = find_outcome(told, "Ego", "P")
    assert (outcome.exists, outcome.moves, outcome.stops) == (True, False, False)
    assert describe_ending(outcome) == ("stands all the time", "does not meet P")
    assert measure_features(told, outcome)["standing"] == pytest.approx(20.0)


def test_traits_are_what_can_be_read_off_a_recording():
    ego = entity(0.0, 0.0, 0.0, (0, 10), (2, 10), (4, 0), (6, 0), (8, 4))
    told = recording(Ego=ego, P=entity(50.0, 3.0, 0.0, (0, 0)), until=10.0)
    traits = measure_features(told, find_outcome(told, "Ego", "P"))
    expected = {
        "lowest speed": 0.0, "highest speed": 10.0, "first speed": 10.0, "last speed": 4.0, "standing": 2.0,
        "braking": 5.0, "way": 20.0 + 10.0 + 4.0 + 8.0, "duration": 10.0, "turn": 0.0, "shift": 0.0,
        "nearest": math.hypot(50.0 - 42.0 - 4.0, 1.0), "nearest time": 10.0, "first distance": math.hypot(46.0, 1.0),
    }  # fmt: skip
    for name, value in expected.items():
        assert traits[name] == pytest.approx(value, abs=0.11), name


def test_a_change_to_the_left_lane_is_a_shift_without_a_turn():
    ego = entity(0.0, 0.0, 0.0, (0, 10))
    aside = 3.5 * np.clip((TIMES - 3.0) / 3.0, 0.0, 1.0)
    ego |= {"y": aside, "heading": np.arctan2(np.gradient(aside, TIMES), 10.0)}
    told = recording(Ego=ego, P=entity(0.0, -30.0, 0.0, (0, 10)))
    traits = measure_features(told, find_outcome(told, "Ego", "P"))
    assert traits["shift"] == pytest.approx(3.5)
    assert traits["turn"] == pytest.approx(0.0)
