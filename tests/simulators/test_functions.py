"""`check` and `simulate`, as Python users call them."""

from __future__ import annotations

from typing import Any

import pytest

from conftest import EXAMPLES, car, same_recording, scenario_file, speed_action, teleport
from cornercase._common.errors import InputError
from cornercase.scenario import ConcreteScenario
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators import Builtin, check, convert, simulate

X = EXAMPLES / "x_intersection" / "x_intersection.xosc"
SPACE = EXAMPLES / "x_intersection" / "x_intersection.space.xosc"


def test_check_tells_what_a_file_holds():
    found = check(X, SPACE)
    assert found.is_valid
    assert found.contents["ScenarioObject"] == 4
    assert found.space is not None
    assert found.space.names == ("ego_start", "pedestrian_wait", "p1_speed")
    assert repr(found).startswith("<Check of x_intersection.xosc: can be run, schema 1.2.0: valid; 4 ScenarioObject")
    assert check(ScenarioFile.read(X)).contents == found.contents
    assert check(X).space is None


def test_check_says_why_a_file_cannot_be_run(tmp_path):
    init = f'<Private entityRef="Ego">{teleport("50", "-7")}{speed_action("10")}</Private>'
    path = scenario_file(tmp_path, init=init, story="", entities=car("Ego"))
    found = check(path)
    assert not found.is_valid
    assert found.run_errors[0] in repr(found)
    assert "cannot be run" in repr(found)


def test_a_space_that_does_not_fit_is_trouble_with_the_scenario():
    other = EXAMPLES / "t_intersection" / "t_intersection.space.xosc"
    found = check(X, other)
    assert found.space is None
    assert "declares no parameter" in found.run_errors[0]


def test_simulate_gives_the_recording_that_the_simulator_gives():
    values, options = {"ego_start": 40.0}, dict[str, Any](duration=5.0, on_collision="stop")
    (expected,) = Builtin(drivers={"Ego": "cautious"}, **options).run([ConcreteScenario(X, values)])
    recording = simulate(X, values, drivers={"Ego": "cautious"}, **options)
    assert same_recording(recording, expected)
    assert same_recording(simulate(ScenarioFile.read(X), values, drivers={"Ego": "cautious"}, **options), expected)


@pytest.mark.parametrize(
    ("values", "options", "says"),
    [
        ({"ego_strt": 40.0}, {}, "declares no parameter 'ego_strt'"),
        ({"ego_start": 4000.0}, {}, "placed off the map"),
        ({}, {"drivers": {"Ego": "careful"}}, "careful"),
        ({}, {"drivers": {"Eggo": "normal"}}, "no entity 'Eggo'"),
        ({}, {"time_step": 0.0}, "time_step"),
    ],
)
def test_simulate_refuses_what_cannot_be_run(values, options, says):
    with pytest.raises(InputError, match=says):
        simulate(X, values, **options)


@pytest.mark.parametrize("wrong", [None, 3, ""])
@pytest.mark.parametrize("call", [simulate, check, lambda one: convert(one, "never.xosc", ego="Ego")])
def test_what_is_no_path_is_refused(call, wrong):
    with pytest.raises(InputError, match=r"`scenario` .*: give the path of a file"):
        call(wrong)


@pytest.mark.parametrize("values", [{"ego_start": None}, {"ego_start": [1.0]}, {3: 1.0}, 3])
def test_values_that_are_none_are_refused(values, tmp_path):
    for call in (simulate, lambda one, given: convert(one, tmp_path / "c.xosc", ego="Ego", values=given)):
        with pytest.raises(InputError, match="`values`"):
            call(X, values)
    assert not list(tmp_path.iterdir())
