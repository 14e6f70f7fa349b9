"""The language of formulas, and formulas without temporal operators."""

from __future__ import annotations

import numpy as np
import pytest

from cornercase._common.errors import InputError
from cornercase.metrics import METRICS, Expression, Signals, measure, signals_from_recording
from helpers.oracle import actor, recorded

TIME = np.array([0.0, 0.1, 0.2, 0.3])


def signals(**values):
    named = {name.replace("__", "."): np.array(one, dtype=float) for name, one in values.items()}
    return Signals(TIME, named)


@pytest.mark.parametrize(
    ("text", "canonical", "metrics", "unit"),
    [
        ("ttc>1.5", "ttc > 1.5", ("ttc",), "s"),
        ("1.5<ttc", "ttc > 1.5", ("ttc",), "s"),
        ("ego.acceleration>=-4m/s^2", "ego.acceleration >= -4 m/s²", (), "m/s²"),
        ("abs( ego.acceleration )<0.3 g", "abs(ego.acceleration) < 0.3 g", (), "m/s²"),
        ("not ttc<1or pet:signed=true>2", "not(ttc < 1) or pet:signed=true > 2", ("ttc", "pet:signed=true"), "s"),
        ("always [0,5s] clearance > 0.5", "always[0:5](clearance > 0.5)", ("clearance",), "m"),
        (
            "always[2:](ttc<3->eventually[0:500 ms] ego.acceleration<-1)",
            "always[2:](ttc < 3 -> eventually[0:0.5](ego.acceleration < -1))", ("ttc",), "1",
        ),
        ("rss:response_time=0.5,min_braking=5 > 0", "rss:response_time=0.5,min_braking=5 > 0",
         ("rss:response_time=0.5,min_braking=5",), "m"),
        # `and` binds more than `or`, and that more than `->`.
        ("hw>1 and thw>1 or ttc>1 -> pet>1", "((hw > 1 and thw > 1) or ttc > 1) -> pet > 1",
         ("hw", "thw", "ttc", "pet"), "1"),
        # The unary operators bind most.
        ("always ttc>1 and pet>1", "always(ttc > 1) and pet > 1", ("ttc", "pet"), "s"),
        ("a-long-req<ego.acceleration until ego.speed<other.speed",
         "a-long-req < ego.acceleration until ego.speed < other.speed", ("a-long-req",), "1"),
    ],
)  # fmt: skip
def test_formulas_are_read_and_written_in_one_way(text, canonical, metrics, unit):
    formula = Expression.parse(text)
    assert (formula.text, formula.metrics, formula.unit) == (canonical, metrics, unit)
    again = Expression.parse(formula.text)
    assert again == formula or text.count("s^2") + text.count("ms") + text.count("5s") > 0
    assert again.text == canonical


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "give a bound such as"),
        ("ttc", "give a comparison of 'ttc'"),
        ("tttc > 1", "there is no signal 'tttc'; did you mean 'ttc'"),
        ("ttc > 1 and ego.sped < 3", "there is no signal 'ego.sped'; did you mean 'ego.speed'"),
        ("alwys(ttc > 1)", "did you mean 'always'"),
        ("ttc > 1 adn pet > 1", "did you mean 'and'"),
        ("pet:sined=true > 1", "has no option 'sined'; did you mean 'signed'"),
        ("ttc > 5 m", "ttc is in s: the unit 'm' does not fit; give s, ms, min"),
        ("ego.speed < 5 kmh", "there is no unit 'kmh'; did you mean 'km/h'"),
        ("ttc > clearance", "'ttc' in s is compared with 'clearance' in m"),
        ("1 < ttc < 5", "compare two values at a time"),
        ("3 > 2", "two numbers are compared"),
        ("ttc == 1", "write '<= or >=' instead of '=='"),
        ("ttc > 1 && pet > 1", "write 'and' instead of '&&'"),
        ("(ttc > 1", "give a closing bracket"),
        ("ttc > 1)", "this bracket has no opening bracket"),
        ("always[5:2](ttc > 1)", "ends at 2 s, before it begins at 5 s"),
        ("always[-1:2](ttc > 1)", "begin at 0 s or later"),
        ("always[0:1 m](ttc > 1)", "this number is in s: the unit 'm' does not fit"),
        ("ttc > 1 until pet > 1 until hw > 1", "put one of them in brackets"),
        ("ttc > 1e999", "too large"),
        ("stl:x > 1", "write the formula itself"),
        ("(" * 60 + "ttc > 1" + ")" * 60, "nested more than 50 deep"),
        ("not " * 60 + "ttc > 1", "nested more than 50 deep"),
        ("ttc > 1 -> " * 60 + "ttc > 1", "nested more than 50 deep"),
        ("ttc > 1 and " * 2000, "characters; give 10000 at most"),
        ("ttc § 1", "'§' (SECTION SIGN) has no meaning here"),
    ],
)
def test_what_is_no_formula_is_refused_with_its_place_and_what_helps(text, sentence):
    with pytest.raises(InputError) as refused:
        Expression.parse(text)
    assert sentence in str(refused.value)
    said, shown, caret = str(refused.value).split("\n")
    assert said.startswith("The formula cannot be read: ")
    assert len(shown) < 100
    assert caret.strip() == "^"


def test_a_long_conjunction_is_no_deep_one():
    text = " and ".join(["hw>1"] * 200)
    found = Expression.parse(text).robustness(signals(hw=[3, 2, 4, 5]))
    np.testing.assert_array_equal(found, [1, 1, 3, 4])


@pytest.mark.parametrize(
    ("text", "metres_per_second"),
    [("36 km/h", 10.0), ("10", 10.0), ("10 m/s", 10.0), ("22.369362920544 mph", 10.0)],
)
def test_numbers_have_units(text, metres_per_second):
    found = Expression.parse(f"ego.speed <= {text}").robustness(signals(ego__speed=[7, 8, 9, 9.5]))
    np.testing.assert_allclose(found, metres_per_second - 9.5, rtol=1e-12)
    angle = Expression.parse("ego.heading < 180 deg").robustness(signals(ego__heading=[0, 1, 2, 3]))
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
        np.testing.assert_array_equal(Expression.parse(text).robustness(given), robustness, err_msg=text)
    assert Expression.parse("ttc > 3").is_fulfilled(given) is False


def test_at_the_bound_itself_the_relation_decides():
    given = signals(ttc=[2, 1.5, 3, 4])
    for relation, holds in ((">", False), (">=", True)):
        formula = Expression.parse(f"ttc {relation} 1.5")
        assert formula.robustness(given)[0] == 0.0
        assert formula.is_fulfilled(given) is holds
        assert Expression.parse(f"eventually[0.1:0.1](not ttc {relation} 1.5)").is_fulfilled(given) is not holds


def test_where_a_signal_is_not_defined_nothing_is_violated():
    given = signals(ttc=[np.nan, 2, np.inf, np.nan], pet=[np.nan] * 4, ego__acceleration=[0, 0, -3, 0])
    np.testing.assert_array_equal(Expression.parse("ttc > 1.5").robustness(given), [0.5, 0.5, np.inf, np.inf])
    np.testing.assert_array_equal(Expression.parse("not ttc < 1.5").robustness(given), [0.5, 0.5, np.inf, np.inf])
    implied = Expression.parse("ttc < 3 -> ego.acceleration < 0")
    np.testing.assert_array_equal(implied.robustness(given), [0, 0, np.inf, np.inf])
    assert Expression.parse("ttc > 1").is_fulfilled(given) is True
    never = Expression.parse("pet > 1")
    assert never.is_fulfilled(given) is None
    # An undefined comparison does not affect the others.
    assert Expression.parse("pet > 1 and ttc > 3").robustness(given)[0] == -1.0
    # Two infinite values are equal.
    both = signals(ttc=[np.inf] * 4, pttc=[np.inf] * 4)
    assert Expression.parse("ttc >= pttc").is_fulfilled(both) is True


def test_signals_are_those_of_the_recording():
    recording = recorded([actor(v=20, a=-1), actor(x=34, v=10, y=1)], [0.0, 0.1, 0.2])
    given = signals_from_recording(recording, "0", "1")
    assert Expression.parse("ego.speed > 0").robustness(given)[0] == recording.speed[0].min()
    assert Expression.parse("other.x > 0").robustness(given)[0] == recording.x[1].min()
    assert Expression.parse("time >= 0").robustness(given).tolist() == [0.0, 0.1, 0.2]
    course = METRICS.create("ttc:accelerating=true").course(recording, "0", "1")
    assert Expression.parse("ttc:accelerating=true > 1").robustness(given)[0] == course.min() - 1
    # Given courses are not computed again.
    known = signals_from_recording(recording, "0", "1", {"ttc": np.array([5.0, 4.0, 3.0])})
    assert Expression.parse("ttc > 1").robustness(known)[0] == 2.0
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
