"""The real ScenarioRunner builds and ticks behaviour trees of converted files, on the test server of CARLA.

CORNERCASE_SCENARIO_RUNNER names its folder, CORNERCASE_CARLA_PYTHON the Python of its environment, and CARLA_ROOT the
folder in which PythonAPI/carla/agents lies.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import pytest

import cornercase as cc
from cornercase.scenario import ConcreteScenario
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators import Carla, simulate
from cornercase.simulators.carla._client_process import find_client_version
from cornercase.simulators.carla._openscenario_1_0 import ConversionOptions, write_openscenario_1_0
from cornercase.simulators.carla._runner_environment import RunnerEnvironment
from helpers.carla_or_stand_in import Served
from helpers.command_line import X
from helpers.isolation import REFERENCE

FOLDER = os.environ.get("CORNERCASE_SCENARIO_RUNNER", "")
pytestmark = pytest.mark.skipif(not FOLDER or not REFERENCE.is_dir(), reason="CORNERCASE_SCENARIO_RUNNER is not set")
# s of each scenario; the whole tree is built whatever is run of it.
DURATION = 4.0
# Half a frame at 130 km/h, and what a walker or a controlled car is behind.
NEAR = 1.5


def client_version():
    return find_client_version(RunnerEnvironment.find(FOLDER, "", ""))


def protocols():
    files = [one for folder in ("ncap", "alks") for one in sorted((REFERENCE / folder).rglob("*.xosc"))]
    return [one for one in files if "<Storyboard" in one.read_text(errors="replace")]


def centers(recording, name):
    k = recording.names.index(name)
    ahead = recording.center_x[k]
    return np.stack(
        [recording.x[k] + ahead * np.cos(recording.heading[k]), recording.y[k] + ahead * np.sin(recording.heading[k])]
    )


def apart(one, other):
    """Largest distance of two paths, one of which may start some frames later."""
    found = []
    for later in range(-5, 25):
        a, b = one[:, max(later, 0) :], other[:, max(-later, 0) :]
        shared = min(a.shape[1], b.shape[1])
        if shared > 20:
            found.append(float(np.nanmax(np.hypot(*(a[:, :shared] - b[:, :shared])))))
    return min(found)


@pytest.mark.parametrize("file", protocols(), ids=lambda file: file.stem)
def test_the_real_tree_of_each_protocol_is_built_and_moves_as_the_scenario_says(file, tmp_path):
    scenario = ScenarioFile.read(file)
    notes = write_openscenario_1_0(
        scenario, {}, tmp_path / "one.xosc", ego="Ego", options=ConversionOptions(duration=DURATION)
    )
    assert (tmp_path / "one.xosc").exists()
    sampled = {note.partition(" moves along")[0] for note in notes if " moves along a trajectory" in note}
    expected = simulate(scenario, duration=DURATION)
    with Served(scenario.road_path_for({}), f"version={client_version()}") as server:
        simulator = Carla(
            hosts=server.host,
            port=server.port,
            scenario_runner=FOLDER,
            ego="Ego",
            duration=DURATION,
            patience=20.0,
            any_version=True,
        )
        (found,) = simulator.run([ConcreteScenario(file, {}, scenario)])
    assert not isinstance(found, Exception), found
    assert set(found.names) == set(scenario.entities)
    for name in sampled:
        assert apart(centers(found, name), centers(expected, name)) < NEAR, name


class Approach(cc.SystemUnderTest):
    """Accelerates up to 12 m/s."""

    def step(self, view, dt):
        assert len(view.objects) == 3
        return 0.5 if view.ego.speed < 12.0 else 0.0


def test_a_driver_of_ones_own_drives_the_ego_as_on_the_builtin_simulator():
    concrete = ConcreteScenario(X, {})
    options: dict[str, Any] = {"duration": DURATION, "drivers": {"Ego": Approach()}}
    with Served(X.with_suffix(".xodr"), f"version={client_version()}") as server:
        simulator = Carla(
            hosts=server.host, port=server.port, scenario_runner=FOLDER, ego="Ego", patience=20.0, undriven=True,
            open_loop=True, any_version=True, **options,
        )  # fmt: skip
        (found,) = simulator.run([concrete])
    assert not isinstance(found, Exception), found
    (expected,) = cc.simulators.Builtin(**options).run([concrete])
    # The first frames are those before it is placed.
    assert apart(centers(found, "Ego")[:, 5:], centers(expected, "Ego")) < 0.05
