"""What another study of the same parameters knows, for a search to begin from."""

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
    """Scores of another study, in the space of a new one.

    Attributes
    ----------
    points : ndarray of float64, shape (n, d)
        In the unit cube of the new study's space.
    scores : ndarray of float64, shape (n,)
        Oriented, of what the new study searches.
    about : dict of str to object
        What `StudyMeta.elsewhere` says of it.
    """

    points: FloatArray
    scores: FloatArray
    about: dict[str, Any]


def read_beginning(
    path: Path, space: ParameterSpace, objective: Objective, ego: str, others: Sequence[str]
) -> Beginning:
    """Read what another study knows of the scores that are to be searched.

    Scenarios that failed, and those with a value that the new space does not have, are left out. Metrics that the other
    study has not, or has of other entities, are measured from its recordings.

    Parameters
    ----------
    path : Path
        The other study.
    space : ParameterSpace
        Of the new one.
    objective : Objective
        What is searched.
    ego : str
    others : sequence of str

    Returns
    -------
    Beginning

    Raises
    ------
    InputError
        There is no such study, its parameters are others, its recordings cannot be measured, or fewer than 10 different
        scores are left.
    """
    # An explorer may be writing to it.
    with Study.open(path, readonly=True) as study, study.snapshot():
        _require_same_parameters(path, study.space, space)
        ended = study.rows()
        every = [row for row in ended if row.state == "done"]
        rows = [row for row in every if _holds(space, row.values)]
        scores = _oriented(study, objective, rows, ego, tuple(others))
        known = np.isfinite(scores)
        points, scores = space.points([row.values for row in rows])[known], scores[known]
        if len(scores) < _FEWEST or np.ptp(scores) == 0.0:
            raise InputError(
                f"`from_study` {path}: {len(scores)} of its {len(every)} scenarios lie in this space and have a score;"
                f" {_FEWEST} with different scores are needed."
            )
        about = {
            "study": path.name,
            "fingerprint": study.meta.fingerprint,
            "simulator": study.meta.simulator,
            "settings": dict(study.meta.settings),
            "scenarios": len(scores),
            "sha256": digest_of_scores(points, scores),
        }
        return Beginning(points, scores, about)


def _require_same_parameters(path: Path, there: ParameterSpace, here: ParameterSpace) -> None:
    for names, lacking, where in ((here, there, "its space has no"), (there, here, "this space has no")):
        if missing := [one for one in names.names if one not in lacking.names]:
            raise InputError(
                f"`from_study` {path}: {where} parameter '{missing[0]}'; begin from a study of the same parameters."
            )


def _holds(space: ParameterSpace, values: Mapping[str, Value]) -> bool:
    """Tell whether a space has these values."""
    for one in space.parameters:
        try:
            value = one.read(values)
        except InputError:
            return False
        if one.choices:
            if str(value) not in one.choices:
                return False
        elif not one.low <= float(value) <= one.high:
            return False
    return True


def _oriented(study: Study, objective: Objective, rows: Sequence[Row], ego: str, others: tuple[str, ...]) -> FloatArray:
    """Oriented scores of scenarios of a study, shape (n,); measured where the study does not have them."""
    meta = study.meta
    names = [one.name for one in objective.metrics]
    # What no weight is of need not be known.
    wanted = [name in objective.weights if objective.weights else k == 0 for k, name in enumerate(names)]
    scores = np.full((len(rows), len(names)), np.nan)
    known = {row.id: k for k, row in enumerate(row for row in study.rows() if row.state == "done")}
    places = [known[row.id] for row in rows]
    same = (meta.ego, set(meta.others)) == (ego, set(others))
    missing = []
    for k, metric in enumerate(objective.metrics):
        if not wanted[k]:
            continue
        if same and metric.name in meta.metrics:
            scores[:, k] = study.scores(metric.name)[places]
        else:
            if condition := condition_of([metric.name]):
                raise InputError(
                    f"`from_study` {study.path}: was not searched for the condition '{condition}'; begin from one with"
                    " the same `critical_if`."
                )
            metric.require()
            missing.append((k, metric))
    if missing:
        for i, row in enumerate(rows):
            found = measured([metric for _, metric in missing], study.recording(row.id), ego, others)
            for k, metric in missing:
                scores[i, k] = found[metric.name].score
    return objective.oriented(scores)
