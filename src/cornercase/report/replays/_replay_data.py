"""Data of a replay: scenarios of a study, and their road."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.metrics import Metric
from cornercase.recordings import Recording
from cornercase.report._event_payload import find_events_of_scenario
from cornercase.report._road_drawing import find_road_outline, recorded_bounds
from cornercase.roads._outline import RoadOutline
from cornercase.scenario import Parameter
from cornercase.scenario._file import ScenarioFile
from cornercase.study import ScenarioRecord, StudyFile, StudyMeta
from cornercase.study._criterion import Criterion
from cornercase.study._study_file import describe_ids


@dataclass(frozen=True, eq=False)
class ReplayItem:
    """One scenario of a replay; its recording has T instants."""

    row: ScenarioRecord
    recording: Recording
    courses: Mapping[str, FloatArray]  # capped courses by metric, shape (T,)
    scores: Mapping[str, float]  # by metric
    outcome: str  # how it ended; empty if unknown
    is_critical: bool
    score_sources: Mapping[str, str | None] = field(default_factory=dict)
    events: Mapping[str, Any] = field(default_factory=dict)  # what happened when, as the page has it

    def most_critical_time(self, metric: Metric) -> float:
        """Return the first time in s at which a metric is most critical.

        If the course of the metric is constant: the time of the first collision, or else the start.
        """
        course = metric.to_minimize(self.courses[metric.name])
        finite = course[np.isfinite(course)]
        if len(finite) and finite.min() < finite.max():
            return float(self.recording.time[int(np.nanargmin(course))])
        return self.recording.collisions[0].time if self.recording.collisions else float(self.recording.time[0])


@dataclass(frozen=True, eq=False)
class ReplayData:
    """All data that a replay shows."""

    file_name: str  # name of the study's file
    meta: StudyMeta
    metrics: tuple[Metric, ...]  # the course of the first one is shown
    criterion: Criterion | None  # of the first metric, if it alone defines what is critical
    items: tuple[ReplayItem, ...]  # one, or two side by side
    road: RoadOutline | None
    road_missing_reason: str  # why there is no road

    @property
    def parameters(self) -> Sequence[Parameter]:
        """Parameters of the study's parameter space."""
        return self.meta.space.parameters

    def main_other(self, item: ReplayItem) -> str:
        """Return the entity against which the first metric measured the ego; if unknown, the first other entity."""
        return item.score_sources.get(self.metrics[0].name) or self.meta.others[0]

    @property
    def start_time(self) -> float:
        """Start of the first recording in s."""
        return float(self.items[0].recording.time[0])

    @property
    def end_time(self) -> float:
        """End of the longest recording in s."""
        return max(float(item.recording.time[-1]) for item in self.items)


def read_replay_data(
    study: StudyFile, ids: Sequence[int], scenario: Path | str | ScenarioFile | None = None
) -> ReplayData:
    """Read scenarios of a study and their road for a replay.

    InputError if a scenario was not run, or if `scenario` is not the file that was explored.
    """
    meta = study.meta
    metrics = meta.create_metrics()
    objective = study.objective
    # The threshold of a weighted sum does not apply to a single course.
    criterion = None if objective.weights else objective.criterion
    outcomes = study.outcomes()
    rows = {row.id: row for row in study.rows()}
    items = []
    for scenario_id in ids:
        row = _require_run_scenario(study, rows, scenario_id)
        scores = study.scenario_scores(scenario_id)
        courses = {metric.name: metric.clip_course(study.course(scenario_id, metric.name)) for metric in metrics}
        recording = study.recording(scenario_id)
        items.append(
            ReplayItem(
                row,
                recording,
                courses,
                scores,
                outcomes.get(scenario_id, ""),
                objective.is_critical(scores),
                study.scenario_score_sources(scenario_id),
                find_events_of_scenario(study, scenario_id, recording),
            )
        )
    region = recorded_bounds(item.recording for item in items)
    road, missing = find_road_outline(study, region, scenario, items[0].row.values)
    return ReplayData(study.path.name, meta, metrics, criterion, tuple(items), road, missing)


def _require_run_scenario(study: StudyFile, rows: Mapping[int, ScenarioRecord], scenario_id: int) -> ScenarioRecord:
    row = rows.get(scenario_id)
    if row is None:
        raise InputError(f"{study.path}: has no scenario {scenario_id}; {describe_ids(rows)}.")
    if row.state == "failed":
        raise InputError(f"{study.path}: scenario {scenario_id} failed, so there is nothing to replay: {row.error}")
    if row.state != "done":
        raise InputError(f"{study.path}: scenario {scenario_id} was not run yet, so there is nothing to replay.")
    return row
