"""Estimates about the whole space: Pareto front, critical set, sensitivities."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from cornercase._common.errors import skip_if_not_enough_data
from cornercase._common.typing import FloatArray
from cornercase.evidence import Estimate, Sensitivity
from cornercase.evidence._critical_set_estimate import MIN_REGION_FRACTION
from cornercase.evidence._proportions import proportion_interval
from cornercase.evidence._sensitivity import estimate_sensitivity
from cornercase.exploration._incumbent import is_on_pareto_front
from cornercase.exploration._study_critical_set import estimate_critical_set, uses_features
from cornercase.study import StudyFile
from cornercase.study._criterion import Criterion

# The missed share is estimated for this range of scenario counts, at this many sizes.
_MIN_SCENARIOS, _MAX_SCENARIOS, _MAX_SIZES = 10, 1000, 8


@dataclass(frozen=True)
class CriticalEstimates:
    """Estimates about the critical scenarios of a study."""

    threshold: float  # in the unit of the objective
    lower_is_critical: bool
    unit: str  # empty for none
    n_critical: int  # number of critical scenarios that were run
    critical_set: CriticalSetEstimates | None  # None if too few scenarios were run
    audits: AuditEstimates | None = None  # None without audits


@dataclass(frozen=True)
class CriticalSetEstimates:
    """Estimates about all critical scenarios of the space, including those that were not run."""

    critical_fraction: Estimate  # critical share of the space
    missed_fraction: Estimate  # share of the critical set that was not found
    p_overlooked_region: float  # probability that a critical region of size `region_fraction` contains no run
    unexplored_fraction: float  # share of the space whose surrounding region of size `region_fraction` contains no run
    region_fraction: float  # share of the space
    max_hidden_fraction: float  # share of the critical set that a region without runs could hold
    interval_unavailable: str | None = None  # why `critical_fraction` has no interval; None if it has
    missed_interval_unavailable: str | None = None  # why `missed_fraction` has no interval; None if it has
    by_committee: bool = False  # predicted by a committee, not by a Gaussian process of the scores


@dataclass(frozen=True)
class AuditEstimates:
    """Estimates from the audits: random scenarios whose results the search did not see."""

    n_scenarios: int  # number of audits that were run
    n_critical: int  # number of critical audits
    critical_fraction: Estimate  # critical share of the space
    missed_fraction: Estimate | None  # share of the critical set that was not found; None if unknown


@dataclass(frozen=True)
class SpaceEstimates:
    """What the scenarios that were run say about the whole space."""

    pareto_front: Mapping[int, Mapping[str, float]] | None = None  # scores on the Pareto front by id and metric
    critical: CriticalEstimates | None = None  # None if a front was searched or there is no threshold
    sensitivity: Sensitivity | None = None  # None if a front was searched or too few scenarios were run


@dataclass(frozen=True)
class MissedFractionAfter:
    """Share of the critical set that was not found after `n_run` scenarios."""

    n_run: int
    missed_fraction: Estimate
    interval_unavailable: str | None  # why there is no interval; None if there is


def estimate_missed_fractions(study: StudyFile, estimates: SpaceEstimates) -> Iterator[MissedFractionAfter]:
    """Estimate the missed share of the critical set after some rounds: up to eight, about doubling, and the last.

    With more than 1,000 scenarios, or a committee (slow to fit), only the last one is estimated.
    """
    critical, rows = estimates.critical, study.finished_rows()
    if critical is None or critical.critical_set is None:
        return
    rounds = np.array([row.round for row in rows])
    ends = (np.flatnonzero(np.diff(rounds)) + 1).tolist()
    criterion = study.criterion
    scores, threshold = criterion.objective.minimized_scores(study), criterion.oriented
    assert threshold is not None
    sizes: list[int] = []
    if not uses_features(study.meta.optimizer):
        targets = [len(rows) / 2.0**k for k in range(_MAX_SIZES - 1, 0, -1)]
        nearest = {min(ends, key=lambda end: abs(end - size)) for size in targets if ends}
        sizes = sorted(size for size in nearest if _MIN_SCENARIOS <= size <= _MAX_SCENARIOS)
    for size in sizes:
        with skip_if_not_enough_data():
            critical_set = estimate_critical_set(study, scores, threshold, last_id=rows[size - 1].id)
            yield MissedFractionAfter(size, critical_set.missed_fraction, critical_set.missed_interval_unavailable)
    yield MissedFractionAfter(
        len(rows), critical.critical_set.missed_fraction, critical.critical_set.missed_interval_unavailable
    )


def estimate_space(study: StudyFile) -> SpaceEstimates:
    """Estimate front, critical set and sensitivities of a study, as far as there are enough scores."""
    rows, meta = study.finished_rows(), study.meta
    if not rows:
        return SpaceEstimates()
    criterion = study.criterion
    objective = criterion.objective
    oriented = objective.minimized_scores(study)
    if objective.pareto:
        scores = {metric.name: study.scores(metric.name) for metric in objective.metrics}
        front = np.flatnonzero(is_on_pareto_front(oriented)).tolist()
        return SpaceEstimates({rows[k].id: {name: float(column[k]) for name, column in scores.items()} for k in front})
    sensitivity = None
    with skip_if_not_enough_data():
        searched = ~study.audit_mask()
        sensitivity = estimate_sensitivity(study.space, study.points()[searched], oriented[searched], meta.seed)
    return SpaceEstimates(None, _estimate_critical(study, criterion, oriented), sensitivity)


def _estimate_critical(study: StudyFile, criterion: Criterion, oriented: FloatArray) -> CriticalEstimates | None:
    threshold, objective = criterion.oriented, criterion.objective
    if criterion.raw is None or threshold is None:
        return None
    audits = study.audit_mask()
    estimates, missed = None, None
    with skip_if_not_enough_data():
        critical_set = estimate_critical_set(study, oriented, threshold)
        estimates = CriticalSetEstimates(
            critical_set.critical_fraction,
            critical_set.missed_fraction,
            critical_set.p_overlooked_region(),
            critical_set.unexplored_fraction(),
            MIN_REGION_FRACTION,
            critical_set.max_hidden_fraction,
            critical_set.interval_unavailable,
            critical_set.missed_interval_unavailable,
            critical_set.uses_committee,
        )
        missed = critical_set.audited_missed_fraction
    n_critical_audits = int(criterion.is_critical(oriented[audits]).sum())
    n_audits = int(audits.sum())
    audit = (
        AuditEstimates(n_audits, n_critical_audits, proportion_interval(n_critical_audits, n_audits), missed)
        if n_audits
        else None
    )
    return CriticalEstimates(
        threshold=float(criterion.raw),
        lower_is_critical=objective.lower_is_critical,
        unit=objective.unit,
        n_critical=int(criterion.is_critical(oriented).sum()),
        critical_set=estimates,
        audits=audit,
    )
