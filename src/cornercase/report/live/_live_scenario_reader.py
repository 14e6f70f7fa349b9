"""Reader of single scenarios for the live page, and conversion of their results to columns for the page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from cornercase._common.typing import FloatArray
from cornercase.report._metric_courses import encode_courses
from cornercase.report._report_payload import parameter_columns, round_score, score_source_column
from cornercase.report._summary import entities_hit_by_ego
from cornercase.study import ScenarioRecord, StudyFile, StudyMeta
from cornercase.study._objective import Objective


@dataclass(frozen=True, eq=False)
class LiveScenario:
    """Results of one ended scenario that the live page shows before any analysis."""

    row: ScenarioRecord
    scores: dict[str, float]  # by metric; empty if the scenario failed
    critical: bool
    collides: bool  # the ego collides with an entity it is measured against
    time_span: tuple[float, float]  # begin and end of the recording in s
    courses: dict[str, FloatArray]  # resampled courses by metric, shape (COURSE_POINTS,)
    score_sources: dict[str, str | None] = field(default_factory=dict)


class LiveScenarioReader:
    """Reader of ended scenarios from an open study, for the live page."""

    def __init__(self, study: StudyFile) -> None:
        self._study = study
        self._objective = Objective.from_study_meta(study.meta)

    def read(self, row: ScenarioRecord) -> LiveScenario:
        """Read the results of a scenario that has ended."""
        if row.state == "failed":
            return LiveScenario(row, {}, False, False, (0.0, 0.0), {})
        study, meta = self._study, self._study.meta
        digest, scores = study.digest(row.id), study.scenario_scores(row.id)
        return LiveScenario(
            row,
            scores,
            self._objective.is_critical(scores),
            not entities_hit_by_ego(meta, digest.collisions).isdisjoint(meta.others),
            (digest.begin, digest.end),
            dict(zip(meta.metrics, digest.lines, strict=True)),
            study.scenario_score_sources(row.id),
        )


def scenario_columns(meta: StudyMeta, digests: Sequence[LiveScenario]) -> dict[str, Any]:
    """Return the results of scenarios as columns for the live page, without results of an analysis."""
    rows = [digest.row for digest in digests]

    def score_column(name: str) -> list[float | None]:
        return [round_score(digest.scores[name]) if name in digest.scores else None for digest in digests]

    return {
        "scenarios": {
            "id": [row.id for row in rows],
            "round": [row.round for row in rows],
            "failed": [int(row.state == "failed") for row in rows],
            "values": parameter_columns(meta.space.parameters, rows),
            "scores": {name: score_column(name) for name in meta.metrics},
            "critical": [int(digest.critical) for digest in digests],
            "collides": [int(digest.collides) if digest.scores else None for digest in digests],
            "outcome": [None] * len(rows),
            "culprit": [None] * len(rows),
            "kept": [0] * len(rows),
            "audit": [int(meta.is_audit(row.id)) for row in rows],
        }
        | score_source_column(
            meta,
            [
                [digest.score_sources.get(name) for name in meta.metrics] if digest.scores else None
                for digest in digests
            ],
        ),
        "errors": {str(row.id): row.error or "" for row in rows if row.state == "failed"},
    }


def course_columns(meta: StudyMeta, digests: Sequence[LiveScenario]) -> dict[str, Any]:
    """Return the courses (values of a metric over time) of scenarios, encoded for the live page, by metric."""
    return {
        name: encode_courses([digest.courses.get(name) for digest in digests], [digest.time_span for digest in digests])
        for name in meta.metrics
    }
