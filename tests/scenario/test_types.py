"""Values keep their declared types when they are drawn, compared, run, shown and written."""

from __future__ import annotations

from math import erf, sqrt

import numpy as np
import pytest
from lxml import etree

from conftest import ROAD, ran, scenario_file, teleport
from cornercase._common.errors import InputError
from cornercase.scenario import ConcreteScenario, LogicalScenario, ParameterSpace
from cornercase.scenario._concrete_file import write_concrete_file
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators import Builtin, check, simulate


def file(folder, *declarations, init=None, name="scenario.xosc"):
    parameters = "".join(
        f'<ParameterDeclaration name="{name}" parameterType="{kind}" value="{value}">{within}</ParameterDeclaration>'
        for name, kind, value, within in declarations
    )
    init = init or teleport("5")
    return scenario_file(folder, init=f'<Private entityRef="Ego">{init}</Private>', parameters=parameters, name=name)


def constrained(rule, value):
    return f'<ConstraintGroup><ValueConstraint rule="{rule}" value="{value}"/></ConstraintGroup>'


def space_file(folder, name, inner, *, stochastic=False):
    path = folder / "space.xosc"
    holder = (
        f'<Stochastic numberOfTestRuns="1"><StochasticDistribution parameterName="{name}">{inner}</StochasticDistribution></Stochastic>'
        if stochastic
        else f'<Deterministic><DeterministicSingleParameterDistribution parameterName="{name}">{inner}'
        "</DeterministicSingleParameterDistribution></Deterministic>"
    )
    path.write_text(
        '<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="2026-01-01T00:00:00" author="a" description="d"/>'
        f'<ParameterValueDistribution><ScenarioFile filepath="scenario.xosc"/>{holder}</ParameterValueDistribution></OpenSCENARIO>'
    )
    return path


def drawn(space: ParameterSpace, name: str, count: int = 500):
    points = np.random.default_rng(0).random((count, space.dimension))
    return [one[name] for one in space.values(space.snap(points))]


def test_a_range_of_integers_gives_whole_numbers(tmp_path):
    path = file(tmp_path, ("n", "integer", "3", ""))
    for text, expected in (("n=-2:3", {-2, -1, 0, 1, 2, 3}), ("n=2:10:4", {2, 6, 10}), ("n=0.5:3.2", {1, 2, 3})):
        space = LogicalScenario.read(path, None, [text]).space
        values = drawn(space, "n")
        assert set(values) == expected
        assert all(isinstance(one, int) for one in values)
        again = ParameterSpace.from_json(space.to_json())
        assert again == space
        assert drawn(again, "n") == values
        assert space.values(space.points([{"n": 3}]))[0]["n"] in expected
    assert str(LogicalScenario.read(path, None, ["n=-2:3"]).space.parameters[0]) == "n -2 to 3"
    # Integers even if searched as a continuous interval.
    assert set(drawn(LogicalScenario.read(path, None, ["n=2:6:4"], continuous=True).space, "n")) == {2, 3, 4, 5, 6}


@pytest.mark.parametrize("text", ["n=1:2:0.5", "n=0.5:2.5:1", "n=1.2:1.8"])
def test_a_range_without_whole_numbers_is_none_of_integers(tmp_path, text):
    with pytest.raises(InputError, match="n is declared as integer"):
        LogicalScenario.read(file(tmp_path, ("n", "integer", "3", "")), None, [text])


def test_a_range_of_unsigned_numbers_does_not_go_below_0(tmp_path):
    with pytest.raises(InputError, match="from 0 to 65535"):
        LogicalScenario.read(file(tmp_path, ("n", "unsignedShort", "3", "")), None, ["n=-1:3"])


def test_integers_from_a_normal_distribution_are_as_likely_as_what_is_rounded_to_them(tmp_path):
    path = file(tmp_path, ("n", "integer", "3", ""))
    law = '<NormalDistribution expectedValue="5" variance="4"><Range lowerLimit="0" upperLimit="10"/></NormalDistribution>'
    space = LogicalScenario.read(path, space_file(tmp_path, "n", law, stochastic=True)).space
    values = drawn(space, "n", 4000)
    assert set(values) <= set(range(11))
    share = (erf(0.5 / 2 / sqrt(2)) - erf(-0.5 / 2 / sqrt(2))) / 2 / (erf(2.5 / sqrt(2)))
    assert np.mean(np.array(values) == 5) == pytest.approx(share, abs=0.02)


def test_a_range_of_a_boolean_is_false_and_true(tmp_path):
    path = file(tmp_path, ("b", "boolean", "true", ""))
    assert set(drawn(LogicalScenario.read(path, None, ["b=0:1"]).space, "b")) == {"false", "true"}
    with pytest.raises(InputError, match="b is declared as boolean"):
        LogicalScenario.read(path, None, ["b=0:2"])


def test_a_range_of_a_text_gives_texts_without_decimals(tmp_path):
    """Road ids are texts; in most files they look like numbers."""
    init = teleport("5").replace('roadId="1"', 'roadId="$road"')
    path = file(tmp_path, ("road", "string", "1", ""), init=init)
    (tmp_path / "road.xodr").write_text(
        ROAD.replace("</OpenDRIVE>", "") + ROAD[ROAD.index("<road ") :].replace('id="1" length', 'id="2" length').replace('y="0"', 'y="50"')
    )  # fmt: skip
    logical = LogicalScenario.read(path, None, ["road=1:2:1"])
    values = logical.space.values(logical.space.full_factorial())
    assert values == [{"road": "1"}, {"road": "2"}]
    found = ran(
        Builtin(duration=0.1),
        [*map(logical.concrete_scenario, values), logical.concrete_scenario({"road": 2.0})],
    )
    assert [float(one.y[0, 0]) for one in found] == [-2.0, 48.0, 48.0]
    with pytest.raises(InputError, match="needs a step"):
        LogicalScenario.read(path, None, ["road=1:2"])


@pytest.mark.parametrize(
    ("kind", "rule", "bound", "good", "bad"),
    [
        ("boolean", "equalTo", "true", ["true", "1", True], ["false", 0]),
        ("boolean", "notEqualTo", "1", ["false"], ["true"]),
        ("string", "equalTo", "1.0", ["1.0"], ["1"]),
        ("integer", "lessThan", "3", [2, "2"], [3, 4]),
        ("double", "greaterOrEqual", "3", [3, 3.5], [2.9]),
    ],
)
def test_constraints_compare_values_of_the_declared_type(tmp_path, kind, rule, bound, good, bad):
    path = file(tmp_path, ("p", kind, good[0], constrained(rule, bound)))
    found = list(Builtin(duration=0.1).run([ConcreteScenario(path, {"p": one}) for one in [*good, *bad]]))
    assert ["breaks a constraint" in str(one) for one in found] == [False] * len(good) + [True] * len(bad)


def test_a_constraint_with_what_is_no_value_of_the_type_is_refused(tmp_path):
    path = file(tmp_path, ("p", "boolean", "true", constrained("equalTo", "often")))
    with pytest.raises(InputError, match="not of the type boolean"):
        simulate(path, duration=0.1)


@pytest.mark.parametrize(
    ("kind", "value", "written"),
    [
        ("integer", 4.0, "4"), ("integer", "4", "4"), ("boolean", True, "true"), ("boolean", "0", "false"),
        ("string", 2.0, "2"), ("string", "2.0", "2.0"), ("double", 2.5, "2.5"), ("double", 2, "2"),
    ],
)  # fmt: skip
def test_values_are_written_as_what_they_are_declared(tmp_path, kind, value, written):
    path = file(tmp_path, ("p", kind, "1", ""))
    write_concrete_file(ScenarioFile.read(path), {"p": value}, tmp_path / "out.xosc")
    (declaration,) = etree.parse(tmp_path / "out.xosc").iterfind(".//ParameterDeclaration")
    assert declaration.get("value") == written


def test_what_is_no_value_of_the_type_is_not_written(tmp_path):
    path = file(tmp_path, ("p", "integer", "1", ""))
    with pytest.raises(InputError, match=r"the parameter p is '4\.33', which is not a whole number"):
        write_concrete_file(ScenarioFile.read(path), {"p": 4.33}, tmp_path / "out.xosc")


def test_check_finds_a_scenario_within_narrow_constraints(tmp_path):
    path = file(tmp_path, ("p", "double", "7", constrained("equalTo", "7")), ("q", "double", "1", ""))
    inner = "<DistributionSet>" + "".join(f'<Element value="{k}"/>' for k in range(2000)) + "</DistributionSet>"
    space = space_file(tmp_path, "p", inner)
    found = check(path, space)
    assert found.is_valid
    assert found.space is not None
    space = space_file(
        tmp_path, "p", '<DistributionRange stepWidth="0.001"><Range lowerLimit="6" upperLimit="8"/></DistributionRange>'
    )
    assert check(path, space).is_valid
    # Almost no point is admissible: one sentence.
    (trouble,) = check(
        path,
        space_file(
            tmp_path,
            "p",
            '<DistributionRange stepWidth="0.00001"><Range lowerLimit="6.3" upperLimit="8"/></DistributionRange>',
        ),
    ).run_errors
    assert "None of 2048 concrete scenarios fulfils the constraints" in trouble
