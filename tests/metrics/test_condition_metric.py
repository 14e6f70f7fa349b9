"""Conditions that define critical scenarios: parsing and evaluation."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from cornercase._common.errors import InputError
from cornercase.metrics import METRICS, CriticalIf, Expression, measure
from cornercase.metrics._critical_if import find_critical_if_condition
from cornercase.metrics._measure import evaluate_metrics
from helpers.two_cars import met

X = np.arange(6) * 1.0


def run(gap, collides=None):
    """The ego goes 5 m towards a standing car, 4 m long as itself, from which it ends `gap` m away."""
    return met((X, 0.0, 0.0, 10.0), (np.full(6, 9.0 + gap), 0.0, 0.0, 0.0), collides)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ("collision and  not reference:cc-human", "collision and not reference:cc-human"),
        ("not(collision or ttc<1s)and reference:fsm", "not (collision or ttc < 1 s) and reference:fsm"),
        ("1 > ttc", "ttc < 1"),
        ("reference:my.drivers:Calm or drac >= 4", "reference:my.drivers:Calm or drac >= 4"),
        ("not not (collision)", "not not collision"),
        ("collision or collision and ttc < 1", "collision or (collision and ttc < 1)"),
    ],
)
def test_a_condition_has_one_way_of_writing_and_is_read_again_as_the_same(given, text):
    read = CriticalIf.from_text(given)
    assert read.name == f"critical-if:{text}"
    assert CriticalIf.from_text(text).condition == read.condition
    assert find_critical_if_condition(["ttc", read.name]) == text
    assert find_critical_if_condition(["ttc"]) == ""


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("", "give a bound such as ttc > 1.5, or a statement such as 'no collision'"),
        ("colision", "did you mean 'collision'"),
        ("tttc < 1", "did you mean 'ttc'"),
        ("collision and", "collision and\n                 ^"),
        (
            "collision not reference:rss",
            "go on with and, or, -> or until, or end the condition here.\n    collision not reference:rss\n              ^",
        ),
        ("reference cc-human", "a colon and the name of a driver"),
        ("reference:", "the name of a driver"),
        ("(collision", "a closing bracket"),
        ("always (ttc > 1", "a closing bracket"),
        ("ego.speed > 3", "as in always(ego.speed > 3) or eventually(ego.speed > 3)"),
        ("ttc < clearance", "compared with"),
        ("thw < ttc", "compare the score of a metric with a number"),
        ("ttc < 1 m", "ttc is in s"),
        ("not " * 60 + "collision", "nested more than 50"),
        ("collision && ttc < 1", "write 'and' instead of '&&'"),
    ],
)
def test_what_is_no_condition_is_refused_with_what_helps(given, words):
    with pytest.raises(InputError, match="The condition cannot be read") as refused:
        CriticalIf.from_text(given)
    assert words in str(refused.value)


def test_the_score_is_0_or_below_just_where_the_condition_holds():
    parts = {"collision": True, "ttc < 1": False, "reference:a": True, "reference:b": False}
    looked = run(0.0, collides=0.5)
    assert measure(looked, "Ego", "Other", ["ttc"]).scores["ttc"] == 0.0
    parts["ttc < 1"] = True
    forms = ("{} and {}", "{} or {}", "not {} and {}", "{} and not ({} or {})", "not ({} and {}) or {}")
    for form in forms:
        for names in itertools.permutations(parts, form.count("{}")):
            text = form.format(*names)
            made = CriticalIf.from_text(text)
            outcomes = {name: parts[f"reference:{name}"] for name in made.reference_drivers}
            # Python reads it the same way, with brackets where names would not be any.
            expected = eval(form.format(*(str(parts[name]) for name in names)))
            found = made.evaluate(looked, "Ego", "Other")
            assert found.is_fulfilled(outcomes) is expected, text
            assert (found.score(outcomes) <= 0.0) is expected, text


def test_the_distance_from_a_collision_is_the_clearance_and_a_reference_decides_without_any():
    made = CriticalIf.from_text("collision and not reference:cc-human")
    assert (made.unit, made.cap, made.default_threshold, made.lower_is_critical) == ("m", 100.0, 0.0, True)
    far, touch = made.evaluate(run(3.0), "Ego", "Other"), made.evaluate(run(0.0, collides=0.5), "Ego", "Other")
    assert far.score({}) == pytest.approx(3.0)
    assert far.next_reference_to_run({}) is None
    assert touch.next_reference_to_run({}) == "cc-human"
    assert touch.score({"cc-human": False}) == 0.0
    assert touch.score({"cc-human": True}) == touch.score({"cc-human": None}) == made.cap
    # Touching boxes without a recorded collision do not count.
    assert made.evaluate(run(0.0), "Ego", "Other").score({}) > 0.0


def test_bounds_are_on_scores_and_their_margins_are_combined():
    close = run(3.0)
    scores = measure(close, "Ego", "Other", ["clearance", "ttc"]).scores
    both, either = (
        CriticalIf.from_text("clearance < 1 and ttc < 0.2"),
        CriticalIf.from_text("clearance < 1 or ttc < 0.2"),
    )
    gaps = scores["clearance"] - 1.0, scores["ttc"] - 0.2
    assert both.unit == "1"
    assert both.evaluate(close, "Ego", "Other").score({}) == pytest.approx(max(gaps))
    assert either.evaluate(close, "Ego", "Other").score({}) == pytest.approx(min(gaps))
    at = CriticalIf.from_text(f"clearance < {scores['clearance']!r}").evaluate(close, "Ego", "Other")
    up_to = CriticalIf.from_text(f"clearance <= {scores['clearance']!r}").evaluate(close, "Ego", "Other")
    assert at.score({}) > 0.0 >= up_to.score({})


def test_only_the_reference_that_decides_is_asked():
    touch = run(0.0, collides=0.5)
    made = CriticalIf.from_text(
        "(clearance > 50 and not reference:a) or (collision and not reference:b and not reference:c)"
    )
    looked = made.evaluate(touch, "Ego", "Other")
    assert looked.next_reference_to_run({}) == "b"
    assert looked.next_reference_to_run({"b": True}) is None
    assert looked.next_reference_to_run({"b": False}) == "c"
    assert looked.next_reference_to_run({"b": None, "c": False}) == "a"


def test_the_course_goes_to_0_at_the_collision_and_is_not_defined_without_the_other():
    touch = run(0.0, collides=0.3)
    made = CriticalIf.from_text("collision and not reference:cc-human")
    course = made.course(touch, "Ego", "Other")
    np.testing.assert_allclose(course, [5.0, 4.0, 3.0, 0.0, 1.0, 0.0])
    touch.x[1, :2] = np.nan
    assert np.isnan(made.course(touch, "Ego", "Other")).tolist() == [True, True, False, False, False, False]


def test_a_recording_alone_cannot_be_measured_by_it():
    for asked in (["critical-if:collision"], ["critical-if:collision and not reference:fsm"]):
        with pytest.raises(InputError, match="critical_if"):
            measure(run(1.0), "Ego", "Other", asked)
    with pytest.raises(InputError, match="cannot be used in an expression"):
        Expression.parse("critical-if < 1")
    made = CriticalIf.from_text("collision")
    assert set(evaluate_metrics([made], run(1.0), "Ego", "Other")) == {made.name}


@pytest.mark.parametrize("bound", ["ttc < 10", "clearance < 100", "delta-v > 0", "drac > 0", "thw < 10", "ttc < 9.5"])
def test_a_bound_at_the_cap_of_its_metric_is_critical_where_it_holds_alone(bound):
    apart = met((-X, 0.0, 0.0, -10.0), (np.full(6, 500.0), 0.0, 0.0, 0.0))
    for text in (bound, f"{bound} and not reference:cc-human"):
        made = CriticalIf.from_text(text)
        found = made.evaluate(apart, "Ego", "Other")
        assert found.is_fulfilled({}) is False
        assert 0.0 < found.score({}) <= made.cap
    # The score distinguishes runs far beyond the bound from runs near it.
    near, nearer = (CriticalIf.from_text(bound).evaluate(run(gap), "Ego", "Other") for gap in (3.0, 2.0))
    if bound.startswith(("ttc", "clearance", "thw")):
        assert nearer.score({}) < near.score({}) < 0.0


@pytest.mark.parametrize("signal", ["ego.lateral_acceleration", "lateral acceleration", "other.lateral_acceleration"])
def test_a_condition_knows_the_signals_that_formulas_know(signal):
    recording = run(3.0)
    (condition,) = evaluate_metrics([CriticalIf(f"always({signal} < 3)")], recording, "Ego", ["Other"]).values()
    (formula,) = evaluate_metrics([METRICS.create(f"stl:always({signal} < 3)")], recording, "Ego", ["Other"]).values()
    # What makes a condition critical fulfils a formula.
    assert -condition.score == formula.score == pytest.approx(3.0)
