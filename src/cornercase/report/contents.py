"""Content of the page as plain values for its JavaScript."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

from cornercase.clustering import Analysis
from cornercase.exploration import Objective
from cornercase.metrics import METRICS
from cornercase.report.answers import find_default_aspect, page_answers, tell_about
from cornercase.report.captions import page_captions
from cornercase.report.course_lines import pack_courses
from cornercase.report.curves import coverage_curves, hull_edges, search_curve, sensitivity_bars
from cornercase.report.data import ReportData
from cornercase.report.words import judge_clusters, name_kind, tell_compared
from cornercase.scenario import Parameter
from cornercase.study import Row, StudyMeta

FORMAT: Final = 1
"""Version of what `page_payload` returns."""


def page_contents(data: ReportData) -> dict[str, Any]:
    """Return all contents of the page except recordings, as JSON values; None for what is unknown."""
    return knowledge_part(data) | scenario_part(data)


def scenario_part(data: ReportData) -> dict[str, Any]:
    """Return the part of `page_payload` that lists single scenarios and grows with each run."""
    meta, rows = data.summary.meta, _rows(data)
    indices = _places(rows)
    done = [indices[row.id] for row in data.rows]

    def of_done(values: Sequence[Any], otherwise: Any = None) -> list[Any]:
        column = [otherwise] * len(rows)
        for k, value in zip(done, values, strict=True):
            column[k] = value
        return column

    selected = set() if data.summary.reduced is None else set(data.summary.reduced.ids)
    outcomes = data.outcomes
    outcome_names = sorted(set(outcomes.values()))
    against = [[data.against[metric.name].get(row.id) for metric in data.metrics] for row in data.rows if data.against]
    return {
        "outcomes": outcome_names,
        "scenarios": {
            "id": [row.id for row in rows],
            "round": [row.round for row in rows],
            "failed": [int(row.state == "failed") for row in rows],
            "values": plain_values(data.parameters, rows),
            "scores": {name: of_done([plain_score(score) for score in scores]) for name, scores in data.scores.items()},
            "critical": of_done(data.critical.astype(int).tolist(), 0),
            "collides": of_done([int(not data.touched[row.id].isdisjoint(meta.others)) for row in data.rows], 0),
            "outcome": [outcome_names.index(outcomes[row.id]) if row.id in outcomes else None for row in rows],
            "kept": [int(row.id in selected) for row in rows],
            "audit": [int(meta.is_audit(row.id)) for row in rows],
        }
        | tell_against(meta, of_done(against) if against else []),
        "errors": {str(row.id): row.error or "" for row in data.failed},
        "courses": {name: _courses(data, name, rows) for name in data.scores},
    }


def tell_against(meta: StudyMeta, whom: Sequence[Sequence[str | None] | None]) -> dict[str, Any]:
    """Return the column ``against``: the index in ``other`` whose score counts, per scenario and metric.

    Empty if there is only one other; `others` has None for failed scenarios.
    """
    if len(meta.others) == 1:
        return {}
    indices = {name: k for k, name in enumerate(meta.others)}
    return {"against": [None if row is None else [indices.get(name or "") for name in row] for row in whom]}


def knowledge_part(data: ReportData) -> dict[str, Any]:
    """Return the part of `page_payload` that depends on all scenarios together."""
    meta, rows = data.summary.meta, _rows(data)
    indices = _places(rows)
    selected = () if data.summary.reduced is None else data.summary.reduced.kept
    return tell_subject(meta, data.study) | {
        "about": tell_about(data),
        "critical": _critical(data),
        "default_aspect": find_default_aspect(data),
        "influential": list(data.influential),
        "answers": [answer.to_json() for answer in page_answers(data)],
        "captions": page_captions(data),
        "notes": {str(scenario): text for scenario, text in data.notes.items()},
        "kept": {
            str(scenario.id): {
                "role": scenario.role,
                "cluster": scenario.cluster,
                "file": scenario.file,
                "why": scenario.why,
            }
            for scenario in selected
        },
        "search": search_curve(data),
        "sensitivity": sensitivity_bars(data),
        "coverage": coverage_curves(data),
        "front": None if data.summary.knowledge.front is None else list(data.summary.knowledge.front),
        "hulls": hull_edges(data),
        "reduced_by": None if data.summary.reduced is None else data.summary.reduced.by,
        "kinds": {name: _kinds(analysis, indices, len(rows)) for name, analysis in data.summary.analyses.items()},
    }


def tell_subject(meta: StudyMeta, study: str) -> dict[str, Any]:
    """Return the part of `page_payload` that is known before a scenario was run; `file_name` is the study's."""
    return {
        "format": FORMAT,
        "title": meta.title,
        "study": study,
        "ego": meta.ego,
        "other": meta.other if isinstance(meta.other, str) else list(meta.other),
        "searched": Objective.of_study(meta).text,
        "parameters": [
            {
                "name": parameter.name,
                "unit": parameter.unit,
                "low": parameter.low,
                "high": parameter.high,
                "choices": list(parameter.choices),
            }
            for parameter in meta.space.parameters
        ],
        "metrics": [
            {"name": metric.name, "unit": metric.unit, "lower_is_critical": metric.lower_is_critical, "cap": metric.cap}
            for metric in map(METRICS.create, meta.metrics)
        ],
    }


def _rows(data: ReportData) -> list[Row]:
    return sorted([*data.rows, *data.failed], key=lambda row: row.id)


def _places(rows: Sequence[Row]) -> dict[int, int]:
    return {row.id: k for k, row in enumerate(rows)}


def _critical(data: ReportData) -> dict[str, Any] | None:
    critical = data.summary.knowledge.critical
    if critical is None:
        return None
    return {"threshold": critical.threshold, "lower_is_critical": critical.lower_is_critical, "unit": critical.unit}


def _kinds(analysis: Analysis, place: Mapping[int, int], count: int) -> dict[str, Any]:
    labels: list[int | None] = [None] * count
    embedding = analysis.clustering.embedding
    columns: list[list[float | None]] = [[None] * count for _ in range(min(3, embedding.shape[1]))]
    for scenario, label, point in zip(analysis.ids.tolist(), analysis.labels.tolist(), embedding, strict=True):
        labels[place[scenario]] = label
        for column, value in zip(columns, point.tolist(), strict=False):
            column[place[scenario]] = round(value, 5)
    return {
        "labels": labels,
        "embedding": columns,
        "names": {str(profile.cluster): name_kind(profile) for profile in analysis.profiles},
        "examples": {
            str(profile.cluster): profile.example for profile in analysis.profiles if profile.example is not None
        },
        "judged": judge_clusters(analysis),
        "compares": tell_compared(analysis.by),
    }


def _courses(data: ReportData, name: str, rows: Sequence[Row]) -> dict[str, Any]:
    lines = data.lines[name]
    spans = []
    for row in rows:
        time = data.times.get(row.id)
        spans.append((0.0, 0.0) if time is None else (float(time[0]), float(time[-1])))
    return pack_courses([lines.get(row.id) for row in rows], spans)


def plain_score(value: float) -> float | None:
    """Round a score to six digits; None if it is not finite."""
    return float(f"{value:.6g}") if math.isfinite(value) else None


def plain_values(parameters: Sequence[Parameter], rows: Sequence[Row]) -> list[list[float]]:
    """Return the parameter values of scenarios as numbers, shape (d, n); for a choice its index."""
    return [[parameter.read_number(row.values) for row in rows] for parameter in parameters]
