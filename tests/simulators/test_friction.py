"""The friction of the road, which a scenario file sets."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

import cornercase as cc
from conftest import at_night
from cornercase._common.typing import FloatArray
from cornercase.drivers import VEHICLES, BehaviourDriver, Driver, EquippedDriver, Situation
from cornercase.drivers.vehicles._actuated import Actuators
from helpers.command_line import cornercase

R157 = Path(__file__).parents[2] / "examples" / "r157"
SPEED, GRAVITY, DT = 25.0, 9.81, 0.05
TRIGGER = (
    '<StartTrigger><ConditionGroup><Condition name="now" delay="0" conditionEdge="none"><ByValueCondition>'
    '<SimulationTimeCondition value="2" rule="greaterOrEqual"/></ByValueCondition></Condition></ConditionGroup></StartTrigger>'
)


class Brake(Driver):
    """Brakes at 8 m/s²."""

    def acceleration(self, situation: Situation) -> FloatArray:
        return np.full_like(situation.speed, -8.0)


class InPython(Driver):
    """Decides as a preset, but not in the compiled loop."""

    def __init__(self) -> None:
        self._inner = BehaviourDriver()

    def start(self, scenarios: int, others: int) -> None:
        self._inner.start(scenarios, others)

    def acceleration(self, situation: Situation) -> FloatArray:
        return self._inner.acceleration(situation)


def action(friction: str) -> str:
    condition = f'<RoadCondition frictionScaleFactor="{friction}"/>'
    return f'<GlobalAction><EnvironmentAction><Environment name="e">{condition}</Environment></EnvironmentAction></GlobalAction>'


def scenario(folder: Path, at_start: str | None = None, later: str | None = None) -> Path:
    """Return a motorway with nobody ahead, and friction from the start or from 2 s on."""
    text = (R157 / "cut_out.xosc").read_text(encoding="utf-8")
    text = text.replace('filepath="motorway.xodr"', f'filepath="{R157 / "motorway.xodr"}"')
    if at_start is not None:
        text = text.replace("<Actions>", f"<Actions>{action(at_start)}", 1)
    if later is not None:
        event = f'<Event name="ice" priority="parallel"><Action name="ice">{action(later)}</Action>{TRIGGER}</Event>'
        text = text.replace('<Maneuver name="Other">', f'<Maneuver name="Other">{event}', 1)
    path = folder / "ice.xosc"
    path.write_text(text, encoding="utf-8")
    return path


def drive(path: Path, driver: str | Driver, duration: float = 20.0) -> cc.Recording:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", cc.NoticeWarning)
        values = {"ego_kmh": 3.6 * SPEED, "gap": 400.0}
        return cc.simulate(path, values, drivers={"Ego": driver}, duration=duration)


@pytest.mark.parametrize("vehicle", at_night(["actuators", "kinematic", "single-track:mu=1"], {"kinematic"}))
def test_friction_lengthens_the_braking_distance(tmp_path: Path, vehicle: str) -> None:
    driver = EquippedDriver(Brake(), vehicle=VEHICLES.create(vehicle))
    for friction, deceleration in (("0.5", 0.5 * GRAVITY), ("1", 8.0)):
        recording = drive(scenario(tmp_path, friction), driver)
        e = recording.entity_index("Ego")
        assert recording.speed[e, -1] == 0.0
        # An action that follows a trajectory moves the ego before it decides, by the speed at the start of the step.
        late = 0.5 * SPEED * DT if vehicle == "actuators" else 0.0
        assert np.ptp(recording.x[e]) == pytest.approx(SPEED**2 / (2.0 * deceleration) + late, rel=2e-3)


def test_friction_changes_at_the_instant_of_the_action(tmp_path: Path) -> None:
    recording = drive(scenario(tmp_path, later="0.3"), EquippedDriver(Brake(), vehicle=Actuators()), duration=3.0)
    acceleration = recording.acceleration[recording.entity_index("Ego")]
    assert acceleration[10:40] == pytest.approx(-8.0)
    assert acceleration[42:50] == pytest.approx(-0.3 * GRAVITY)


def test_friction_acts_in_kernels_as_in_python(tmp_path: Path) -> None:
    path = scenario(tmp_path, at_start="0.9", later="0.2")
    compiled = drive(path, "normal + actuators:lag=0.1")
    in_python = drive(path, EquippedDriver(InPython(), vehicle=Actuators(lag=0.1)))
    assert compiled.speed.tobytes() == in_python.speed.tobytes()
    assert compiled.speed.tobytes() != drive(scenario(tmp_path), "normal + actuators:lag=0.1").speed.tobytes()


def test_friction_without_a_vehicle_model_is_named(tmp_path: Path) -> None:
    path = scenario(tmp_path, at_start="0.5")
    text = "frictionScaleFactor of <RoadCondition> .ice.xosc, line .*no entity has a vehicle model"
    with pytest.warns(cc.NoticeWarning, match=text):
        cc.simulate(path, drivers={"Ego": "normal"}, duration=0.2)
    assert "no entity has a vehicle model" in cornercase("check", path).stderr
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        cc.simulate(path, drivers={"Ego": "normal + actuators"}, duration=0.2)
    assert not any("frictionScaleFactor" in str(one.message) for one in caught)


def test_friction_below_zero_is_refused(tmp_path: Path) -> None:
    path = scenario(tmp_path, at_start="-0.5")
    result = cornercase("simulate", path, "--duration", 0.1, "-o", tmp_path / "r.csv")
    assert result.returncode == 2
    assert "frictionScaleFactor" in result.stderr
    assert "is below 0" in result.stderr
    assert result.stderr.count("\n") == 1


def test_friction_is_a_dimension(tmp_path: Path) -> None:
    path = scenario(tmp_path, at_start="$friction")
    text = path.read_text(encoding="utf-8").replace(
        "<ParameterDeclarations>",
        '<ParameterDeclarations><ParameterDeclaration name="friction" parameterType="double" value="1"/>',
        1,
    )
    path.write_text(text, encoding="utf-8")
    stops = []
    for friction in (0.3, 0.6, 1.0):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", cc.NoticeWarning)
            values = {"ego_kmh": 3.6 * SPEED, "gap": 400.0, "friction": friction}
            driver = EquippedDriver(Brake(), vehicle=Actuators())
            recording = cc.simulate(path, values, drivers={"Ego": driver}, duration=20.0)
        stops.append(float(recording.x[recording.entity_index("Ego"), -1]))
    assert stops == sorted(stops, reverse=True)
    assert stops[0] > stops[2] + 50.0
