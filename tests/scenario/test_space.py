from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import EXAMPLES
from cornercase._common.errors import InputError
from cornercase.exploration import Problem, explore
from cornercase.scenario import Constraint, LogicalScenario, Parameter, ParameterDeclaration, ParameterSpace
from cornercase.scenario import _distributions as distributions
from cornercase.scenario._distributions import Distribution
from cornercase.scenario._expressions import evaluate_expression
from cornercase.scenario._xml import read_xml


def distribution(body: str) -> str:
    return f"""<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="2026-01-01T00:00:00" author="a" description="d"/>
<ParameterValueDistribution><ScenarioFile filepath="s.xosc"/>{body}</ParameterValueDistribution></OpenSCENARIO>"""


def test_steps_give_round_values():
    space = ParameterSpace.from_ranges(["a=0:1:0.1", "b=-1:1"])
    assert space.parameters[0].size == 11
    values = [one["a"] for one in space.values(np.array([[(k + 0.5) / 11, 0.5] for k in range(11)]))]
    assert values == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]
    assert space.size is None


@pytest.mark.parametrize(
    ("low", "step", "is_integer"), [(1e13, 1.0, True), (1e13 + 1.0, 10_000.0, True), (1e13 + 0.5, 0.5, False)]
)
def test_steps_of_large_values_are_all_there(low, step, is_integer):
    parameter = Parameter("a", low, low + 5 * step, step, is_integer=is_integer)
    assert [parameter.value_at((k + 0.5) / 6) for k in range(6)] == [low + k * step for k in range(6)]


def test_no_step_is_below_the_lower_bound():
    assert Parameter("a", 0.1234567890123456, 2.0, 1.0).value_at(0.0) == 0.1234567890123456


def test_a_value_that_is_no_choice_has_no_number():
    parameter = Parameter("a", 0, 1, choices=("x", "y"))
    assert parameter.extract_number({"a": "y"}) == 1.0
    with pytest.raises(InputError, match="The parameter a has no value 'z'"):
        parameter.extract_number({"a": "z"})


@given(st.lists(st.floats(0, 1), min_size=3, max_size=3))
def test_values_and_points_are_inverse(u):
    space = ParameterSpace.from_ranges(["a=2:7:0.5", "b=-1:1", "c=0:3:1"])
    point = space.snap(np.array([u]))
    np.testing.assert_allclose(space.points(space.values(point)), point, atol=1e-12)
    np.testing.assert_array_equal(space.snap(point), point)


EVERY_KIND = ParameterSpace(
    [
        Parameter("continuous", -3.0, 7.0),
        Parameter("stepped", 0.0, 1.0, 0.1),
        Parameter("whole", 0.0, 900.0, 1.0, is_integer=True),
        Parameter("name", 0, 2, choices=("a", "b", "c")),
        Parameter("set", 0, 1, choices=("0", "1"), value_sets=((("x", "1.5"), ("y", "p")), (("x", "2.5"), ("y", "q")))),
        *(
            Parameter(f"{kind}", low, 9.0, distribution=Distribution(kind, low, 9.0, numbers))
            for kind, low, numbers in (
                ("uniform", -4.0, ()),
                ("normal", -4.0, (2.0, 1.5)),
                ("lognormal", 0.5, (0.3, 0.9)),
                ("histogram", 0.0, (0.0, 1.0, 4.0, 9.0, 1.0, 5.0, 2.0)),
            )
        ),
        Parameter("stepped law", 0.0, 3.0, 0.5, distribution=Distribution("normal", 0.0, 3.0, (1.0, 0.7))),
    ]
)


def test_the_values_of_many_scenarios_are_those_of_each_alone():
    points = np.random.default_rng(0).random((400, EVERY_KIND.dimension))
    points[:3] = [[0.0], [1.0], [0.5]]
    values = EVERY_KIND.values(points)
    assert values == [EVERY_KIND.values(point[None])[0] for point in points]
    assert [type(one) for one in values[0].values()] == [float, float, int, str, str, str, *[float] * 5]
    assert EVERY_KIND.values(points[:0]) == []


def test_many_scenarios_ask_a_distribution_once():
    distributions._truncated_normal.cache_clear()
    laws = [ParameterDeclaration("normal", "double", "0", ((Constraint("greaterThan", "$lognormal"),),))]
    space = ParameterSpace(
        [one for one in EVERY_KIND.parameters if one.name in ("normal", "lognormal")],
        [ParameterDeclaration("lognormal", "double", "0"), *laws],
    )
    share = space.is_admissible(np.random.default_rng(0).random((2000, 2))).mean()
    assert 0.2 < share < 0.8
    calls = distributions._truncated_normal.cache_info()
    assert calls.hits + calls.misses == 2


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
    assert ParameterSpace.read_scenario_path(path) == tmp_path / "s.xosc"


@pytest.mark.parametrize(
    "text",
    ["a=1:1", "a=2:1", "a=0:inf", "a=0", "a", "=0:1", "a=x:1", "a=0:1:0", "a=0:1:2", "a=0:1:-1", "a=-1e308:1e308",
     "a=0:1e16", "a=0:1:1e-300"],
)  # fmt: skip
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
    assert evaluate_expression(expression, {"a": 2.0}) == value


@pytest.mark.parametrize(
    "expression", ["__import__('os')", "1+", "(" * 500, "a" * 20_000, "$b", "1 2", "a.b()", "lambda: 1"]
)
def test_bad_expressions_are_refused(expression):
    with pytest.raises(InputError):
        evaluate_expression(expression, {"a": 1.0})


def stochastic(tmp_path, law: str) -> ParameterSpace:
    path = tmp_path / "d.xosc"
    body = f'<StochasticDistribution parameterName="n">{law}</StochasticDistribution>'
    path.write_text(distribution(f'<Stochastic numberOfTestRuns="10" randomSeed="1">{body}</Stochastic>'))
    return ParameterSpace.from_file(path)


RANGE = '<Range lowerLimit="{}" upperLimit="{}"/>'


@pytest.mark.parametrize(
    ("law", "low", "high", "draw"),
    [
        ("UniformDistribution", -1, 3, lambda r, n: r.uniform(-1, 3, n)),
        ('NormalDistribution expectedValue="2" variance="9"', 1, 8, lambda r, n: r.normal(2, 3, n)),
        ('LogNormalDistribution expectedValue="0.5" variance="0.25"', 0, 4, lambda r, n: r.lognormal(0.5, 0.5, n)),
        ('PoissonDistribution expectedValue="3"', 1, 6, lambda r, n: r.poisson(3, n).astype(float)),
    ],
)
def test_values_are_distributed_as_random_numbers_within_the_bounds(tmp_path, law, low, high, draw):
    space = stochastic(tmp_path, f"<{law}>{RANGE.format(low, high)}</{law.split()[0]}>")
    drawn = draw(np.random.default_rng(0), 200_000)
    drawn = np.sort(drawn[(drawn >= low) & (drawn <= high)])
    places = (np.arange(200) + 0.5) / 200
    values = np.array([one["n"] for one in space.values(places[:, None])])
    expected = drawn[(places * len(drawn)).astype(int)]
    # The upper bound of a count may be rounded to either side.
    assert np.mean(np.abs(values - expected) > 0.02 * (high - low)) <= 0.02
    again = space.values(space.points(space.values(places[:, None])))
    assert again[7]["n"] == pytest.approx(values[7])


def test_bounds_far_in_the_tail_are_kept(tmp_path):
    law = f'<NormalDistribution expectedValue="0" variance="1">{RANGE.format(20, 21)}</NormalDistribution>'
    space = stochastic(tmp_path, law)
    values = [one["n"] for one in space.values(np.linspace(0, 1, 11)[:, None])]
    assert values[0] == 20
    assert values == sorted(values)
    # Beyond x, the tail decreases by a factor of e within about 1 / x.
    assert values[5] == pytest.approx(20 + np.log(2) / 20, rel=1e-3)


def test_histogram_and_set_share_the_unit_interval_by_weight(tmp_path):
    bins = f'<Bin weight="1">{RANGE.format(0, 1)}</Bin><Bin weight="3">{RANGE.format(1, 2)}</Bin>'
    space = stochastic(tmp_path, f"<Histogram>{bins}</Histogram>")
    assert [one["n"] for one in space.values(np.array([[0.125], [0.25], [0.625]]))] == [0.5, 1.0, 1.5]
    elements = "".join(f'<Element value="{v}" weight="{w}"/>' for v, w in (("x", 1), ("y", 0), ("z", 3)))
    space = stochastic(tmp_path, f"<ProbabilityDistributionSet>{elements}</ProbabilityDistributionSet>")
    assert [one["n"] for one in space.values(np.array([[0.2], [0.3], [0.9]]))] == ["x", "z", "z"]
    assert space.size == 2
    np.testing.assert_array_equal(space.snap(np.array([[0.1], [0.9]])), [[0.125], [0.625]])
    assert ParameterSpace.from_json(space.to_json()).parameters == space.parameters


@pytest.mark.parametrize(
    "law",
    [
        '<UserDefinedDistribution type="python" content="import os"/>',
        '<NormalDistribution expectedValue="0" variance="-1"/>',
        '<NormalDistribution expectedValue="nan" variance="1"/>',
        f'<PoissonDistribution expectedValue="0">{RANGE.format(0, 3)}</PoissonDistribution>',
        f'<PoissonDistribution expectedValue="3">{RANGE.format(500, 600)}</PoissonDistribution>',
        f'<PoissonDistribution expectedValue="3">{RANGE.format(0, 1e12)}</PoissonDistribution>',
        f'<PoissonDistribution expectedValue="50000">{RANGE.format(0, 100_000)}</PoissonDistribution>',
        f'<LogNormalDistribution expectedValue="3" variance="1">{RANGE.format(-3, -1)}</LogNormalDistribution>',
        f'<UniformDistribution>{RANGE.format(3, 3)}</UniformDistribution>',
        "<UniformDistribution/>",
        f'<Histogram><Bin weight="-1">{RANGE.format(0, 1)}</Bin></Histogram>',
        f'<Histogram><Bin weight="0">{RANGE.format(0, 1)}</Bin></Histogram>',
        '<ProbabilityDistributionSet><Element value="a" weight="0"/></ProbabilityDistributionSet>',
        # Numbers that are lost in a sum.
        '<NormalDistribution expectedValue="1e308" variance="1"/>',
        f'<NormalDistribution expectedValue="0" variance="1">{RANGE.format(-1e308, 1e308)}</NormalDistribution>',
        '<NormalDistribution expectedValue="1e9" variance="1e-30"/>',
        '<LogNormalDistribution expectedValue="1000" variance="1"/>',
        '<PoissonDistribution expectedValue="1e308"/>',
        f'<UniformDistribution>{RANGE.format(-1e308, 1e308)}</UniformDistribution>',
        f'<Histogram><Bin weight="1e308">{RANGE.format(0, 1)}</Bin><Bin weight="1e308">{RANGE.format(1, 2)}</Bin></Histogram>',
        "",
    ],
)  # fmt: skip
def test_bad_distributions_are_refused_by_file_and_parameter(tmp_path, law):
    with pytest.raises(InputError, match=r"d\.xosc, line \d+: <StochasticDistribution>: parameter n"):
        stochastic(tmp_path, law)


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ("", "the file varies no parameter"),
        ('<Deterministic><DeterministicMultiParameterDistribution/></Deterministic>', "all must set the same ones"),
        (2 * '<Deterministic><DeterministicSingleParameterDistribution parameterName="a"><DistributionSet><Element '
         'value="1"/></DistributionSet></DeterministicSingleParameterDistribution></Deterministic>', "a is varied twice"),
        ('<Deterministic><DeterministicSingleParameterDistribution parameterName="a"><DistributionRange stepWidth="x">'
         '<Range lowerLimit="0" upperLimit="1"/></DistributionRange></DeterministicSingleParameterDistribution>'
         '</Deterministic>', "'x' is not a number"),
    ],
)  # fmt: skip
def test_bad_files_are_refused(tmp_path, body, says):
    path = tmp_path / "d.xosc"
    path.write_text(distribution(body))
    with pytest.raises(InputError, match=rf"d\.xosc.*{says}"):
        ParameterSpace.from_file(path)


@pytest.mark.parametrize("name", ["http://example.org/s.xosc", "file:///etc/passwd", ""])
def test_scenarios_elsewhere_are_refused(tmp_path, name):
    path = tmp_path / "d.xosc"
    path.write_text(distribution("").replace("s.xosc", name))
    with pytest.raises(InputError, match="local file"):
        ParameterSpace.read_scenario_path(path)


def test_ranges_add_and_replace_and_keep_the_unit():
    space = ParameterSpace.from_file(EXAMPLES / "x_intersection" / "x_intersection.space.xosc")
    name = space.names[0]
    merged = space.with_ranges([f"{name}=1:2", "new=0:1"])
    assert merged.names == (*space.names, "new")
    assert (merged.parameters[0].low, merged.parameters[0].high, merged.parameters[0].unit) == (1, 2, "m")
    assert space.with_ranges([]).parameters == space.parameters
    with pytest.raises(InputError, match="a is varied twice"):
        ParameterSpace.from_ranges(["a=0:1", "a=0:2"])


REFERENCE = Path(__file__).parents[3] / "shared" / "reference" / "openscenario"


@pytest.mark.skipif(not REFERENCE.is_dir(), reason="the published scenarios are not beside the checkout")
@pytest.mark.parametrize(
    ("file", "size"),
    [
        ("alks/logical_scenarios/alks_scenario_4_1_1_free_driving_variation.xosc", 12),
        ("ncap/OpenSCENARIO/NCAP/AEB_VRU_2023/Variations/NCAP_AEB_VRU_CPNA-25_Variation_2023.xosc", 11),
    ],
)
def test_published_variations_are_read(file, size):
    space = ParameterSpace.from_file(REFERENCE / file)
    assert space.size == size
    assert len({tuple(one.items()) for one in space.values(space.full_factorial())}) == size
    assert ParameterSpace.read_scenario_path(REFERENCE / file).is_file()


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="has no endless file")
def test_endless_files_are_refused():
    with pytest.raises(InputError, match="not a file"):
        read_xml("/dev/zero")


@pytest.mark.parametrize("name", ["content", "attribute", "default", "external"])
def test_entities_are_never_expanded(tmp_path, name):
    entities = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10}">' for i in range(1, 12))
    inner = f'[<!ENTITY e0 "lol">{entities}<!ATTLIST b c CDATA "&e11;">]'
    path = tmp_path / "bomb.xosc"
    path.write_text(
        {
            "content": f"<!DOCTYPE a {inner}><a>&e11;</a>",
            "attribute": f'<!DOCTYPE a {inner}><a d="&e11;"/>',
            "default": f"<!DOCTYPE a {inner}><a><b/></a>",
            "external": '<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]><a>&x;</a>',
        }[name]
    )
    with pytest.raises(InputError, match=r"bomb\.xosc"):
        read_xml(path)


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ((1, 0), "`low` 1, `high` 0"),
        ((1, 1), "`low` 1, `high` 1"),
        ((1, 0, 1), "`low` 1, `high` 0"),
        ((0, float("nan")), "`high` nan"),
        ((float("-inf"), 0), "`low` -inf"),
        (("0", 1), "`low` '0'"),
        ((0, None), "`high` None"),
        ((0, 1, 0), "`step` 0"),
        ((0, 1, -1), "`step` -1"),
        ((0, 1, float("nan")), "`step` nan"),
        ((0, 1, "1"), "`step` '1'"),
    ],
)
def test_a_parameter_without_a_range_is_refused(given, named):
    with pytest.raises(InputError) as refused:
        Parameter("a", *given)
    assert str(refused.value).startswith(f"{named}: ")


def test_what_is_searched_or_stored_has_parameters():
    stored = ParameterSpace(()).to_json()
    for make in (lambda: ParameterSpace.from_ranges([]), lambda: ParameterSpace.from_json(stored)):
        with pytest.raises(InputError, match=r"^The parameter space is empty; vary at least one parameter"):
            make()


def test_a_scenario_of_which_nothing_varies_yet_is_varied_step_by_step(tmp_path):
    path = EXAMPLES / "r157" / "deceleration.xosc"
    logical = LogicalScenario.read(path)
    assert (logical.space.names, logical.space.size) == ((), 1)
    assert repr(logical).endswith("deceleration.xosc': nothing is varied>")
    assert logical.concrete_scenario({}).with_all_values().values["ego_kmh"] == 90.0
    varied = logical.vary("gap", 20, 40).vary("deceleration", 1, 6, step=0.5)
    assert varied == LogicalScenario.read(path, ranges=["gap=20:40", "deceleration=1:6:0.5"])
    with pytest.raises(InputError, match=r"nothing is varied; give a `space` file, or `ranges` such as NAME=LOW:HIGH"):
        Problem(logical, "Ego", "Other", "ttc")
    with pytest.raises(InputError, match="nothing is varied"):
        explore(path, tmp_path / "s.db", ego="Ego", other="Other", metrics=["ttc"])
    assert not list(tmp_path.iterdir())


def test_equal_bounds_fix_a_parameter_in_each_run():
    logical = LogicalScenario.read(EXAMPLES / "r157" / "deceleration.xosc").vary("gap", 20, 40)
    fixed = logical.vary("deceleration", 2.5, 2.5)
    assert repr(fixed).endswith("gap 20 to 40, deceleration 2.5>")
    assert {values["deceleration"] for values in fixed.space.values(np.random.default_rng(0).random((9, 2)))} == {2.5}
    assert ParameterSpace.from_json(fixed.space.to_json()) == fixed.space
    assert fixed.vary("deceleration", 1, 6) == logical.vary("deceleration", 1, 6)


@pytest.mark.parametrize(
    ("bounds", "says"),
    [
        ({"low": 9, "high": 8}, "`low` 9, `high` 8: the range of gap is 9 to 8; the lower bound must be below"),
        ({"low": 9, "high": 10, "step": 3}, "`low` 9, `high` 10, `step` 3: the step of gap must be above 0"),
        ({"low": 9, "high": 1e16}, "`low` 9, `high` 1e+16: the bounds of gap are"),
        ({"low": 1e16, "high": 1e16}, "`low` 1e+16, `high` 1e+16: the bounds of gap are"),
    ],
)
def test_a_range_that_cannot_be_varied_names_the_arguments_of_vary(bounds, says):
    with pytest.raises(InputError) as refused:
        LogicalScenario.read(EXAMPLES / "r157" / "deceleration.xosc").vary("gap", **bounds)
    assert str(refused.value).startswith(says)


def test_a_parameter_may_have_a_single_value():
    one = Parameter("a", 2.0, 2.0, 1.0)
    assert (one.size, one.value_at(0.7), one.unit_position(2.0)) == (1, 2.0, 0.5)
    assert ParameterSpace([one]).as_continuous().parameters == (one,)


@pytest.mark.parametrize(
    ("name", "says"), [("nofile.xosc", "cannot be read"), ("", "`scenario`"), (".", "is not a file")]
)
def test_a_scenario_that_is_not_there_is_said_before_its_space(name, says, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=says):
        LogicalScenario.read(name)
