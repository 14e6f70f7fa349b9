"""Data of a replay: scenarios of a study and their road."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.exploration import Objective
from cornercase.metrics import METRICS, Metric
from cornercase.recordings import Recording
from cornercase.report.roads import find_roads, recorded_region
from cornercase.roads import RoadSketch
from cornercase.scenario import Parameter, Scenario
from cornercase.study import Row, Study, StudyMeta


@dataclass(frozen=True, eq=False)
class Take:
    """One scenario of a replay, with T instants."""

    row: Row
    recording: Recording
    courses: Mapping[str, FloatArray]  # capped courses by metric, shape (T,)
    scores: Mapping[str, float]  # by metric
    outcome: str  # how it ended; empty if unknown
    critical: bool
    against: Mapping[str, str | None] = field(default_factory=dict)

    def critical_time(self, metric: Metric) -> float:
        """Return the first most critical time of a metric in s.

        If its course is constant: the first collision, or the start.
        """
        course = metric.oriented(self.courses[metric.name])
        finite = course[np.isfinite(course)]
        if len(finite) and finite.min() < finite.max():
            return float(self.recording.time[int(np.nanargmin(course))])
        return self.recording.collisions[0].time if self.recording.collisions else float(self.recording.time[0])


@dataclass(frozen=True, eq=False)
class Footage:
    """All data that a replay shows."""

    study: str  # name of the study's file
    meta: StudyMeta
    metrics: tuple[Metric, ...]  # the course of the first one is shown
    threshold: float | None  # of the first metric, if it alone defines what is critical
    takes: tuple[Take, ...]  # one, or two side by side
    road: RoadSketch | None
    road_missing: str  # why there is no road

    @property
    def parameters(self) -> Sequence[Parameter]:
        """Parameters of the space."""
        return self.meta.space.parameters

    def other_of(self, take: Take) -> str:
        """Return the other that the score by the first metric belongs to, or the first other."""
        return take.against.get(self.metrics[0].name) or self.meta.others[0]

    @property
    def begin(self) -> float:
        """Start of the first recording in s."""
        return float(self.takes[0].recording.time[0])

    @property
    def end(self) -> float:
        """End of the longest recording in s."""
        return max(float(take.recording.time[-1]) for take in self.takes)


def read_footage(study: Study, ids: Sequence[int], scenario: Path | str | Scenario | None = None) -> Footage:
    """Read scenarios and their road for a replay; InputError if a scenario was not run or `scenario` does not match."""
    meta = study.meta
    metrics = tuple(METRICS.create(name) for name in meta.metrics)
    objective = Objective.of_study(meta)
    # A front has no threshold, and the threshold of a weighted sum does not apply to a single course.
    threshold = None if objective.pareto or objective.weights else study.critical
    outcomes = study.outcomes()
    rows = {row.id: row for row in study.rows()}
    takes = []
    for scenario_id in ids:
        row = _require_run(study, rows, scenario_id)
        scores = study.scores_of(scenario_id)
        courses = {metric.name: metric.capped(study.course(scenario_id, metric.name)) for metric in metrics}
        scores_row = np.array([[scores[metric.name] for metric in metrics]])
        critical = bool(objective.critical(scores_row, study.critical)[0])
        against = study.against_of(scenario_id)
        takes.append(
            Take(row, study.recording(scenario_id), courses, scores, outcomes.get(scenario_id, ""), critical, against)
        )
    region = recorded_region(take.recording for take in takes)
    road, missing = find_roads(study, region, scenario, takes[0].row.values)
    return Footage(study.path.name, meta, metrics, threshold, tuple(takes), road, missing)


def _require_run(study: Study, rows: Mapping[int, Row], scenario: int) -> Row:
    row = rows.get(scenario)
    if row is None:
        count = f"its scenarios are 1 to {max(rows)}" if rows else "it has none yet"
        raise InputError(f"{study.path}: has no scenario {scenario}; {count}.")
    if row.state == "failed":
        raise InputError(f"{study.path}: scenario {scenario} failed, so there is nothing to replay: {row.error}")
    if row.state != "done":
        raise InputError(f"{study.path}: scenario {scenario} was not run yet, so there is nothing to replay.")
    return row
