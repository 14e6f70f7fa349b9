"""Controls become motion: steering, pedals, trajectories and lane changes of a system under test."""

from __future__ import annotations

import warnings
from typing import Any, ClassVar, Literal

import numpy as np
import pytest

import cornercase as cc
from conftest import EXAMPLES
from cornercase.drivers import VEHICLES, Controls, DrivingFunction, EquippedDriver, Trajectory
from cornercase.drivers._resolve import resolve_driver
from cornercase.drivers._system_under_test import PerScenarioDriver
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin, Sumo

CUT_OUT = "examples/r157/cut_out.xosc"
X = "examples/x_intersection/x_intersection.xosc"
# The leader is far away.
FREE = {"ego_kmh": 90.0, "gap": 400.0}
LANE, LEFT_LANE = -5.25, -1.75
DT = 0.05


class Steering(cc.SystemUnderTest):
    def __init__(self, angle: float = 0.0, acceleration: float = 0.0, until: float = 100.0) -> None:
        self.angle, self.acceleration, self.until = angle, acceleration, until

    def step(self, view, dt):
        if view.time > self.until:
            return cc.Control(acceleration=self.acceleration)
        return cc.Control(acceleration=self.acceleration, steering=self.angle)


def drive(
    driver: Any, scenario=CUT_OUT, values=FREE, duration=6.0, quiet=True, **options
) -> tuple[cc.Recording, dict[str, Any]]:
    with warnings.catch_warnings():
        if quiet:
            warnings.simplefilter("ignore", cc.NoticeWarning)
        recording = cc.simulate(scenario, values, drivers={"Ego": driver}, duration=duration, **options)
    e = recording.entity_index("Ego")
    names = ("x", "y", "heading", "speed", "acceleration")
    return recording, {name: getattr(recording, name)[e] for name in names} | {"time": recording.time}


def run_rows(driver, rows, duration, kind: type[Builtin | Sumo] = Builtin) -> list[Any]:
    scenario = cc.LogicalScenario.read(CUT_OUT, ranges=["gap=20:500"])
    assert scenario.file is not None
    concretes = [ConcreteScenario(scenario.file.path, row, scenario.file).with_all_values() for row in rows]
    return list(kind(duration=duration, drivers={"Ego": resolve_driver(driver)}).run(concretes))


def assert_speed_is_displacement(ego, tolerance):
    step = np.hypot(np.diff(ego["x"]), np.diff(ego["y"])) / np.diff(ego["time"])
    assert step == pytest.approx(ego["speed"][1:], abs=tolerance)
    assert ego["acceleration"][1:] == pytest.approx(np.diff(ego["speed"]) / np.diff(ego["time"]), abs=1e-9)


def test_a_constant_angle_of_the_wheels_is_a_circle():
    angle, wheelbase, speed = 0.02, 2.8, 25.0
    _, ego = drive(Steering(angle))
    radius = wheelbase / np.tan(angle)
    turned = speed * ego["time"] / radius
    assert ego["x"] == pytest.approx(100.0 + radius * np.sin(turned), abs=1e-6)
    assert ego["y"] == pytest.approx(LANE + radius * (1.0 - np.cos(turned)), abs=1e-6)
    assert ego["heading"] == pytest.approx(turned, abs=1e-9)
    assert ego["speed"] == pytest.approx(speed)
    assert ego["acceleration"] == pytest.approx(0.0, abs=1e-9)


def test_straight_wheels_and_brakes_are_a_straight_way_to_a_stop():
    recording, ego = drive(Steering(0.0, acceleration=-5.0))
    assert ego["y"] == pytest.approx(LANE)
    assert ego["x"][-1] - 100.0 == pytest.approx(25.0**2 / (2.0 * 5.0), abs=0.01)
    assert ego["speed"][-1] == 0.0
    assert not any("Ego" in collision.entities for collision in recording.collisions)


class Pedals(cc.SystemUnderTest):
    def step(self, view, dt):
        return cc.Control(throttle=1.0) if view.time < 1.0 else cc.Control(brake=0.5)


def test_pedals_ask_for_a_part_of_what_the_vehicle_can_do():
    _, ego = drive(Pedals())
    assert ego["acceleration"][10] == pytest.approx(4.0)
    assert ego["acceleration"][40] == pytest.approx(-5.0)


def test_who_steers_off_the_road_is_asked_on():
    _, ego = drive(Steering(-0.1, until=1.5), values=FREE | {"ego_kmh": 30.0})
    assert ego["y"].min() < -8.0
    # It has come back to its lane, to which its path belongs.
    assert ego["y"][-1] == pytest.approx(LANE, abs=0.1)


def test_a_collision_of_a_steered_ego_is_seen():
    # It is in the lane beside the one that leaves, and the other stands.
    recording, _ = drive(Steering(), values={"ego_kmh": 90.0, "gap": 60.0, "front_gap": 60.0}, duration=15.0)
    assert recording.collisions[0].entities[0] == "Ego"


def test_a_vehicle_is_steered_along_the_turn_of_an_intersection():
    _, exact = drive("normal", X, None, 25.0)
    _, steered = drive("normal + kinematic", X, None, 25.0)
    line = np.stack((exact["x"], exact["y"]), 1)
    line = line[np.append(True, np.hypot(*np.diff(line, axis=0).T) > 1e-6)]
    begin, chord = line[:-1], np.diff(line, axis=0)
    points = np.stack((steered["x"], steered["y"]), 1)[:, None]
    share = np.clip(((points - begin) * chord).sum(-1) / (chord**2).sum(-1), 0.0, 1.0)
    gap = np.hypot(*np.moveaxis(begin + share[..., None] * chord - points, -1, 0)).min(axis=1)
    assert exact["heading"][0] - exact["heading"][-1] == pytest.approx(np.pi / 2, abs=1e-3)
    # The last instant may be beyond the end of the line.
    assert gap[:-1].max() < 0.2
    assert np.ptp(exact["speed"]) > 2.0


class Follower(cc.SystemUnderTest):
    """Follows a bend to the left of 200 m radius at 20 m/s, for 4 s."""

    def start(self, ego, road, rng):
        time = np.arange(0.0, 4.05, 0.1)
        angle = 20.0 * time / 200.0
        self.way = cc.drivers.Trajectory(time, 100.0 + 200.0 * np.sin(angle), LANE + 200.0 * (1.0 - np.cos(angle)))

    def step(self, view, dt):
        return cc.Control(trajectory=self.way)


def test_a_trajectory_is_followed_exactly_and_then_to_a_stop():
    _, ego = drive(Follower(), duration=12.0)
    during = slice(0, 81)
    angle = 20.0 * ego["time"][during] / 200.0
    assert ego["x"][during] == pytest.approx(100.0 + 200.0 * np.sin(angle), abs=0.01)
    assert ego["y"][during] == pytest.approx(LANE + 200.0 * (1.0 - np.cos(angle)), abs=0.01)
    assert ego["heading"][during] == pytest.approx(angle, abs=0.011)
    assert ego["speed"][1:81] == pytest.approx(20.0, abs=0.01)
    assert_speed_is_displacement(ego, 1e-6)
    assert ego["heading"][81:] == pytest.approx(ego["heading"][80])
    assert ego["acceleration"][90] == pytest.approx(-3.0)
    assert ego["speed"][-1] == 0.0


class PosedFollower(cc.SystemUnderTest):
    """Goes straight on, and says for each point a heading and a speed of its own."""

    def start(self, ego, road, rng):
        time = np.array([0.0, 4.0])
        heading, speed = np.array([3.0, 3.4]), np.array([10.0, 18.0])
        self.way = Trajectory(time, 100.0 + 20.0 * time, np.full(2, LANE), heading, speed)

    def step(self, view, dt):
        return cc.Control(trajectory=self.way)


def test_a_trajectory_may_say_heading_and_speed():
    _, ego = drive(PosedFollower(), duration=4.0)
    assert ego["x"] == pytest.approx(100.0 + 20.0 * ego["time"])
    assert np.unwrap(ego["heading"][1:]) % (2.0 * np.pi) == pytest.approx(3.0 + 0.1 * ego["time"][1:])
    assert ego["speed"][1:] == pytest.approx(10.0 + 2.0 * ego["time"][1:])
    with pytest.raises(ValueError, match="needs time, x, y, speed of one shape"):
        Trajectory(np.arange(2.0), np.zeros(2), np.zeros(2), speed=np.ones(1))


class Reverser(cc.SystemUnderTest):
    """Goes on for 2 s, slower and slower, and back for another second."""

    def start(self, ego, road, rng):
        time = np.arange(0.0, 3.05, 0.1)
        self.way = Trajectory(time, 100.0 + 20.0 * time - 5.0 * time**2, np.full(len(time), LANE))

    def step(self, view, dt):
        return cc.Control(trajectory=self.way)


def test_a_vehicle_that_reverses_keeps_its_heading_and_has_a_negative_speed():
    _, ego = drive(Reverser(), duration=5.0)
    assert np.abs(ego["heading"]).max() < 1e-9
    assert ego["speed"][1:60] == pytest.approx(np.diff(ego["x"][:60]) / 0.05, abs=1e-6)
    assert ego["speed"][59] < -9.0
    # It brakes to a stop after the last point.
    assert ego["acceleration"][62] == pytest.approx(3.0)
    assert ego["speed"].min() >= -10.0


class Jumper(cc.SystemUnderTest):
    def __init__(self, by: float = 1e6):
        self.by = by

    def step(self, view, dt):
        if view.time < 0.99:
            return 0.0
        x = view.ego.x + self.by if view.time < 1.04 else view.ego.x
        return cc.Control(trajectory=Trajectory(view.time + np.array([0.0, dt]), np.array([x, x]), np.full(2, LANE)))


@pytest.mark.parametrize("by", [1e6, -1e6, 100.0])
def test_a_trajectory_that_jumps_fails_the_scenario_with_its_instant(by):
    with pytest.raises(
        cc.InputError, match=r"jumps by .* m in the step at t = 1 s, and at most .* m are driven; give a"
    ):
        drive(Jumper(by))


def test_a_trajectory_may_begin_beside_the_vehicle():
    drive(Jumper(5.0), duration=1.2)


def test_a_vehicle_is_steered_along_a_trajectory():
    _, ego = drive(equipped(Follower(), "kinematic"), duration=12.0)
    angle = 20.0 * ego["time"][60:81] / 200.0
    assert ego["x"][60:81] == pytest.approx(100.0 + 200.0 * np.sin(angle), abs=0.6)
    assert ego["y"][60:81] == pytest.approx(LANE + 200.0 * (1.0 - np.cos(angle)), abs=0.3)
    assert ego["speed"][-1] == 0.0


def equipped(driver, vehicle):
    return EquippedDriver(PerScenarioDriver(driver), vehicle=VEHICLES.create(vehicle))


class LaneChanger(cc.SystemUnderTest):
    def __init__(self, side: Literal["left", "right"] = "left") -> None:
        self.side = side

    def step(self, view, dt):
        return cc.Control(acceleration=0.0, lane_change=self.side if view.time >= 1.0 else None)


LATE = "single-track:steering_delay=0.1,steering_lag=0.15"


@pytest.mark.parametrize("vehicle", ["", "kinematic", LATE])
def test_a_lane_change_ends_in_the_middle_of_the_next_lane_after_4_s(vehicle):
    driver = equipped(LaneChanger(), vehicle) if vehicle else LaneChanger()
    _, ego = drive(driver, duration=9.0)
    time, y = ego["time"], ego["y"]
    assert y[time <= 1.0] == pytest.approx(LANE)
    share = np.clip((time - 1.0) / 4.0, 0.0, 1.0)
    profile = LANE + 3.5 * (10.0 * share**3 - 15.0 * share**4 + 6.0 * share**5)
    assert y == pytest.approx(profile, abs={"": 1e-9, LATE: 0.3}.get(vehicle, 0.1))
    assert y[time > 7.5] == pytest.approx(LEFT_LANE, abs={LATE: 0.05}.get(vehicle, 0.03))
    assert ego["heading"][time > 7.5] == pytest.approx(0.0, abs=0.01)
    assert_speed_is_displacement(ego, 2e-3)


def test_a_change_to_a_lane_that_is_not_there_is_ignored_with_one_notice():
    with pytest.warns(cc.NoticeWarning, match="asks for a lane on the right") as warned:
        recording, _ = drive(LaneChanger("right"), duration=4.0, quiet=False)
    assert sum("asks for a lane" in str(one.message) for one in warned) == 1
    assert recording.y[recording.entity_index("Ego")] == pytest.approx(LANE)


# Where the scenario puts the ego at 3 s, in the middle of its change to the left.
ELSEWHERE = """
<ManeuverGroup name="elsewhere" maximumExecutionCount="1">
<Actors selectTriggeringEntities="false"><EntityRef entityRef="Ego"/></Actors>
<Maneuver name="elsewhere"><Event name="elsewhere" priority="parallel" maximumExecutionCount="1"><Action name="elsewhere">
<PrivateAction><TeleportAction><Position><WorldPosition x="{x}" y="{y}" h="0"/></Position></TeleportAction></PrivateAction>
</Action><StartTrigger><ConditionGroup><Condition name="later" delay="0" conditionEdge="none"><ByValueCondition>
<SimulationTimeCondition value="3" rule="greaterOrEqual"/></ByValueCondition></Condition></ConditionGroup></StartTrigger>
</Event></Maneuver></ManeuverGroup>"""


@pytest.mark.parametrize("vehicle", ["", "actuators", "kinematic"])
@pytest.mark.parametrize("y", [LANE, LEFT_LANE])
def test_a_lane_change_ends_where_the_scenario_puts_the_ego_elsewhere(tmp_path, y, vehicle):
    file = EXAMPLES / "r157" / "cut_out.xosc"
    text = file.read_text(encoding="utf-8").replace("motorway.xodr", (file.parent / "motorway.xodr").as_posix())
    path, group = tmp_path / "elsewhere.xosc", "</ManeuverGroup>"
    before, after = text.rsplit(group, 1)
    path.write_text(before + group + ELSEWHERE.format(x=300.0, y=y) + after, encoding="utf-8")
    _, ego = drive(equipped(LaneChanger(), vehicle) if vehicle else LaneChanger(), path, duration=6.0)
    later = ego["time"] > 3.01
    assert ego["x"][later][0] == pytest.approx(300.0 + 1.25, abs=1.3)
    assert ego["y"][later] == pytest.approx(y, abs=1e-6)


class Reporting(Steering):
    """Notes where it is relative to its path."""

    offsets: ClassVar[list[float]] = []

    def step(self, view, dt):
        self.offsets.append(view.ego.offset)
        return super().step(view, dt)


def test_the_path_is_that_of_the_lane_in_which_the_ego_is():
    Reporting.offsets.clear()
    _, ego = drive(Reporting(0.01, until=1.5), duration=5.0)
    offsets = np.array(Reporting.offsets)
    # Once, it goes from the edge of its own lane to that of the next, and a little later back to its middle.
    (jump,) = np.flatnonzero(np.abs(np.diff(offsets)) > 1.0)
    assert offsets[jump] == pytest.approx(1.75 + 0.1, abs=0.35)
    assert np.abs(offsets[jump + 1 :]).max() < 2.0
    assert ego["y"][-1] == pytest.approx(LEFT_LANE, abs=0.05)


class Batch(DrivingFunction):
    """Steers by what it is given, for each time."""

    def __init__(self, angle: float) -> None:
        self.angle = angle

    def decide(self, situation):
        controls = Controls.from_acceleration(0.0 * situation.speed)
        controls.steering[:] = self.angle if situation.time > 0.5 else 0.0
        return controls


@pytest.mark.parametrize("angle", [np.inf, -np.inf])
def test_steering_that_is_no_number_fails_with_its_instant(angle):
    with pytest.raises(cc.InputError, match=r"returned -?inf at t = 0\.55 s, which is not an angle in rad"):
        drive(Batch(angle))


class Broken(cc.SystemUnderTest):
    def step(self, view, dt):
        return cc.Control(acceleration=0.0, steering=float("nan") if view.time > 0.5 and view.ego.speed > 26.0 else 0.0)


def test_a_steering_of_nan_fails_one_scenario_alone():
    rows = [FREE | {"ego_kmh": speed} for speed in (80.0, 100.0, 90.0)]
    outcomes = run_rows(Broken(), rows, 2.0)
    assert [isinstance(outcome, cc.Recording) for outcome in outcomes] == [True, False, True]
    assert "at t = 0.55 s" in str(outcomes[1])


class Mixed(cc.SystemUnderTest):
    """Does something else in each scenario."""

    def start(self, ego, road, rng):
        self.kind = int(ego.values.get("front_gap", 0.0)) % 4

    def step(self, view, dt):
        ego = view.ego
        if self.kind == 0:
            return cc.Control(acceleration=0.0, lane_change="left" if view.time > 0.3 else None)
        if self.kind == 1:
            return cc.Control(acceleration=-1.0, steering=0.02 * np.sin(view.time))
        if self.kind == 2:
            time = view.time + np.array([0.0, 1.0, 2.0])
            return cc.Control(
                trajectory=Trajectory(time, ego.x + np.array([0.0, 20.0, 38.0]), ego.y + np.array([0, 0, 1]))
            )
        return cc.Control(throttle=0.2, steering=0.01 if view.time < 1.0 else None)


@pytest.mark.parametrize("vehicle", ["", "kinematic"])
def test_a_scenario_has_the_same_bytes_alone_and_among_others(vehicle):
    driver = equipped(Mixed(), vehicle) if vehicle else Mixed()
    rows = [FREE | {"ego_kmh": 60.0 + 14.0 * k, "front_gap": 40.0 + k} for k in range(4)]
    together = run_rows(driver, rows, 3.0)
    for row, recording in zip(rows, together, strict=True):
        (alone,) = run_rows(driver, [row], 3.0)
        for name in ("x", "y", "heading", "speed", "acceleration"):
            assert getattr(alone, name).tobytes() == getattr(recording, name).tobytes()


@pytest.mark.parametrize(
    "driver",
    [Steering(0.02), *(pytest.param(one, marks=pytest.mark.slow) for one in (Follower(), LaneChanger()))],
    ids=str,
)
def test_it_moves_in_sumo_as_in_the_builtin_simulator(driver):
    pytest.importorskip("libsumo", reason="SUMO comes with the extra 'sumo'")
    (expected,) = run_rows(driver, [FREE], 6.0)
    (recording,) = run_rows(driver, [FREE], 6.0, Sumo)
    for name in ("x", "y", "heading", "speed", "acceleration"):
        moved, ego = getattr(expected, name), recording.entity_index("Ego")
        np.testing.assert_array_equal(getattr(recording, name)[ego], moved[expected.entity_index("Ego")])


class Straight(cc.SystemUnderTest):
    """Goes on as it goes, by its next place or by its acceleration, and notes what it sees."""

    seen: ClassVar[list[tuple[float, float, float]]] = []

    def __init__(self, places: bool = False) -> None:
        self.places = places

    def step(self, view, dt):
        ego, (other,) = view.ego, view.objects
        Straight.seen.append((view.time, ego.x, ego.x + other.x))
        if not self.places:
            return cc.Control(acceleration=0.0)
        time, x = view.time + np.array([0.0, dt]), ego.x + np.array([0.0, ego.speed * dt])
        return cc.Control(trajectory=Trajectory(time, x, np.full(2, ego.y), np.zeros(2)))


# The storyboard moves ego and other along trajectories.
@pytest.mark.parametrize("places", [False, True])
def test_a_function_sees_all_where_they_are_at_its_time(places):
    Straight.seen.clear()
    recording, ego = drive(Straight(places), "examples/r157/cut_in.xosc", {}, duration=2.0)
    time, x, other = np.array(Straight.seen).T
    assert time == pytest.approx(DT * np.arange(len(time)))
    assert x == pytest.approx(ego["x"][: len(x)])
    assert ego["x"] == pytest.approx(ego["x"][0] + ego["speed"][0] * ego["time"])
    o = 1 - recording.entity_index("Ego")
    heading = recording.heading[o, : len(x)]
    expected = recording.x[o, : len(x)] + recording.center_x[o] * np.cos(heading)
    assert other == pytest.approx(expected, abs=1e-6)


WAY = cc.drivers.Trajectory(np.array([0.0, 1.0]), np.zeros(2), np.zeros(2))


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({}, "has to decide something; give acceleration, throttle and brake, or a trajectory"),
        ({"steering": 0.1}, "steering alone does not set the speed; also give acceleration, or throttle and brake"),
        ({"lane_change": "left"}, "lane_change alone does not set the speed; also give acceleration"),
        ({"acceleration": 1, "brake": 0}, "acceleration and brake exclude each other; give acceleration, or throttle"),
        ({"acceleration": 1, "trajectory": WAY}, "a trajectory already sets the whole motion; leave out acceleration"),
        ({"brake": 1, "steering": 0, "trajectory": WAY}, "leave out brake and steering"),
        (
            {"acceleration": 1, "steering": 0, "lane_change": "left"},
            "steers by itself; leave out steering or lane_change",
        ),
        ({"acceleration": "fast"}, "acceleration is 'fast'; give a number in m/s²"),
        ({"acceleration": np.zeros(3)}, "give a number in m/s²"),
        (
            {"acceleration": 1, "steering": float("nan")},
            "steering is nan, which is not a finite number; give one in rad",
        ),
        ({"throttle": 50}, "throttle is 50; give a number from 0 to 1"),
        ({"acceleration": 1, "lane_change": ["left"]}, "give 'left', 'right' or None"),
        ({"trajectory": [(0, 0, 0)]}, "; give a Trajectory with time, x and y"),
    ],
)
def test_a_control_that_cannot_be_says_what_to_give(values, says):
    with pytest.raises(ValueError, match=r".") as raised:
        cc.Control(**values)
    assert says in str(raised.value)


@pytest.mark.parametrize("equipment", ["", "kinematic", "single-track"])
def test_steering_beyond_what_the_wheels_can_do_is_limited_and_said_once(equipment):
    vehicle = VEHICLES.create(equipment) if equipment else None
    driver = EquippedDriver(Steering(45.0), vehicle=vehicle)
    with pytest.warns(cc.NoticeWarning) as told:
        drive(driver, quiet=False, duration=1.0)
    said = [str(one.message) for one in told if "steering" in str(one.message)]
    assert said == [
        "the driver of Ego exceeds the steering angle of 0.6 rad that its front wheels can do, and is limited to it; first"
        " 45 rad at t = 0 s"
    ]
    with warnings.catch_warnings(record=True) as quiet:
        warnings.simplefilter("always")
        drive(Steering(-0.6), quiet=False, duration=1.0)
    assert not any("steering" in str(one.message) for one in quiet)


class Brakes(cc.SystemUnderTest):
    def step(self, view, dt):
        return -2.0 if view.time >= 1.0 else 0.0


@pytest.mark.parametrize("name", ["cut_in", "deceleration"])
def test_a_function_goes_as_far_on_a_trajectory_as_on_a_lane(name):
    # The ego of the first file follows a trajectory, that of the second one a lane.
    recording = cc.simulate(EXAMPLES / "r157" / f"{name}.xosc", drivers={"Ego": Brakes()}, duration=4.0)
    e = recording.entity_index("Ego")
    steps = np.hypot(np.diff(recording.x[e]), np.diff(recording.y[e]))
    assert steps == pytest.approx(recording.speed[e, 1:] * np.diff(recording.time), abs=1e-9)
    assert recording.speed[e, -1] == pytest.approx(recording.speed[e, 0] - 6.0, abs=0.2)
