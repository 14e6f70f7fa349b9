"""How far a simulator is from the builtin one in small scenarios."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Final

import numpy as np

from cornercase._common.errors import SimulationError
from cornercase._common.geometry.boxes import wrap_angle
from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin, Simulator
from cornercase.testing._cases import Cases

TOLERANCES: Final = {
    "position": 0.5,
    "heading": 0.1,
    "speed": 0.3,
    "acceleration": 0.5,
    "collision": 0.15,
    "box": 0.05,
    "end": 0.3,
}
"""Largest deviations that count as agreement, as in `Deviations`."""

_UNITS: Final = {
    "position": "m",
    "heading": "rad",
    "speed": "m/s",
    "acceleration": "m/s²",
    "collision": "s",
    "box": "m",
    "end": "s",
}


@dataclass(frozen=True)
class Deviations:
    """The largest deviations of an entity from the builtin simulator; infinite where one cannot be told."""

    position: float  # m, at an instant
    heading: float  # rad, at an instant
    speed: float  # m/s, on average over time, as speeds jump where an action begins
    acceleration: float  # m/s², the median over time
    collision: float  # s, of when two entities collide first; infinite if they collide in one recording only
    box: float  # m, of length, width and centre of its bounding box
    end: float  # s, of the end of the recording

    @property
    def problem(self) -> str:
        """What is beyond its tolerance, as a sentence; empty if nothing is."""
        beyond = [
            f"{name} by {'any' if value == np.inf else f'{value:.3g}'} {_UNITS[name]} (at most {TOLERANCES[name]:g})"
            for name, value in asdict(self).items()
            if not value <= TOLERANCES[name]
        ]
        return f"It differs from the builtin simulator in {', '.join(beyond)}." if beyond else ""


@dataclass(frozen=True)
class SmallRun:
    """A run of a small scenario in a simulator, beside one in the builtin simulator."""

    name: str
    problem: str  # why they do not agree, as a sentence; empty if they do
    deviations: Deviations | None  # None if there is no recording that can be compared
    seconds: float
    own: Recording | None
    expected: Recording


def run_small_scenario(simulator: str | Simulator, name: str, concrete: ConcreteScenario) -> SmallRun:
    """Run a small scenario in a simulator and in the builtin one."""
    (expected,) = Builtin().run([concrete])
    assert isinstance(expected, Recording), expected
    begin = time.perf_counter()
    (own,) = Cases((concrete,), "Ego").outcomes(simulator)
    seconds = time.perf_counter() - begin
    if isinstance(own, SimulationError):
        return SmallRun(name, f"It failed: {own}.", None, seconds, None, expected)
    missing = sorted({*expected.names} ^ {*own.names})
    if missing:
        return SmallRun(name, f"It has other entities: {', '.join(missing)}.", None, seconds, own, expected)
    deviations = measure_deviations(own, expected)
    return SmallRun(name, deviations.problem, deviations, seconds, own, expected)


def measure_deviations(own: Recording, expected: Recording) -> Deviations:
    """Return how far a recording is from another one of the same entities, at the instants of the latter."""
    end = min(own.time[-1], expected.time[-1])
    at = expected.time[(expected.time <= end) & (expected.time >= own.time[0])]
    rows = [own.entity_index(name) for name in expected.names]
    begin = int(np.searchsorted(expected.time, at[0])) if len(at) else 0
    shown = slice(begin, begin + len(at))
    x, y, speed, acceleration = (
        _resample(own.time, getattr(own, name)[rows], at) - getattr(expected, name)[:, shown]
        for name in ("x", "y", "speed", "acceleration")
    )
    heading = wrap_angle(_resample(own.time, np.unwrap(own.heading[rows]), at) - expected.heading[:, shown])
    boxes = [np.abs(getattr(own, name)[rows] - getattr(expected, name)) for name in ("length", "width", "center_x")]
    return Deviations(
        position=_largest(np.hypot(x, y)),
        heading=_largest(np.abs(heading)),
        speed=_largest(np.abs(speed).mean(axis=1)) if len(at) else np.inf,
        acceleration=_largest(np.median(np.abs(acceleration), axis=1)) if len(at) else np.inf,
        collision=_collision_deviation(own, expected),
        box=_largest(np.array(boxes)),
        end=abs(float(own.time[-1] - expected.time[-1])),
    )


def _resample(time: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    return np.array([np.interp(at, time, row) for row in values])


def _largest(values: FloatArray) -> float:
    """Return the largest value; infinite if there is none, or one that is not a number."""
    return float(values.max()) if values.size and np.isfinite(values).all() else np.inf


def _collision_deviation(own: Recording, expected: Recording) -> float:
    first, second = _first_collisions(own), _first_collisions(expected)
    if first.keys() != second.keys():
        return np.inf
    return max((abs(first[pair] - second[pair]) for pair in first), default=0.0)


def _first_collisions(recording: Recording) -> Mapping[frozenset[str], float]:
    first = dict[frozenset[str], float]()
    for collision in recording.collisions:
        pair = frozenset(collision.entities)
        first[pair] = min(first.get(pair, np.inf), collision.time)
    return first
