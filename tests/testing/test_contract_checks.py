"""Checks for users: what keeps its contract passes, and each way of breaking it is found by its check."""

from __future__ import annotations

import itertools
import json
import math
import time
from dataclasses import replace

import numpy as np
import pytest

import cornercase as cc
from conftest import at_night
from cornercase.metrics import METRICS
from cornercase.optimizers import OPTIMIZERS
from cornercase.testing import (
    check,
    list_checks,
    metric_checks,
    optimizer_checks,
    parametrize_with_checks,
    run_checks,
    simulator_checks,
    sut_checks,
)
from cornercase.testing._metric_checks import _default_recordings
from helpers.command_line import SPACE, X, cornercase

UNITS = "decides what fits m/s² and rad (not seen: signs, units inside)"


class Cruise(cc.SystemUnderTest):
    def __init__(self, gain: float = 0.5):
        self.gain = gain

    def step(self, view, dt):
        leader = view.leader
        if leader is not None and leader.gap < 1.5 * max(leader.closing, 0.0):
            return cc.Control(acceleration=-6.0)
        return self.gain * (10.0 - view.ego.speed)


class Vectorized(cc.Driver):
    def acceleration(self, situation):
        return 0.5 * (10.0 - situation.speed)


class Pursuit(cc.SystemUnderTest):
    """Steers towards a point of the path."""

    def __init__(self, in_degrees: bool = False):
        self.in_degrees = in_degrees

    def start(self, ego, road, rng):
        self.ego = ego

    def step(self, view, dt):
        point = view.path(4.0 + 0.6 * view.ego.speed)
        angle = math.atan(2.0 * self.ego.wheelbase * point.y / (point.x**2 + point.y**2))
        return cc.Control(acceleration=0.0, steering=math.degrees(angle) if self.in_degrees else angle)


def problems(checks):
    return {result.name: result.problem for result in run_checks(checks) if result.problem}


@parametrize_with_checks([Vectorized()])
def test_systems_that_keep_their_contract_pass(check):
    check.run()


@pytest.mark.slow
@parametrize_with_checks([Pursuit()])
def test_systems_that_steer_and_keep_their_contract_pass(check):
    check.run()


def test_a_system_that_steers_in_radians_passes():
    assert problems([check for check in sut_checks(Pursuit()) if check.name == UNITS]) == {}


@pytest.mark.slow
@parametrize_with_checks([Cruise()])
def test_a_system_that_does_not_steer_passes(check):
    check.run()


@pytest.fixture(scope="module")
def recordings():
    return _default_recordings()


@pytest.mark.parametrize("name", at_night(METRICS.names(), {*METRICS.names()} - {*METRICS.names()[::4]}))
def test_every_metric_of_cornercase_passes(recordings, name):
    if METRICS.get_class(name).required_option:
        pytest.skip("means nothing without its option")
    if name == "lane-margin":
        pytest.skip("measures on the roads of the scenario, which are nowhere else")
    assert problems(metric_checks(name, recordings)) == {}


@pytest.mark.parametrize("name", OPTIMIZERS.names())
def test_every_optimizer_of_cornercase_passes(name):
    assert problems(optimizer_checks(name)) == {}


# By day test_small_scenarios.py runs the command.
@pytest.mark.slow
def test_the_builtin_simulator_passes():
    assert problems(simulator_checks("builtin")) == {}


class Random(Cruise):
    def step(self, view, dt):
        return float(np.random.default_rng().normal())


class KeepsState(Cruise):
    count = itertools.count()

    def step(self, view, dt):
        return 0.001 * next(KeepsState.count)


class Clock(Cruise):
    def step(self, view, dt):
        return 0.1 * (time.perf_counter() % 1.0)


class LastTime(Cruise):
    """Begins with what the last step of the run before left."""

    time = 0.0

    def start(self, ego, road, rng):
        self.begun = LastTime.time

    def step(self, view, dt):
        LastTime.time = view.time
        return 0.01 * self.begun


class InKmh(Cruise):
    def step(self, view, dt):
        return 50.0


class InDegrees(Cruise):
    def step(self, view, dt):
        return cc.Control(acceleration=0.0, steering=2.0)


class SeesOthers(cc.Driver):
    """Depends on the other scenarios of its batch."""

    def acceleration(self, situation):
        return 0.5 * (10.0 - situation.speed) + 0.01 * len(situation.speed)


class NeverReset(cc.Driver):
    def __init__(self):
        self._steps = 0

    def acceleration(self, situation):
        self._steps += 1
        return np.full(len(situation.speed), 0.0001 * self._steps)


class Fails(Cruise):
    def step(self, view, dt):
        raise RuntimeError("no gap")


class Stores(Cruise):
    def __init__(self):
        super().__init__()
        self.settings = {"curve": (1, 2)}


@pytest.mark.parametrize(
    ("system", "name", "words"),
    [
        (Random(), "repeats itself", "differs, first at 0.05 s"),
        pytest.param(Clock(), "repeats itself", "differs", marks=pytest.mark.slow),
        pytest.param(KeepsState(), "gives the same alone and among other scenarios", "differs", marks=pytest.mark.slow),
        (SeesOthers(), "gives the same alone and among other scenarios", "Alone, a scenario differs"),
        (NeverReset(), "forgets the scenario before", "`start` does not set again"),
        (InKmh(), UNITS, "At 0 s it asks for an acceleration of 50 m/s², and no vehicle does more than 15"),
        (
            InDegrees(),
            UNITS,
            "At 0 s it asks for a steering angle of 2 rad, and the front wheels turn by at most 0.6 rad",
        ),
        (Pursuit(in_degrees=True), UNITS, "are these degrees?"),
        (LastTime(), "knows nothing of the time after", "ends at 4 s, it differs from 0.05 s on"),
        (Fails(), "drives every scenario", "no gap"),
        (Stores(), "can be stored and sent to another process", "plain JSON"),
    ],
)
def test_each_way_of_breaking_the_contract_is_found(system, name, words):
    (found,) = run_checks([check for check in sut_checks(system) if check.name == name])
    assert words in found.problem


@pytest.mark.parametrize(
    ("system", "cause", "count"),
    [
        (Fails(), "drives every scenario", 6),
        pytest.param(Random(), "repeats itself", 4, marks=pytest.mark.slow),
    ],
)
def test_checks_that_need_one_that_failed_are_not_run(system, cause, count):
    results = [*run_checks(sut_checks(system))]
    blocked = [result for result in results if result.blocked_by]
    assert {result.blocked_by for result in blocked} == {cause}
    assert len(blocked) == count
    assert all(result.problem for result in blocked)
    with pytest.raises(AssertionError) as raised:
        check(system)
    assert str(raised.value).startswith(f"{cause}: ")
    assert "\n" not in str(raised.value)


def test_a_setting_that_cannot_be_stored_is_named():
    class Handles(Cruise):
        def __init__(self):
            super().__init__()
            self.settings = {"curve": object()}

    (found,) = run_checks(sut_checks(Handles())[:1])
    assert found.problem.startswith("Its setting 'curve' is <object")


class HalfSpeed(cc.simulators.Builtin):
    name = "half-speed"

    def run(self, concretes):
        for recording in super().run(concretes):
            assert isinstance(recording, cc.Recording)
            yield replace(recording, speed=0.5 * recording.speed)


class LeftHanded(cc.simulators.Builtin):
    name = "left-handed"

    def run(self, concretes):
        for recording in super().run(concretes):
            assert isinstance(recording, cc.Recording)
            yield replace(recording, y=-recording.y)


class Alone(cc.simulators.Simulator):
    """Another simulator, one scenario at a time, whose `InputError` is about this scenario only."""

    name = "alone"

    def __init__(self):
        self.inner, self.settings = cc.simulators.Builtin(), {}

    def run(self, concretes):
        yield from self.inner.run(concretes)


class Shuffled(cc.simulators.Builtin):
    name = "shuffled"

    def run(self, concretes):
        yield from sorted(super().run(concretes), key=lambda recording: str(recording))


class Drifting(cc.simulators.Builtin):
    name = "drifting"
    runs = itertools.count(1)

    def run(self, concretes):
        for recording in super().run(concretes):
            assert isinstance(recording, cc.Recording)
            yield replace(recording, x=recording.x + 1e-9 * next(Drifting.runs))


@pytest.mark.parametrize(
    ("simulator", "name"),
    [
        (HalfSpeed(), "records m, rad, m/s, m/s² in right-handed axes"),
        (LeftHanded(), "records m, rad, m/s, m/s² in right-handed axes"),
        (LeftHanded(), "agrees with the builtin simulator: lane change"),
        (Shuffled(), "gives them in order"),
        (Drifting(), "repeats itself, as it declares"),
    ],
)
def test_simulators_that_break_their_contract_are_found(simulator, name):
    assert name in problems([check for check in simulator_checks(simulator) if check.name == name])


class Gap(cc.Metric):
    name, unit, source, lower_is_critical, cap = "gap-of-centres", "m", "a test", True, 100.0

    def course(self, recording, ego, other):
        i, j = recording.entity_index(ego), recording.entity_index(other)
        return np.hypot(recording.x[i] - recording.x[j], recording.y[i] - recording.y[j])


class WrongWay(Gap):
    lower_is_critical, cap = False, 0.0


class AlongX(Gap):
    def course(self, recording, ego, other):
        return np.abs(recording.x[recording.entity_index(ego)] - recording.x[recording.entity_index(other)])


class TooShort(Gap):
    def course(self, recording, ego, other):
        return super().course(recording, ego, other)[1:]


class BeyondItsBound(Gap):
    bound = 0.0

    def score(self, course):
        return float(np.nanmin(course)) - 50.0


@pytest.mark.parametrize(
    ("metric", "name"),
    [
        (BeyondItsBound(), "scores within its cap and bound"),
        (WrongWay(), "is not more critical far away than near"),
        (AlongX(), "is the same elsewhere on the map"),
        (TooShort(), "has a value or NaN at each instant"),
    ],
)
def test_metrics_that_break_their_contract_are_found(metric, name):
    found, right = (problems([one for one in metric_checks(each) if one.name == name]) for each in (metric, Gap()))
    assert (set(found), set(right)) == ({name}, set())


class Forgets(cc.Optimizer):
    """Depends on how often it was asked, which a resumed study does not repeat."""

    name = "forgets"

    def prepare(self, space, seed):
        self._rng, self._dimension = np.random.default_rng(seed), space.dimension

    def ask(self, n):
        return self._rng.random((n, self._dimension))

    def tell(self, points, scores):
        pass


def test_a_search_that_one_scenario_ends_is_found_with_a_way_out():
    name = "runs on after a scenario that cannot be run"
    (found,) = problems([check for check in simulator_checks(Alone()) if check.name == name]).values()
    assert found.startswith("If a number in one scenario is 'nonsense', the simulator raises InputError")
    assert "yield a SimulationError for this scenario instead" in found


def test_a_class_is_no_simulator_that_could_be_checked():
    with pytest.raises(
        cc.InputError, match=r"Alone: is a class; give the simulator's name, or an object, as in Alone\(\)"
    ):
        simulator_checks(Alone)  # type: ignore[arg-type]


class Unset(Alone):
    name = "unset"

    def __init__(self):
        pass


class Handles(Alone):
    name = "handles"

    def __init__(self):
        self.settings = {"file": object()}


class Pairs(Alone):
    name = "pairs"

    def __init__(self):
        self.settings = {"size": (1, 2)}


class Lost(Alone):
    name = "lost"

    @classmethod
    def availability(cls):
        raise RuntimeError("no such key")


@pytest.mark.parametrize(
    ("simulator", "words"),
    [
        (Unset(), "The simulator 'unset' has the `settings` None; set a dict of plain JSON values in its constructor"),
        (Handles(), "The simulator 'handles' has the `settings` {'file': <object"),
        (Pairs(), "Its setting 'size' is (1, 2), but [1, 2] after it was stored"),
        (Lost(), "The simulator 'lost' failed in availability: RuntimeError: no such key"),
    ],
)
def test_what_keeps_a_simulator_from_running_is_a_sentence(simulator, words):
    (found,) = problems(simulator_checks(simulator)[:1]).values()
    assert found.startswith(words)


@pytest.mark.parametrize("simulator", [Unset(), Handles()])
@pytest.mark.parametrize("workers", [1, 2])
def test_a_simulator_whose_settings_cannot_be_stored_runs_nothing(simulator, workers, tmp_path):
    with pytest.raises(cc.InputError, match=f"The simulator '{simulator.name}' has the `settings`"):
        cc.explore(
            X, tmp_path / "s.db", space=SPACE, ego="Ego", other="Pedestrian", metrics=["wttc"], budget=1,
            simulator=simulator, workers=workers,
        )  # fmt: skip
    assert not (tmp_path / "s.db").exists()


def test_agents_that_cannot_be_listed_are_a_fault_of_the_simulator():
    class Agents(Alone):
        @classmethod
        def own_agents(cls):
            raise RuntimeError("nobody")

    with pytest.raises(cc.InputError, match="The simulator 'alone' failed in own_agents: RuntimeError: nobody"):
        simulator_checks(Agents())


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("builtin:foo=1",), "The simulator 'builtin' has no option 'foo'"),
        (("builtin:",), "ends in a colon"),
        (
            ("my_sims:Braking",),
            "to use your own class Braking, register the class as an entry point of an installed package",
        ),
        (("builtin", "-o", "here.txt/proof.zip"), "-o here.txt/proof.zip: cannot be written into here.txt"),
    ],
)
def test_what_cannot_be_checked_is_refused_before_any_check(tmp_path, words, sentence):
    (tmp_path / "here.txt").touch()
    done = cornercase("check-simulator", *words, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert sentence in done.stderr


def test_an_optimizer_that_cannot_be_resumed_is_found():
    found = problems(optimizer_checks(Forgets()))
    assert list(found) == ["goes on after a restart as if nothing had happened"]
    with pytest.raises(AssertionError, match="goes on after a restart"):
        check(Forgets())


def test_what_has_no_checks_is_named():
    with pytest.raises(cc.InputError, match="give a SystemUnderTest"):
        list_checks(3)  # type: ignore[arg-type]


def test_the_commands_print_a_line_per_check_and_tell_by_the_exit_code(tmp_path):
    (tmp_path / "own.py").write_text(
        "import cornercase as cc\n\n\nclass Own(cc.SystemUnderTest):\n    def step(self, view, dt):\n        return 40.0\n"
    )
    bad = cornercase("check-sut", "own:Own", cwd=tmp_path)
    assert bad.returncode == 1
    assert f"FAILED {UNITS}" in bad.stdout
    assert "7 of 8 checks hold for the system under test own:Own" in bad.stdout
    (tmp_path / "fails.py").write_text(
        "import cornercase as cc\n\n\nclass Own(cc.SystemUnderTest):\n    def step(self, view, dt):\n        return 1 / 0\n"
    )
    failing = cornercase("check-sut", "fails:Own", cwd=tmp_path)
    assert failing.stdout.count("FAILED") == 1
    assert "not run: 6 checks that need this one: drives every scenario" in failing.stdout
    stored = json.loads(cornercase("check-sut", "fails:Own", "--json", cwd=tmp_path).stdout)
    assert [row["holds"] for row in stored["checks"]] == [True, False, *[None] * 6]
    wrong = cornercase("check-sut", "own:Owm", cwd=tmp_path)
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert "has no class 'Owm'" in wrong.stderr
