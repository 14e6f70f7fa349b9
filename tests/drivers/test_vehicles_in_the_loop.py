"""Vehicle models that drivers move in the builtin simulator."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from random import Random

import numpy as np
import pytest

from conftest import at_night
from cornercase._common.errors import InputError, NoticeWarning
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers import BehaviourDriver, Driver, EquippedDriver, PlanarMotion, Situation
from cornercase.drivers.vehicles._actuated import Actuators
from cornercase.drivers.vehicles._kinematic import Kinematic
from cornercase.drivers.vehicles._single_track import SingleTrack
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario, LogicalScenario
from cornercase.simulators import Builtin
from helpers.command_line import SPACE, X
from helpers.random_storyboards import storyboard, write_roads

EQUIPPED = "normal + actuators:delay=0.08,lag=0.15,max_jerk=30,mu=0.6"


class InPython(Driver):
    """Decides as the preset does, but not in the compiled loop."""

    def __init__(self) -> None:
        self._inner = BehaviourDriver()

    def start(self, scenarios: int, others: int) -> None:
        self._inner.start(scenarios, others)

    def acceleration(self, situation: Situation) -> FloatArray:
        return self._inner.acceleration(situation)


def concretes(count: int) -> list[ConcreteScenario]:
    """Return some concrete scenarios of the x intersection."""
    logical = LogicalScenario.read(X, SPACE)
    points = np.random.default_rng(3).random((count, len(logical.space.names)))
    file = logical.scenario_file
    return [ConcreteScenario(file.path, values, file) for values in logical.space.values(points)]


def run(chosen: Sequence[ConcreteScenario], driver: str | Driver) -> list[Recording]:
    results = list(Builtin(duration=12.0, drivers={"Ego": driver}).run(chosen))
    recordings = [result for result in results if isinstance(result, Recording)]
    assert len(recordings) == len(chosen)
    return recordings


def as_bytes(recording: Recording) -> list[bytes]:
    return [getattr(recording, name).tobytes() for name in ("x", "y", "heading", "speed", "acceleration")]


def test_kernels_and_python_move_actuators_to_the_same_bytes() -> None:
    chosen = concretes(12)
    vehicle = Actuators(delay=0.08, lag=0.15, max_jerk=30.0, mu=0.6)
    in_python = run(chosen, EquippedDriver(InPython(), vehicle=vehicle))
    compiled = run(chosen, EQUIPPED)
    assert [as_bytes(one) for one in compiled] == [as_bytes(one) for one in in_python]
    assert [as_bytes(one) for one in compiled] != [as_bytes(one) for one in run(chosen, "normal")]


STEERED = {
    "kinematic": Kinematic(),
    "kinematic:delay=0.08,steering_lag=0.1,mu=0.3": Kinematic(delay=0.08, steering_lag=0.1, mu=0.3),
    "single-track": SingleTrack(),
    "single-track:mu=0.2,steering_delay=0.2": SingleTrack(mu=0.2, steering_delay=0.2),
}


@pytest.mark.parametrize("vehicle", STEERED)
def test_kernels_and_python_steer_to_the_same_bytes(vehicle: str) -> None:
    chosen = concretes(5)
    in_python = run(chosen, EquippedDriver(InPython(), vehicle=STEERED[vehicle]))
    assert [as_bytes(one) for one in run(chosen, f"normal + {vehicle}")] == [as_bytes(one) for one in in_python]


@pytest.fixture(scope="module")
def roads(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("roads")
    write_roads(folder)
    return folder


def run_file(file: Path, driver: str | Driver, **others: str | Driver) -> Recording:
    drivers = {"Ego": driver, **others}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NoticeWarning)
        (result,) = Builtin(duration=10.0, drivers=drivers).run([ConcreteScenario(file, {})])
    assert isinstance(result, Recording)
    return result


# By day two for each vehicle.
@pytest.mark.parametrize("seed", at_night(range(24), range(4, 24)))
def test_kernels_and_python_steer_to_the_same_bytes_whatever_the_storyboard_does(seed: int, roads: Path) -> None:
    file, vehicle = roads / f"{seed}.xosc", [*STEERED][seed % len(STEERED)]
    file.write_text(storyboard(Random(seed)))
    in_python = run_file(file, EquippedDriver(InPython(), vehicle=STEERED[vehicle]))
    assert as_bytes(run_file(file, f"normal + {vehicle}")) == as_bytes(in_python)


# With few tyres and long axles it leaves its lane.
@pytest.mark.parametrize("seed", at_night(range(12), range(2, 12)))
def test_a_steered_vehicle_goes_the_same_way_beside_a_driver_in_python(seed: int, roads: Path) -> None:
    file, ego = roads / f"two {seed}.xosc", "normal + kinematic:wheelbase=5.0,mu=0.1"
    file.write_text(storyboard(Random(seed)))
    in_python = run_file(file, ego, A=EquippedDriver(InPython(), vehicle=SingleTrack(mu=0.3)))
    assert as_bytes(run_file(file, ego, A="normal + single-track:mu=0.3")) == as_bytes(in_python)


@pytest.mark.filterwarnings("ignore::cornercase.NoticeWarning")
def test_a_vehicle_that_spins_gets_no_more_than_it_can_do() -> None:
    chosen = [replace(one, values={**one.values, "ego_speed": 30.0}) for one in concretes(3)]
    spinning = SingleTrack(front_stiffness=30.0, rear_stiffness=12.0)
    in_python = run(chosen, EquippedDriver(InPython(), vehicle=spinning))
    compiled = run(chosen, "normal + single-track:front_stiffness=30,rear_stiffness=12")
    assert [as_bytes(one) for one in compiled] == [as_bytes(one) for one in in_python]


@pytest.mark.parametrize("option", ["front_stiffness=1e300", "mass=1e300", "mu=1e300", "height=1e300"])
def test_a_vehicle_that_is_none_is_refused(option: str) -> None:
    with pytest.raises(InputError, match=option.partition("=")[0]):
        Builtin(drivers={"Ego": f"normal + single-track:{option}"})


# It begins 20 m before the end of its road.
NEAR_THE_END = """<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="2026-01-01T00:00:00" description="" author=""/>
<CatalogLocations/><RoadNetwork><LogicFile filepath="straight.xodr"/></RoadNetwork>
<Entities><ScenarioObject name="Ego"><Vehicle name="car" vehicleCategory="car">
<BoundingBox><Center x="1.4" y="0" z="0.7"/><Dimensions length="4.5" width="1.8" height="1.5"/></BoundingBox>
<Performance maxSpeed="60" maxAcceleration="10" maxDeceleration="10"/>
<Axles><FrontAxle maxSteering="0.5" wheelDiameter="0.6" trackWidth="1.6" positionX="2.7" positionZ="0.3"/>
<RearAxle maxSteering="0" wheelDiameter="0.6" trackWidth="1.6" positionX="0" positionZ="0.3"/></Axles>
<Properties/></Vehicle></ScenarioObject></Entities>
<Storyboard><Init><Actions><Private entityRef="Ego">
<PrivateAction><TeleportAction><Position><LanePosition roadId="1" laneId="-1" s="880"/></Position></TeleportAction></PrivateAction>
<PrivateAction><LongitudinalAction><SpeedAction>
<SpeedActionDynamics dynamicsShape="step" dynamicsDimension="time" value="0"/>
<SpeedActionTarget><AbsoluteTargetSpeed value="15"/></SpeedActionTarget></SpeedAction></LongitudinalAction></PrivateAction>
</Private></Actions></Init></Storyboard></OpenSCENARIO>"""


def test_a_steered_vehicle_goes_on_beyond_the_end_of_its_road(roads: Path) -> None:
    file = roads / "end.xosc"
    file.write_text(NEAR_THE_END)
    recording = run_file(file, "normal + kinematic")
    gone = np.hypot(recording.x[0] - recording.x[0, 0], recording.y[0] - recording.y[0, 0])
    assert gone == pytest.approx(np.cumsum([0.0, *(0.05 * recording.speed[0, 1:])]), abs=1e-6)
    assert gone[-1] > 130.0


@pytest.mark.parametrize("driver", [EQUIPPED, "normal + single-track"])
def test_a_scenario_gives_the_same_bytes_alone(driver: str) -> None:
    chosen = concretes(6)
    together = run(chosen, driver)
    assert [as_bytes(one) for one in together] == [as_bytes(run([one], driver)[0]) for one in chosen]


class Heavy(Kinematic):
    """Steps in Python, with its own speed."""

    name = "heavy"

    def step(
        self,
        motion: PlanarMotion,
        acceleration: FloatArray,
        steering: FloatArray,
        friction: FloatArray,
        time_step: float,
        active: BoolArray,
    ) -> PlanarMotion:
        return super().step(motion, 0.5 * acceleration, steering, friction, time_step, active)


def test_a_model_of_ones_own_that_is_derived_from_a_compiled_one_is_asked() -> None:
    chosen = concretes(1)
    (own,) = run(chosen, EquippedDriver(BehaviourDriver(), vehicle=Heavy()))
    (plain,) = run(chosen, "normal + kinematic")
    assert as_bytes(own) != as_bytes(plain)


def test_acceleration_changes_slowly_and_within_friction() -> None:
    (recording,) = run(concretes(1), "aggressive + actuators:mu=0.15,max_jerk=5")
    acceleration = recording.acceleration[recording.entity_index("Ego")]
    assert np.abs(acceleration).max() == pytest.approx(0.15 * 9.81, rel=1e-6)
    assert np.abs(np.diff(acceleration[1:])).max() <= 5.0 * 0.05 + 1e-9


@pytest.mark.parametrize("options", ["", ":steering_delay=0.1,steering_lag=0.2"])
def test_slow_steering_follows_the_turn_of_an_intersection(options: str) -> None:
    chosen = concretes(4)
    for exact, steered in zip(run(chosen, "normal"), run(chosen, f"normal + single-track{options}"), strict=True):
        e = exact.entity_index("Ego")
        line, ends = np.stack((exact.x[e], exact.y[e]), 1), len(steered.x[e]) // 2
        ways = np.stack((steered.x[e], steered.y[e]), 1)[: -ends // 4]
        deviation = np.hypot(*(ways[:, None] - line).T).min(axis=0)
        assert deviation.max() < 1.0
