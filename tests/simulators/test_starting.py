"""Declarations of simulators, and where they run."""

from __future__ import annotations

from typing import Any

import pytest

from cornercase._common.errors import InputError
from cornercase._common.registry import Registry
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators import SIMULATORS, Builtin, Simulator, list_simulators
from cornercase.simulators._create import create_simulator
from cornercase.simulators.pool._simulator import WorkerSimulator
from helpers import fake_simulators as fake_simulators
from helpers.command_line import X


class Least(Simulator):
    """A minimal simulator."""

    name = "least"

    def __init__(self, **options):
        self.settings, self.options = {}, options

    def run(self, concretes):
        yield from ()


class Duck:
    """Looks like a simulator, but is not one."""

    name = "duck"

    def __init__(self, **options):
        self.settings = {}

    def run(self, concretes):
        yield from ()


def test_the_least_simulator_refuses_nothing_and_has_nothing_to_close():
    scenario = ScenarioFile.read(X)
    with Least() as simulator:
        simulator.check_supported(scenario)
        assert simulator.notices(scenario) == ()
        assert list(simulator.run([])) == []
    assert Least.availability().problem == ""
    assert (Least.in_process, Least.batched, Least.requires) == (False, False, ())


def test_a_simulator_that_cannot_run_is_none():
    class Half(Simulator):
        pass

    with pytest.raises(TypeError, match="run"):
        Half()  # type: ignore[abstract]


@pytest.mark.parametrize("what", [Duck, lambda **options: Least()])
def test_what_subclasses_nothing_is_refused_in_one_sentence(what):
    registry: Registry[Simulator] = Registry("simulator", "cornercase.none", Simulator)
    with pytest.raises(
        InputError, match=r"'duck' is .*not a subclass of cornercase\.simulators\.Simulator; register a subclass"
    ):
        registry.register("duck", what)


def test_one_that_cannot_be_loaded_is_not_available(monkeypatch):
    monkeypatch.setitem(SIMULATORS._factories, "duck", (Duck, {}))
    found = list_simulators()
    assert "not a subclass" in found["duck"].problem
    assert found["builtin"].problem == ""


@pytest.mark.parametrize(
    ("name", "options", "kind"),
    [
        ("builtin", {}, Builtin),
        ("builtin", {"timeout": 9.0}, WorkerSimulator),
        ("builtin", {"workers": 2}, WorkerSimulator),
        ("noisy", {}, WorkerSimulator),
    ],
)
def test_who_may_runs_in_this_process_where_nothing_can_be_gained(name, options, kind):
    with create_simulator(name, {}, **options) as simulator:
        assert isinstance(simulator, kind)


def test_a_simulator_is_given_what_it_says_it_needs(monkeypatch):
    class Needy(Least):
        requires = ("ego",)
        in_process = True

    monkeypatch.setitem(SIMULATORS._factories, "needy", (Needy, {}))
    monkeypatch.setitem(SIMULATORS._factories, "plain", (type("Plain", (Least,), {"in_process": True}), {}))
    needy: Any = create_simulator("needy", {"duration": 60.0}, ego="Hero")
    plain: Any = create_simulator("plain", ego="Hero")
    assert needy.options == {"duration": 60.0, "ego": "Hero"}
    assert plain.options == {}


@pytest.mark.parametrize("options", [{"timeout": 0.0}, {"timeout": float("inf")}, {"workers": 0}, {"retries": -1}])
def test_numbers_out_of_range_are_refused(options):
    with pytest.raises(InputError, match=f"`{next(iter(options))}`"):
        create_simulator("builtin", **options)
