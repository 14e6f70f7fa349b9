"""Vehicle models that drivers move in the builtin simulator."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from cornercase._common.typing import FloatArray
from cornercase.drivers import BehaviourDriver, Driver, EquippedDriver, Situation
from cornercase.drivers.vehicles._actuated import Actuators
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario, LogicalScenario
from cornercase.simulators import Builtin
from helpers.command_line import SPACE, X

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


def test_a_scenario_gives_the_same_bytes_alone() -> None:
    chosen = concretes(6)
    together = run(chosen, EQUIPPED)
    assert [as_bytes(one) for one in together] == [as_bytes(run([one], EQUIPPED)[0]) for one in chosen]


def test_acceleration_changes_slowly_and_within_friction() -> None:
    (recording,) = run(concretes(1), "aggressive + actuators:mu=0.15,max_jerk=5")
    acceleration = recording.acceleration[recording.entity_index("Ego")]
    assert np.abs(acceleration).max() == pytest.approx(0.15 * 9.81, rel=1e-6)
    assert np.abs(np.diff(acceleration[1:])).max() <= 5.0 * 0.05 + 1e-9
