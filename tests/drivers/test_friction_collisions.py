"""Friction turns collisions that an emergency brake prevents into collisions that it does not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import cornercase as cc
from cornercase.drivers import VEHICLES, Actuators, Driver, EquippedDriver, VehicleModel
from cornercase.scenario import ConcreteScenario, LogicalScenario
from cornercase.simulators import Builtin

CCRS = Path(__file__).parents[2] / "examples" / "ccrs" / "ccrs.xosc"
NCAP = Path(__file__).parents[3] / "shared/reference/openscenario/ncap/OpenSCENARIO/NCAP/CA-FC_2026/CCRs.xosc"
SPEEDS = np.linspace(10.0, 80.0, 60)


class Aeb(Driver):
    """Brakes if the time to collision with the other entity is below 1.6 s, and goes on to do so."""

    def start(self, scenarios, others):
        self._brakes = np.zeros(scenarios, dtype=bool)

    def acceleration(self, situation):
        way = np.hypot(situation.others_x[:, 0] - situation.x, situation.others_y[:, 0] - situation.y)
        reach = situation.center_x + 0.5 * situation.length
        gap = way + situation.others_center_x[0] - 0.5 * situation.others_length[0] - reach
        self._brakes |= situation.active & (gap < 1.6 * situation.speed)
        return np.where(self._brakes, -9.0, 0.0)


def count_collisions(path: Path, rows: list[dict[str, float]], vehicle: VehicleModel) -> int:
    logical = LogicalScenario.read(path, ranges=[f"{next(iter(rows[0]))}=10:80"])
    concretes = [ConcreteScenario(logical.scenario_file.path, row, logical.scenario_file) for row in rows]
    simulator = Builtin(duration=30.0, on_collision="stop", drivers={"Ego": EquippedDriver(Aeb(), vehicle=vehicle)})
    runs = [run for run in simulator.run(concretes) if isinstance(run, cc.Recording)]
    assert len(runs) == len(rows)
    return sum(any("Ego" in collision.entities for collision in run.collisions) for run in runs)


def test_half_the_friction_of_the_road_makes_collisions_of_a_part() -> None:
    rows = {friction: [{"ego_kmh": speed, "friction": friction} for speed in SPEEDS] for friction in (1.0, 0.5)}
    assert count_collisions(CCRS, rows[1.0], Actuators(delay=0.1, lag=0.1)) == 0
    assert 10 < count_collisions(CCRS, rows[0.5], Actuators(delay=0.1, lag=0.1)) < 50


@pytest.mark.skipif(not NCAP.exists(), reason="needs the scenarios of Euro NCAP")
@pytest.mark.parametrize("model", ["actuators", "single-track"])
def test_so_does_half_the_friction_of_the_tyres_in_tests_of_euro_ncap(model: str) -> None:
    rows = [{"Ego_speed_kph": speed} for speed in SPEEDS]
    assert count_collisions(NCAP, rows, VEHICLES.create(f"{model}:delay=0.1,mu=1")) == 0
    assert 10 < count_collisions(NCAP, rows, VEHICLES.create(f"{model}:delay=0.1,mu=0.5")) < 50
