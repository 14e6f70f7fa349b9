"""What the paper leaves open of its scenarios, as a space of reconstructions of which some are explored.

The reconstructions fill the space evenly: they are the first points of a Sobol' sequence. So the share of them in which
a statement holds estimates its share of the space. They use a seed of their own, with which nothing else is judged.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from benchmarks.replication.family import READINGS, Runs
from benchmarks.replication.observed import ASPECTS_OF, Observed
from benchmarks.replication.statements import STATEMENTS, Statement, T, X
from benchmarks.replication.verdicts import road_file

from cornercase.exploration._explore import explore_config
from cornercase.optimizers import Sobol
from cornercase.scenario import Parameter, ParameterSpace, Value

SEED: Final = 200
_ENDS: Final = ("the ego arrives", "33 s")

SPACE_X: Final = ParameterSpace(
    (
        Parameter("distance of the pedestrian from the middle of the road", 4.6, 12.0, 0.1, unit="m"),
        Parameter("shortest wait", 2.0, 6.0, 0.5, unit="s"),
        Parameter("longest wait", 8.0, 18.0, 0.5, unit="s"),
        Parameter("smallest start of the ego", 5.0, 40.0, 1.0, unit="m"),
        Parameter("speed of the ego", 8.0, 14.0, 0.5, unit="m/s"),
        Parameter("speed of the pedestrian", 1.2, 2.8, 0.1, unit="m/s"),
        Parameter("a run ends", 0, len(_ENDS) - 1, choices=_ENDS),
    )
)
SPACE_T: Final = ParameterSpace(
    (
        Parameter("driver", 0, 2, choices=("cautious", "normal", "aggressive")),
        Parameter("field of view", 0.6, 6.2, 0.1, unit="rad"),
        Parameter("sight", 8.0, 80.0, 1.0, unit="m"),
        Parameter("reaction time", 0.0, 1.0, 0.1, unit="s"),
        Parameter("time to the leader", 0.5, 4.0, 0.5, unit="s"),
        Parameter("speed of C", 7.0, 15.0, 0.5, unit="m/s"),
        Parameter("latest start of C", 3.0, 8.0, 0.5, unit="s"),
    )
)
"""What is not stated, with ranges that a test engineer would take."""

_READINGS: Final = {X: ("automatic", "by hand", "speed, by hand"), T: ("automatic", "by hand", "contact")}
# These are about computing time.
_LEFT_OUT: Final = ("2.10", "2.11")


@dataclass(frozen=True)
class Tried:
    """A reconstruction, and which statements hold in it, by number and reading."""

    scenario: str
    values: Mapping[str, Value]
    holds: Mapping[str, Mapping[str, bool]]


def try_reconstructions(folder: Path, count: int, budget: int | None, progress: bool) -> Iterator[Tried]:
    """Explore `count` reconstructions of each scenario, and test the statements; what is tested already is read."""
    folder.mkdir(parents=True, exist_ok=True)
    for scenario, space in ((X, SPACE_X), (T, SPACE_T)):
        for k, values in enumerate(space.values(Sobol().start(space, SEED).ask(count))):
            name = f"space-{scenario[0]}-{k}"
            known = folder / f"{name}.json"
            asked = _statements_of(scenario)
            stored = json.loads(known.read_text("utf-8")) if known.exists() else {}
            if stored.get("values") != values or set(stored["holds"]) != {_name(one) for one in asked}:
                stored = {"values": values, "holds": _test(_runs(name, scenario, values), folder, asked, budget)}
                known.write_text(json.dumps(stored), "utf-8")
                if progress:
                    held = sum(any(one.values()) for one in stored["holds"].values())
                    print(f"{name}: {held} of {len(asked)} hold by some reading", flush=True)
            yield Tried(scenario, values, stored["holds"])


def _statements_of(scenario: str) -> list[Statement]:
    """Return the statements about a scenario, those of scenario 2 once for all egos."""
    return [
        one
        for one in STATEMENTS.values()
        if one.scenario == scenario and one.ego in ("", "normal") and not one.number.startswith(_LEFT_OUT)
    ]


def _name(statement: Statement) -> str:
    return statement.number.rstrip("n")


def _test(runs: Runs, folder: Path, asked: Sequence[Statement], budget: int | None) -> dict[str, dict[str, bool]]:
    path = folder / f"{runs.name}.db"
    config = runs.config("", SEED, budget, folder)
    explore_config(config, path, progress=False)
    observed = Observed.read(path, SEED, ASPECTS_OF[runs.scenario], road_file(config))
    readings = [one for one in READINGS if one.name in runs.readings]
    return {
        _name(one): {reading.name: bool(one.measure(observed, reading)[1]) for reading in readings} for one in asked
    }


def _runs(name: str, scenario: str, values: Mapping[str, Any]) -> Runs:
    """Return the reconstruction with these values."""
    changes: tuple[tuple[str, str], ...]
    if scenario == T:
        driver = (
            f"{values['driver']}:field_of_view={values['field of view']:g},sight_range={values['sight']:g},"
            f"reaction_time={values['reaction time']:g},memory=0,safety_time={values['time to the leader']:g}"
        )
        changes = ((_declared("c_speed", "10"), _declared("c_speed", f"{values['speed of C']:g}")),)
        latest = f"c_start_time=0:{values['latest start of C']:g}:0.01"
        return Runs(name, scenario, "", {"": driver}, _READINGS[T], changes, (latest,))
    place = '<WorldPosition x="18.000" y="{}" h="-1.5708"/>'
    away = values["distance of the pedestrian from the middle of the road"]
    changes = (
        (place.format("4.600"), place.format(f"{away:.3f}")),
        (_declared("ego_speed", "10"), _declared("ego_speed", f"{values['speed of the ego']:g}")),
        (_declared("pedestrian_speed", "2.2"), _declared("pedestrian_speed", f"{values['speed of the pedestrian']:g}")),
    )
    if values["a run ends"] == _ENDS[1]:
        rule = '<SimulationTimeCondition value="{}" rule="greaterThan"/>'
        # No end where the ego arrives: this place is not on its way.
        lane = '<LanePosition roadId="{}" laneId="1" s="{}"/>'
        changes += ((rule.format(30), rule.format(33)), (lane.format(2, 40), lane.format(1, 0)))
    ranges = (
        f"ego_start={values['smallest start of the ego']:g}:95:0.1",
        f"pedestrian_wait={values['shortest wait']:g}:{values['longest wait']:g}:0.01",
    )
    return Runs(name, scenario, "", {"": None}, _READINGS[X], changes, ranges)


def _declared(name: str, value: str) -> str:
    return f'name="{name}" parameterType="double" value="{value}"'


def table(tried: Sequence[Tried]) -> Iterator[str]:
    """Markdown rows: each statement, and in how many reconstructions it holds by each reading."""
    yield "| statement | holds in | by readings |"
    yield "| --- | --- | --- |"
    for scenario in (X, T):
        those = [one for one in tried if one.scenario == scenario]
        for statement in _statements_of(scenario) if those else ():
            name = _name(statement)
            counts = {reading: sum(one.holds[name][reading] for one in those) for reading in _READINGS[scenario]}
            some = sum(any(one.holds[name].values()) for one in those)
            told = ", ".join(f"{reading} {count}" for reading, count in counts.items())
            yield f"| {statement.says} ({name}) | {some} of {len(those)} | {told} |"
    for scenario, space in ((X, SPACE_X), (T, SPACE_T)):
        those = [one for one in tried if one.scenario == scenario]
        if those:
            best = max(those, key=lambda one: sum(any(cell.values()) for cell in one.holds.values()))
            held = [name for name, cell in best.holds.items() if any(cell.values())]
            values = ", ".join(
                f"{one.name} {best.values[one.name]}{one.unit and ' '}{one.unit}" for one in space.parameters
            )
            yield f"| most in one of {scenario} | {len(held)} of {len(best.holds)} | {values} |"
