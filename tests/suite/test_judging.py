"""Verdicts against motions whose answer is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import examples
from cornercase import InputError
from cornercase.metrics import Expression, Signals
from cornercase.metrics._evaluation import Evaluation
from cornercase.metrics.expressions._ast import Bound
from cornercase.suite import Requirement, judge
from helpers.two_cars import met

FORMULAS = (
    "ego.speed > 0",
    "always(clearance > 1)",
    "not (eventually[0.2:](ego.speed < 1))",
    "eventually[0.1:0.3](clearance > 0 and ego.speed <= 1)",
    "(ego.speed >= 0) until[0:0.3] (clearance < 0)",
    "always(ego.speed > 1) or eventually(clearance < -1)",
    "always[0:0.2](eventually[0:0.2](ego.speed > 0))",
    "ego.speed > 1 -> eventually[0.3:](clearance > 2)",
)
FAR = (np.full(6, 100.0), 0.0, 0.0, 0.0)


def judged(requirement, recording):
    return judge(Requirement.parse(requirement), recording, "Ego", "Other")


def along(x, speed=10.0):
    return (x, 0.0, 0.0, speed)


# Six instants, 0.1 s apart: who drives where at the contact, and whether the ego is at fault; None is undecided, as half
# a second does not show who came first, or who left its line.
DRIVES = np.arange(6) * 1.0
CONTACTS = {
    "runs into one ahead": (along(DRIVES), along(np.full(6, 8.5), 0.0), True),
    "is hit from behind": (along(np.full(6, 8.5), 0.0), along(DRIVES), False),
    "is hit from behind by a faster one": (along(8.5 + 0.5 * DRIVES, 5.0), along(2.0 * DRIVES - 2.0, 20.0), False),
    "backs into one behind": (along(-DRIVES, -10.0), along(np.full(6, -8.5), 0.0), True),
    "stands on a crossing": (along(np.zeros(6), 0.0), (0.0 * DRIVES, DRIVES - 7.5, math.pi / 2, 10.0), False),
    "is hit at its side": (along(DRIVES), (DRIVES[::-1] * 0 + 5.0, DRIVES - 7.5, math.pi / 2, 10.0), None),
    "hits the side of one that crosses": (along(DRIVES), (np.full(6, 7.5), DRIVES - 4.0, math.pi / 2, 10.0), None),
    "head-on": (along(DRIVES), (12.5 - DRIVES, 0.0, math.pi, 10.0), None),
    "changes into the lane of one beside it": (
        (DRIVES * 0 + 10.0 * np.arange(6), 0.22 * np.arange(6), 0.022, 100.0),
        (10.0 * np.arange(6), np.full(6, 3.0), 0.0, 100.0),
        None,
    ),
    "is beside one that changes into its lane": (
        (10.0 * np.arange(6), np.full(6, 0.0), 0.0, 100.0),
        (10.0 * np.arange(6), 3.0 - 0.22 * np.arange(6), -0.022, 100.0),
        None,
    ),
}


@pytest.mark.parametrize("case", CONTACTS)
def test_the_one_who_drives_into_the_other_is_at_fault(case):
    ego, other, at_fault = CONTACTS[case]
    recording = met(ego, other, collides=0.5)
    found = judged("no collision at fault", recording)
    assert found.state == {True: "failed", False: "passed", None: "inconclusive"}[at_fault], found.reason
    assert "Ego and Other collide at 0.5 s" in found.reason
    # It is a collision, whoever is at fault.
    assert judged("no collision", recording).state == "failed"
    assert judged("no collision with Other", recording).time == 0.5


def test_no_collision_is_passed_where_nobody_is_touched_and_open_where_nobody_was_there():
    assert judged("no collision", met(along(DRIVES), FAR)).state == "passed"
    never = met(along(np.full(6, np.nan)), FAR)
    assert judged("no collision", never).reason == "Ego is never present"
    assert {judged(one, never).state for one in ("no collision", "no collision at fault", "reach 0,0 within 1")} == {
        "inconclusive"
    }
    absent = met(along(DRIVES), (np.full(6, np.nan), 0.0, 0.0, 0.0))
    assert judged("no collision with Other", absent).state == "inconclusive"
    assert judged("no collision", absent).state == "passed"


def test_nobody_to_judge_against_is_refused():
    with pytest.raises(InputError, match="`other`: is empty; name at least one entity"):
        judge(Requirement.parse("no collision"), met(along(DRIVES), FAR), "Ego", ())


@pytest.mark.parametrize(
    ("requirement", "state", "time", "value"),
    [
        ("reach 4,0,0.5 within 1", "passed", 0.4, 0.0),
        ("reach 4,0,1.5 within 0.3", "passed", 0.3, 1.0),
        ("reach 4,3,1 within 0.5", "failed", 0.4, 3.0),
        # What is observed ends before the time is over.
        ("reach 9,0,1 within 2 s", "inconclusive", 0.5, 4.0),
    ],
)
def test_a_place_is_reached_in_time_or_not_or_nobody_knows(requirement, state, time, value):
    found = judged(requirement, met(along(DRIVES), FAR))
    assert (found.state, found.time, found.value) == (state, pytest.approx(time), pytest.approx(value))


def test_a_bound_names_the_worst_instant_and_the_value_there():
    # 20 m behind one that stands, 4 m long each: the gap closes from 16 m at 10 m/s.
    recording = met(along(DRIVES), along(np.full(6, 20.0), 0.0))
    found = judged("ttc > 1.45", recording)
    assert found.reason == "ttc falls to 1.1 s at 0.5 s, below 1.45 s, first at 0.2 s"
    assert (found.time, found.value) == (0.5, pytest.approx(1.1))
    assert judged("ttc > 1", recording).reason == "ttc is 1.1 s at least, at 0.5 s"
    assert judged("ego.speed < 36 km/h", recording).state == "failed"
    assert judged("ego.speed <= 36 km/h", recording).state == "passed"
    assert (
        judged("ego.speed < 36 km/h", recording).reason
        == "ego.speed rises to 10 m/s at 0 s, not below 10 m/s (36 km/h)"
    )
    said = "ego.speed rises to 10 m/s at 0 s, above other.speed, which is 0 m/s"
    assert judged("ego.speed < other.speed", recording).reason == said
    assert judged("No Collision", recording).requirement == "no collision"


def test_a_bound_on_what_never_arose_is_open():
    apart = met(along(-DRIVES, -10.0), along(np.full(6, 20.0), 0.0))
    found = judged("pet >= 1", apart)
    assert (found.state, found.reason) == ("inconclusive", "what pet >= 1 refers to never occurred")
    # They are not on a collision course, which is known.
    assert judged("ttc > 1.5", apart).reason == "ttc is infinite throughout"


def test_temporal_logic_names_the_number_that_decides():
    recording = met(along(DRIVES), along(np.full(6, 20.0), 0.0))
    found = judged("always[0:0.3] (clearance > 14)", recording)
    assert (found.state, found.time, found.value) == ("failed", pytest.approx(0.3), pytest.approx(13.0))
    assert found.reason.endswith("does not hold: clearance is 13 m at 0.3 s, compared with 14 m")
    assert judged("eventually (clearance < 12)", recording).state == "passed"
    # At 0 s the clearance is as far above 15 m as it is below at 0.2 s: what decides is in the interval.
    found = judged("not (eventually[0.2:] (clearance <= 14))", recording)
    assert (found.state, found.time, found.value) == ("failed", pytest.approx(0.5), pytest.approx(11.0))
    found = judged("always[0:0.1] (clearance > 3) or eventually[9:10] (clearance > 3)", recording)
    assert (found.state, found.time, found.value) == ("passed", pytest.approx(0.1), pytest.approx(15.0))
    assert judged("eventually[9:10] (clearance > 3)", recording).reason.endswith("the interval contains no sample")


@settings(max_examples=examples(25), deadline=None)
@given(st.lists(st.integers(-3, 3), min_size=12, max_size=12), st.sampled_from(FORMULAS))
def test_what_decides_is_the_robustness_and_changes_it(values, text):
    formula = Expression.parse(text)
    time = np.arange(6) * 0.1
    signals = Signals(time, {"ego.speed": np.array(values[:6], float), "clearance": np.array(values[6:], float)})
    robustness = formula.robustness(signals)[0]
    evaluation = Evaluation.from_signals(formula.root, signals)
    found = evaluation.find_decisive_leaf()
    assert (found is None) == bool(np.isinf(robustness))
    if found is not None:
        one, k = found
        assert isinstance(one, Bound)
        assert abs(evaluation.leaves[one].margin[k]) == abs(robustness)
        # Another number there and at the earlier ones that are alike, and it is another robustness.
        name = one.left.name
        alike = np.flatnonzero(signals.values[name][: k + 1] == signals.values[name][k])
        changed = []
        for step in (0.25, -0.25):
            other = signals.values[name].copy()
            other[alike] += step
            changed.append(formula.robustness(Signals(time, {**signals.values, name: other}))[0] != robustness)
        assert any(changed)


@pytest.mark.parametrize(
    ("requirement", "words"),
    [
        ("no colision", "give collision, as in 'no collision'"),
        ("no collision with", "give the name of an entity"),
        ("reach 3 within 5", "as in 'reach X,Y"),
        ("reach 3,4 within 5 km", "this number is in s: the unit 'km' does not fit"),
        ("reach 3,4,0 within 5", "a positive radius and time"),
        ("tcc > 1.5", "ttc"),
        ("ttc > 1.5 m", "unit 'm' does not fit"),
        ("ttc >", "ttc >"),
        ('for " ": ttc > 1', "is empty or not quoted as in JSON"),
        (r'for "\*": ttc > 1', "not quoted as in JSON"),
        ("not " * 60 + "(ttc > 1)", "nested more than"),
        ("for *:no collision", "with a space after the colon"),
        ("", "give a text"),
    ],
)
def test_what_is_no_requirement_is_refused(requirement, words):
    with pytest.raises(InputError) as error:
        Requirement.parse(requirement)
    assert words in str(error.value)


def test_a_requirement_may_be_for_some_files_only():
    one = Requirement.parse("for run-*.xosc: no  collision with  Van 2")
    assert one.text == "for run-*.xosc: no collision with Van 2"
    assert Requirement.parse(one.text) == one
    assert one.applies_to("run-12.xosc")
    assert not one.applies_to("other.xosc")
    assert one.expression.entities == ("Van 2",)


@pytest.mark.parametrize(
    ("given", "text", "file", "kind"),
    [
        ('for  "my run: [1] *.xosc":  no collision', 'for "my run: [1] *.xosc": no collision', "my run: [1] 2.xosc", ""),
        ('for "run-*": no collision', "for run-*: no collision", "run-1", ""),
        ("for C:run?: no collision", "for C:run?: no collision", "C:run1", ""),
        ("for kind: no collision", "for kind: no collision", "kind", ""),
        ('for kind "Ego *, closely": ttc > 1', 'for kind "Ego *, closely": ttc > 1', "x", "Ego yields to C, closely"),
        ("for kind late*: ttc > 1", 'for kind "late*": ttc > 1', "x", "late"),
        (r'for kind "Ego yields to \"C: 1\"": ttc > 1', r'for kind "Ego yields to \"C: 1\"": ttc > 1', "x", 'Ego yields to "C: 1"'),
    ],
)  # fmt: skip
def test_a_requirement_may_be_for_a_kind_and_names_may_be_of_several_words(given, text, file, kind):
    one = Requirement.parse(given)
    assert one.text == text
    assert Requirement.parse(one.text) == one
    assert one.applies_to(file, kind)
    assert not one.applies_to(f"no {file}", f"no {kind}")
    assert one.is_for_clusters == bool(kind)
