"""Temporal operators, compared with their definition and with RTAMT."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import cornercase as cc
from conftest import examples
from cornercase._common.errors import InputError
from cornercase.metrics import METRICS, Expression, Signals
from cornercase.metrics._evaluation import Evaluation
from cornercase.metrics.expressions._ast import Bound
from cornercase.metrics.expressions._leaf_evaluation import evaluate_leaf
from cornercase.study import StudyFile
from helpers.oracle import actor, recorded

SIGNALS = {"ttc": "s", "pet": "s", "ego.speed": "m/s"}
STEP = 0.1


def signals(time=None, **values):
    named = {name.replace("__", "."): np.array(one, dtype=float) for name, one in values.items()}
    count = len(next(iter(named.values())))
    return Signals(np.arange(count) * STEP if time is None else np.asarray(time, dtype=float), named)


def robustness(text, given):
    return Expression.parse(text).robustness(given)


def defined(node, margins, time):
    """Robustness from the definition: of each instant by itself, over the times in the interval, not by steps."""
    if isinstance(node, Bound):
        return margins[node]
    found = [defined(one, margins, time) for one in node.operands]
    if node.operator == "not":
        return -found[0]
    if node.operator == "->":
        return np.maximum(-found[0], found[1])
    if node.operator in ("and", "or"):
        return (np.min if node.operator == "and" else np.max)(found, axis=0)
    begin, end = node.interval or (0.0, np.inf)
    out = []
    for t in range(len(time)):
        ahead = [i for i in range(t, len(time)) if begin - 1e-9 <= time[i] - time[t] <= end + 1e-9]
        if node.operator == "until":
            out.append(max((min([found[1][i], *found[0][t:i]]) for i in ahead), default=-np.inf))
        elif node.operator == "always":
            out.append(min((found[0][i] for i in ahead), default=np.inf))
        else:
            out.append(max((found[0][i] for i in ahead), default=-np.inf))
    return np.array(out)


def told_to_rtamt(text, given):
    """Robustness of the whole formula by RTAMT; it has no dots in names, and its steps are seconds."""
    rtamt = pytest.importorskip("rtamt", reason="it is there for Python up to 3.12")
    specification = rtamt.StlDiscreteTimeSpecification()
    specification.set_sampling_period(100, "ms", 0.1)
    data = {"time": given.time.tolist()}
    for name, values in given.values.items():
        specification.declare_var(name.replace(".", "_"), "float")
        text = text.replace(name, name.replace(".", "_"))
        data[name.replace(".", "_")] = values.tolist()
    specification.spec = text
    specification.parse()
    return np.array([value for _, value in specification.evaluate(data)])


numbers = st.integers(-8, 8).map(lambda n: n / 4)
comparisons = st.builds(
    lambda name, relation, bound: f"({name} {relation} {bound})",
    st.sampled_from(sorted(SIGNALS)), st.sampled_from(["<", "<=", ">", ">="]), numbers,
)  # fmt: skip
intervals = st.one_of(
    st.just(""), st.tuples(st.integers(0, 14), st.integers(0, 14)).map(lambda p: f"[{100 * min(p)}ms:{100 * max(p)}ms]")
)


def nested(inner):
    one = st.tuples(st.sampled_from(["always", "eventually"]), intervals, inner).map(lambda p: f"({p[0]}{p[1]} {p[2]})")
    two = st.tuples(inner, st.sampled_from(["and", "or", "->"]), inner).map(lambda p: f"({p[0]} {p[1]} {p[2]})")
    lasting = st.tuples(inner, intervals, inner).map(lambda p: f"({p[0]} until{p[1]} {p[2]})")
    return st.one_of(one, two, lasting, inner.map(lambda text: f"(not {text})"))


formulas = st.recursive(comparisons, nested, max_leaves=6).map(lambda text: f"always[0:0]({text})")
# Corners of a line of straight pieces, and how many steps each piece has.
pieces = st.lists(st.tuples(st.integers(-12, 12), st.integers(1, 5)), min_size=2, max_size=5)


@st.composite
def recordings(draw):
    lines = [draw(pieces) for _ in SIGNALS]
    longest = min(sum(steps for _, steps in line) for line in lines)
    count = draw(st.integers(2, max(2, longest)))
    at = [np.interp(np.arange(count), np.cumsum([steps for _, steps in line]), [y for y, _ in line]) for line in lines]
    return Signals(np.arange(count) * STEP, dict(zip(SIGNALS, at, strict=True)))


@settings(max_examples=examples(40), deadline=None, derandomize=True)
@given(formulas, recordings())
def test_robustness_is_that_of_rtamt(text, given):
    np.testing.assert_array_equal(robustness(text, given), told_to_rtamt(text, given))


@settings(max_examples=examples(80), deadline=None, derandomize=True)
@given(formulas, recordings())
def test_robustness_is_that_of_the_definition(text, given):
    formula = Expression.parse(text)
    found = formula.robustness(given)
    margins = {one: evaluate_leaf(one, given).margin for one in formula.bounds}
    np.testing.assert_array_equal(found, defined(formula.root, margins, given.time))
    # Except at the bound, the sign of the robustness says whether it holds.
    held = Evaluation.from_signals(formula.root, given).holds()
    assert held[found > 0].all()
    assert not held[found < 0].any()


def test_robustness_of_lines_in_closed_form():
    time = np.arange(101) * STEP
    given = signals(ttc=10 - time, ego__speed=20 - 2 * time, pet=np.abs(time - 5))
    for text, value in (
        ("always[0:5](ttc > 1.5)", 10 - 5 - 1.5),
        ("always[2:5](ttc > 1.5)", 10 - 5 - 1.5),
        ("eventually[2:5](ttc > 1.5)", 10 - 2 - 1.5),
        ("eventually[0:10](ego.speed < 1)", 1.0),
        ("always(pet >= 0)", 0.0),
        # 2 s ahead of the begin it is 3 s still, and from 3 s on 5 s are in reach.
        ("always[0:3](eventually[0:2](pet < 1))", 1.0 - 3.0),
        ("always[3:5](eventually[0:2](pet < 1))", 1.0),
        ("eventually(always[0:2](pet < 3))", 3 - 1.0),
        # Before an instant t the speed is 20 - 2 (t - 0.1) at least, and the time to collision at t is 10 - t.
        ("ego.speed > 11 until ttc < 7", max(min(9 - 2 * (t - STEP), t - 3) for t in time)),
        ("ego.speed > 12 until[2:3] ttc < 9", 1.8 + 0.2),
        ("not (ego.speed > 12 until[2:3] ttc < 9)", -2.0),
    ):
        assert robustness(text, given)[0] == pytest.approx(value, abs=1e-9), text


def test_intervals_end_with_the_recording_however_far_they_reach():
    given = signals(ttc=[5, 4, 3, 2])
    np.testing.assert_array_equal(robustness("always[0:1e12](ttc > 1)", given), [1, 1, 1, 1])
    np.testing.assert_array_equal(robustness("always[0.1:](ttc > 1)", given), [1, 1, 1, np.inf])
    np.testing.assert_array_equal(robustness("always[7:1e12](ttc > 1)", given), [np.inf] * 4)
    np.testing.assert_array_equal(robustness("eventually[0.2:9](ttc > 1)", given), [2, 1, -np.inf, -np.inf])
    np.testing.assert_array_equal(robustness("ttc > 1 until[0.2:] ttc < 9", given), [3, 2, -np.inf, -np.inf])
    assert robustness("always(ttc > 1) and eventually[0:3](ttc < 9)", signals(ttc=[5])).tolist() == [4.0]
    assert robustness("ttc > 1 until[0:2] ttc < 9", signals(ttc=[5])).tolist() == [4.0]


def test_bounds_of_intervals_are_those_of_the_nearest_instant():
    given = signals(ttc=[9, 8, 7, 6, 5, 4])
    for interval, last in (("[0:0.14]", 8), ("[0:0.16]", 7), ("[0:0.2]", 7), ("[0.04:0.04]", 9), ("[0.06:0.06]", 8)):
        assert robustness(f"always{interval}(ttc > 0)", given)[0] == last, interval
    # Steps that are rounded are even.
    rounded = signals(np.round(np.arange(300) / 60, 3), ttc=np.arange(300.0))
    assert robustness("always[1:4](ttc < 0)", rounded)[0] == -240.0
    assert robustness("always[1:4](ttc > 0)", rounded)[0] == 60.0


def test_of_uneven_instants_each_lasts_until_the_next():
    uneven = signals([0, 0.5, 0.6, 0.7, 2.0, 2.1], ttc=[5, 4, 1, 3, 9, 2])
    np.testing.assert_array_equal(robustness("eventually[0:1](ttc > 0)", uneven), [5, 4, 3, 3, 9, 2])
    np.testing.assert_array_equal(robustness("always[0:0.5](ttc > 0)", uneven), [4, 1, 1, 3, 2, 2])
    # 1.3 s after 0.6 s the one of 0.7 s lasts.
    np.testing.assert_array_equal(robustness("always[1.3:1.3](ttc > 0)", uneven)[:3], [3, 3, 3])
    # Without an interval, the time between instants does not matter.
    np.testing.assert_array_equal(robustness("always(ttc > 0)", uneven), [1, 1, 1, 2, 2, 2])
    with pytest.raises(InputError, match="too uneven"):
        robustness("always[0:1](ttc > 0)", signals([0, 1e-9, 5], ttc=[1, 2, 3]))
    assert robustness("always(ttc > 0)", signals([0, 1e-9, 5], ttc=[1, 2, 3]))[0] == 1.0


def test_instants_at_which_a_signal_is_not_defined_are_left_out():
    nan = np.nan
    gaps = signals(ttc=[nan, 5, nan, 2, nan], pet=[nan] * 5, ego__speed=[9, 9, 1, 9, 9])
    for text, found in (
        ("always(ttc > 1)", [1, 1, 1, 1, np.inf]),
        # Undefined instants do not fulfil it.
        ("eventually(ttc < 4)", [2, 2, 2, 2, -np.inf]),
        ("eventually(ttc < 1)", [-1, -1, -1, -1, -np.inf]),
        ("not eventually(ttc < 1)", [1, 1, 1, 1, np.inf]),
        ("not always(ttc > 1)", [-1, -1, -1, -1, -np.inf]),
        ("eventually(ttc < 4 and ego.speed > 5)", [2, 2, 2, 2, -np.inf]),
        ("always(ttc < 4 -> ego.speed > 5)", [4, 4, 4, 4, np.inf]),
        ("ttc > 1 until ego.speed < 2", [1, 1, 1, -7, -7]),
        ("ego.speed > 5 until ttc < 4", [-1, -1, -4, 2, -np.inf]),
        # A comparison that is never defined violates nothing.
        ("eventually(pet < 1)", [np.inf] * 5),
        ("eventually(pet < 1 and ego.speed < 2)", [1, 1, 1, -7, -7]),
    ):
        np.testing.assert_array_equal(robustness(text, gaps), found, err_msg=text)
    assert Expression.parse("always(ttc > 1) and eventually(pet < 1)").is_fulfilled(gaps) is None


def test_a_conjunct_without_a_temporal_operator_has_to_hold_all_the_time():
    given = signals(ttc=[5, 4, 1, 3], ego__speed=[9, 5, 0, 0])
    assert robustness("ttc > 2 and eventually(ego.speed < 1)", given)[0] == -1.0
    # Elsewhere it is that of the instant from which one looks.
    assert robustness("ttc > 2 -> always[0:0.1](ego.speed > 4)", given).tolist() == [1, -2, 1, -1]


def test_the_metric_of_a_formula():
    metric = METRICS.create("stl:always[0:5] (clearance > 0.5)")
    assert (metric.name, metric.unit, metric.default_threshold) == ("stl:always[0:5] (clearance > 0.5)", "m", 0.0)
    assert (metric.cap, metric.bound) == (99.5, -100.0)
    assert METRICS.create("stl:rss > 1").bound == -501.0
    assert METRICS.create("stl:ego.speed < 3 and ttc > 1").cap == 100.0
    assert METRICS.create("stl:always(drac < 4)").cap == 4.0
    passing = recorded([actor(v=20), actor(x=34, y=8, v=1)], np.arange(0, 3, 0.1))
    # The least gap is that of the widths, 8 m - 2 m.
    assert metric.score(metric.course(passing, "0", "1")) == pytest.approx(5.5)
    never = METRICS.create("stl:eventually(pet < 1)")
    assert np.isnan(never.course(passing, "0", "1")).all() or never.score(never.course(passing, "0", "1")) == never.cap
    with pytest.raises(InputError, match="did you mean 'clearance'"):
        METRICS.create("stl:always(clearence > 0.5)")


def test_searching_a_robustness_finds_what_searching_its_metric_finds(tmp_path):
    example = "examples/t_intersection/t_intersection"
    logical = cc.LogicalScenario.read(f"{example}.xosc", f"{example}.space.xosc")
    found = {}
    for name, threshold in (("clearance", 0.5), ("stl:always(clearance > 0.5)", 0.0)):
        path = tmp_path / f"{threshold}.db"
        cc.explore(
            logical,
            path,
            ego="Ego",
            other="C",
            metrics=[name],
            budget=24,
            seed=3,
            optimizer="level-set",
            critical=threshold,
        )
        with StudyFile.open(path, readonly=True) as study:
            found[name] = (np.array([row.point for row in study.finished_rows()]), np.array(study.scores(name)))
    (points, scores), (same_points, robust) = found.values()
    np.testing.assert_array_equal(points, same_points)
    np.testing.assert_allclose(robust, scores - 0.5, atol=1e-12)
    assert 0 < (scores <= 0.5).sum() < len(scores)
    np.testing.assert_array_equal(robust <= 0.0, scores <= 0.5)
