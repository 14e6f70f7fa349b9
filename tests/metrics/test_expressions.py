"""One language for formulas, requirements and conditions: a text means the same as each, and hostile ones are refused."""

from __future__ import annotations

import time as clock
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import examples
from cornercase._common.errors import InputError
from cornercase.metrics import METRICS, CriticalIf, Expression, measure, signals_from_recording
from cornercase.metrics.fault._find_fault import find_fault
from cornercase.recordings import Collision, Recording
from cornercase.suite import Requirement, judge
from helpers.two_cars import met

COUNT, STEP = 8, 0.1
TEMPORAL = ("always", "eventually", "until")
CONSTANT = ("collision", "fault", "reference", "reach", "drive", "score")


class Run:
    """A recording of two cars on the x axis, and all that the definition needs of it, in plain lists."""

    def __init__(self, steps, gaps, speeds, collided, references):
        x = [float(sum(steps[: k + 1])) for k in range(COUNT)]
        other = [position + 4.0 + gap for position, gap in zip(x, gaps, strict=True)]
        self.recording = met((x, 0.0, 0.0, speeds), (other, 0.0, 0.0, 0.0), collided * STEP if collided else None)
        self.gaps, self.speeds, self.x, self.references = [float(gap) for gap in gaps], speeds, x, references
        self.collided = [k == collided and collided > 0 for k in range(COUNT)]
        faults = [find_fault(self.recording, "Ego", collision).who for collision in self.recording.collisions]
        self.is_decided = "undecided" not in faults
        self.at_fault = [collides and faults == ["ego"] for collides in self.collided]
        # A contact counts as a gap of 0.
        self.clearance = [0.0 if collides else gap for gap, collides in zip(self.gaps, self.collided, strict=True)]
        self.driven = [position - x[0] for position in x]


def value(node, run, k, in_time, truth):
    """Robustness (or 1 and -1 for truth) from the definition: straightforward recursion over the instants."""
    operator, *parts = node
    if operator in TEMPORAL:
        (begin, end), *operands = parts
        ahead = [j for j in range(k, COUNT) if begin - 1e-9 <= STEP * (j - k) <= end + 1e-9]
        seen = [[value(part, run, j, True, truth) for j in range(COUNT)] for part in operands]
        if operator == "always":
            return min((seen[0][j] for j in ahead), default=np.inf)
        if operator == "eventually":
            return max((seen[0][j] for j in ahead), default=-np.inf)
        return max((min([seen[1][j], *seen[0][k:j]]) for j in ahead), default=-np.inf)
    if operator == "not":
        return -value(parts[0], run, k, in_time, truth)
    if operator in ("and", "or"):
        return (min if operator == "and" else max)(value(part, run, k, in_time, truth) for part in parts)
    if operator == "->":
        return max(-value(parts[0], run, k, in_time, truth), value(parts[1], run, k, in_time, truth))
    if operator in CONSTANT and not in_time:
        return max(leaf(node, run, j, truth) for j in range(COUNT))
    return leaf(node, run, k, truth)


def leaf(node, run, k, truth):
    operator, *parts = node
    if operator in ("collision", "fault"):
        collides = (run.collided if operator == "collision" else run.at_fault)[k]
        return (1.0 if collides else -1.0) if truth else (0.0 if run.collided[k] and collides else -run.gaps[k])
    if operator == "reference":
        return (1.0 if truth else np.inf) * (1 if run.references[parts[0]] else -1)
    if operator == "reach":
        gap = 1.0 - abs(run.x[k] - parts[0]) if STEP * k <= parts[1] + 1e-6 else -np.inf
        return gap if not truth else 1.0 if gap >= 0.0 else -1.0
    if operator == "drive":
        gap = run.driven[k] - parts[0]
        return gap if not truth else 1.0 if gap >= -1e-6 else -1.0
    signal, relation, number = parts
    values = {"ego.speed": run.speeds, "clearance": run.clearance, "score(clearance)": [min(run.clearance)] * COUNT}[
        signal
    ]
    gap = values[k] - number if relation in (">", ">=") else number - values[k]
    return gap if not truth else 1.0 if gap > 0.0 or (gap == 0.0 and "=" in relation) else -1.0


def of_run(node, run, truth):
    """What a formula means of the run: bounds have to hold all the time, unless joined with a temporal operator."""
    if not is_temporal(node):
        return min(value(node, run, k, False, truth) for k in range(COUNT))
    if node[0] == "and":
        return min(of_run(part, run, truth) for part in node[1:])
    return value(node, run, 0, False, truth)


def is_temporal(node):
    return node[0] in TEMPORAL or any(isinstance(part, tuple) and is_temporal(part) for part in node[1:] if part)


def written(node):
    operator, *parts = node
    if operator in TEMPORAL:
        (begin, end), *operands = parts
        interval = "" if (begin, end) == (0.0, np.inf) else f"[{begin}:{'' if end == np.inf else end}]"
        inner = [f"({written(part)})" for part in operands]
        return f"{inner[0]} until{interval} {inner[1]}" if operator == "until" else f"{operator}{interval} {inner[0]}"
    if operator in ("not", "and", "or", "->"):
        inner = [f"({written(part)})" for part in parts]
        return f"not {inner[0]}" if operator == "not" else f" {operator} ".join(inner)
    if operator == "reach":
        return f"reach {parts[0]},0,1 within {parts[1]} s"
    if operator in ("bound", "score"):
        return " ".join(map(str, parts))
    return {"collision": "collision", "fault": "collision at fault", "drive": f"drive {parts[:1] and parts[0]}",
            "reference": f"reference:{parts[:1] and parts[0]}"}[operator]  # fmt: skip


tenths = st.integers(0, 9).map(lambda n: n / 10)
intervals = st.one_of(st.just((0.0, np.inf)), st.tuples(tenths, tenths).map(lambda p: (min(p), max(p))))
numbers = st.integers(0, 12).map(lambda n: n / 2)
relations = st.sampled_from(["<", "<=", ">", ">="])
statements = st.one_of(
    st.sampled_from([("collision",), ("fault",), ("reference", "a"), ("reference", "b")]),
    st.tuples(st.just("reach"), numbers, st.integers(1, 6).map(lambda n: n / 10)),
    st.tuples(st.just("drive"), st.integers(1, 12).map(lambda n: n / 2)),
    st.tuples(st.just("score"), st.just("score(clearance)"), relations, numbers),
)
bounds = st.tuples(st.just("bound"), st.sampled_from(["ego.speed", "clearance"]), relations, numbers)


def logical(inner):
    two = st.tuples(st.sampled_from(["and", "or", "->"]), inner, inner)
    return st.one_of(two, st.tuples(st.just("not"), inner))


def temporal(inner):
    one = st.tuples(st.sampled_from(["always", "eventually"]), intervals, inner)
    return st.one_of(one, st.tuples(st.just("until"), intervals, inner, inner))


courses = st.recursive(bounds | statements, lambda inner: logical(inner) | temporal(inner), max_leaves=4)
# A condition does not have bounds outside of temporal operators, except on scores.
of_runs = st.recursive(statements | temporal(courses), logical, max_leaves=5)
anything = st.recursive(bounds | statements | temporal(courses), logical, max_leaves=5)


def touching_run(steps, gaps, speeds, collided, references):
    """Let both touch at the instant of their collision, and not before, so that it can be known whose fault it is."""
    touching = [*(max(gap, 0.5) for gap in gaps[:collided]), 0.0, *gaps[collided + 1 :]] if collided else gaps
    return Run(steps, touching, speeds, collided, references)


runs = st.builds(
    touching_run,
    st.lists(st.integers(0, 4).map(lambda n: n / 2), min_size=COUNT, max_size=COUNT),
    st.lists(st.integers(1, 12).map(lambda n: n / 2), min_size=COUNT, max_size=COUNT),
    st.lists(st.sampled_from([0.0, 1.0, 2.5, 6.0]), min_size=COUNT, max_size=COUNT),
    st.sampled_from([0, 0, 3, 7]),
    st.fixed_dictionaries({"a": st.booleans(), "b": st.booleans()}),
).filter(lambda run: run.is_decided)


class Outcome:
    """What a reference does, as the suite stores it."""

    def __init__(self, collides):
        self.collides = collides

    def describe(self, driver):
        return f"{driver} was run"


def verdict(text, run):
    outcomes: Any = {name: Outcome(collides) for name, collides in run.references.items()}
    return judge(Requirement.parse(text), run.recording, "Ego", "Other", references=outcomes).state


@settings(max_examples=examples(150), deadline=None, derandomize=True)
@given(anything, runs)
def test_a_formula_and_a_requirement_mean_what_the_definition_says(node, run):
    text = written(node)
    expression = Expression.parse(text)
    signals = signals_from_recording(run.recording, "Ego", "Other")
    object.__setattr__(signals, "references", run.references)
    expected, holds = of_run(node, run, truth=False), of_run(node, run, truth=True) > 0.0
    # A sum of steps is rounded.
    assert expression.robustness(signals)[0] == pytest.approx(expected, abs=1e-9)
    assert expression.is_fulfilled(signals) is bool(holds)
    assert verdict(text, run) == ("passed" if holds else "failed")
    assert Expression.parse(expression.text).text == expression.text
    assert verdict(expression.text, run) == verdict(text, run)
    if not expression.reference_drivers:
        metric = METRICS.create(f"stl:{text}")
        score = measure(run.recording, "Ego", "Other", [metric.name]).scores[metric.name]
        assert score == pytest.approx(np.clip(expected, metric.bound, metric.cap), abs=1e-9)


@settings(max_examples=examples(150), deadline=None, derandomize=True)
@given(of_runs, runs)
def test_a_condition_means_what_the_requirement_of_its_text_does(node, run):
    text = written(node)
    holds = of_run(node, run, truth=True) > 0.0
    metric = CriticalIf.from_text(text)
    state = metric.evaluate(run.recording, "Ego", "Other")
    assert state.is_fulfilled(run.references) is bool(holds)
    assert verdict(text, run) == ("passed" if holds else "failed")
    distance = -of_run(node, run, truth=False)
    score = np.clip(min(distance, 0.0) if holds else max(distance, 1e-9), metric.bound, metric.cap)
    assert state.score(run.references) == pytest.approx(score, abs=1e-9)
    assert (state.score(run.references) <= 0.0) == holds
    assert CriticalIf.from_text(metric.condition.text).condition == metric.condition


def test_a_bare_bound_of_a_condition_is_on_the_score():
    run = Run([1.0] * COUNT, [3.0, 2.0, 1.0, 0.5, 1.0, 2.0, 3.0, 4.0], [5.0] * COUNT, 0, {})
    for number in (0.4, 0.5, 2.0, 5.0):
        for relation in ("<", "<=", ">", ">="):
            bound = f"clearance {relation} {number}"
            critical = CriticalIf.from_text(bound).evaluate(run.recording, "Ego", "Other").is_fulfilled({})
            assert critical == (verdict(f"score({bound.replace(' ', ') ', 1)}", run) == "passed")
            lasting = "eventually" if "<" in relation else "always"
            assert critical == (verdict(f"{lasting}({bound})", run) == "passed")
    assert CriticalIf.from_text("score(ttc) < 1 and always(score(ttc) < 1)").name == (
        "critical-if:ttc < 1 and always(score(ttc) < 1)"
    )


def test_of_several_others_a_requirement_holds_against_each_and_a_condition_against_one():
    near, far = (
        Run([1.0] * COUNT, [1.0] * COUNT, [5.0] * COUNT, 0, {}),
        Run([1.0] * COUNT, [9.0] * COUNT, [5.0] * COUNT, 0, {}),
    )
    one = near.recording
    fields: Any = {name: np.vstack([getattr(one, name), getattr(far.recording, name)[1:]])
              for name in ("x", "y", "heading", "speed", "acceleration")}  # fmt: skip
    both = Recording(
        time=one.time, names=("Ego", "Other", "Far"), object_types=("car",) * 3, length=np.full(3, 4.0),
        width=np.full(3, 2.0), center_x=np.zeros(3), collisions=(Collision(0.3, ("Ego", "Other")),), **fields,
    )  # fmt: skip
    others = ("Other", "Far")
    for text, requirement, condition in (
        ("eventually(clearance < 2)", "failed", True),
        ("always(clearance > 0.5)", "failed", True),
        ("score(clearance) < 2", "passed", True),
        ("collision and eventually(clearance < 2)", "failed", True),
        ("no collision with Far", "passed", True),
        ("collision with Other or collision at fault", "passed", True),
        ("no collision", "failed", False),
    ):
        found = judge(Requirement.parse(text), both, "Ego", others)
        assert (text, found.state) == (text, requirement)
        assert CriticalIf.from_text(text).evaluate(both, "Ego", others).is_fulfilled({}) is condition, text
    assert judge(Requirement.parse("eventually(clearance < 2)"), both, "Ego", others).reason.startswith("against Far: ")


@pytest.mark.parametrize(
    ("text", "state", "reason"),
    [
        ("no collision and ego.speed < 30", "failed", "does not hold: Ego and Other collide at 0.3 s with"),
        ("no collision or drive 3", "passed", "holds: Ego has driven 3 m at 0.3 s"),
        ("no collision unless a collides", "inconclusive", "; a was not run"),
        ("collision -> reference:a", "inconclusive", "may hold or not: Ego and Other collide at 0.3 s"),
        ("no collision with Other and time >= 0", "failed", "does not hold: Ego and Other collide"),
        ("eventually(time > 0) and pet > 1 or drive 1", "inconclusive", "what pet > 1 refers to never occurred"),
        ("not (always[0:0.2](no collision))", "failed", "does not hold: Ego does not"),
    ],
)
def test_a_verdict_on_several_statements_names_what_decides(text, state, reason):
    run = Run([1.0] * COUNT, [3.0] * COUNT, [5.0] * COUNT, 3, {})
    if "always" in text or "pet" in text:
        run = Run([1.0] * COUNT, [3.0] * COUNT, [5.0] * COUNT, 0, {})
    found = judge(Requirement.parse(text), run.recording, "Ego", "Other")
    assert found.state == state
    assert reason in found.reason


@pytest.mark.parametrize("name", ["Van 2", "Van (2)", "Tom and Jerry", 'a "b"', "x)", "or", "  two  blanks", "naïve"])
def test_the_name_of_an_entity_is_quoted_if_it_has_to_be(name):
    quoted = Expression.parse(f"no collision with {__import__('json').dumps(name)} and ttc > 1", "requirement")
    assert quoted.entities == (name,)
    assert Expression.parse(quoted.text) == quoted


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("(no collision with C) until[0:9] (wttc < 0.3)", '(no collision with "C") until[0:9] (wttc < 0.3)'),
        ("no collision with C unless cautious collides", 'no collision with "C" unless cautious collides'),
        ("collision with C->wttc < 1", 'collision with "C" -> (wttc < 1)'),
        ("collision with C and(wttc < 1)", 'collision with "C" and (wttc < 1)'),
    ],
)
def test_a_name_ends_where_an_operator_begins(text, meant):
    read = Expression.parse(text)
    assert read == Expression.parse(meant)
    assert Expression.parse(read.text) == read


@pytest.mark.parametrize(("operator", "right"), [("AND", "did you mean 'and'"), ("&&", "write 'and' instead of '&&'")])
def test_an_operator_of_another_language_behind_a_name_is_no_part_of_it(operator, right):
    with pytest.raises(InputError, match=right):
        Expression.parse(f"collision with C {operator} ttc < 1")


# Without roads, nobody knows where the lane is.
@pytest.mark.parametrize(
    ("text", "state", "score"),
    [
        ("ego leaves its lane", "inconclusive", float("nan")),
        ("no collision and ego stays in its lane", "inconclusive", float("nan")),
        ("collision and ego stays in its lane", "failed", -3.0),
        ("ego leaves its lane -> drive 1", "passed", 1.0),
        ("eventually[100:200](pet > 1)", "failed", -float("inf")),
        ("pet > 1 and eventually[100:200](ego leaves its lane)", "failed", -float("inf")),
        ("always[100:200](ego leaves its lane)", "passed", float("inf")),
        ("eventually[100:200](ego leaves its lane)", "failed", -float("inf")),
    ],
)
def test_what_a_run_does_not_show_matters_to_a_formula_where_it_does_to_a_requirement(text, state, score):
    recording = met(([0.0, 1.0, 2.0], 0.0, 0.0, 10.0), ([10.0, 9.0, 9.0], 0.0, 0.0, 0.0))
    assert judge(Requirement.parse(text), recording, "Ego", "Other").state == state
    first = measure(recording, "Ego", "Other", [f"stl:{text}"]).courses[f"stl:{text}"][0]
    assert first == pytest.approx(score, nan_ok=True)


@pytest.mark.parametrize("text", [3, None, b"ttc < 1", ["ttc < 1"]])
def test_what_is_no_text_is_refused(text):
    with pytest.raises(InputError, match="give a text"):
        Expression.parse(text)


def test_a_verdict_on_a_score_names_no_instant():
    run = Run([1.0] * COUNT, [3.0] * COUNT, [5.0] * COUNT, 3, {})
    found = judge(Requirement.parse("score(clearance) > 2"), run.recording, "Ego", "Other")
    assert (found.state, found.reason) == ("failed", "score(clearance) is 0 m, which is compared with 2 m")


@pytest.mark.parametrize("text", [
    "(" * 100_000, "not " * 20_000, "ttc > 1 -> " * 900 + "ttc > 1", "always(" * 900, "ttc > " + "9" * 9000, "", " \n\t ",
    "x" * 100_000, "-" * 9000, '"' * 9000, "no collision with " + "(" * 9000, "reference:" + ":" * 9000, "\x00", "\ud800",
    "tt\u0441 > 1", "ttc \uff1e 1", "ttc > \u0661", "ttc \u2264 1", "ttc > \u22121", "\u202ettc > 1", "abs(", "score(",
    "always[1e999:](ttc > 1)", "reach 1e400,2 within 3", "drive 1e300", "ttc > 1 until",
    "no collision with " + "a " * 4990 + ")",
])  # fmt: skip
@pytest.mark.parametrize("language", ["formula", "requirement", "condition"])
def test_what_is_hostile_is_refused_in_a_sentence_at_once(text, language):
    begin = clock.process_time()
    with pytest.raises(InputError) as refused:
        Expression.parse(text, language)
    assert clock.process_time() - begin < 2.0
    said, shown, caret = str(refused.value).split("\n")
    assert said.startswith(f"The {language} cannot be read: ")
    assert (len(shown) < 600, caret.strip()) == (True, "^")
    assert said.isprintable()


def test_a_letter_that_only_looks_like_one_is_named():
    for text, words in (("ttc > 1 and tt\u0441 > 1", "did you mean 'ttc'"), ("ttc \uff1e 1", "FULLWIDTH GREATER-THAN SIGN"),
                        ("ttc > \u22121", "write .-. instead of"), ("ttc > \u0661", "ARABIC-INDIC DIGIT ONE")):  # fmt: skip
        with pytest.raises(InputError, match=words):
            Expression.parse(text)


def test_the_caret_is_at_the_fault_in_long_and_wide_texts():
    for before in ("ttc > 1 and ", "ttc > 1 and " * 40, "ttc\t>\n1 and ", "no collision with 車 and "):
        with pytest.raises(InputError) as refused:
            Expression.parse(f"{before}tttc > 1 and pet > 1")
        _, shown, caret = str(refused.value).split("\n")
        assert shown.replace("車", "車 ")[len(caret) - 1 :].startswith("tttc > 1")


words = st.sampled_from(["ttc", ">", "<=", "1", "1.5 s", "and", "or", "not", "(", ")", "always", "until", "[0:5]", "->", "no",
                         "collision", "with", "Van", "at fault", "unless", "reference:", "cc-human", "collides", "reach",
                         "3,4", "within", "drive", "abs(", "score(", "ego.speed", "km/h", "é", "°", '"', ":", ","])  # fmt: skip


@settings(max_examples=examples(400), deadline=None, derandomize=True)
@given(st.lists(words, max_size=12).map(" ".join) | st.text(max_size=40), st.sampled_from(["formula", "condition"]))
def test_any_text_is_read_and_written_again_or_refused(text, language):
    try:
        expression = Expression.parse(text, language)
    except InputError:
        return
    assert Expression.parse(expression.text, language).text == expression.text
