"""Drivers of entities in the builtin simulator, along lanes and trajectories."""

from __future__ import annotations

import signal
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import cornercase as cc
from conftest import (
    car,
    event,
    place,
    private,
    ran,
    same_recording,
    scenario_file,
    speed_action,
    story_of,
    teleport,
    time_trigger,
    trajectory,
)  # fmt: skip
from cornercase._common.errors import InputError, NoticeWarning, SimulationError
from cornercase._common.process.signals import collect_interrupts
from cornercase.drivers import Driver, EquippedDriver
from cornercase.drivers.vehicles._single_track import SingleTrack
from cornercase.drivers.vehicles._vehicle_model import VEHICLES
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin

DT = 0.05


def controller(action: str) -> str:
    return f"<PrivateAction><ControllerAction>{action}</ControllerAction></PrivateAction>"


def assign(driver: str | None, activate: str = 'activateLongitudinal="true"') -> str:
    named = "" if driver is None else f'<Property name="cornercase.driver" value="{driver}"/>'
    return controller(
        f'<AssignControllerAction {activate}><Controller name="c"><Properties>{named}</Properties></Controller>'
        "</AssignControllerAction>"
    )


def controlled(folder, action: str, drivers=None):
    """Two cars 10 m/s fast on one lane; the first gets an action at 1 s and is told to go 20 m/s at 2 s."""
    init = "".join(
        f'<Private entityRef="{name}">{teleport(s)}{speed_action("10")}</Private>'
        for name, s in (("A", "10"), ("B", "90"))
    )
    story = story_of(
        event("c", action, time_trigger("1")) + event("f", speed_action("20"), time_trigger("2")), actor="A"
    )
    path = scenario_file(folder, init=init, story=story, stop=time_trigger("5"), entities=car("A") + car("B"))
    (recording,) = Builtin(drivers=drivers).run([ConcreteScenario(path)])
    return recording


def test_a_controller_takes_over_when_it_is_assigned_and_activated(tmp_path):
    """The storyboard jumps to 20 m/s; a driver accelerates to 20 m/s once it is in control."""
    alone = controlled(tmp_path, assign(None))
    assert alone.speed[0][alone.time > 2.1].min() == 20.0
    driven = controlled(tmp_path, assign("normal"))
    jump = np.diff(driven.speed[0]).max()
    assert 0.0 < jump < 1.0
    assert driven.speed[0].max() < 20.0
    assert np.array_equal(driven.speed[0][driven.time < 1.0], alone.speed[0][alone.time < 1.0])
    idle = controlled(tmp_path, assign("normal", ""))
    assert same_recording(idle, alone)
    off = controller('<ActivateControllerAction longitudinal="false"/>')
    idle = controlled(tmp_path, f'{assign("normal")}</Action><Action name="off">{off}')
    assert same_recording(idle, alone)


def test_who_runs_a_file_keeps_the_driver_that_they_chose(tmp_path):
    chosen = controlled(tmp_path, controller('<ActivateControllerAction longitudinal="false"/>'), {"A": "cautious"})
    assert chosen.speed[0].max() < 20.0
    again = controlled(tmp_path, assign("aggressive"), {"A": "cautious"})
    assert same_recording(chosen, again)
    with pytest.raises(InputError, match="asks for the driver 'os:system'"):
        controlled(tmp_path, assign("os:system"))


def test_a_driver_does_not_see_who_is_hidden(tmp_path):
    """Behind a standing car the driver stops; behind one that is hidden from the traffic it does not."""
    hide = '<PrivateAction><VisibilityAction graphics="true" sensors="true" traffic="{}"/></PrivateAction>'
    ends = {}
    for seen in ("true", "false"):
        init = (
            f'<Private entityRef="A">{teleport("10")}{speed_action("10")}</Private>'
            f'<Private entityRef="B">{teleport("90")}{hide.format(seen)}</Private>'
        )
        path = scenario_file(tmp_path, init=init, stop=time_trigger("20"), entities=car("A") + car("B"))
        (recording,) = ran(Builtin(drivers={"A": "normal"}), [ConcreteScenario(path)])
        ends[seen] = recording.x[0, -1]
    assert ends["true"] < 88.0
    assert ends["false"] > 150.0


# Ahead of the ego a car stands, across a bend that each concrete scenario takes otherwise.
BEND = """<ClothoidSpline><ClothoidSplineSegment curvatureStart="0" curvatureEnd="0" length="30"><PositionStart>
<WorldPosition x="0" y="-2" h="0"/></PositionStart></ClothoidSplineSegment><ClothoidSplineSegment curvatureStart="0"
curvatureEnd="$bend" length="60"/></ClothoidSpline>"""


def bend_file(folder, shape=BEND, reference="<None/>"):
    position = place(70, -1, 'h="1.57"')
    across = f"<PrivateAction><TeleportAction>{position}</TeleportAction></PrivateAction>"
    follow = trajectory(shape, reference, "follow")
    return scenario_file(
        folder,
        init=private("Ego", follow, speed_action("10")) + private("Other", across, speed_action("0")),
        entities=car("Ego") + car("Other"),
        parameters='<ParameterDeclaration name="bend" parameterType="double" value="0.001"/>',
    )


def test_a_driver_brakes_along_a_trajectory_that_runs_otherwise_in_each_scenario(tmp_path):
    path = bend_file(tmp_path)
    bends = (0.0005, 0.002, 0.08)
    concretes = [ConcreteScenario(path, {"bend": bend}) for bend in bends]
    simulator = Builtin(time_step=DT, duration=20.0, drivers={"Ego": "normal"})
    together = ran(simulator, concretes)
    for concrete, recording in zip(concretes, together, strict=True):
        assert not recording.collisions
        (alone,) = simulator.run([concrete])
        assert same_recording(alone, recording)
    straight, _, away = together
    assert straight.speed[0][-1] < 0.1
    assert straight.x[0][-1] > 40.0
    # The sharp bend leads past the car.
    assert away.speed[0][away.time < 15.0].min() > 5.0
    # Without a driver it continues.
    (undriven,) = ran(Builtin(time_step=DT, duration=20.0), concretes[:1])
    assert undriven.collisions


def test_a_driver_slows_down_for_the_bend_of_a_trajectory(tmp_path):
    path = bend_file(tmp_path)
    simulator = Builtin(time_step=DT, duration=20.0, drivers={"Ego": "normal"})
    (recording,) = ran(simulator, [ConcreteScenario(path, {"bend": 0.2})])
    # 3 m/s² across at a radius of 5 m.
    assert recording.speed[0].min() == pytest.approx(np.sqrt(3.0 * 5.0), rel=0.1)


def test_a_trajectory_with_times_leaves_the_driver_nothing_to_decide(tmp_path):
    timed = '<Timing domainAbsoluteRelative="relative" scale="1" offset="0"/>'
    legs = "".join(f'<Vertex time="{t}">{place(x, -2)}</Vertex>' for t, x in ((0, 0), (3, 40), (8, 90)))
    path = bend_file(tmp_path, f"<Polyline>{legs}</Polyline>", timed)
    recordings = [
        next(iter(Builtin(time_step=DT, duration=7.9, drivers=drivers).run([ConcreteScenario(path, {})])))
        for drivers in ({}, {"Ego": "normal"})
    ]
    assert same_recording(*recordings)


class Own(Driver):
    """A user's driver: returns the value of a function of the situation."""

    def __init__(self, decide):
        self.decide = decide

    def acceleration(self, situation):
        return self.decide(situation)


def driven_by(folder, decide, speeds=(8.0, 10.0, 12.0)):
    init = "".join(
        private(name, teleport(s), speed_action(v)) for name, s, v in (("Ego", "10", "$v"), ("B", "90", "10"))
    )
    speed = '<ParameterDeclaration name="v" parameterType="double" value="10"/>'
    path = scenario_file(folder, init=init, entities=car("Ego") + car("B"), parameters=speed)
    concretes = [ConcreteScenario(path, {"v": float(v)}) for v in speeds]
    driver = decide(None) if isinstance(decide, type) else Own(decide)
    return list(Builtin(duration=2.0, drivers={"Ego": driver}).run(concretes))


OWN = "the driver of Ego (test_controllers:Own)"


def test_42_4_a_driver_that_gives_no_number_fails_its_own_scenario(tmp_path):
    def decide(situation):
        return np.where((situation.speed == 10.0) & (situation.time > 0.12), np.nan, situation.time < 0.12)

    first, lost, last = driven_by(tmp_path, decide)
    assert [first.speed[0, -1], last.speed[0, -1]] == pytest.approx([8.15, 12.15])
    assert isinstance(lost, Recording)
    first, lost, last = driven_by(tmp_path, lambda one: np.where(one.speed == 10.0, np.nan, one.time < 0.12))
    assert [first.speed[0, -1], last.speed[0, -1]] == pytest.approx([8.15, 12.15])
    assert str(lost) == f"{OWN} returned nan at t = 0 s, which is not an acceleration in m/s²"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (np.ones(2), "but array([1., 1.])"),
        (None, "but None"),
        (1j * np.ones(1), "but array([0.+1.j])"),
        ("fast", "fast"),
        (-1.0, "but -1.0"),
    ],
)
def test_42_4_a_driver_that_gives_something_else_fails(tmp_path, given, said):
    for lost in driven_by(tmp_path, lambda situation: given):
        assert f"{OWN} returned no acceleration for the scenario at t = 0 s, but" in str(lost)
        assert said in str(lost)


def test_42_4_one_number_is_not_taken_for_all_scenarios(tmp_path):
    """A driver that depends on the first scenario decides differently when run alone."""

    def decide(situation):
        return -0.1 * situation.speed[:1]

    for v, found in zip((8.0, 12.0), driven_by(tmp_path, decide, (8.0, 12.0)), strict=True):
        (alone,) = driven_by(tmp_path, decide, [v])
        assert same_recording(alone, found)


class MyExit(BaseException):
    pass


def nested(depth):
    return nested(depth + 1)


RAISED = {
    "SystemExit: 0": lambda: sys.exit(0),
    "KeyboardInterrupt": lambda: raised(KeyboardInterrupt()),
    "GeneratorExit": lambda: raised(GeneratorExit()),
    "MyExit: of mine": lambda: raised(MyExit("of mine")),
    "RecursionError: maximum recursion depth exceeded": lambda: nested(0),
    "MemoryError: Unable to allocate": lambda: np.zeros(10**17),
    "InputError: no": lambda: raised(InputError("no.")),
    "ZeroDivisionError: division by zero": lambda: 1 / 0,
}


def raised(error):
    raise error


@pytest.mark.parametrize("said", RAISED)
def test_42_s5_whatever_a_driver_raises_fails_its_scenario_alone(tmp_path, said):
    def decide(situation):
        if situation.time > 0.48 and (situation.active & (situation.speed == 10.0)).any():
            RAISED[said]()
        return np.zeros(len(situation.speed))

    with collect_interrupts():
        first, lost, last = driven_by(tmp_path, decide)
    assert isinstance(lost, SimulationError)
    assert str(lost).startswith(f"{OWN} failed at t = 0.5 s: {said}")
    assert "(test_controllers.py line " in str(lost)
    assert str(tmp_path) not in str(lost)
    assert len(str(lost)) < 900
    # The others are as they would be alone.
    for v, other in ((8.0, first), (12.0, last)):
        (alone,) = driven_by(tmp_path, decide, [v])
        assert same_recording(alone, other)


def test_42_s5_ctrl_c_ends_a_driver_that_catches_it(tmp_path):
    def decide(situation):
        try:
            signal.raise_signal(signal.SIGINT)
        except BaseException:
            raise RuntimeError("caught") from None
        return np.zeros(3)

    with collect_interrupts(), pytest.raises(KeyboardInterrupt):
        driven_by(tmp_path, decide)


def test_42_4_a_driver_that_cannot_be_started_fails_each_scenario(tmp_path):
    class Unlicensed(Own):
        def start(self, scenarios, others):
            raise OSError(f"no licence in {Path.cwd() / 'licences'}")

    for lost in driven_by(tmp_path, Unlicensed):
        assert isinstance(lost, SimulationError)
        assert "failed at t = 0 s: OSError: no licence in licences (test_controllers.py line " in str(lost)


def test_42_4_one_of_many_scenarios_is_found_in_few_runs(tmp_path):
    runs = []

    class Counting(Own):
        def start(self, scenarios, others):
            runs.append(scenarios)

        def acceleration(self, situation):
            if (situation.speed == 40.0).any():
                raise ValueError("too fast")
            return np.zeros(len(situation.speed))

    found = driven_by(tmp_path, Counting, np.arange(1.0, 65.0))
    assert [k for k, one in enumerate(found) if isinstance(one, SimulationError)] == [39]
    assert len(runs) <= 2 * 6 + 1


def limited(folder, driver, dec="10", **more):
    init = "".join(private(name, teleport(s), speed_action("20")) for name, s in (("Ego", "10"), ("B", "190")))
    parameters = f'<ParameterDeclaration name="dec" parameterType="double" value="{dec}"/>'
    ego = car("Ego").replace(
        'maxAcceleration="200" maxDeceleration="200"', 'maxAcceleration="4" maxDeceleration="$dec"'
    )
    path = scenario_file(folder, init=init, entities=ego + car("B"), parameters=parameters)
    return path, Builtin(duration=1.0, drivers={"Ego": driver}, **more)


def test_42_9_no_driver_gets_more_than_its_vehicle_can_do_and_it_is_said_once(tmp_path):
    def decide(situation):
        return np.full(len(situation.speed), -30.0 if situation.time < 0.48 else 30.0)

    path, simulator = limited(tmp_path, Own(decide))
    with pytest.warns(NoticeWarning) as told:
        found = list(simulator.run([ConcreteScenario(path, {"dec": dec}) for dec in (6.0, 10.0, 10.0)]))
    for dec, one in zip((6.0, 10.0, 10.0), found, strict=True):
        assert one.acceleration[0].min() == pytest.approx(-dec)
        assert one.acceleration[0].max() == pytest.approx(4.0)
    said = [str(one.message) for one in told]
    assert said == [
        f"{OWN} exceeds the deceleration of 6 m/s² in <Performance>, and is limited to it; first 30 m/s² at t = 0 s",
        f"{OWN} exceeds the acceleration of 4 m/s² in <Performance>, and is limited to it; first 30 m/s² at t = 0.5 s",
        f"{OWN} exceeds the deceleration of 10 m/s² in <Performance>, and is limited to it; first 30 m/s² at t = 0 s",
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("error", NoticeWarning)
        list(simulator.run([ConcreteScenario(path, {})]))


def test_42_9_a_driver_within_its_vehicle_is_as_it_was(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error", NoticeWarning)
        for driver in (Own(lambda one: np.full(1, -6.0)), "normal", "cc-human"):
            path, simulator = limited(tmp_path, driver)
            (found,) = ran(simulator, [ConcreteScenario(path, {})])
            assert found.acceleration[0].min() >= -10.0


def test_42_9_a_built_in_driver_knows_what_its_vehicle_can_do(tmp_path):
    path, simulator = limited(tmp_path, "normal:max_deceleration=30,comfortable_deceleration=30", "7")
    hit = ConcreteScenario(path, {})
    with pytest.warns(NoticeWarning, match="the driver of Ego exceeds the deceleration of 7 m/s²"):
        (found,) = ran(simulator, [hit])
    # Compiled code and Python decide the same.
    own = limited(tmp_path, Own(lambda one: np.zeros(1)), "7")[1]
    own._drivers = {**simulator._drivers, "B": own._drivers["Ego"]}
    with pytest.warns(NoticeWarning):
        (beside,) = ran(own, [hit])
    assert np.array_equal(found.speed[0], beside.speed[0])


def test_what_a_driver_was_told_stays_and_is_its_own(tmp_path):
    kept = []

    def decide(situation):
        kept.append((situation.x, situation.x.copy()))
        return np.zeros(3)

    def scribble(situation):
        for told in (situation.x, situation.speed, situation.active, situation.others_x):
            told[:] = 0
        return np.zeros(3)

    held = driven_by(tmp_path, decide)
    assert len(kept) > 30
    assert all((told == then).all() for told, then in kept)
    assert all(same_recording(*pair) for pair in zip(held, driven_by(tmp_path, scribble), strict=True))


class Cruise(cc.SystemUnderTest):
    def step(self, view, dt):
        return 0.0


def line_file(folder, length, lead):
    """The ego drives north from the road at 30 m/s, along `length` m of a trajectory; a car stands `lead` m ahead."""
    vertices = "".join(
        f'<Vertex time="0"><Position><WorldPosition x="60" y="{y}"/></Position></Vertex>' for y in ("0", "$length")
    )
    position = f'<Position><WorldPosition x="60" y="{lead}" h="1.5707963"/></Position>'
    across = f"<PrivateAction><TeleportAction>{position}</TeleportAction></PrivateAction>"
    follow = trajectory(f"<Polyline>{vertices}</Polyline>", "<None/>", "position")
    return scenario_file(
        folder,
        init=private("Ego", follow, speed_action("30")) + private("Other", across, speed_action("0")),
        entities=car("Ego") + car("Other"),
        parameters=f'<ParameterDeclaration name="length" parameterType="double" value="{length}"/>',
    )


class Stopping(cc.SystemUnderTest):
    """Brakes for what it sees less than 200 m ahead, and a little for what is farther away."""

    def step(self, view, dt):
        leader = view.leader
        assert np.isfinite(view.ego.distance)
        if leader is None:
            return 0.0
        return -8.0 if leader.gap < 200.0 else -0.1


@pytest.mark.parametrize("driver", ["normal", Stopping()])
def test_a_driver_brakes_at_the_end_of_a_long_trajectory(tmp_path, driver):
    path = line_file(tmp_path, 5000, 2900)
    simulator = Builtin(time_step=0.1, duration=130.0, drivers={"Ego": driver})
    (recording,) = ran(simulator, [ConcreteScenario(path)])
    assert not recording.collisions
    assert recording.y[0][-1] > 2700.0


def test_how_far_a_function_sees_beyond_its_trajectory_does_not_depend_on_others(tmp_path):
    path = line_file(tmp_path, 50, 310)
    simulator = Builtin(time_step=0.1, duration=1.0, drivers={"Ego": Stopping()})
    (alone,) = ran(simulator, [ConcreteScenario(path, {"length": 50})])
    together = ran(simulator, [ConcreteScenario(path, {"length": length}) for length in (50, 1000)])
    assert same_recording(alone, together[0])


@pytest.mark.parametrize(
    "driver", ["simple + kinematic", "simple + single-track", EquippedDriver(Cruise(), vehicle=SingleTrack())]
)
@pytest.mark.parametrize("begin", [-2, 6])
def test_a_steered_vehicle_comes_back_to_a_trajectory_that_leaves_it(tmp_path, driver, begin):
    # At 30°, from its own place or 8 m beside it.
    vertices = "".join(
        f'<Vertex time="0"><Position><WorldPosition x="{x}" y="{y}"/></Position></Vertex>'
        for x, y in ((60, begin), (100, begin + 23), (200, begin + 23))
    )
    follow = trajectory(f"<Polyline>{vertices}</Polyline>", "<None/>", "position")
    path = scenario_file(
        tmp_path,
        init=private("Ego", teleport("50"), speed_action("10")),
        story=story_of(event("follows", follow, time_trigger("0.975"))),
    )
    (recording,) = ran(Builtin(time_step=DT, duration=12.0, drivers={"Ego": driver}), [ConcreteScenario(path)])
    assert recording.x[0][-1] > 150.0
    assert recording.y[0][-1] == pytest.approx(begin + 23, abs=0.1)


@pytest.mark.parametrize("vehicle", ["actuators", "kinematic", "single-track", "kinematic:lag=0.2"])
@pytest.mark.parametrize("driver", [Cruise(), "simple"])
def test_a_vehicle_that_the_scenario_starts_backwards_stops_before_it_drives(tmp_path, vehicle, driver):
    path = scenario_file(tmp_path, init=private("Ego", teleport("50"), speed_action("-5")))
    equipped = (
        f"{driver} + {vehicle}" if isinstance(driver, str) else EquippedDriver(driver, vehicle=VEHICLES.create(vehicle))
    )
    (recording,) = ran(Builtin(time_step=DT, duration=2.0, drivers={"Ego": equipped}), [ConcreteScenario(path)])
    assert recording.x[0] == pytest.approx(50.0, abs=0.3)
    assert recording.heading[0] == pytest.approx(0.0, abs=1e-3)
    assert recording.speed[0][1:] == pytest.approx(0.0, abs=1e-9)
