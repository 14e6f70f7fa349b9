"""When the ego could see the other, reacted and braked, and what earlier braking would have changed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from cornercase.metrics import _timeline
from cornercase.metrics._timeline import EARLIER, find_events
from helpers.crash import crash, straight

EAST, NORTH = 0.0, math.pi / 2


def braking(speed, since, deceleration, until=math.inf):
    return lambda time: np.maximum(speed - deceleration * (np.clip(time, since, until) - since), 0.0)


def find_reply(recording, ego, other, time):
    reply = _timeline.find_ego_reaction(recording, ego, other, time)
    assert reply is not None
    return reply


def contact(recording):
    return recording.collisions[0].time


def test_an_ego_that_brakes_for_a_standing_car_has_all_events_in_their_order():
    recording = crash(straight(0, 0, EAST, braking(15, 2.0, 6.0)), straight(45, 0, EAST, 0))
    events = find_events(recording, "Ego", "Other", contact(recording))
    assert events.sees == 0.0
    # The front is 41 m away at first, which is 5 s at 15 m/s from the beginning on.
    assert events.foresees == pytest.approx(0.0, abs=0.15)
    assert events.slows == events.brakes == pytest.approx(2.0, abs=0.11)
    assert events.contact == contact(recording)
    assert events.gap == 0.0


def test_what_hides_the_other_ends_the_sight_of_it():
    # A wall beside the road hides one that crosses until the ego has passed its end.
    wall = straight(-5, 8, EAST, 0, ("misc", 30.0, 0.5))
    recording = crash(straight(-40, 0, EAST, 10), straight(0, 40, -NORTH, 10), wall)
    events = find_events(recording, "Ego", "Other", contact(recording))
    assert events.sees is not None
    assert events.foresees is not None
    assert 0.5 < events.sees < contact(recording)
    assert events.foresees >= events.sees
    clear = crash(straight(-40, 0, EAST, 10), straight(0, 40, -NORTH, 10))
    assert find_events(clear, "Ego", "Other", contact(clear)).sees == 0.0


def test_braking_for_something_else_long_before_is_no_reaction():
    # For a bend at 1 s; for the other, which starts at 5 s, at 6 s.
    def speed(time):
        return np.where(
            time < 6.0, np.maximum(15 - 5 * np.clip(time - 1.0, 0, 1), 10), 10 - 8 * np.maximum(time - 6, 0)
        )

    ego = straight(0, 0, EAST, lambda time: np.maximum(speed(time), 0.0), until=9.0)
    other = straight(75.5, -12, NORTH, lambda time: np.where(time > 4.8, 5.0, 0.0), until=9.0)
    recording = crash(ego, other)
    events = find_events(recording, "Ego", "Other", contact(recording))
    assert events.brakes == pytest.approx(6.0, abs=0.11)
    assert events.slows == events.brakes


def test_an_ego_that_never_brakes_has_no_reaction():
    recording = crash(straight(0, 0, EAST, 15), straight(45, 0, EAST, 0))
    events = find_events(recording, "Ego", "Other", contact(recording))
    assert (events.slows, events.brakes) == (None, None)
    reply = find_reply(recording, "Ego", "Other", contact(recording))
    assert (reply.reply, reply.reaction, reply.avoided_by) == ("none", None, None)
    # 1.15 s and braking with 7.6 m/s² need 17 + 17 m of the 41 m.
    assert reply.avoided
    assert not reply.seen_too_late


def test_leaving_the_accelerator_is_a_reaction_and_braking_comes_later():
    def speed(time):
        return 15 - 0.5 * np.clip(time - 1.5, 0, 0.5) - 6 * np.clip(time - 2.0, 0, 1)

    recording = crash(straight(0, 0, EAST, speed), straight(40, 0, EAST, 0))
    events = find_events(recording, "Ego", "Other", contact(recording))
    assert events.slows == pytest.approx(1.5, abs=0.11)
    assert events.brakes == pytest.approx(2.0, abs=0.11)


def test_earlier_braking_avoids_a_collision_once_it_stops_in_time():
    # From 15 m/s with 6 m/s² it takes 18.75 m; the front stands at 41 m, so the last moment is at 1.48 s.
    for late, expected in ((0.2, (True, True, True)), (0.4, (False, True, True)), (0.8, (False, False, True))):
        recording = crash(straight(0, 0, EAST, braking(15, 1.48 + late, 6.0)), straight(45, 0, EAST, 0))
        reply = find_reply(recording, "Ego", "Other", contact(recording))
        assert EARLIER == (0.3, 0.5, 1.0)
        assert reply.reply == "brakes"
        assert reply.avoided_by == expected, late


def test_earlier_braking_begins_when_the_other_can_be_seen():
    # It stands behind a wall across the road that vanishes when 20 m are left.
    recording = crash(straight(0, 0, EAST, braking(15, 1.9, 6.0)), straight(45, 0, EAST, 0))
    hidden = crash(
        straight(0, 0, EAST, braking(15, 1.9, 6.0)),
        straight(45, 0, EAST, 0),
        straight(40, 0, EAST, 0, ("misc", 0.5, 30)),
    )
    gone = hidden.time > 1.7
    third = hidden.entity_index("Third0")
    hidden.x[third, gone] = math.nan
    assert find_reply(recording, "Ego", "Other", contact(recording)).avoided_by[-1]
    reply = find_reply(hidden, "Ego", "Other", contact(hidden))
    assert reply.events.sees == pytest.approx(1.75, abs=0.06)
    assert reply.avoided_by == (False, False, False)
    assert reply.seen_too_late


def test_an_ego_that_drives_on_again_is_told_from_one_that_brakes_until_they_touch():
    def speed(time):
        return np.where(time < 4, np.maximum(10 - 8 * np.maximum(time - 2, 0), 0), 3 * (time - 4))

    # It stops before the way of the other, and drives on into it.
    recording = crash(
        straight(-29.75, 0, EAST, speed), straight(0, -44.5, NORTH, lambda t: np.where(t < 2.0, 15.0, 5.0))
    )
    reply = find_reply(recording, "Ego", "Other", contact(recording))
    assert reply.reply == "drives on"
    assert reply.events.brakes == pytest.approx(2.0, abs=0.11)
    assert reply.avoided
    # What it stopped for was over by then.
    assert reply.reaction is None


def test_without_a_collision_the_closest_point_is_the_last_event():
    whole = crash(straight(-30, 0, EAST, 10), straight(0, -31, NORTH, 10))
    later = replace(whole, collisions=())
    events = find_events(later, "Ego", "Other")
    assert events.contact is None
    assert events.closest == pytest.approx(float(whole.time[-1]), abs=0.06)
    assert events.sees == 0.0


def test_one_that_is_never_there_has_no_events():
    recording = crash(straight(0, 0, EAST, 15), straight(45, 0, EAST, 0))
    events = find_events(recording, "Ego", "Nobody")
    assert (events.sees, events.brakes, events.closest) == (None, None, None)
