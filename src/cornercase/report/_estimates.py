"""Estimates about the whole parameter space of a study: Pareto front, critical set, sensitivities."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from html import escape
from typing import TYPE_CHECKING, Final

import numpy as np

from cornercase._common.errors import skip_if_not_enough_data
from cornercase._common.row_keys import row_keys
from cornercase.evidence import Estimate, Sensitivity
from cornercase.evidence._critical_set_estimate import MIN_REGION_FRACTION
from cornercase.evidence._proportions import proportion_interval
from cornercase.evidence._score_surrogate import ScoreSurrogate, fit_surrogate
from cornercase.evidence._sensitivity import sensitivity_of_surrogate
from cornercase.evidence._space_sample import SpaceSample, is_small_and_finite
from cornercase.exploration._best_scores import is_on_pareto_front
from cornercase.exploration._study_critical_set import estimate_critical_set
from cornercase.study import StudyFile
from cornercase.study._criterion import Criterion

if TYPE_CHECKING:
    import pandas as pd

_MIN_SCENARIOS: Final = 10  # smallest number of scenarios with which the missed share is estimated
# The missed share is estimated after several numbers of scenarios. First value: how many such numbers there are at
# most. Second value: the largest number of scenarios, apart from all scenarios at the end.
_PROCESS_LIMITS, _COMMITTEE_LIMITS = (8, 1000), (3, 400)
_CRITICAL: Final = "critical share of the space"
_MISSED: Final = "missed share of the critical set"


@dataclass(frozen=True, repr=False)
class CriticalEstimates:
    """Estimates about the critical scenarios of a study.

    Attributes
    ----------
    threshold : float
        Score from which a scenario is critical, in the unit of the objective.
    lower_is_critical : bool
        True if scores below the threshold are critical, False if scores above are.
    unit : str
        Unit of the objective; empty if there is none.
    n_run, n_critical : int
        Number of scenarios that were run, and of critical scenarios among them.
    critical_set : CriticalSetEstimates or None
        Estimates about all critical scenarios of the space. None if too few scenarios were run, or if all have the same
        score.
    audits : AuditEstimates or None
        Estimates from audits (scenarios drawn at random as a check). None without audits.

    Examples
    --------
    >>> import cornercase as cc
    >>> estimates = cc.Study.open("study.db").critical_set()  # doctest: +SKIP
    >>> estimates.n_critical, estimates.n_run  # doctest: +SKIP
    (24, 200)
    >>> estimates.table()["fraction"].round(2).to_dict()  # doctest: +SKIP
    {'critical share of the space': 0.13, 'missed share of the critical set': 0.11}
    """

    threshold: float
    lower_is_critical: bool
    unit: str
    n_run: int
    n_critical: int
    critical_set: CriticalSetEstimates | None
    audits: AuditEstimates | None = None

    @property
    def criterion(self) -> Criterion:
        """Condition for being critical: threshold, side of the threshold, and unit."""
        return Criterion(self.threshold, self.lower_is_critical, self.unit)

    def table(self) -> pd.DataFrame:
        """Make a table of the estimates.

        Returns
        -------
        DataFrame
            One row per estimate; the index names the estimated fraction. Columns are ``fraction``, the bounds ``low``
            and ``high`` of the 90 % interval, and ``no interval``, the reason if there is no interval. Estimates from
            audits (scenarios drawn at random as a check) are separate rows. Without audits, the table is empty if too
            few scenarios were run, or if all have the same score.
        """
        import pandas as pd

        rows: dict[str, tuple[float, float, float, str | None]] = {}
        if self.critical_set is not None:
            for name, estimate, why in self.critical_set.fractions():
                bounds = (estimate.low, estimate.high) if why is None else (np.nan, np.nan)
                rows[name] = (estimate.value, *bounds, why)
        if self.audits is not None:
            audited = {_CRITICAL: self.audits.critical_fraction, _MISSED: self.audits.missed_fraction}
            for name, audit in audited.items():
                if audit is not None:
                    rows[f"{name}, by audits"] = (audit.value, audit.low, audit.high, None)
        columns = ["fraction", "low", "high", "no interval"]
        return pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis("of")

    def __repr__(self) -> str:
        return f"<CriticalEstimates: {'; '.join(self._facts())}>"

    def _repr_html_(self) -> str:
        """Return the estimates as an HTML list, for notebooks."""
        return f"<ul>{''.join(f'<li>{escape(fact)}</li>' for fact in self._facts())}</ul>"

    def _facts(self) -> list[str]:
        facts = [f"{self.n_critical} of {self.n_run} scenarios are critical (score {self.criterion})"]
        if self.critical_set is None:
            return [*facts, "too few scenarios with different scores for estimates about the whole space"]
        return facts + self.critical_set.descriptions()


@dataclass(frozen=True, repr=False)
class CriticalSetEstimates:
    """Estimates about all critical scenarios of the space, including those that were not run.

    Attributes
    ----------
    critical_fraction : Estimate
        Fraction of the space that is critical.
    missed_fraction : Estimate
        Fraction of the critical part of the space that no scenario in the study has found.
    p_overlooked_region : float
        Probability that some critical region of at least the size `region_fraction` contains no scenario that was run.
        Before a critical scenario was run, this is `unexplored_fraction`.
    unexplored_fraction : float
        Fraction of the points of the space around which a region of size `region_fraction` contains no scenario.
    region_fraction : float
        Size of a region, as a fraction of the space.
    max_fraction_in_empty_region : float
        Fraction of the critical part of the space that a ball without scenarios may hold, in addition to
        `missed_fraction`. For 95 % of random centres, the largest such ball is smaller.
    interval_unavailable : str or None
        Why `critical_fraction` has no interval; None if there is an interval.
    missed_interval_unavailable : str or None
        Why `missed_fraction` has no interval; None if there is an interval.
    by_committee : bool
        Whether several classifiers together (a committee) made the predictions, instead of a Gaussian process of the
        scores.
    is_exhausted : bool
        Whether all scenarios of a space of at most 16,384 scenarios were run and none failed, so that the fractions are
        exact.

    Examples
    --------
    >>> import cornercase as cc
    >>> found = cc.Study.open("study.db").critical_set().critical_set  # doctest: +SKIP
    >>> f"at most {found.missed_fraction.high:.0%} of the critical set is missed"  # doctest: +SKIP
    'at most 21% of the critical set is missed'
    """

    critical_fraction: Estimate
    missed_fraction: Estimate
    p_overlooked_region: float
    unexplored_fraction: float
    region_fraction: float
    max_fraction_in_empty_region: float
    interval_unavailable: str | None = None
    missed_interval_unavailable: str | None = None
    by_committee: bool = False
    is_exhausted: bool = False

    def descriptions(self) -> list[str]:
        """Describe both fractions, each with its interval or the reason why there is none.

        Returns
        -------
        list of str
        """
        return [
            f"{name}: {estimate.value:.2%} "
            + (
                f"(90 % interval: {estimate.low:.2%} to {estimate.high:.2%})"
                if why is None
                else f"(no interval: {why})"
            )
            for name, estimate, why in self.fractions()
        ]

    def fractions(self) -> list[tuple[str, Estimate, str | None]]:
        """List both estimated fractions: name, estimate, and the reason if there is no interval (else None).

        Returns
        -------
        list of (str, Estimate, str or None)
        """
        return [
            (_CRITICAL, self.critical_fraction, self.interval_unavailable),
            (_MISSED, self.missed_fraction, self.missed_interval_unavailable),
        ]

    def __repr__(self) -> str:
        return f"<CriticalSetEstimates: {'; '.join(self.descriptions())}>"


@dataclass(frozen=True)
class AuditEstimates:
    """Estimates from audits: scenarios drawn at random as a check, whose results the search did not see.

    Attributes
    ----------
    n_scenarios, n_critical : int
        Number of audits that were run, and of critical audits among them.
    critical_fraction : Estimate
        Fraction of the space that is critical.
    missed_fraction : Estimate or None
        Fraction of the critical part of the space that no scenario in the study has found; None if unknown.

    Examples
    --------
    The estimates of a study that was explored with ``audit=0.3``:

    >>> import cornercase as cc
    >>> audits = cc.Study.open("study.db").critical_set().audits  # doctest: +SKIP
    >>> audits.n_scenarios, audits.n_critical, round(audits.critical_fraction.high, 2)  # doctest: +SKIP
    (30, 5, 0.32)
    """

    n_scenarios: int
    n_critical: int
    critical_fraction: Estimate
    missed_fraction: Estimate | None


@dataclass(frozen=True)
class SpaceEstimates:
    """Estimates for the whole parameter space from the scenarios that were run.

    Attributes
    ----------
    pareto_front : mapping of int to mapping of str to float, or None
        Scores of the scenarios on the Pareto front, by scenario id and metric; None if no front was searched.
    critical : CriticalEstimates or None
        Estimates about the critical scenarios. None if a Pareto front was searched, there is no threshold, or no
        scenario was run.
    sensitivity : Sensitivity or None
        Sensitivity of the objective to each parameter. None if a Pareto front was searched, too few scenarios were run,
        or all scores are equal.
    surrogate : ScoreSurrogate or None
        Gaussian process of the scores from which `sensitivity` was computed.

    Examples
    --------
    >>> import cornercase as cc
    >>> estimates = cc.summarize("study.db").estimates  # doctest: +SKIP
    >>> estimates.critical.n_critical, estimates.sensitivity.names  # doctest: +SKIP
    (24, ('ego_start', 'pedestrian_wait', 'p1_speed'))
    """

    pareto_front: Mapping[int, Mapping[str, float]] | None = None
    critical: CriticalEstimates | None = None
    sensitivity: Sensitivity | None = None
    surrogate: ScoreSurrogate | None = None


@dataclass(frozen=True)
class MissedFractionAfterRuns:
    """Estimate, from the first `n_run` scenarios, of the fraction of the critical set that they have not found."""

    n_run: int
    missed_fraction: Estimate
    interval_unavailable: str | None  # why there is no interval; None if there is an interval


def estimate_missed_fractions(study: StudyFile, estimates: SpaceEstimates) -> Iterator[MissedFractionAfterRuns]:
    """Estimate, after some rounds of a search, the fraction of the critical set that no scenario had found by then.

    The number of scenarios about doubles from one estimate to the next. The last estimate uses all scenarios, the
    others at most 1,000. There are at most eight estimates. If the model is a committee (several classifiers together),
    which is slow to fit, there are at most three, and all but the last use at most 400 scenarios.
    """
    critical, rows = estimates.critical, study.finished_rows()
    if critical is None or critical.critical_set is None:
        return
    rounds = np.array([row.round for row in rows])
    ends = (np.flatnonzero(np.diff(rounds)) + 1).tolist()
    max_sizes, max_scenarios = _COMMITTEE_LIMITS if critical.critical_set.by_committee else _PROCESS_LIMITS
    targets = [len(rows) / 2.0**k for k in range(max_sizes - 1, 0, -1)]
    nearest = {min(ends, key=lambda end: abs(end - size)) for size in targets if ends}
    for size in sorted(size for size in nearest if _MIN_SCENARIOS <= size <= max_scenarios):
        with skip_if_not_enough_data():
            critical_set = estimate_critical_set(study, last_id=rows[size - 1].id)
            yield MissedFractionAfterRuns(size, critical_set.missed_fraction, critical_set.missed_interval_unavailable)
    yield MissedFractionAfterRuns(
        len(rows), critical.critical_set.missed_fraction, critical.critical_set.missed_interval_unavailable
    )


def estimate_space(study: StudyFile) -> SpaceEstimates:
    """Estimate Pareto front, critical set and sensitivities of a study; None for estimates that need more scenarios."""
    rows = study.finished_rows()
    if not rows:
        return SpaceEstimates()
    objective = study.objective
    if objective.pareto:
        scores = {metric.name: study.scores(metric.name) for metric in objective.metrics}
        front = np.flatnonzero(is_on_pareto_front(objective.minimized_scores(study))).tolist()
        return SpaceEstimates({rows[k].id: {name: float(column[k]) for name, column in scores.items()} for k in front})
    sensitivity, surrogate = None, None
    with skip_if_not_enough_data():
        surrogate = fit_study_surrogate(study)
        sensitivity = sensitivity_of_surrogate(surrogate, study.meta.seed)
    return SpaceEstimates(None, estimate_critical(study), sensitivity, surrogate)


def estimate_study_sensitivity(study: StudyFile) -> Sensitivity:
    """Estimate the sensitivity of the objective to each parameter.

    ValueError if there are too few scores, or all scores are equal.
    """
    return sensitivity_of_surrogate(fit_study_surrogate(study), study.meta.seed)


def fit_study_surrogate(study: StudyFile) -> ScoreSurrogate:
    """Fit a Gaussian process to the scores of a study, signed so that lower is more critical.

    Audits (scenarios drawn at random as a check) are left out. ValueError if there are fewer than 10 scores, or all
    scores are equal.
    """
    scores = study.objective.minimized_scores(study)
    searched = ~study.audit_mask()
    return fit_surrogate(study.space, study.points()[searched], scores[searched])


def estimate_critical(study: StudyFile) -> CriticalEstimates | None:
    """Estimate the critical set of a study; None without a threshold, or if no scenario was run."""
    criterion = study.criterion
    if criterion is None or not study.finished_rows():
        return None
    critical, audits = study.critical_mask(), study.audit_mask()
    estimates, missed = None, None
    with skip_if_not_enough_data():
        critical_set = estimate_critical_set(study)
        estimates = CriticalSetEstimates(
            critical_set.critical_fraction,
            critical_set.missed_fraction,
            critical_set.p_overlooked_region(),
            critical_set.unexplored_fraction(),
            MIN_REGION_FRACTION,
            critical_set.max_fraction_in_empty_region,
            critical_set.interval_unavailable,
            critical_set.missed_interval_unavailable,
            critical_set.uses_committee,
            critical_set.is_exhausted,
        )
        missed = critical_set.audited_missed_fraction
    estimates = estimates or _estimate_exhausted_space(study)
    n_critical_audits, n_audits = int(critical[audits].sum()), int(audits.sum())
    audit = (
        AuditEstimates(n_audits, n_critical_audits, proportion_interval(n_critical_audits, n_audits), missed)
        if n_audits
        else None
    )
    return CriticalEstimates(
        **asdict(criterion),
        n_run=len(critical),
        n_critical=int(critical.sum()),
        critical_set=estimates,
        audits=audit,
    )


def _estimate_exhausted_space(study: StudyFile) -> CriticalSetEstimates | None:
    """Return the exact fractions of a small finite space all of whose scenarios were run; None for any other space."""
    if not is_small_and_finite(study.space):
        return None
    sample = SpaceSample.from_space(study.space, study.meta.seed)
    outcomes = dict(zip(row_keys(study.space.snap(study.points())), study.critical_mask().tolist(), strict=True))
    keys = row_keys(study.space.snap(sample.points))
    if not outcomes.keys() >= set(keys):
        return None
    fraction = float(sample.weights[[outcomes[key] for key in keys]].sum())
    exact, nothing = Estimate(fraction, fraction, fraction), Estimate(0.0, 0.0, 0.0)
    return CriticalSetEstimates(exact, nothing, 0.0, 0.0, MIN_REGION_FRACTION, 0.0, is_exhausted=True)
