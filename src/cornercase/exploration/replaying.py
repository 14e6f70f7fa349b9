"""Proposals made again from the results that a study holds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cornercase._common.errors import InputError
from cornercase.exploration.explorer import ExplorationResult
from cornercase.exploration.objective import Objective
from cornercase.exploration.proposing import Proposer, Search, turns_of
from cornercase.metrics import features_of
from cornercase.optimizers import Optimizer
from cornercase.study import Row, Study, StudyMeta


def replay_proposals(path: Path, meta: StudyMeta, objective: Objective, optimizer: Optimizer) -> ExplorationResult:
    """Ask a search again for all scenarios of a study, with the stored results; nothing is simulated.

    Parameters
    ----------
    path : Path
        The study, which is only read.
    meta : StudyMeta
        What it has to be about; the settings of the simulator are not looked at.
    objective : Objective
    optimizer : Optimizer
        A fresh one.

    Returns
    -------
    ExplorationResult
        Its `same` tells whether all proposals were the same, and its `reason` which was the first that was not.

    Raises
    ------
    InputError
        There is no such study, it is of another exploration, or it is read while an explorer writes to it.
    """
    with Study.open(path, readonly=True) as study, study.snapshot():
        study.meta.require_same(meta, path, same_budget="budget" in optimizer.needs)
        other = _first_other(study, objective, optimizer)
        count = len(study.rows())
        said = f"the same {count} scenarios were proposed again" if other is None else (
            f"the scenario {other} of {count} is proposed otherwise from the same results"
        )  # fmt: skip
        return ExplorationResult(path, len(study.done()), len(study.failed()), said, same=other is None)


def _first_other(study: Study, objective: Objective, optimizer: Optimizer) -> int | None:
    """Id of the first scenario that is proposed otherwise; None where all are the same."""
    results = _Results(study, objective, "features" in optimizer.needs)
    if (known := study.elsewhere()) is not None:
        optimizer.begin_from(*known)
    search = Search(optimizer, study.meta.asynchronous)
    rows = study.rows()
    ran = study.space.values(np.array([row.point for row in rows]).reshape(-1, study.space.dimension))
    if other := next((row.id for row, values in zip(rows, ran, strict=True) if dict(row.values) != values), None):
        return other
    proposer, done = Proposer(search, study), 0
    for turn in turns_of(study):
        if searched := [row for row in turn.ended if not study.meta.is_audit(row.id)]:
            search.tell(*results.of(searched))
        pending = [row.point for row in turn.pending if not study.meta.is_audit(row.id)]
        search.pending = np.array(pending).reshape(-1, study.space.dimension)
        if not turn.proposed:
            break
        points = proposer.propose(done, len(turn.proposed))
        for k, row in enumerate(turn.proposed):
            if k >= len(points) or not np.array_equal(points[k], row.point):
                return row.id
        done += len(turn.proposed)
    return None


class _Results:
    """What a search is told of the scenarios of a study."""

    def __init__(self, study: Study, objective: Objective, with_features: bool) -> None:
        self._study, self._with_features = study, with_features
        ids = [row.id for row in study.done()]
        self._scores = dict(zip(ids, objective.oriented_of(study), strict=True))
        uncritical = np.full_like(objective.uncritical, np.nan)
        self._failed: Any = uncritical if objective.pareto else np.nan

    def of(self, rows: Sequence[Row]) -> list[Any]:
        """Points, scores and features of scenarios."""
        if pending := next((row.id for row in rows if row.state == "pending"), None):
            raise InputError(
                f"{self._study.path}: the scenario {pending} has not ended; let its exploration end first."
            )
        points = np.array([row.point for row in rows])
        scores = np.array([self._scores.get(row.id, self._failed) for row in rows])
        if not self._with_features:
            return [points, scores]
        recordings = [self._study.recording(row.id) if row.id in self._scores else None for row in rows]
        return [points, scores, features_of(recordings, self._study.meta.ego, self._study.meta.others)]
