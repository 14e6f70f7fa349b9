"""Whose fault a collision is: cases with a known answer, and what must not change it."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import examples
from cornercase.metrics.fault._find_fault import find_fault
from cornercase.recordings import Collision
from helpers.crash import CAR, PEDESTRIAN, crash, moved, straight, swapped, turned

EAST, NORTH, WEST, SOUTH = 0.0, math.pi / 2, math.pi, -math.pi / 2
X_ROADS = Path(__file__).parents[2] / "examples" / "x_intersection" / "x_intersection.xodr"
MIRRORED_SIDES = {"left": "right", "right": "left"}


def braking(speed, since, deceleration):
    return lambda time: np.maximum(speed - deceleration * np.maximum(time - since, 0.0), 0.0)


def starting(speed, since, acceleration):
    return lambda time: np.clip(acceleration * (time - since), 0.0, speed)


def cut_in(gap, slower):
    """A car that is slower by 10 m/s changes into the lane of the ego, `gap` m ahead of it at the intrusion."""
    # Boxes of 2 m width overlap from 2 m on: half of the way of 3 m is beyond the third of the time.
    begin, end = 3.0, 4.5
    intrusion = begin + (end - begin) / 3.0
    x = gap + 4.0 + slower * intrusion
    return straight(0.0, 0.0, EAST, 25.0), moved(straight(x, 3.0, EAST, 25.0 - slower), -3.0, begin, end)


# Ego, other (and obstacles); whose fault it is, the conflict, and the sides that are hit.
CASES = {
    "runs into a slower one": (
        (straight(0, 0, EAST, 15), straight(40, 0, EAST, 5)), "ego", "rear end", ("front", "rear")),
    "runs into one that brakes": (
        (straight(0, 0, EAST, 15), straight(20, 0, EAST, braking(15, 1.0, 6.0))), "ego", "rear end", ("front", "rear")),
    "is hit from behind": (
        (straight(40, 0, EAST, 5), straight(0, 0, EAST, 15)), "other", "rear end", ("rear", "front")),
    "is hit from behind after it braked to standing": (
        (straight(30, 0, EAST, braking(15, 0.5, 8.0)), straight(0, 0, EAST, 15)), "other", "standing", ("rear", "front")),
    "stands and is hit": (
        (straight(40, 0, EAST, 0), straight(0, 0, EAST, 10)), "other", "standing", ("rear", "front")),
    "runs into an obstacle": (
        (straight(0, 0, EAST, 10), straight(40, 0, EAST, 0, ("misc", 1.0, 1.0))), "ego", "standing", ("front", "rear")),
    "backs into a parked one": (
        (straight(0, 0, EAST, -2), straight(-10, 0, EAST, 0)), "ego", "standing", ("rear", "front")),
    "backs out in front of one that drives": (
        (straight(0, 0, EAST, -2), straight(-8.4, -20, NORTH, 5.0)), "ego", "reversing", ("right", "front")),
    "comes later and hits the side of one that crosses": (
        (straight(-45, 0, EAST, 10), straight(0, -30, NORTH, 7)), "ego", "crossing", ("front", "left")),
    "is there first and is hit at its side": (
        (straight(0, -30, NORTH, 7), straight(-45, 0, EAST, 10)), "other", "crossing", ("left", "front")),
    "starts from standing in front of one without time": (
        (straight(0, -3.2, NORTH, starting(3, 3.4, 3.0)), straight(-74, 0, EAST, 15)), "ego", "crossing", None),
    "turns across the path of one that comes towards it": (
        (moved(straight(-40, -1.75, EAST, 8), 6.0, 3.5, 5.5), straight(50, 1.75, WEST, 10)), "ego", "turning", None),
    "keeps its lane and meets one that leaves its own": (
        (straight(-60, 0, EAST, 10), moved(straight(60, 3.5, WEST, 10), 3.5, 4.0, 5.4)), "other", "oncoming", None),
    "leaves its lane towards one that comes": (
        (moved(straight(-60, 0, EAST, 10), 3.5, 4.0, 5.4), straight(60, 3.5, WEST, 10)), "ego", "oncoming", None),
    "comes towards one in the same lane": (
        (straight(-60, 0, EAST, 10), straight(60, 0, WEST, 10)), "undecided", "oncoming", ("front", "front")),
    "changes into the lane of one beside it": (
        (moved(straight(0, 0, EAST, 20), 3.0, 2.0, 5.0), straight(0, 3.0, EAST, 20)), "ego", "lane change", None),
    "is beside one that changes into its lane": (
        (straight(0, 3.0, EAST, 20), moved(straight(0, 0, EAST, 20), 3.0, 2.0, 5.0)), "other", "lane change", None),
    "moves sideways towards one that does, too": (
        (moved(straight(0, 0, EAST, 20), 1.5, 2.0, 5.0), moved(straight(0, 3.0, EAST, 20), -1.5, 2.0, 5.0)),
        "both", "lane change", ("left", "right")),
    "meets a cut-in with time to react": (cut_in(20.0, 10.0), "ego", "rear end", ("front", "rear")),
    "meets a cut-in without time to react": (cut_in(9.0, 10.0), "other", "rear end", ("front", "rear")),
    "hits a pedestrian who could be seen": (
        (straight(-60, 0, EAST, 10), straight(0, -9.0, NORTH, 1.5, PEDESTRIAN)), "ego", "pedestrian", None),
    "hits a pedestrian who comes from behind an obstacle": (
        (straight(-60, 0, EAST, 10), straight(0, -9.0, NORTH, 1.5, PEDESTRIAN), straight(-4, -2.6, EAST, 0, CAR)),
        "other", "pedestrian", None),
    "hits a pedestrian who comes from behind an obstacle far off": (
        (straight(-60, 0, EAST, 10), straight(0, -9.0, NORTH, 1.5, PEDESTRIAN), straight(-4, -6.6, EAST, 0, CAR)),
        "ego", "pedestrian", None),
    "stands and a pedestrian walks into it": (
        (straight(-30, 0, EAST, braking(10, 1.0, 5.0)), straight(-12, -9.3, NORTH, 1.5, PEDESTRIAN)),
        "other", "standing", ("right", "front")),
}  # fmt: skip


def judged(recording):
    return find_fault(recording, "Ego", recording.collisions[0])


@pytest.mark.parametrize("case", CASES)
def test_cases_with_a_known_answer(case):
    road_users, who, conflict, sides = CASES[case]
    fault = judged(crash(*road_users))
    assert (fault.who, fault.conflict) == (who, conflict), fault
    if sides is not None:
        assert fault.sides == sides, fault
    assert all(re.fullmatch(r"[^{}.]+(\.\d[^{}.]*)*", reason) for reason in fault.reasons), fault.reasons


@settings(max_examples=examples(40), deadline=None)
@given(st.sampled_from(sorted(CASES)), st.floats(-4.0, 4.0), st.booleans())
def test_neither_roles_nor_direction_nor_mirroring_matter(case, angle, mirror):
    recording = crash(*CASES[case][0])
    fault, other = judged(recording), judged(swapped(turned(recording, angle, mirror)))
    assert other.who == {"ego": "other", "other": "ego"}.get(fault.who, fault.who), (fault, other)
    assert other.conflict == fault.conflict
    expected = [MIRRORED_SIDES.get(side, side) if mirror else side for side in fault.sides[::-1]]
    assert list(other.sides) == expected
    cos, sin = math.cos(angle), math.sin(angle)
    x, y = fault.point[0], -fault.point[1] if mirror else fault.point[1]
    # A corner of boxes that are parallel may count or not.
    assert other.point == pytest.approx((cos * x - sin * y, sin * x + cos * y), abs=0.1)


@settings(max_examples=examples(40), deadline=None)
@given(st.floats(2.0, 30.0), st.floats(-1.0, 1.0))
def test_a_cut_in_is_judged_by_the_condition_of_the_regulation(gap, shift):
    closing = 10.0
    ego, other = cut_in(gap, closing)
    recording = crash(ego, other)
    least = closing / 12.0 + 0.35
    # Instants of 0.1 s, and a box that is turned.
    if abs(gap / closing - least) < 0.15:
        return
    fault = judged(recording)
    if fault.conflict == "rear end":
        assert fault.who == ("ego" if gap / closing > least else "other"), fault


def test_the_point_of_contact_is_where_the_boxes_touch():
    fault = judged(crash(straight(0, 0, EAST, 15), straight(40, 1.0, EAST, 5)))
    recording = crash(straight(0, 0, EAST, 15), straight(40, 1.0, EAST, 5))
    # Bumper to bumper: 36 m at 10 m/s; half of the other overlaps.
    assert fault.point == pytest.approx((15 * 3.6 + 2.0, 0.5), abs=0.1)
    assert recording.time[-1] == pytest.approx(3.6, abs=0.05)


def test_what_the_motion_does_not_show_is_undecided():
    recording = crash(straight(0, 0, EAST, 15), straight(40, 0, EAST, 5))
    (hit,) = recording.collisions
    far = replace(recording, x=recording.x + np.array([[0.0], [9.0]]))
    assert judged(far).reasons == ("their boxes do not touch in the recording",)
    unknown = replace(recording, speed=np.full_like(recording.speed, np.nan))
    assert judged(unknown).reasons == ("their motion is unknown",)
    late = replace(recording, collisions=(Collision(recording.time[0], hit.entities),), x=recording.x * 0.0)
    assert judged(late).reasons == ("they touch from the beginning",)
    for one in (far, unknown, late):
        assert judged(one).who == "undecided"
    # The last half second shows who hits whom, but not who could have acted.
    crossing = crash(straight(-45, 0, EAST, 10), straight(0, -30, NORTH, 7))
    short = slice(-10, None)
    arrays = {name: getattr(crossing, name)[:, short] for name in ("x", "y", "heading", "speed", "acceleration")}
    assert judged(replace(crossing, time=crossing.time[short], **arrays)).who == "undecided"


def test_a_contact_that_is_reported_late_or_with_other_shapes_counts():
    recording = crash(straight(0, 0, EAST, 15), straight(40, 0, EAST, 5), straight(0, 50, EAST, 15))
    late = replace(recording, collisions=(Collision(float(recording.time[-1]), ("Ego", "Other")),))
    apart = replace(recording, length=recording.length - np.array([0.2, 0.2, 0.0]))
    assert judged(late).who == judged(apart).who == "ego"


def test_a_simulation_that_goes_on_after_the_contact_gives_the_same():
    road_users = CASES["comes later and hits the side of one that crosses"][0]
    recording = crash(*road_users)
    arrays: dict[str, Any] = {
        name: np.hstack([getattr(recording, name), np.repeat(getattr(recording, name)[:, -1:], 39, axis=1)])
        for name in ("x", "y", "heading", "speed", "acceleration")
    }
    later = recording.time[-1] + 0.05 * np.arange(1, 40)
    longer = replace(recording, time=np.append(recording.time, later), **arrays)
    assert judged(longer) == judged(recording)


def at_the_crossing(tmp_path, replacement):
    """Both cross straight, from the south and the west; nobody could avoid the other for long."""
    text = X_ROADS.read_text(encoding="utf-8")
    roads = tmp_path / "roads.xodr"
    roads.write_text(replacement(text), encoding="utf-8")
    recording = crash(straight(1.75, -30, NORTH, 7.5, until=6), straight(-36.25, -1.75, EAST, 10, until=6))
    return judged(replace(recording, road_file=roads))


@pytest.mark.parametrize(("high", "low"), [("1", "4"), ("102", "111"), ("4", "1"), ("111", "102")])
def test_the_priorities_of_a_junction_say_who_yields(tmp_path, high, low):
    fault = at_the_crossing(
        tmp_path, lambda text: text.replace("</junction>", f'<priority high="{high}" low="{low}"/></junction>')
    )
    yields = "Other" if high in ("1", "102") else "Ego"
    assert fault.who == ("other" if yields == "Other" else "ego"), fault
    assert f"{yields} has to yield" in fault.reasons[0]


@pytest.mark.parametrize("signs", ["205", "206"])
@pytest.mark.parametrize("road", ["1", "4"])
def test_signs_before_a_junction_say_who_yields(tmp_path, signs, road):
    sign = f'<signals><signal s="95" t="-4" id="9" type="{signs}" country="DE" orientation="+" dynamic="no"/></signals>'

    def with_sign(text):
        begin = text.index(f'<road name="arm {road}"')
        end = text.index("</road>", begin)
        return text[:end] + sign + text[end:]

    fault = at_the_crossing(tmp_path, with_sign)
    assert fault.who == ("ego" if road == "1" else "other"), fault


@pytest.mark.parametrize("rule", ["RHT", "LHT"])
def test_without_signs_who_comes_from_the_right_goes_first(tmp_path, rule):
    fault = at_the_crossing(tmp_path, lambda text: text.replace('rule="RHT"', f'rule="{rule}"'))
    # The ego drives north, and the other comes from its left.
    assert fault.who == ("other" if rule == "RHT" else "ego"), fault
    yields, first = ("Other", "Ego") if rule == "RHT" else ("Ego", "Other")
    assert fault.reasons[0].startswith(f"{yields} has to yield to {first} at the junction")


@pytest.mark.parametrize(("high", "who"), [("1", "other"), ("4", "ego")])
def test_who_stops_in_the_way_of_one_that_goes_first_is_at_fault(tmp_path, high, who):
    """The ego creeps into the crossing from the south, and stands there for 3 s until the other drives into it."""
    low = "4" if high == "1" else "1"
    text = X_ROADS.read_text(encoding="utf-8")
    roads = tmp_path / "roads.xodr"
    roads.write_text(text.replace("</junction>", f'<priority high="{high}" low="{low}"/></junction>'), encoding="utf-8")
    ego = straight(1.75, -15.0, NORTH, braking(7.5, 1.0, 5.0), until=9)
    recording = crash(ego, straight(-60, -1.75, EAST, 10, until=9))
    fault = judged(replace(recording, road_file=roads))
    assert fault.who == who, fault
    assert judged(recording).who == "other"


def test_roads_say_who_is_on_the_wrong_side(tmp_path):
    recording = crash(straight(-90, -1.75, EAST, 10, until=4), straight(-20, -1.75, WEST, 10, until=4))
    assert judged(recording).who == "undecided"
    fault = judged(replace(recording, road_file=X_ROADS))
    assert fault.who == "other", fault
    assert fault.reasons == ("Other is on the wrong side of the road",)
    # A file that is gone says nothing.
    assert judged(replace(recording, road_file=tmp_path / "gone.xodr")).who == "undecided"


BEND = """<OpenDRIVE><header revMajor="1" revMinor="6"/><road id="1" length="300" junction="-1"><planView>
<geometry s="0" x="0" y="0" hdg="0" length="300"><arc curvature="0.0025"/></geometry></planView><lanes><laneSection s="0">
<center><lane id="0" type="none"/></center><right>
<lane id="-1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>
<lane id="-2" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane></right></laneSection></lanes></road></OpenDRIVE>"""


def in_the_bend(start, aside, speed, until=6.0):
    """Drive along the bend with a radius of 400 m to the left; `aside` is a function of time, in m to its right."""
    kind, time, driven, _, _, speeds = straight(start, 0.0, EAST, speed, until=until)
    radius, angle = 400.0 + aside(time), driven / 400.0
    x, y = radius * np.sin(angle), 400.0 - radius * np.cos(angle)
    return kind, time, x, y, angle - np.gradient(aside(time), time) / speed, speeds


def test_who_keeps_its_lane_in_a_bend_does_not_move_sideways(tmp_path):
    roads = tmp_path / "bend.xodr"
    roads.write_text(BEND)
    ego = in_the_bend(0.0, lambda time: np.full(len(time), 5.25), 25.0)
    truck = in_the_bend(78.0, lambda time: 1.75 + 3.5 * np.clip((time - 4.0) / 1.5, 0.0, 1.0), 9.0)
    recording = crash(ego, truck)
    fault = judged(replace(recording, road_file=roads))
    assert fault.who == "other", fault
    assert judged(swapped(replace(recording, road_file=roads))).who == "ego"
