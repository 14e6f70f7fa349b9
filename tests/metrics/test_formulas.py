"""The language of formulas, and formulas without temporal operators."""

from __future__ import annotations

import numpy as np
import pytest

from cornercase._common.errors import InputError
from cornercase.metrics import METRICS, Formula, Signals, measure, signals_from_recording
from helpers.oracle import actor, recorded

TIME = np.array([0.0, 0.1, 0.2, 0.3])


def signals(**values):
    named = {name.replace("__", "."): np.array(one, dtype=float) for name, one in values.items()}
    return Signals(TIME, named)


@pytest.mark.parametrize(
    ("text", "canonical", "metrics", "unit", "temporal"),
    [
        ("ttc>1.5", "ttc > 1.5", ("ttc",), "s", False),
        ("1.5<ttc", "ttc > 1.5", ("ttc",), "s", False),
        ("ego.acceleration>=-4m/s^2", "ego.acceleration >= -4 m/s²", (), "m/s²", False),
        ("abs( ego.acceleration )<0.3 g", "abs(ego.acceleration) < 0.3 g", (), "m/s²", False),
        ("not ttc<1or pet:signed=true>2", "not(ttc < 1) or pet:signed=true > 2", ("ttc", "pet:signed=true"), "s", False),
        ("always [0,5s] clearance > 0.5", "always[0:5](clearance > 0.5)", ("clearance",), "m", True),
        (
            "always[2:](ttc<3->eventually[0:500 ms] ego.acceleration<-1)",
            "always[2:](ttc < 3 -> eventually[0:0.5](ego.acceleration < -1))", ("ttc",), "1", True,
        ),
        ("rss:response_time=0.5,min_braking=5 > 0", "rss:response_time=0.5,min_braking=5 > 0",
         ("rss:response_time=0.5,min_braking=5",), "m", False),
        # `and` binds more than `or`, and that more than `->`.
        ("hw>1 and thw>1 or ttc>1 -> pet>1", "((hw > 1 and thw > 1) or ttc > 1) -> pet > 1",
         ("hw", "thw", "ttc", "pet"), "1", False),
        # The unary operators bind most.
        ("always ttc>1 and pet>1", "always(ttc > 1) and pet > 1", ("ttc", "pet"), "s", True),
        ("a-long-req<ego.acceleration until ego.speed<other.speed",
         "a-long-req < ego.acceleration until ego.speed < other.speed", ("a-long-req",), "1", True),
    ],
)  # fmt: skip
def test_formulas_are_read_and_written_in_one_way(text, canonical, metrics, unit, temporal):
    formula = Formula.parse(text)
    assert (formula.text, formula.metrics, formula.unit, formula.is_temporal) == (canonical, metrics, unit, temporal)
    again = Formula.parse(formula.text)
    assert again == formula or text.count("s^2") + text.count("ms") + text.count("5s") > 0
    assert again.text == canonical


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "at its end: give a comparison"),
        ("ttc", "at its end: give a comparison of 'ttc'"),
        ("tttc > 1", "at 'tttc > 1': there is no signal 'tttc'; did you mean 'ttc'"),
        ("ttc > 1 and ego.sped < 3", "at 'ego.sped < 3': there is no signal 'ego.sped'; did you mean 'ego.speed'"),
        ("alwys(ttc > 1)", "did you mean 'always'"),
        ("ttc > 1 adn pet > 1", "did you mean 'and'"),
        ("pet:sined=true > 1", "has no option 'sined'; did you mean 'signed'"),
        ("ttc > 5 m", "at 'm': ttc is in s: the unit 'm' does not fit; give s, ms, min"),
        ("ego.speed < 5 kmh", "there is no unit 'kmh'; did you mean 'km/h'"),
        ("ttc > clearance", "'ttc' in s is compared with 'clearance' in m"),
        ("1 < ttc < 5", "compare two at a time"),
        ("3 > 2", "two numbers are compared"),
        ("ttc == 1", "write <= or >= for =="),
        ("ttc > 1 && pet > 1", "write and for &&"),
        ("(ttc > 1", "at its end: give a closing bracket"),
        ("ttc > 1)", "this bracket has no opening bracket"),
        ("always[5:2](ttc > 1)", "ends at 2 s, before it begins at 5 s"),
        ("always[-1:2](ttc > 1)", "begin at 0 s or later"),
        ("always[0:1 m](ttc > 1)", "at 'm](ttc > 1)': intervals are in s"),
        ("ttc > 1 until pet > 1 until hw > 1", "brackets around one of the two"),
        ("ttc > 1e999", "too large"),
        ("stl:x > 1", "write the formula itself"),
        ("(" * 60 + "ttc > 1" + ")" * 60, "nested more than 50 deep"),
        ("not " * 60 + "ttc > 1", "nested more than 50 deep"),
        ("ttc > 1 -> " * 60 + "ttc > 1", "nested more than 50 deep"),
        ("ttc > 1 and " * 2000, "characters; give 10000 at most"),
        ("ttc § 1", "'§' is no part of a formula"),
    ],
)
def test_what_is_no_formula_is_refused_with_its_place_and_what_helps(text, sentence):
    with pytest.raises(InputError) as refused:
        Formula.parse(text)
    assert sentence in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_long_conjunction_is_no_deep_one():
    text = " and ".join(["hw>1"] * 200)
    found = Formula.parse(text).robustness(signals(hw=[3, 2, 4, 5]))
    np.testing.assert_array_equal(found, [1, 1, 3, 4])


@pytest.mark.parametrize(
    ("text", "metres_per_second"),
    [("36 km/h", 10.0), ("10", 10.0), ("10 m/s", 10.0), ("22.369362920544 mph", 10.0)],
)
def test_numbers_have_units(text, metres_per_second):
    found = Formula.parse(f"ego.speed <= {text}").robustness(signals(ego__speed=[7, 8, 9, 9.5]))
    np.testing.assert_allclose(found, metres_per_second - 9.5, rtol=1e-12)
    angle = Formula.parse("ego.heading < 180 deg").robustness(signals(ego__heading=[0, 1, 2, 3]))
    np.testing.assert_allclose(angle, np.pi - 3)


def test_a_bound_has_to_hold_all_the_time():
    given = signals(ttc=[9, 2, 4, 1], pet=[3, 3, 3, 3], ego__speed=[5, 6, 7, 5])
    for text, robustness in (
        ("ttc > 1.5", [-0.5, -0.5, -0.5, -0.5]),
        ("ttc > 0.5", [0.5] * 4),
        ("ttc < 9.5", [0.5, 5.5, 5.5, 8.5]),
        ("not ttc >= 9.5", [0.5, 5.5, 5.5, 8.5]),
        ("ttc > 0.5 and pet > 2.25", [0.5] * 4),
        ("ttc > 2 or ego.speed < 6", [0, 0, 1, 1]),
        ("ttc < 3 -> ego.speed < 6.5", [0.5, 0.5, 1, 1.5]),
        ("ttc > pet", [-2] * 4),
        ("ttc < pet", [-6, -1, -1, 2]),
    ):
        np.testing.assert_array_equal(Formula.parse(text).robustness(given), robustness, err_msg=text)
    # Each instant by itself.
    assert Formula.parse("ttc > 3").holds_at_each(given).tolist() == [True, False, True, False]
    assert Formula.parse("ttc > 3").holds(given).tolist() == [False] * 4


def test_at_the_bound_itself_the_relation_decides():
    given = signals(ttc=[2, 1.5, 3, 4])
    for relation, holds in ((">", False), (">=", True)):
        formula = Formula.parse(f"ttc {relation} 1.5")
        assert formula.robustness(given)[0] == 0.0
        assert formula.holds(given)[0] == holds
        assert Formula.parse(f"not ttc {relation} 1.5").holds_at_each(given)[1] != holds


def test_where_a_signal_is_not_defined_nothing_is_violated():
    given = signals(ttc=[np.nan, 2, np.inf, np.nan], pet=[np.nan] * 4, ego__acceleration=[0, 0, -3, 0])
    np.testing.assert_array_equal(Formula.parse("ttc > 1.5").robustness(given), [0.5, 0.5, np.inf, np.inf])
    np.testing.assert_array_equal(Formula.parse("not ttc < 1.5").robustness(given), [0.5, 0.5, np.inf, np.inf])
    implied = Formula.parse("ttc < 3 -> ego.acceleration < 0")
    np.testing.assert_array_equal(implied.robustness(given), [0, 0, np.inf, np.inf])
    assert Formula.parse("ttc > 1").is_defined(given)
    never = Formula.parse("pet > 1")
    assert not never.is_defined(given)
    assert never.holds(given).all()
    # An undefined comparison does not affect the others.
    assert Formula.parse("pet > 1 and ttc > 3").robustness(given)[0] == -1.0
    # Two infinite values are equal.
    both = signals(ttc=[np.inf] * 4, pttc=[np.inf] * 4)
    assert Formula.parse("ttc >= pttc").holds(both).all()


def test_signals_are_those_of_the_recording():
    recording = recorded([actor(v=20, a=-1), actor(x=34, v=10, y=1)], [0.0, 0.1, 0.2])
    given = signals_from_recording(recording, "0", "1")
    assert Formula.parse("ego.speed > 0").robustness(given)[0] == recording.speed[0].min()
    assert Formula.parse("other.x > 0").robustness(given)[0] == recording.x[1].min()
    assert Formula.parse("time >= 0").robustness(given).tolist() == [0.0, 0.1, 0.2]
    course = METRICS.create("ttc:accelerating=true").course(recording, "0", "1")
    assert Formula.parse("ttc:accelerating=true > 1").robustness(given)[0] == course.min() - 1
    # Given courses are not computed again.
    known = signals_from_recording(recording, "0", "1", {"ttc": np.array([5.0, 4.0, 3.0])})
    assert Formula.parse("ttc > 1").robustness(known)[0] == 2.0
    with pytest.raises(InputError, match="no entity 'nobody'"):
        signals_from_recording(recording, "0", "nobody")


@pytest.mark.parametrize("name", ["clearance", "distance", "ttc", "wttc", "pet", "tet", "msd", "ttc:severity=true"])
def test_a_bound_on_a_metric_scores_what_the_metric_does(name):
    """Also in a collision, which some courses do not see, and if the metric is never defined."""
    metric = METRICS.create(name)
    sign, relation = (1.0, ">") if metric.lower_is_critical else (-1.0, "<")
    hit = recorded([actor(v=20), actor(x=34)], np.arange(0, 3, 0.1))
    passed = recorded([actor(v=20), actor(x=34, y=8, v=1)], np.arange(0, 3, 0.1))
    for recording in (hit, passed):
        found = measure(recording, "0", "1", [name, f"stl:{name} {relation} 2"]).scores
        assert found[f"stl:{name} {relation} 2"] == pytest.approx(sign * (found[name] - 2.0), abs=1e-12)
