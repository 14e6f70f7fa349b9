"""Content of the report page as JSON values for the scripts of the page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, Final

from cornercase.clustering import Analysis
from cornercase.clustering._headline_aspect import find_headline_aspect, has_useful_clusters
from cornercase.evidence._criticality_bands import BANDS_PREFIX
from cornercase.metrics._outcome import Impact
from cornercase.report._chart_data import coverage_charts, hull_edges, search_progress_chart, sensitivity_chart
from cornercase.report._metric_courses import encode_courses
from cornercase.report._predictor_payload import predictor_payload
from cornercase.report._report_data import ReportData
from cornercase.report.text._answers import describe_study, page_answers
from cornercase.report.text._captions import describe_views
from cornercase.report.text._phrases import describe_aspect, describe_informativeness, format_cluster_title
from cornercase.scenario import Parameter
from cornercase.study import ScenarioRecord, StudyMeta
from cornercase.study._objective import Objective
from cornercase.suite._verdict import worst_state

FORMAT_VERSION: Final = 1
"""Version of what `page_payload` returns."""


def page_payload(data: ReportData) -> dict[str, Any]:
    """Return the content of the report page that comes from `data` as JSON values; None stands for unknown values."""
    return whole_study_payload(data) | scenario_table_payload(data)


def scenario_table_payload(data: ReportData) -> dict[str, Any]:
    """Return the part of the content of the report page that has values for each scenario, as JSON values."""
    meta, rows = data.summary.meta, _sorted_rows(data)
    indices = _row_indices(rows)
    done = [indices[row.id] for row in data.rows]

    def spread_over_rows(values: Sequence[Any], default: Any = None) -> list[Any]:
        column = [default] * len(rows)
        for k, value in zip(done, values, strict=True):
            column[k] = value
        return column

    selected = set() if data.summary.reduced_set is None else set(data.summary.reduced_set.ids)
    outcomes = data.outcomes
    outcome_names = sorted(set(outcomes.values()))
    culprits = {scenario: _culprit(meta.ego, impact) for scenario, impact in data.hardest_measured_impacts.items()}
    culprit_names = sorted({name for name in culprits.values() if name is not None})
    against = [
        [data.score_sources[metric.name].get(row.id) for metric in data.metrics]
        for row in data.rows
        if data.score_sources
    ]
    return {
        "outcomes": outcome_names,
        "culprits": culprit_names,
        "scenarios": {
            "id": [row.id for row in rows],
            "round": [row.round for row in rows],
            "failed": [int(row.state == "failed") for row in rows],
            "values": parameter_columns(data.parameters, rows),
            "scores": {
                name: spread_over_rows([round_score(score) for score in scores]) for name, scores in data.scores.items()
            },
            "critical": spread_over_rows(data.is_critical.astype(int).tolist(), 0),
            "collides": spread_over_rows(data.collides.astype(int).tolist(), 0),
            "outcome": [outcome_names.index(outcomes[row.id]) if row.id in outcomes else None for row in rows],
            "culprit": [culprit_names.index(name) if (name := culprits.get(row.id)) else None for row in rows],
            "kept": [int(row.id in selected) for row in rows],
            "audit": [int(meta.is_audit(row.id)) for row in rows],
        }
        | score_source_column(meta, spread_over_rows(against) if against else []),
        "errors": {str(row.id): row.error or "" for row in data.failed},
        "courses": {name: _courses_payload(data, name, rows) for name in data.scores},
    }


def _culprit(ego: str, impact: Impact) -> str | None:
    """Return the name of the entity at fault for a collision, ``"both"`` or ``"undecided"``; None if not stored."""
    if impact.fault is None:
        return None
    return {"ego": ego, "other": impact.entity}.get(impact.fault.who, impact.fault.who)


def score_source_column(meta: StudyMeta, others: Sequence[Sequence[str | None] | None]) -> dict[str, Any]:
    """Return the column ``against``: for each score, the index in ``meta.others`` of the entity that it refers to.

    `others` has the name of this entity for each scenario and metric; None stands for a failed scenario. The result is
    empty if the study has only one other entity.
    """
    if len(meta.others) == 1:
        return {}
    indices = {name: k for k, name in enumerate(meta.others)}
    return {"against": [None if row is None else [indices.get(name or "") for name in row] for row in others]}


def whole_study_payload(data: ReportData) -> dict[str, Any]:
    """Return the part of the content of the report page that depends on all scenarios together, as JSON values."""
    meta, rows = data.summary.meta, _sorted_rows(data)
    indices = _row_indices(rows)
    selected = () if data.summary.reduced_set is None else data.summary.reduced_set.scenarios
    critical = data.summary.estimates.critical
    return study_info_payload(meta, data.file_name) | {
        "about": describe_study(data),
        "critical": None if critical is None else asdict(critical.criterion),
        "default_aspect": find_headline_aspect(data.summary.analyses),
        "influential": list(data.influential_parameters),
        "answers": [answer.to_json() for answer in page_answers(data)],
        "captions": describe_views(data),
        "notes": {str(scenario): text for scenario, text in data.notes.items()},
        "most_critical": {name: metric.most_critical_id for name, metric in data.summary.metrics.items()},
        "kept": {
            str(scenario.id): {
                "role": scenario.role,
                "cluster": scenario.cluster,
                "file": scenario.file,
                "why": scenario.why,
            }
            for scenario in selected
        },
        "verdicts": _verdicts_payload(data),
        "search": search_progress_chart(data),
        "sensitivity": sensitivity_chart(data) if data.summary.represents_space else None,
        "coverage": coverage_charts(data),
        "front": None if data.summary.estimates.pareto_front is None else list(data.summary.estimates.pareto_front),
        "hulls": hull_edges(data),
        "reduced_by": None
        if data.summary.reduced_set is None
        else data.summary.reduced_set.by.removeprefix(BANDS_PREFIX),
        "kinds": {
            name: _clusters_payload(analysis, indices, len(rows)) for name, analysis in data.summary.analyses.items()
        },
        **predictor_payload(data),
    }


def _verdicts_payload(data: ReportData) -> dict[str, dict[str, str]]:
    """Return file, worst verdict and reason of this verdict for each scenario of a suite, by id."""
    files = data.summary.meta.files
    payload = {}
    for scenario, verdicts in data.verdicts.items():
        state = worst_state(verdicts)
        payload[str(scenario)] = {
            "file": files[scenario - 1] if scenario <= len(files) else "",
            "state": state,
            "why": next((verdict.reason for verdict in verdicts if verdict.state == state), "no requirement applies"),
        }
    return payload


def study_info_payload(meta: StudyMeta, file_name: str) -> dict[str, Any]:
    """Return title, roles, parameters and metrics of a study for the report page, as JSON values."""
    return {
        "format": FORMAT_VERSION,
        "title": meta.title,
        "study": file_name,
        "ego": meta.ego,
        "other": meta.other if isinstance(meta.other, str) else list(meta.other),
        "searched": Objective.from_study_meta(meta).label,
        "parameters": [
            {
                "name": parameter.name,
                "unit": parameter.unit,
                "low": parameter.low,
                "high": parameter.high,
                "choices": list(parameter.choices),
            }
            | ({"value_sets": [list(members) for members in parameter.value_sets]} if parameter.value_sets else {})
            for parameter in meta.space.parameters
        ],
        "metrics": [
            {"name": metric.name, "unit": metric.unit, "lower_is_critical": metric.lower_is_critical, "cap": metric.cap}
            for metric in meta.create_metrics()
        ],
    }


def _sorted_rows(data: ReportData) -> list[ScenarioRecord]:
    return sorted([*data.rows, *data.failed], key=lambda row: row.id)


def _row_indices(rows: Sequence[ScenarioRecord]) -> dict[int, int]:
    return {row.id: k for k, row in enumerate(rows)}


def _clusters_payload(analysis: Analysis, row_indices: Mapping[int, int], n_rows: int) -> dict[str, Any]:
    labels: list[int | None] = [None] * n_rows
    embedding = analysis.clustering.embedding
    columns: list[list[float | None]] = [[None] * n_rows for _ in range(min(3, embedding.shape[1]))]
    for scenario, label, point in zip(analysis.ids.tolist(), analysis.labels.tolist(), embedding, strict=True):
        labels[row_indices[scenario]] = label
        for column, value in zip(columns, point.tolist(), strict=False):
            column[row_indices[scenario]] = round(value, 5)
    return {
        "labels": labels,
        "embedding": columns,
        "useful": has_useful_clusters(analysis),
        "names": {str(profile.cluster): format_cluster_title(profile, analysis.by) for profile in analysis.profiles},
        "examples": {
            str(profile.cluster): profile.example for profile in analysis.profiles if profile.example is not None
        },
        "judged": describe_informativeness(analysis),
        "compares": describe_aspect(analysis.by),
    }


def _courses_payload(data: ReportData, name: str, rows: Sequence[ScenarioRecord]) -> dict[str, Any]:
    lines = data.course_lines[name]
    spans = [data.time_spans.get(row.id, (0.0, 0.0)) for row in rows]
    return encode_courses([lines.get(row.id) for row in rows], spans)


def round_score(value: float) -> float | None:
    """Round a score to six significant digits; None if the score is not finite."""
    return float(f"{value:.6g}") if math.isfinite(value) else None


def parameter_columns(parameters: Sequence[Parameter], rows: Sequence[ScenarioRecord]) -> list[list[float]]:
    """Return the parameter values of scenarios as numbers, one list per parameter; a choice is given as its index."""
    return [[parameter.extract_number(row.values) for row in rows] for parameter in parameters]
