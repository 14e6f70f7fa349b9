from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import EXAMPLES
from cornercase.errors import InputError
from cornercase.scenario.expressions import evaluate
from cornercase.scenario.space import ParameterSpace
from cornercase.scenario.xml import read_xml


def distribution(body: str) -> str:
    return f"""<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="2026-01-01T00:00:00" author="a" description="d"/>
<ParameterValueDistribution><ScenarioFile filepath="s.xosc"/>{body}</ParameterValueDistribution></OpenSCENARIO>"""


def test_steps_give_round_values():
    space = ParameterSpace.from_ranges(["a=0:1:0.1", "b=-1:1"])
    assert space.parameters[0].size == 11
    values = [one["a"] for one in space.values(np.array([[(k + 0.5) / 11, 0.5] for k in range(11)]))]
    assert values == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]
    assert space.size is None


@given(st.lists(st.floats(0, 1), min_size=3, max_size=3))
def test_values_and_points_are_inverse(u):
    space = ParameterSpace.from_ranges(["a=2:7:0.5", "b=-1:1", "c=0:3:1"])
    point = space.snap(np.array([u]))
    np.testing.assert_allclose(space.points(space.values(point)), point, atol=1e-12)
    np.testing.assert_array_equal(space.snap(point), point)


def test_space_survives_json():
    space = ParameterSpace.from_file(EXAMPLES / "x_intersection" / "x_intersection.space.xosc")
    again = ParameterSpace.from_json(space.to_json())
    assert again.parameters == space.parameters
    assert [p.unit for p in again.parameters] == ["m", "s", "m/s"]


def test_sets_and_stochastic_distributions(tmp_path):
    path = tmp_path / "d.xosc"
    path.write_text(
        distribution(
            """<Stochastic numberOfTestRuns="10" randomSeed="1">
<StochasticDistribution parameterName="n"><NormalDistribution expectedValue="10" variance="4">
<Range lowerLimit="6" upperLimit="14"/></NormalDistribution></StochasticDistribution>
<StochasticDistribution parameterName="p"><ProbabilityDistributionSet><Element value="x" weight="1"/>
<Element value="y" weight="3"/></ProbabilityDistributionSet></StochasticDistribution></Stochastic>"""
        )
    )
    space = ParameterSpace.from_file(path)
    values = space.values(np.array([[0.0, 0.1], [0.5, 0.9], [1.0, 0.9]]))
    assert [round(float(v["n"]), 6) for v in values] == [6.0, 10.0, 14.0]
    assert [v["p"] for v in values] == ["x", "y", "y"]
    assert ParameterSpace.scenario_file(path) == tmp_path / "s.xosc"


@pytest.mark.parametrize(
    "text", ["a=1:1", "a=2:1", "a=0:inf", "a=0", "a", "=0:1", "a=x:1", "a=0:1:0", "a=0:1:2", "a=0:1:-1"]
)
def test_bad_ranges_are_refused(text):
    with pytest.raises(InputError):
        ParameterSpace.from_ranges([text])


def test_hostile_xml_is_refused(tmp_path):
    bomb = tmp_path / "bomb.xosc"
    bomb.write_text('<!DOCTYPE a [<!ENTITY b "bbbb"><!ENTITY c "&b;&b;">]><a>&c;</a>')
    with pytest.raises(InputError, match="document type"):
        read_xml(bomb)
    deep = tmp_path / "deep.xosc"
    deep.write_text("<a>" * 10_000 + "</a>" * 10_000)
    with pytest.raises(InputError):
        read_xml(deep)
    text = tmp_path / "text.xosc"
    text.write_text("hello")
    with pytest.raises(InputError, match="not well-formed"):
        read_xml(text)


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("1 + 2 * 3", 7), ("-2 - -3", 1), ("(1 + 2) * 3 / 2", 4.5), ("7 % 3", 1), ("pow(2, 3) - sqrt(16)", 4),
        ("round(2.5) + floor(-0.5) + ceil(0.2)", 3), ("max($a, 1) - min($a, 1)", 1), ("$a-$a", 0),
        ("1 < 2 and not 3 <= 2", True), ("1 == 2 or 2 != 2", False), ("abs(-$a) == $a", True), ("sign(-3)", -1),
    ],
)  # fmt: skip
def test_expressions(expression, value):
    assert evaluate(expression, {"a": 2.0}) == value


@pytest.mark.parametrize(
    "expression", ["__import__('os')", "1+", "(" * 500, "a" * 20_000, "$b", "1 2", "a.b()", "lambda: 1"]
)
def test_bad_expressions_are_refused(expression):
    with pytest.raises(InputError):
        evaluate(expression, {"a": 1.0})
