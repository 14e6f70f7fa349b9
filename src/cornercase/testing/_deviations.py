"""Deviations of a simulator from the builtin simulator in small scenarios."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple

import numpy as np
from lxml import etree

from cornercase._common.errors import SimulationError
from cornercase._common.geometry.boxes import wrap_angle
from cornercase._common.typing import FloatArray
from cornercase.drivers._resolve import DriverLike
from cornercase.recordings import Recording
from cornercase.recordings._compare import max_position_difference
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import SIMULATORS, Builtin, Simulator
from cornercase.testing._agent_runs import AgentMotion, describe_agent_problems, measure_agent_motion
from cornercase.testing._cases import Cases
from cornercase.testing._corrections import box_centers, iter_corrections
from cornercase.testing._small_scenarios import AGENT_DURATIONS

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

# s by which equal instants may differ.
_SAME_TIME: Final = 1e-6
UNITS: Final = {
    "position": "m",
    "heading": "rad",
    "speed": "m/s",
    "acceleration": "m/s²",
    "collision": "s",
    "box": "m",
    "end": "s",
}
"""Units of deviations."""


@dataclass(frozen=True)
class Deviations:
    """Largest deviations of any entity from its motion in the builtin simulator; an unknown deviation is infinite."""

    position: float  # m, of the centre of the bounding box at an instant
    heading: float  # rad, at an instant
    speed: float  # m/s, on average over time, as speeds jump where an action begins
    acceleration: float  # m/s², the median over time
    collision: float  # s, of the first collision of two entities; infinite if they collide in one recording only
    box: float  # m, of length and width of its bounding box; 0 if the simulator has its own
    end: float  # s, of the end of the recording

    @property
    def largest_relative_deviation(self) -> float:
        """Largest ratio of a deviation to its tolerance; `end` does not count, since some corrections change it."""
        return max(float(value) / TOLERANCES[name] for name, value in asdict(self).items() if name != "end")

    @property
    def problem(self) -> str:
        """Sentence that lists the deviations beyond their tolerances; empty if there are none."""
        beyond = [
            f"{name} by {'any' if value == np.inf else f'{value:.3g}'} {UNITS[name]} (at most {TOLERANCES[name]:g})"
            for name, value in asdict(self).items()
            if not value <= TOLERANCES[name]
        ]
        return f"It differs from the builtin simulator in {', '.join(beyond)}." if beyond else ""


@dataclass(frozen=True)
class SmallRun:
    """Two runs of a small scenario in a simulator, compared with one run in the builtin simulator."""

    name: str
    problem: str  # why both simulators do not agree, or what is implausible, as a sentence; empty if nothing is wrong
    deviations: Deviations | None  # None if there is no recording that can be compared
    seconds: float  # duration of the first run, with the start of the simulator
    seconds_again: float  # duration of the second run
    spread: float | None  # largest distance in m between positions in both runs; None if not known
    own: Recording | None  # of the first run; None if it failed
    expected: Recording | None  # of the builtin simulator; None if an agent of the other simulator drives
    agent: str = ""  # what drives the ego; empty for the storyboard
    motion: AgentMotion | None = None  # of the ego that an agent drives


class _RepeatedRun(NamedTuple):
    """Two runs of the same scenario in a simulator, and the duration of each in s."""

    own: Recording | SimulationError
    again: Recording | SimulationError
    seconds: float
    seconds_again: float

    @property
    def spread(self) -> float | None:
        """Largest distance in m between positions in both runs; None if the runs cannot be compared."""
        if isinstance(self.own, SimulationError) or isinstance(self.again, SimulationError):
            return None
        return max_position_difference(self.own, self.again)


def run_small_scenario(
    simulator: str | Simulator,
    name: str,
    concrete: ConcreteScenario,
    *,
    agent: str = "",
    drivers: Mapping[str, DriverLike] | None = None,
) -> SmallRun:
    """Run a small scenario twice in a simulator and once in the builtin simulator, with the same drivers."""
    runs = _run_twice(simulator, concrete, {} if drivers is None else {"drivers": drivers})
    own = runs.own
    has_own_boxes = SIMULATORS.get_class(simulator).has_own_boxes
    expected = _run_builtin(concrete, own if has_own_boxes and isinstance(own, Recording) else None, drivers)
    run = partial(
        SmallRun, name, seconds=runs.seconds, seconds_again=runs.seconds_again, spread=runs.spread, expected=expected,
        agent=agent,
    )  # fmt: skip
    if isinstance(own, SimulationError):
        return run(f"It failed: {own}.", None, own=None)
    if missing := _describe_different_entities({*expected.names}, own):
        return run(missing, None, own=own)
    deviations = measure_deviations(own, expected)
    problem = deviations.problem
    if problem and (cause := find_likely_mistake(own, expected)):
        problem = f"{problem.removesuffix('.')}; it looks as if {cause}."
    return run(problem, deviations, own=own, motion=measure_agent_motion(own) if drivers else None)


def run_with_agent(
    simulator: str | Simulator, name: str, concrete: ConcreteScenario, agent: str, options: Mapping[str, object]
) -> SmallRun:
    """Run a small scenario twice with an agent of the simulator; check only whether the runs are plausible."""
    runs = _run_twice(simulator, concrete, options)
    own = runs.own
    run = partial(
        SmallRun, name, deviations=None, seconds=runs.seconds, seconds_again=runs.seconds_again, spread=runs.spread,
        expected=None, agent=agent,
    )  # fmt: skip
    if isinstance(own, SimulationError):
        return run(problem=f"It failed: {own}.", own=None)
    if missing := _describe_different_entities({*concrete.load_file().entities}, own):
        return run(problem=missing, own=own)
    motion = measure_agent_motion(own)
    problem = describe_agent_problems(motion, float(own.time[-1]), AGENT_DURATIONS[name])
    return run(problem=problem, own=own, motion=motion)


def _run_twice(simulator: str | Simulator, concrete: ConcreteScenario, options: Mapping[str, Any]) -> _RepeatedRun:
    outcomes, seconds = list[Recording | SimulationError](), list[float]()
    begin = time.perf_counter()
    for outcome in Cases((concrete, concrete), "Ego").iter_outcomes(simulator, **options):
        outcomes.append(outcome)
        seconds.append(time.perf_counter() - begin)
        begin = time.perf_counter()
    (own, again), (first, second) = outcomes, seconds
    return _RepeatedRun(own, again, first, second)


def _describe_different_entities(names: set[str], own: Recording) -> str:
    """Return a sentence on entities that are only in `names` or only in a recording; empty if there are none."""
    different = sorted(names ^ {*own.names})
    return f"It has other entities: {', '.join(different)}." if different else ""


def _run_builtin(
    concrete: ConcreteScenario, boxes: Recording | None, drivers: Mapping[str, DriverLike] | None
) -> Recording:
    """Run a scenario in the builtin simulator; if `boxes` is given, entities have the box sizes of this recording."""
    with TemporaryDirectory() as name:
        if boxes is not None:
            root = etree.parse(concrete.path).getroot()
            for element in root.iter("ScenarioObject"):
                dimensions = element.find(".//Dimensions")
                if dimensions is not None and element.get("name") in boxes.names:
                    e = boxes.entity_index(element.get("name", ""))
                    dimensions.set("length", f"{boxes.length[e]:.6g}")
                    dimensions.set("width", f"{boxes.width[e]:.6g}")
            road = root.find("RoadNetwork/LogicFile")
            assert road is not None
            road.set("filepath", str((concrete.path.parent / road.get("filepath", "")).resolve()))
            path = Path(name) / concrete.path.name
            path.write_bytes(etree.tostring(root))
            concrete = ConcreteScenario(path, {})
        (expected,) = Builtin(drivers=drivers).run([concrete])
    assert isinstance(expected, Recording), expected
    return expected


def find_likely_mistake(own: Recording, expected: Recording) -> str:
    """Return as a clause which mistake most likely explains how a recording differs from the expected recording.

    This is the mistake whose correction makes both recordings agree best. Empty if no correction makes them agree.
    """
    best, cause = np.inf, ""
    for clause, corrected in iter_corrections(own, expected):
        deviations = measure_deviations(corrected, expected)
        if not deviations.problem and deviations.largest_relative_deviation < best:
            best, cause = deviations.largest_relative_deviation, clause
    return cause


def measure_deviations(own: Recording, expected: Recording) -> Deviations:
    """Measure deviations of a recording from an expected recording, at the instants of the expected recording."""
    end = min(own.time[-1], expected.time[-1])
    # Instants may differ by rounding.
    at = expected.time[(expected.time <= end + _SAME_TIME) & (expected.time >= own.time[0] - _SAME_TIME)]
    rows = [own.entity_index(name) for name in expected.names]
    begin = int(np.searchsorted(expected.time, at[0])) if len(at) else 0
    shown = slice(begin, begin + len(at))
    x, y = (
        _resample(own.time, own_center[rows], at) - expected_center[:, shown]
        for own_center, expected_center in zip(box_centers(own), box_centers(expected), strict=True)
    )
    speed, acceleration = (
        _resample(own.time, getattr(own, name)[rows], at) - getattr(expected, name)[:, shown]
        for name in ("speed", "acceleration")
    )
    heading = wrap_angle(_resample(own.time, np.unwrap(own.heading[rows]), at) - expected.heading[:, shown])
    boxes = [np.abs(getattr(own, name)[rows] - getattr(expected, name)) for name in ("length", "width")]
    return Deviations(
        position=_find_largest_or_inf(np.hypot(x, y)),
        heading=_find_largest_or_inf(np.abs(heading)),
        speed=_find_largest_or_inf(np.abs(speed).mean(axis=1)) if len(at) else np.inf,
        acceleration=_find_largest_or_inf(np.median(np.abs(acceleration), axis=1)) if len(at) else np.inf,
        collision=_collision_deviation(own, expected),
        box=_find_largest_or_inf(np.array(boxes)),
        end=abs(float(own.time[-1] - expected.time[-1])),
    )


def _resample(time: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    return np.array([np.interp(at, time, row) for row in values])


def _find_largest_or_inf(values: FloatArray) -> float:
    """Return the largest value; infinite if there are no values, or one of them is not finite."""
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
