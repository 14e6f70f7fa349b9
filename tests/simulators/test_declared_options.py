"""Options of users' simulators, metrics and other classes: declared, or refused."""

from __future__ import annotations

import pytest

import cornercase as cc
from cornercase import InputError
from cornercase._common.errors import NoticeWarning
from cornercase._common.registry import Registry
from cornercase.optimizers import OPTIMIZERS
from cornercase.scenario import ParameterSpace
from cornercase.simulators import SIMULATORS, Builtin, Simulator
from cornercase.simulators._create import create_simulator
from helpers.fake_simulators import recording


class Swallowing(Simulator):
    """Accepts any option, like a hastily written constructor."""

    name = "swallowing"
    in_process = True

    def __init__(self, *, crash: float = 10.0, **options):
        self.settings = {"crash": crash}
        self.given = options

    def run(self, concretes):
        for _ in concretes:
            yield recording(0)


class Terse(Swallowing):
    """Accepts only a time step."""

    name = "terse"

    def __init__(self, *, time_step: float = 0.1):
        super().__init__()
        self.time_step = time_step


class Longer(Builtin):
    """Passes other options to its base class."""

    name = "longer"

    def __init__(self, *, more: float = 1.0, **options):
        super().__init__(**options)
        self.more = more


class Needy(Swallowing):
    name = "needy"

    def __init__(self, *, licence: str):
        super().__init__()


class Drifting(Swallowing):
    name = "drifting"
    requires = ("ego",)

    def __init__(self):
        super().__init__()


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    monkeypatch.setattr(SIMULATORS, "_factories", dict(SIMULATORS._factories))
    for one in (Swallowing, Terse, Longer, Needy, Drifting):
        SIMULATORS.register(one.name, one)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("swallowing:crash=15,typo=3", "The simulator 'swallowing' has no option 'typo'; known are: crash."),
        ("swallowing:crsh=15", "has no option 'crsh'; did you mean 'crash'?"),
        (
            "terse:crash=15",
            "The simulator 'terse' has no option 'crash'; its options (time_step) are given on their own",
        ),
        ("longer:typo=3", "The simulator 'longer' has no option 'typo'; known are: more."),
        ("needy", "The simulator 'needy' needs the option 'licence'; give it as in 'needy:licence=value'."),
        (
            "drifting",
            "The simulator 'drifting' does not accept the argument 'ego', which cornercase always gives; add it to the constructor.",
        ),
    ],
)
def test_42_7_options_that_a_simulator_does_not_declare_are_refused(name, says):
    options = {"time_step": 0.05, "duration": 60.0, "on_collision": "continue", "drivers": {}}
    with pytest.raises(InputError) as caught:
        create_simulator(name, options)
    assert says in str(caught.value)


@pytest.mark.parametrize("name", ["swallowing", "terse"])
def test_42_7_a_simulator_without_drivers_is_not_given_any(name, x_intersection, tmp_path):
    says = f"`drivers` Ego: the simulator '{name}' supports no drivers; leave them out, or declare 'drivers'"
    with pytest.raises(InputError) as caught:
        create_simulator(name, {"drivers": {"Ego": "normal"}})
    assert str(caught.value).startswith(says)
    with pytest.raises(InputError, match="supports no drivers"):
        cc.explore(
            x_intersection, tmp_path / "s.db", ego="Ego", other="C", metrics=["distance"], simulator=name,
            drivers={"Ego": "normal"},
        )  # fmt: skip
    assert not (tmp_path / "s.db").exists()
    with pytest.raises(InputError, match=r"`on_collision` stop: the simulator .* does not declare 'on_collision'"):
        create_simulator(name, {"on_collision": "stop"})


def test_42_7_a_time_that_a_simulator_does_not_declare_is_named_as_without_effect():
    with pytest.warns(NoticeWarning, match=r"without effect: duration 20.0 s, since the simulator 'terse' does not"):
        made = create_simulator("terse", {"time_step": 0.01, "duration": 20.0, "on_collision": "continue"})
    assert isinstance(made, Terse)
    assert made.time_step == 0.01


@pytest.mark.filterwarnings("error")
def test_42_7_what_nobody_asked_for_is_said_of_nobody():
    usual = {"time_step": 0.05, "duration": 60.0, "on_collision": "continue", "drivers": {}}
    assert isinstance(create_simulator("terse", usual), Terse)
    made = create_simulator("swallowing:crash=15", usual)
    assert isinstance(made, Swallowing)
    # A constructor with **options gets all of them.
    assert (made.settings, made.given) == ({"crash": 15.0}, usual)


@pytest.mark.filterwarnings("error")
def test_42_7_options_of_the_base_class_count_where_they_are_handed_on():
    made = create_simulator("longer:more=2", {"drivers": {"Ego": "normal"}, "on_collision": "stop", "duration": 9.0})
    assert isinstance(made, Longer)
    assert made.more == 2.0
    assert made.settings["drivers"] == {"Ego": "normal"}


def test_42_7_the_same_holds_of_everything_that_has_a_name(monkeypatch):
    class Line(OPTIMIZERS.get_class("random")):  # type: ignore[misc]
        def __init__(self, **more):
            super().__init__()

    monkeypatch.setattr(OPTIMIZERS, "_factories", dict(OPTIMIZERS._factories))
    OPTIMIZERS.register("line", Line)
    space = ParameterSpace.from_ranges(["a=0:1"])
    assert OPTIMIZERS.create("line").start(space, 1, budget=3).ask(2).shape == (2, 1)
    with pytest.raises(InputError, match="The optimizer 'line' has no option 'step'; its constructor declares none"):
        OPTIMIZERS.create("line:step=3").start(space, 1, budget=3)
    things: Registry[object] = Registry("thing", "cornercase.nothing")
    things.register("all", lambda **more: more)
    with pytest.raises(InputError, match="The thing 'all' has no option 'a'; its constructor declares none"):
        things.create("all:a=1")
