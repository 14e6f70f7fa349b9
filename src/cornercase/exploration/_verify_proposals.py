"""Check that an optimizer proposes the scenarios of a study again, from the stored results."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cornercase._common.errors import InputError
from cornercase.exploration._explorer import ExplorationResult
from cornercase.exploration._proposals import AskTell, ProposalSource, iter_rounds
from cornercase.optimizers import Optimizer
from cornercase.study import ScenarioRecord, StudyFile, StudyMeta
from cornercase.study._objective import Objective


def verify_proposals(path: Path, meta: StudyMeta, objective: Objective, optimizer: Optimizer) -> ExplorationResult:
    """Ask a fresh optimizer for all scenarios of a study again, with the stored results; nothing is simulated.

    The study has to match `meta`, except for the settings of the simulator. `reproducible` of the result is True if all
    proposals agree; otherwise `reason` names the first one that differs. Raises `InputError` if the study belongs to
    another exploration or is being written.
    """
    with StudyFile.open(path, readonly=True) as study, study.snapshot():
        study.meta.require_resumable(meta, path, same_budget="budget" in optimizer.requires)
        first_difference = _find_first_difference(study, objective, optimizer)
        count = len(study.rows())
        reason = f"the same {count} scenarios were proposed again" if first_difference is None else (
            f"scenario {first_difference} of {count} is proposed differently from the same results"
        )  # fmt: skip
        return ExplorationResult(
            path, len(study.finished_rows()), len(study.failed_rows()), reason, reproducible=first_difference is None
        )


def _find_first_difference(study: StudyFile, objective: Objective, optimizer: Optimizer) -> int | None:
    """Return the id of the first scenario that is proposed differently; None if all proposals agree."""
    results = _StoredResults(study, objective, "features" in optimizer.requires)
    if (warm_start := study.warm_start_data()) is not None:
        optimizer.warm_start(*warm_start)
    search = AskTell(optimizer, study, objective)
    rows = study.rows()
    stored_values = study.space.values(np.array([row.point for row in rows]).reshape(-1, study.space.dimension))
    if mismatch := next(
        (row.id for row, values in zip(rows, stored_values, strict=True) if dict(row.values) != values), None
    ):
        return mismatch
    proposer, done = ProposalSource(search, study), 0
    for turn in iter_rounds(study):
        if searched := [row for row in turn.finished if not study.meta.is_audit(row.id)]:
            search.tell(*results.for_rows(searched))
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


class _StoredResults:
    """Stored results of a study, in the form in which a search observes them."""

    def __init__(self, study: StudyFile, objective: Objective, with_features: bool) -> None:
        self._study, self._with_features = study, with_features
        ids = [row.id for row in study.finished_rows()]
        self._scores = dict(zip(ids, objective.minimized_scores(study), strict=True))
        missing = np.full_like(objective.least_critical_scores, np.nan)
        self._failed_score: Any = missing if objective.pareto else np.nan

    def for_rows(self, rows: Sequence[ScenarioRecord]) -> list[Any]:
        """Return points and scores of scenarios, and their features if the search uses features."""
        if pending := next((row.id for row in rows if row.state == "pending"), None):
            raise InputError(f"{self._study.path}: scenario {pending} has not ended; finish the exploration first.")
        points = np.array([row.point for row in rows])
        scores = np.array([self._scores.get(row.id, self._failed_score) for row in rows])
        if not self._with_features:
            return [points, scores]
        return [points, scores, self._study.features([row.id if row.id in self._scores else None for row in rows])]
