"""Parameters declared as text and used as numbers."""

from __future__ import annotations

import numpy as np
import pytest

from conftest import scenario_file, teleport
from cornercase import InputError, simulate
from cornercase.scenario._expressions import evaluate_expression
from cornercase.simulators import check

SPEED = (
    '<PrivateAction><LongitudinalAction><SpeedAction><SpeedActionDynamics dynamicsShape="step" value="0"'
    ' dynamicsDimension="time"/><SpeedActionTarget><AbsoluteTargetSpeed value="{value}"/></SpeedActionTarget>'
    "</SpeedAction></LongitudinalAction></PrivateAction>"
)


def scenario(folder, value, text, constraint=""):
    declaration = f'<ParameterDeclaration name="v" parameterType="string" value="{text}">{constraint}'
    init = f'<Private entityRef="Ego">{teleport("5")}{SPEED.format(value=value)}</Private>'
    return scenario_file(folder, init=init, parameters=f"{declaration}</ParameterDeclaration>")


def test_43_8_an_expression_calculates_with_a_text_that_is_a_number(tmp_path):
    path = scenario(tmp_path, "${$v * -2 + 30}", "10")
    with pytest.warns(UserWarning, match="adapted: value of <AbsoluteTargetSpeed>.*text of the parameter v is taken"):
        recording = simulate(path)
    assert recording.speed[0, 0] == 10.0


def test_43_8_a_text_that_is_no_number_is_refused_in_an_expression(tmp_path):
    with pytest.raises(InputError, match=r"line \d+: value of <AbsoluteTargetSpeed> .* mixes text and numbers"):
        simulate(scenario(tmp_path, "${$v * 2}", "fast"))


@pytest.mark.parametrize(("text", "good"), [("-4", True), ("-10", False), ("4", False)])
def test_43_8_constraints_compare_texts_that_are_numbers_as_numbers(tmp_path, text, good):
    # Compared as texts, "-4" is outside of "-5" to "-3", and "-10" inside.
    group = (
        '<ConstraintGroup><ValueConstraint rule="greaterOrEqual" value="-5"/>'
        '<ValueConstraint rule="lessOrEqual" value="-3"/></ConstraintGroup>'
    )
    found = check(scenario(tmp_path, "10", text, group))
    assert (not found.run_errors) == good, found.run_errors
    assert any("compared as numbers" in one.reason and "equalTo" in one.rule for one in found.notices)


@pytest.mark.parametrize(
    ("expression", "value"),
    [("-$a", -1.5), ("$a == 1.5", True), ("$a == '1.50'", False), ("$a == '1.5'", True), ("max($a, 1)", 1.5)],
)
def test_43_8_two_texts_are_compared_as_texts(expression, value):
    assert evaluate_expression(expression, {"a": "1.5"}) == value
    assert np.array_equal(evaluate_expression("$a < $n", {"a": "1.5", "n": np.array([1.0, 2.0])}), [False, True])
