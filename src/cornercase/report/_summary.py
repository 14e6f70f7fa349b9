"""Class `Summary`: main results of a study as typed values."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any, Final, get_args

import numpy as np

from cornercase._common.plugin_errors import group_failure_messages
from cornercase._common.text.notebook_html import render_html_table
from cornercase.clustering import Agreement, Analysis, read_analyses
from cornercase.clustering._agreement import compare_clusterings
from cornercase.evidence._criticality_bands import Bands, bands_of_study
from cornercase.exploration._constant_metrics import describe_constant_metrics
from cornercase.metrics._outcome import Culprit, Impact
from cornercase.recordings import Collision
from cornercase.reduction import ReducedSet, read_reduction
from cornercase.reduction._evaluate import evaluate_with_study_threshold
from cornercase.report._collision_reactions import CollisionReactionCounts, count_collision_reactions
from cornercase.report._estimates import SpaceEstimates, estimate_space
from cornercase.report._reference_driver_results import ReferenceDriverResults, count_reference_driver_results
from cornercase.scenario import Value
from cornercase.study import ScenarioRecord, StudyFile, StudyMeta
from cornercase.study._criticality_order import order_by_criticality
from cornercase.study._damage import require_condition, reraise_read_errors
from cornercase.study._objective import Objective

# Longest list of reasons that somebody may still read.
_MAX_REASONS: Final = 20


@dataclass(frozen=True)
class MetricSummary:
    """Summary of the scores of all scenarios that were run, by one metric.

    Attributes
    ----------
    name, unit : str
        Name and unit of the metric; the unit ``"1"`` means no unit.
    lower_is_critical : bool
        True if lower scores are more critical.
    most_critical, median : float
        Most critical and median score, in the unit of the metric.
    most_critical_id : int
        Id of the scenario with the most critical score. If several have this score: the scenario in which the first
        collision of the ego is the fastest.
    parameters : mapping of str to float or str
        Parameters of the most critical scenario.
    repeat_spread : tuple of float, or None
        Only if each scenario was run several times, else None. For each scenario, the spread is its highest score minus
        its lowest score; the two values are the median and the maximum of the spreads.
    constant_note : str
        A message if at least ten scenarios were run and all have the same score; else empty.
    most_critical_other : str or None
        If the study has several other entities, the one that the most critical score refers to. Else None.
    scores_per_other : mapping of str to int
        If the study has several other entities, the number of scores that refer to each of them. Else empty.

    Examples
    --------
    >>> import cornercase as cc
    >>> wttc = cc.summarize("study.db").metrics["wttc"]  # doctest: +SKIP
    >>> wttc.most_critical, wttc.most_critical_id, round(wttc.median, 2)  # doctest: +SKIP
    (0.0, 17, 0.82)
    """

    name: str
    unit: str
    lower_is_critical: bool
    most_critical: float
    median: float
    most_critical_id: int
    parameters: Mapping[str, Value]
    repeat_spread: tuple[float, float] | None
    constant_note: str = ""
    most_critical_other: str | None = None
    scores_per_other: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class FailureSummary:
    """Summary of the scenarios of a study that failed for the same reason.

    Attributes
    ----------
    n_scenarios : int
        Number of scenarios that failed for this reason.
    first_id : int
        Id of the first of these scenarios.
    parameters : mapping of str to float or str
        Parameters of the first of these scenarios.

    Examples
    --------
    >>> import cornercase as cc
    >>> for reason, failure in cc.summarize("study.db").failures.items():  # doctest: +SKIP
    ...     print(f"{failure.n_scenarios} failed, such as {failure.first_id} with {failure.parameters}: {reason}")
    """

    n_scenarios: int
    first_id: int
    parameters: Mapping[str, Value]


@dataclass(frozen=True, repr=False)
class Summary:
    """Summary of the scenarios that were run in a study and their results.

    `str` reads the study file again, and returns the text that ``cornercase show`` prints for it.

    Attributes
    ----------
    meta : StudyMeta
        Configuration of the study.
    objective : str
        Objective of the search: a metric, a weighted sum, or the front of several metrics.
    n_run, n_failed, n_pending : int
        Number of scenarios that were run, that failed, and that were not run yet.
    n_collisions : int
        Number of scenarios in which the ego collides with one of the entities that the metrics consider.
    faults : mapping of str to int
        Number of scenarios in which the ego collides with one of the entities that the metrics consider, by who is at
        fault for the first such collision: ``"ego"``, ``"other"``, ``"both"``, ``"undecided"``. Empty without such
        collisions, and in a study of an early version.
    unmeasured_collisions : mapping of str to int
        Number of scenarios in which the ego collides with an entity that the metrics do not consider, by entity.
    metrics : mapping of str to MetricSummary
        Summary of the scores by metric; empty before a scenario was run.
    analyses : mapping of str to Analysis
        Clustering by aspect (what the scenarios are compared by).
    agreements : mapping of (str, str) to Agreement
        Agreement of the clusterings by two aspects, for each pair of aspects by which the same scenarios were analyzed.
        A pair is left out if both clusterings have a single cluster or only noise.
    seconds_by_stage : mapping of str to float
        Time spent by stage, in s.
    estimates : SpaceEstimates
        Estimates about the whole space.
    reduced_set : ReducedSet or None
        Scenarios that were selected as tests; None before the study was reduced.
    probability : mapping of str to object, or None
        Result of `cornercase.exploration.estimate`, in the form of its ``to_json``; None if the study is not an
        estimate.
    references : mapping of str to ReferenceDriverResults
        Results by name of the reference driver (model of a careful driver), for all reference drivers that the
        condition or a requirement names.
    failures : mapping of str to FailureSummary
        Failed scenarios by reason, the most frequent reason first; at most 20 reasons.
    bands : mapping of str to Bands
        Bands of criticality by metric, without metrics whose scores are all the same.
    replies : CollisionReactionCounts or None
        Numbers of collisions by how the ego braked, and by what would have avoided them. None without collisions, or if
        no motion is known.

    Examples
    --------
    >>> import cornercase as cc
    >>> folder = "examples/x_intersection/x_intersection"
    >>> scenario = cc.LogicalScenario.read(f"{folder}.xosc", f"{folder}.space.xosc")
    >>> problem = cc.Problem(scenario, ego="Ego", other="Pedestrian", metrics=["wttc"], threshold=0.2)
    >>> study = cc.Study.create("summarized.db", problem)
    >>> _ = study.explore("sobol", budget=20)
    >>> summary = study.summary()
    >>> summary.n_run, summary.metrics["wttc"].unit, summary.reduced_set
    (20, 's', None)
    """

    meta: StudyMeta
    objective: str
    n_run: int
    n_failed: int
    n_pending: int
    n_collisions: int
    faults: Mapping[str, int]
    unmeasured_collisions: Mapping[str, int]
    metrics: Mapping[str, MetricSummary]
    analyses: Mapping[str, Analysis]
    agreements: Mapping[tuple[str, str], Agreement]
    seconds_by_stage: Mapping[str, float]
    estimates: SpaceEstimates
    reduced_set: ReducedSet | None
    probability: Mapping[str, Any] | None = None
    references: Mapping[str, ReferenceDriverResults] = field(default_factory=dict)
    failures: Mapping[str, FailureSummary] = field(default_factory=dict)
    bands: Mapping[str, Bands] = field(default_factory=dict)
    replies: CollisionReactionCounts | None = None
    _describe: Callable[[], str] = field(default=str, compare=False)
    """Function that returns the text of ``cornercase show``, which may be empty."""

    @property
    def represents_space(self) -> bool:
        """True if scenarios were searched or imported, False for the run of a suite or an estimate of a probability."""
        return not self.meta.suite and self.probability is None

    def __str__(self) -> str:
        return self._describe() or repr(self)

    def __repr__(self) -> str:
        parts = [f"{self.meta.title}: {self.n_run} scenarios run, {self.n_collisions} collisions"]
        if self.n_failed:
            parts.append(f"{self.n_failed} failed")
        if self.n_pending:
            parts.append(f"{self.n_pending} pending")
        parts += [f"{name} from {metric.most_critical:.4g} {metric.unit}" for name, metric in self.metrics.items()]
        parts += [
            f"{len(analysis.sizes)} cluster{'' if len(analysis.sizes) == 1 else 's'} by {by}"
            for by, analysis in self.analyses.items()
        ]
        if self.reduced_set is not None:
            parts.append(f"{len(self.reduced_set)} kept")
        return f"<Summary of {', '.join(parts)}>"

    def _repr_html_(self) -> str:
        """Return sentences, a table of the metrics, the clusters and the reduced set as HTML, for notebooks."""
        import pandas as pd

        metrics = pd.DataFrame(
            {
                name: {
                    "unit": "" if metric.unit == "1" else metric.unit,
                    "most critical": metric.most_critical,
                    "median": metric.median,
                    "most critical scenario": metric.most_critical_id,
                }
                for name, metric in self.metrics.items()
            }
        ).T
        parts = [f'<div style="white-space: pre-wrap">{escape(str(self))}</div>', render_html_table("Metrics", metrics)]
        parts += [analysis._repr_html_() for analysis in self.analyses.values()]
        if self.reduced_set is not None:
            parts.append(self.reduced_set._repr_html_())
        return "".join(parts)


def entities_hit_by_ego(meta: StudyMeta, collisions: Iterable[Collision]) -> frozenset[str]:
    """Return the names of all entities that the ego collides with in one scenario."""
    hits = (collision.entities for collision in collisions if meta.ego in collision.entities)
    return frozenset(name for pair in hits for name in pair if name != meta.ego)


def summarize_with_collisions(
    study: StudyFile, entities_hit: Sequence[frozenset[str]], impacts: Sequence[Sequence[Impact]]
) -> Summary:
    """Summarize an open study like `summarize`, with collisions that the caller has already read.

    For each scenario that ran, `entities_hit` has the names of the entities that the ego collides with, and `impacts`
    has the collisions of the ego.
    """
    states = [row.state for row in study.rows()]
    others = frozenset(study.meta.others)
    names, constant_notes = study.meta.metrics, describe_constant_metrics(study)
    reduced = read_reduction(study)
    return Summary(
        meta=study.meta,
        objective=Objective.from_study_meta(study.meta).label,
        n_run=states.count("done"),
        n_failed=states.count("failed"),
        n_pending=states.count("pending"),
        n_collisions=sum(not names.isdisjoint(others) for names in entities_hit),
        faults=_count_faults(impacts, others),
        unmeasured_collisions={
            name: sum(name in names for names in entities_hit)
            for name in sorted(frozenset().union(*entities_hit) - others)
        },
        metrics={name: _summarize_metric(study, name, constant_notes.get(name, ""), impacts) for name in names}
        if "done" in states
        else {},
        analyses=read_analyses(study),
        agreements=compare_clusterings(study),
        seconds_by_stage=study.elapsed_by_stage(),
        estimates=estimate_space(study),
        reduced_set=None if reduced is None else evaluate_with_study_threshold(study, reduced),
        probability=_read_probability(study),
        references=count_reference_driver_results(study),
        failures=_summarize_failures(study.failed_rows()),
        bands=bands_of_study(study) if "done" in states else {},
        replies=count_collision_reactions(study, impacts),
    )


def _count_faults(impacts: Sequence[Sequence[Impact]], others: Collection[str]) -> dict[str, int]:
    """Count the scenarios in which the ego collides with one of `others`, by who is at fault for the first such hit."""
    measured = [[hit.fault for hit in hits if hit.entity in others] for hits in impacts]
    first = [faults[0] for faults in measured if faults]
    counts = Counter(fault.who for fault in first if fault is not None)
    return {who: counts[who] for who in get_args(Culprit)} if counts else {}


def _summarize_failures(failed: Sequence[ScenarioRecord]) -> dict[str, FailureSummary]:
    groups = group_failure_messages(row.error or "" for row in failed)
    counts = {why: (len(members), failed[members[0]]) for why, members in list(groups.items())[:_MAX_REASONS]}
    return {why: FailureSummary(count, first.id, first.values) for why, (count, first) in counts.items()}


def _read_probability(study: StudyFile) -> dict[str, Any] | None:
    estimate = study.read_estimate()
    if estimate is not None:
        with reraise_read_errors(study.path):
            for event in ("critical", "collision"):
                low, high = estimate[event]["95 % interval"]
                require_condition(
                    all(isinstance(number, float | int) for number in (estimate[event]["probability"], low, high)),
                    event,
                )
            require_condition(
                isinstance(estimate["critical is"], str) and isinstance(estimate["scenarios"], int), "its estimate"
            )
            require_condition(
                all(isinstance(warning, str) for warning in estimate["warnings"]), "the warnings of its estimate"
            )
    return estimate


def _summarize_metric(
    study: StudyFile, name: str, constant_note: str, impacts: Sequence[Sequence[Impact]]
) -> MetricSummary:
    metric, scores = study.meta.create_metric(name), study.scores(name)
    worst = int(order_by_criticality(metric.to_minimize(scores), impacts)[0])
    row = study.finished_rows()[worst]
    ranges = study.score_range(name)
    against = study.score_sources(name)
    counts = Counter(other for other in against.values() if other is not None)
    width = None if ranges is None else ranges[:, 1] - ranges[:, 0]
    return MetricSummary(
        name=name,
        unit=metric.unit,
        lower_is_critical=metric.lower_is_critical,
        most_critical=float(scores[worst]),
        median=float(np.median(scores)),
        most_critical_id=row.id,
        parameters=row.values,
        repeat_spread=None if width is None else (float(np.median(width)), float(width.max())),
        constant_note=constant_note,
        most_critical_other=against.get(row.id),
        scores_per_other={name: counts[name] for name in study.meta.others} if against else {},
    )
