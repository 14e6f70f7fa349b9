"""Constraints of parameters belong to the space, in the study and in the search."""

from __future__ import annotations

import json
import pickle
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import EXAMPLES, examples
from cornercase._common.errors import InputError
from cornercase.reduction import reduce
from cornercase.scenario import Constraint, LogicalScenario, Parameter, ParameterDeclaration, ParameterSpace
from cornercase.study import StudyFile
from helpers.command_line import cornercase

RULES = ("equalTo", "notEqualTo", "greaterThan", "greaterOrEqual", "lessThan", "lessOrEqual")
PARAMETERS = [Parameter("a", 0, 10, 1.0), Parameter("b", -1, 1), Parameter("kind", 0, 2, choices=("car", "van", "<b>"))]
NUMBERS = st.one_of(st.integers(0, 10).map(str), st.sampled_from(["$b", "${$b * 5 + 5}", "$c", "${$c / 2}"]))


def groups(values):
    constraints = st.builds(Constraint, st.sampled_from(RULES), values)
    return st.lists(st.lists(constraints, max_size=3).map(tuple), max_size=3).map(tuple)


@st.composite
def spaces(draw):
    texts = st.builds(Constraint, st.sampled_from(RULES[:2]), st.sampled_from(["car", "van", "truck"]))
    kinds = st.lists(st.lists(texts, max_size=2).map(tuple), max_size=2).map(tuple)
    declarations = [
        ParameterDeclaration("b", "double", "0", draw(groups(st.sampled_from(["0", "0.5", "-0.2"])))),
        ParameterDeclaration("c", "double", "${$b * 3}"),
        ParameterDeclaration("a", "integer", "1", draw(groups(NUMBERS))),
        ParameterDeclaration("kind", "string", "car", draw(kinds)),
    ]
    return ParameterSpace(PARAMETERS, declarations)


@settings(max_examples=examples(60), deadline=None)
@given(spaces(), st.integers(0, 2**32 - 1))
def test_a_space_that_was_written_admits_the_same(space, seed):
    points = np.random.default_rng(seed).random((60, 3))
    admitted = space.is_admissible(points)
    for again in (ParameterSpace.from_json(json.loads(json.dumps(space.to_json()))), pickle.loads(pickle.dumps(space))):
        assert again == space
        np.testing.assert_array_equal(again.is_admissible(points), admitted)


@settings(max_examples=examples(60), deadline=None)
@given(st.sampled_from(RULES), st.integers(0, 10))
def test_a_rule_holds_where_its_comparison_does(rule, bound):
    space = ParameterSpace(
        PARAMETERS[:1], [ParameterDeclaration("a", "double", "0", ((Constraint(rule, str(bound)),),))]
    )
    points = space.full_factorial()
    values = np.array([one["a"] for one in space.values(points)])
    compare = {
        "equalTo": values == bound, "notEqualTo": values != bound, "greaterThan": values > bound,
        "greaterOrEqual": values >= bound, "lessThan": values < bound, "lessOrEqual": values <= bound,
    }  # fmt: skip
    np.testing.assert_array_equal(space.is_admissible(points), compare[rule])


def test_a_space_says_what_it_is_and_escapes_names():
    limit = ((Constraint("greaterThan", "2"), Constraint("lessThan", "$b")), (Constraint("equalTo", "9"),))
    space = ParameterSpace(PARAMETERS, [ParameterDeclaration("a", "double", "0", limit)])
    assert repr(space) == "<ParameterSpace: a 0 to 10 by 1, b -1 to 1, kind car, van, <b>, a constrained>"
    assert repr(space.parameters[0]) == "<Parameter a 0 to 10 by 1>"
    page = space._repr_html_()
    assert "<b>" not in page
    assert "&gt; 2 and &lt; $b or = 9" in page


def test_a_rule_that_does_not_exist_is_refused():
    plain = ParameterSpace(
        PARAMETERS, [ParameterDeclaration("a", "double", "0", ((Constraint("lessThan", "1"),),))]
    ).to_json()
    plain["declarations"][0]["groups"][0][0]["rule"] = "lesThan"
    with pytest.raises(InputError, match="did you mean 'lessThan'"):
        ParameterSpace.from_json(plain)


@pytest.fixture(scope="module")
def constrained(tmp_path_factory):
    """A copy of the X-intersection with constrained parameters, and the result of its exploration."""
    folder = tmp_path_factory.mktemp("constrained") / "x_intersection"
    shutil.copytree(EXAMPLES / "x_intersection", folder)
    path = folder / "x_intersection.xosc"
    text = path.read_text(encoding="utf-8")
    group = '<ConstraintGroup><ValueConstraint rule="lessThan" value="${$pedestrian_wait * 4 + 35}"/></ConstraintGroup>'
    # Declared after the parameter in its constraint.
    (declared,) = re.findall(r'<ParameterDeclaration [^>]*name="ego_start"[^>]*/>', text)
    (waits,) = re.findall(r'<ParameterDeclaration [^>]*name="pedestrian_wait"[^>]*/>', text)
    text = text.replace(declared, "").replace(waits, f"{waits}{declared[:-2]}>{group}</ParameterDeclaration>")
    path.write_text(text, encoding="utf-8")
    study = folder / "study.db"
    done = cornercase(
        "explore", path, "--space", folder / "x_intersection.space.xosc", "--ego", "Ego", "--other", "Pedestrian",
        "--metric", "wttc", "--optimizer", "sobol", "--stop-when", "interval<1", "--budget", "60", "-o", study,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return path, study, done.stdout


def test_explore_and_show_judge_the_same_space(constrained):
    path, study, said = constrained
    searched = LogicalScenario.read(path, path.with_name("x_intersection.space.xosc")).space
    points = np.random.default_rng(0).random((2000, searched.dimension))
    assert 0.2 < searched.is_admissible(points).mean() < 0.8
    with StudyFile.open(study, readonly=True) as opened:
        assert opened.space == searched
        np.testing.assert_array_equal(opened.space.is_admissible(points), searched.is_admissible(points))
    # `show` gives the same reason for stopping as `explore`.
    shown = json.loads(cornercase("show", study, "--json").stdout)["critical"]
    width = shown["share"]["high"] - shown["share"]["low"]
    assert f"the critical share is known within {width:.2%}" in " ".join(said.split())


@pytest.mark.slow
def test_the_reduced_set_is_that_of_the_space_that_was_searched(constrained, tmp_path):
    path, explored, _ = constrained
    searched = LogicalScenario.read(path, path.with_name("x_intersection.space.xosc")).space
    study = Path(shutil.copy(explored, tmp_path / "study.db"))
    assert cornercase("analyze", study, "--by", "wttc").returncode == 0
    kept = [Path(shutil.copy(study, tmp_path / f"{name}.db")) for name in "ab"]
    reduced = []
    for name, space in zip(kept, (None, searched), strict=True):
        with StudyFile.open(name, readonly=False) as opened:
            opened.space = opened.space if space is None else space
            reduced.append(reduce(opened, tmp_path / name.stem, scenario=path))
    assert reduced[0].critical == reduced[1].critical
    assert reduced[0].ids == reduced[1].ids
