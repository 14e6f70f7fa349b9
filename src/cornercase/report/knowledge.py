"""Estimates about the whole space: Pareto front, critical set, sensitivities."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from cornercase._common.errors import left_out_if_too_little
from cornercase._common.typing import FloatArray
from cornercase.evidence import REGION, Estimate, Sensitivity, bounds_of_share, estimate_sensitivity
from cornercase.exploration import Objective, critical_set_of, learns_from_features, on_front
from cornercase.study import Study

# The missed share is estimated for this range of scenario counts, at this many sizes.
_FEWEST, _MOST_JUDGED, _MOST_SIZES = 10, 1000, 8


@dataclass(frozen=True)
class CriticalKnowledge:
    """Estimates about the critical scenarios of a study."""

    threshold: float  # in the unit of the objective
    lower_is_critical: bool
    unit: str  # empty for none
    scenarios: int  # number of critical scenarios that were run
    known: CriticalSetKnowledge | None  # None if too few scenarios were run
    audit: AuditKnowledge | None = None  # None without audits


@dataclass(frozen=True)
class CriticalSetKnowledge:
    """Estimates about all critical scenarios of the space, including those that were not run."""

    share: Estimate  # critical share of the space
    missed: Estimate  # share of the critical set that was not found
    overlooked: float  # probability that a critical region of size `region_fraction` contains no run
    unvisited: float  # share of the space whose surrounding region of size `region_fraction` contains no run
    region: float  # share of the space
    hidden: float  # share of the critical set that a region without runs could hold
    share_doubt: str | None = None  # why `critical_fraction` has no interval; None if it has
    missed_doubt: str | None = None  # why `missed_fraction` has no interval; None if it has
    by_committee: bool = False  # predicted by a committee, not by a Gaussian process of the scores


@dataclass(frozen=True)
class AuditKnowledge:
    """Estimates from the audits: random scenarios whose results the search did not see."""

    scenarios: int  # number of audits that were run
    critical: int  # number of critical audits
    share: Estimate  # critical share of the space
    missed: Estimate | None  # share of the critical set that was not found; None if unknown


@dataclass(frozen=True)
class Knowledge:
    """What the scenarios that were run say about the whole space."""

    front: Mapping[int, Mapping[str, float]] | None = None  # scores on the Pareto front by id and metric
    critical: CriticalKnowledge | None = None  # None if a front was searched or there is no threshold
    sensitivity: Sensitivity | None = None  # None if a front was searched or too few scenarios were run


@dataclass(frozen=True)
class MissedAfter:
    """Share of the critical set that was not found after `n_run` scenarios."""

    run: int
    share: Estimate
    doubt: str | None  # why there is no interval; None if there is


def find_missed(study: Study, knowledge: Knowledge) -> Iterator[MissedAfter]:
    """Estimate the missed share of the critical set after some rounds: up to eight, about doubling, and the last.

    With more than 1,000 scenarios, or a committee (slow to fit), only the last one is estimated.
    """
    critical, rows = knowledge.critical, study.done()
    if critical is None or critical.known is None:
        return
    rounds = np.array([row.round for row in rows])
    ends = (np.flatnonzero(np.diff(rounds)) + 1).tolist()
    objective = Objective.of_study(study.meta)
    scores, threshold = objective.oriented_of(study), objective.flip(critical.threshold)
    sizes: list[int] = []
    if not learns_from_features(study.meta.optimizer):
        targets = [len(rows) / 2.0**k for k in range(_MOST_SIZES - 1, 0, -1)]
        nearest = {min(ends, key=lambda end: abs(end - size)) for size in targets if ends}
        sizes = sorted(size for size in nearest if _FEWEST <= size <= _MOST_JUDGED)
    for size in sizes:
        with left_out_if_too_little():
            critical_set = critical_set_of(study, scores, threshold, last=rows[size - 1].id)
            yield MissedAfter(size, critical_set.missed, critical_set.missed_doubt)
    yield MissedAfter(len(rows), critical.known.missed, critical.known.missed_doubt)


def find_knowledge(study: Study) -> Knowledge:
    """Estimate front, critical set and sensitivities of a study, as far as there are enough scores."""
    rows, meta = study.done(), study.meta
    if not rows:
        return Knowledge()
    objective = Objective.of_study(meta)
    oriented = objective.oriented_of(study)
    if objective.pareto:
        scores = {metric.name: study.scores(metric.name) for metric in objective.metrics}
        front = np.flatnonzero(on_front(oriented)).tolist()
        return Knowledge({rows[k].id: {name: float(column[k]) for name, column in scores.items()} for k in front})
    sensitivity = None
    with left_out_if_too_little():
        searched = ~study.audits()
        sensitivity = estimate_sensitivity(study.space, study.points()[searched], oriented[searched], meta.seed)
    return Knowledge(None, _of_critical(study, objective, oriented), sensitivity)


def _of_critical(study: Study, objective: Objective, oriented: FloatArray) -> CriticalKnowledge | None:
    if study.critical is None:
        return None
    threshold = objective.flip(study.critical)
    audits = study.audits()
    estimates, missed = None, None
    with left_out_if_too_little():
        critical_set = critical_set_of(study, oriented, threshold)
        estimates = CriticalSetKnowledge(
            critical_set.share,
            critical_set.missed,
            critical_set.overlooked(),
            critical_set.unvisited(),
            REGION,
            critical_set.hidden,
            critical_set.doubt,
            critical_set.missed_doubt,
            critical_set.by_committee,
        )
        missed = critical_set.audited_missed
    n_critical_audits = int((oriented[audits] <= threshold).sum())
    n_audits = int(audits.sum())
    audit = (
        AuditKnowledge(n_audits, n_critical_audits, bounds_of_share(n_critical_audits, n_audits), missed)
        if n_audits
        else None
    )
    return CriticalKnowledge(
        threshold=float(study.critical),
        lower_is_critical=objective.lower_is_critical,
        unit=objective.unit,
        scenarios=int((oriented <= threshold).sum()),
        known=estimates,
        audit=audit,
    )
