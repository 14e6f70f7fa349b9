"""Warm start: read the scores of another study with the same parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.exploration.objective import Objective
from cornercase.metrics import condition_of, measured
from cornercase.scenario import ParameterSpace, Value
from cornercase.study import Row, Study, digest_of_scores

_FEWEST: Final = 10


@dataclass(frozen=True, eq=False)
class Beginning:
    """Scores of another study in the space of a new one.

    `points`, shape (n, d), are in the unit cube of the new space, `scores`, shape (n,), are minimized; `about` is the
    content of `StudyMeta.elsewhere`.
    """

    points: FloatArray
    scores: FloatArray
    about: dict[str, Any]


def read_beginning(
    path: Path, space: ParameterSpace, objective: Objective, ego: str, others: Sequence[str]
) -> Beginning:
    """Read points and minimized scores of another study, to warm-start a search.

    Failed scenarios and those with values outside the new space are skipped. Metrics that the other study lacks, or
    measured for other entities, are measured from its recordings. Raises `InputError` if the parameters differ, the
    recordings cannot be measured, or fewer than 10 different scores remain.
    """
    # A snapshot, since another process may be writing to it.
    with Study.open(path, readonly=True) as study, study.snapshot():
        _require_same_parameters(path, study.space, space)
        all_rows = study.rows()
        finished = [row for row in all_rows if row.state == "done"]
        rows = [row for row in finished if _holds(space, row.values)]
        scores = _oriented(study, objective, rows, ego, tuple(others))
        is_finite = np.isfinite(scores)
        points, scores = space.points([row.values for row in rows])[is_finite], scores[is_finite]
        if len(scores) < _FEWEST or np.ptp(scores) == 0.0:
            raise InputError(
                f"`from_study` {path}: {len(scores)} of its {len(finished)} scenarios are in this space with a score;"
                f" at least {_FEWEST} with different scores are needed."
            )
        info = {
            "study": path.name,
            "fingerprint": study.meta.fingerprint,
            "simulator": study.meta.simulator,
            "settings": dict(study.meta.settings),
            "scenarios": len(scores),
            "sha256": digest_of_scores(points, scores),
        }
        return Beginning(points, scores, info)


def _require_same_parameters(path: Path, there: ParameterSpace, here: ParameterSpace) -> None:
    for names, lacking, where in ((here, there, "its space has no"), (there, here, "this space has no")):
        if missing := [name for name in names.names if name not in lacking.names]:
            raise InputError(
                f"`from_study` {path}: {where} parameter '{missing[0]}'; use a study with the same parameters."
            )


def _holds(space: ParameterSpace, values: Mapping[str, Value]) -> bool:
    """Return whether a space contains these values."""
    for parameter in space.parameters:
        try:
            value = parameter.read(values)
        except InputError:
            return False
        if parameter.choices:
            if str(value) not in parameter.choices:
                return False
        elif not parameter.low <= float(value) <= parameter.high:
            return False
    return True


def _oriented(study: Study, objective: Objective, rows: Sequence[Row], ego: str, others: tuple[str, ...]) -> FloatArray:
    """Minimized scores of scenarios of a study, shape (n,); measured if they are not stored."""
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
            if condition := condition_of([metric.name]):
                raise InputError(
                    f"`from_study` {study.path}: was not searched for the condition '{condition}'; use a study with"
                    " the same `critical_if`."
                )
            metric.require()
            missing.append((k, metric))
    if missing:
        for i, row in enumerate(rows):
            results = measured([metric for _, metric in missing], study.recording(row.id), ego, others)
            for k, metric in missing:
                scores[i, k] = results[metric.name].score
    return objective.oriented(scores)
