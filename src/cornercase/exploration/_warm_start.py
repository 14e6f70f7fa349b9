"""Warm start: read the scores of another study with the same parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.metrics._critical_if import find_critical_if_condition
from cornercase.metrics._measure import evaluate_metrics
from cornercase.scenario import ParameterSpace, Value
from cornercase.study import ScenarioRecord, StudyFile
from cornercase.study._meta import hash_points_and_scores
from cornercase.study._objective import Objective

_MIN_SCORES: Final = 10


@dataclass(frozen=True, eq=False)
class WarmStart:
    """Scores of another study, in the space of a new study.

    `points`, shape (n, d), are in the unit cube of the new space. `scores`, shape (n,), are lower for more critical
    scenarios. `study_info` describes the other study, for the metadata of the new study.
    """

    points: FloatArray
    scores: FloatArray
    study_info: dict[str, Any]


def read_warm_start(
    path: Path, space: ParameterSpace, objective: Objective, ego: str, others: Sequence[str]
) -> WarmStart:
    """Read points and scores of another study, to warm-start a search; lower scores are more critical.

    Failed scenarios, and scenarios with values outside the new space, are skipped. Metrics that the other study lacks
    or has measured for other entities are measured from its recordings. Raises `InputError` if the parameters differ,
    the recordings cannot be measured, fewer than 10 scores remain, or all scores are equal.
    """
    # A snapshot, since another process may be writing to it.
    with StudyFile.open(path, readonly=True) as study, study.snapshot():
        _require_same_parameters(path, study.space, space)
        all_rows = study.rows()
        finished = [row for row in all_rows if row.state == "done"]
        rows = [row for row in finished if _contains_values(space, row.values)]
        scores = _minimized_scores(study, objective, rows, ego, tuple(others))
        is_finite = np.isfinite(scores)
        points, scores = space.points([row.values for row in rows])[is_finite], scores[is_finite]
        if len(scores) < _MIN_SCORES or np.ptp(scores) == 0.0:
            raise InputError(
                f"`warm_start` {path}: {len(scores)} of its {len(finished)} scenarios have a score and lie in the space"
                f" of this search; at least {_MIN_SCORES} are needed, and their scores must not all be equal."
            )
        info = {
            "study": path.name,
            "fingerprint": study.meta.fingerprint,
            "simulator": study.meta.simulator,
            "settings": dict(study.meta.settings),
            "scenarios": len(scores),
            "sha256": hash_points_and_scores(points, scores),
        }
        return WarmStart(points, scores, info)


def _require_same_parameters(path: Path, source_space: ParameterSpace, own_space: ParameterSpace) -> None:
    for names, lacking, where in (
        (own_space, source_space, "its space has no"),
        (source_space, own_space, "this space has no"),
    ):
        if missing := [name for name in names.names if name not in lacking.names]:
            raise InputError(
                f"`warm_start` {path}: {where} parameter '{missing[0]}'; use a study with the same parameters."
            )


def _contains_values(space: ParameterSpace, values: Mapping[str, Value]) -> bool:
    """Return whether a space contains these values of its parameters."""
    for parameter in space.parameters:
        try:
            value = parameter.extract_value(values)
        except InputError:
            return False
        if parameter.choices:
            if str(value) not in parameter.choices:
                return False
        elif not parameter.low <= float(value) <= parameter.high:
            return False
    return True


def _minimized_scores(
    study: StudyFile, objective: Objective, rows: Sequence[ScenarioRecord], ego: str, others: tuple[str, ...]
) -> FloatArray:
    """Return the scores of n scenarios of a study, shape (n,); lower scores are more critical.

    Scores that are not stored are measured from the recordings.
    """
    meta = study.meta
    names = [metric.name for metric in objective.metrics]
    # Metrics without weight are not needed.
    is_needed = [name in objective.weights if objective.weights else k == 0 for k, name in enumerate(names)]
    scores = np.full((len(rows), len(names)), np.nan)
    index_by_id = {row.id: k for k, row in enumerate(row for row in study.rows() if row.state == "done")}
    indices = [index_by_id[row.id] for row in rows]
    same_entities = (meta.ego, set(meta.others)) == (ego, set(others))
    missing = []
    for k, metric in enumerate(objective.metrics):
        if not is_needed[k]:
            continue
        if same_entities and metric.name in meta.metrics:
            scores[:, k] = study.scores(metric.name)[indices]
        else:
            if condition := find_critical_if_condition([metric.name]):
                raise InputError(
                    f"`warm_start` {study.path}: was not searched for the condition '{condition}'; use a study with"
                    " the same `critical_if`."
                )
            metric.check_installed()
            missing.append((k, metric))
    if missing:
        for i, row in enumerate(rows):
            results = evaluate_metrics([metric for _, metric in missing], study.recording(row.id), ego, others)
            for k, metric in missing:
                scores[i, k] = results[metric.name].score
    return objective.compute_scores_to_minimize(scores)
