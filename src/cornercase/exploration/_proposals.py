"""Proposals of the next scenarios, and the rounds of a stored study."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import Any, Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.io.support_table import issue_notice_warning
from cornercase._common.plugin_errors import convert_plugin_errors, is_built_in
from cornercase._common.row_keys import row_keys
from cornercase._common.typing import FloatArray
from cornercase._common.validation import repr_short
from cornercase.exploration._study_critical_set import audit_sampler
from cornercase.optimizers import Optimizer
from cornercase.study import ScenarioRecord, StudyFile
from cornercase.study._meta import count_audits
from cornercase.study._objective import Objective

# Largest distance from the unit cube that rounding explains.
_ROUNDING: Final = 1e-9


class AskTell:
    """Interface to an optimizer that is the same for an asynchronous search and for a search that is not asynchronous.

    In an asynchronous search, `pending`, shape (p, d), are the points of the p scenarios that are running during
    `ask`, with d parameters each.
    """

    def __init__(self, optimizer: Optimizer, study: StudyFile, objective: Objective) -> None:
        self._optimizer, self._space, self._asynchronous = optimizer, study.space, study.meta.asynchronous
        self.pending: FloatArray | None = None
        self._name = f"The optimizer '{optimizer}'"
        # Running sums and counts, so that the mean costs the same however many results there are.
        shapes = [objective.least_critical_scores.shape if objective.pareto else ()]
        if "features" in optimizer.requires:
            shapes.append(study.features([None])[0].shape)
        self._result_sums = [(np.zeros(shape), np.zeros(shape)) for shape in shapes]

    def ask(self, n: int) -> FloatArray:
        """Return at most `n` points that the optimizer proposes, shape (m, d); `InputError` if points are invalid."""
        with convert_plugin_errors(self._name, self._optimizer, "in ask"):
            if self._asynchronous:
                pending = np.zeros((0, 0)) if self.pending is None else self.pending
                proposed = self._optimizer.ask_async(n, pending, *self._pseudo_results(len(pending)))
            else:
                proposed = self._optimizer.ask(n)
        return self._check_points(proposed, n)

    def _check_points(self, proposed: object, n: int) -> FloatArray:
        """Return proposals as an array; `InputError` unless they are at most `n` points of the unit cube."""
        dimension = self._space.dimension
        try:
            points = np.asarray(proposed, dtype=np.float64)
        except (TypeError, ValueError):
            points = np.zeros(())
        if points.ndim != 2 or points.shape[1] != dimension or len(points) > n:
            shape = f"an array of shape {points.shape}" if points.ndim else repr_short(proposed)
            raise InputError(
                f"{self._name} proposed {shape} in ask({n}); return an array of shape (m, {dimension}), a row per"
                f" scenario and a column per parameter, with m up to {n}."
            )
        outside = np.argwhere(~((points >= -_ROUNDING) & (points <= 1.0 + _ROUNDING)))
        if len(outside):
            row, column = outside[0].tolist()
            raise InputError(
                f"{self._name} proposed {points[row, column]:.6g} for {self._space.names[column]} in ask; return values"
                " from 0, for the lower bound of the parameter, to 1, for the upper bound."
            )
        return points

    def tell(self, points: FloatArray, *results: FloatArray) -> None:
        """Pass m points, shape (m, d), and their results to the optimizer.

        `results` are the scores, shape (m,), or (m, k) for k metrics, and optionally f features, shape (m, f).
        """
        tell: Any = self._optimizer.tell
        with convert_plugin_errors(self._name, self._optimizer, "in tell"):
            tell(points, *results)
        if self._asynchronous:
            for k, (result, (total, count)) in enumerate(zip(results, self._result_sums, strict=True)):
                finite = np.isfinite(result)
                new_total = total + np.where(finite, result, 0.0).sum(axis=0)
                self._result_sums[k] = (new_total, count + finite.sum(axis=0))

    def _pseudo_results(self, count: int) -> list[FloatArray]:
        """Return results to assume for `count` running points (constant liar): the mean of all results, or NaN."""
        with np.errstate(invalid="ignore"):
            return [np.repeat((total / number)[None], count, axis=0) for total, number in self._result_sums]


class ProposalSource:
    """Source of the scenarios to run: proposals of the search, and audits (scenarios drawn at random as a check)."""

    def __init__(self, ask_tell: AskTell, study: StudyFile) -> None:
        self._ask_tell, self._study = ask_tell, study
        self._audit_sampler = audit_sampler(study.space, study.meta.seed)

    def propose(self, n_done: int, n_wanted: int) -> FloatArray:
        """Choose `n_wanted` scenarios to run after the first `n_done` scenarios; return their points, shape (m, d).

        There are fewer points if the search is exhausted. A parameter with steps gets the value of the nearest step.
        """
        meta, space = self._study.meta, self._study.space
        audits = [meta.is_audit(n_done + k + 1) for k in range(n_wanted)]
        proposals = iter(self._ask_tell.ask(n_wanted - sum(audits)) if not all(audits) else ())
        first, last = (count_audits(meta.audit, count) for count in (n_done, n_done + n_wanted))
        audit_points = iter(self._audit_sampler.ask(last)[first:])
        points = []
        for audit in audits:
            point = next(audit_points if audit else proposals, None)
            if point is None:
                break
            points.append(point)
        return space.snap(np.array(points).reshape(-1, space.dimension))


def warn_of_repeated_proposals(study: StudyFile, optimizer: Optimizer, n_before: int) -> None:
    """Warn if an optimizer of the user's own class proposed scenarios that had been run already.

    Only repetitions after the first `n_before` scenarios of the study count.
    """
    if is_built_in(optimizer):
        return
    rows = [row for row in study.rows() if not study.meta.is_audit(row.id)]
    keys = row_keys(np.array([row.point for row in rows])) if rows else []
    seen, n_repeated = set[bytes](), 0
    for row, key in zip(rows, keys, strict=True):
        n_repeated += key in seen and row.id > n_before
        seen.add(key)
    if n_repeated:
        n_old = sum(row.id <= n_before for row in rows)
        n_compared = min(n_old, len(rows) - n_old)
        first_keys = list(keys[:n_compared])
        proposes_first_again = n_compared > 0 and list(keys[n_old : n_old + n_compared]) == first_keys
        why = "they were run again and say nothing new, so leave them out in ask"
        if proposes_first_again and not optimizer.is_stateful_ask and len(set(first_keys)) == n_compared:
            why = (
                "when a search is continued, its optimizer gets the stored scores by tell, but this optimizer began"
                " again from the start, since its ask depends on earlier calls of ask; set is_stateful_ask = True in"
                " its class, or draw random numbers from the seed and the number of scenarios passed to tell"
            )
        issue_notice_warning(
            f"the optimizer '{optimizer}' proposed {n_repeated} scenarios that were run already; {why}"
        )


@dataclass(frozen=True)
class Round:
    """A round of a study, and what was known when it was proposed.

    `finished` are the scenarios whose results came since the previous round, in order of arrival. `pending` are the
    scenarios that were running. `proposed` are the scenarios of the round; empty if no round was proposed after these
    results.
    """

    finished: tuple[ScenarioRecord, ...]
    pending: tuple[ScenarioRecord, ...]
    proposed: tuple[ScenarioRecord, ...]


def iter_rounds(study: StudyFile) -> Iterator[Round]:
    """Iterate over the rounds of a study, in the order in which they were proposed."""
    rows = study.rows()
    rounds = {number: tuple(members) for number, members in groupby(rows, key=lambda row: row.round)}
    if not study.meta.asynchronous:
        ended: tuple[ScenarioRecord, ...] = ()
        for members in rounds.values():
            yield Round(ended, (), members)
            ended = members
        return
    by_id = {row.id: row for row in rows}
    results_by_round: dict[int, list[ScenarioRecord]] = {}
    for scenario, turn in study.result_order():
        results_by_round.setdefault(turn, []).append(by_id[scenario])
    pending: dict[int, ScenarioRecord] = {}
    for number in sorted({*rounds, *results_by_round}):
        new_results = tuple(results_by_round.get(number, ()))
        for row in new_results:
            del pending[row.id]
        proposed = rounds.get(number, ())
        yield Round(new_results, tuple(pending.values()), proposed)
        pending |= {row.id: row for row in proposed}
