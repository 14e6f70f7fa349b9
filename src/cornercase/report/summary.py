"""What a study holds, as typed values."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from cornercase._common.parts import group_reasons
from cornercase.clustering import Agreement, Analysis, compare_clusterings, read_analyses
from cornercase.exploration import Objective, tell_alike
from cornercase.metrics import METRICS
from cornercase.recordings import Collision
from cornercase.reduction import ReducedSet, grade_anew, read_reduction
from cornercase.report.knowledge import Knowledge, find_knowledge
from cornercase.report.references import ReferenceCount, count_references
from cornercase.scenario import Value
from cornercase.study import Row, Study, StudyMeta, damage_told, open_study, require

# Reasons of failures that somebody may still read.
_MOST_REASONS: Final = 20


@dataclass(frozen=True)
class MetricSummary:
    """Scores of the scenarios that were run, by one metric.

    Attributes
    ----------
    name, unit : str
        The unit is ``"1"`` for none.
    lower_is_critical : bool
    most_critical, median : float
        In the unit of the metric.
    scenario : int
        Id of the most critical scenario.
    at : mapping of str to float or str
        Its parameters.
    spread : tuple of float, or None
        Difference between the scores of the runs of one scenario, in the median scenario and at most; None where each
        was run once.
    alike : str
        What there is to say where the scores of all scenarios are the same, else empty.
    against : str or None
        Of several others the one that the most critical score is against; None where there is one, or where the score
        is not of one rather than of another.
    counts : mapping of str to int
        Of several others, how many scores are against each; empty where there is one.
    """

    name: str
    unit: str
    lower_is_critical: bool
    most_critical: float
    median: float
    scenario: int
    at: Mapping[str, Value]
    spread: tuple[float, float] | None
    alike: str = ""
    against: str | None = None
    counts: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class FailureSummary:
    """Scenarios that failed for one reason.

    Attributes
    ----------
    scenarios : int
        Number of them.
    first : int
        Id of the first.
    at : mapping of str to float or str
        Its parameters.
    """

    scenarios: int
    first: int
    at: Mapping[str, Value]


@dataclass(frozen=True, repr=False)
class Summary:
    """What was run in a study, and what was found.

    Attributes
    ----------
    meta : StudyMeta
        What the study is about.
    searched : str
        What the search made as critical as it could: a metric, a weighted sum, or the front of several metrics.
    run, failed, pending : int
        Number of scenarios.
    collisions : int
        Number of scenarios in which the ego collides with whom it is measured against.
    beside : mapping of str to int
        By entity that the ego is not measured against, the number of scenarios in which both collide.
    metrics : mapping of str to MetricSummary
        Empty before a scenario was run.
    analyses : mapping of str to Analysis
        By aspect.
    agreements : mapping of (str, str) to Agreement
        Of each pair of aspects that the same scenarios were analysed by.
    seconds : mapping of str to float
        Time spent by stage, in s.
    knowledge : Knowledge
        What the scenarios that were run say of all others.
    reduced : ReducedSet or None
        None before the study was reduced.
    probability : mapping of str to object, or None
        What an estimate found, as `cornercase.exploration.Estimation.to_json` gives it; None where the study is none.
    references : mapping of str to ReferenceCount
        By name, of those that the condition or a requirement of the study speaks of.
    failures : mapping of str to FailureSummary
        By reason, the most frequent ones first.
    """

    meta: StudyMeta
    searched: str
    run: int
    failed: int
    pending: int
    collisions: int
    beside: Mapping[str, int]
    metrics: Mapping[str, MetricSummary]
    analyses: Mapping[str, Analysis]
    agreements: Mapping[tuple[str, str], Agreement]
    seconds: Mapping[str, float]
    knowledge: Knowledge
    reduced: ReducedSet | None
    probability: Mapping[str, Any] | None = None
    references: Mapping[str, ReferenceCount] = field(default_factory=dict)
    failures: Mapping[str, FailureSummary] = field(default_factory=dict)

    def __repr__(self) -> str:
        found = [f"{self.meta.title}: {self.run} scenarios run, {self.collisions} collisions"]
        if self.failed:
            found.append(f"{self.failed} failed")
        if self.pending:
            found.append(f"{self.pending} pending")
        found += [f"{name} from {one.most_critical:.4g} {one.unit}" for name, one in self.metrics.items()]
        found += [f"{len(one.sizes)} clusters by {by}" for by, one in self.analyses.items()]
        if self.reduced is not None:
            found.append(f"{len(self.reduced)} kept")
        return f"Summary({', '.join(found)})"


def summarize(study: Study | Path | str, *, critical: float | None = None) -> Summary:
    """Say what was run in a study, and what was found.

    Parameters
    ----------
    study : Study or path
        Open, or the file; it is only read.
    critical : float, optional
        Score from which a scenario is critical, in the unit of what was searched; by default that of the study.

    Returns
    -------
    Summary
        Typed values; ``print`` shows them in a line.

    Raises
    ------
    InputError
        There is no such study, or it says by no one score what is critical and `critical` is given.

    See Also
    --------
    cornercase.write_report : The same with figures, for a person.
    """
    with open_study(study, readonly=True, critical=critical) as opened:
        touched = [touched_by_ego(opened.meta, hits) for hits in opened.collisions().values()]
        return summarize_with(opened, touched)


def touched_by_ego(meta: StudyMeta, collisions: Iterable[Collision]) -> frozenset[str]:
    """Find everybody whom the ego collides with in a scenario.

    Parameters
    ----------
    meta : StudyMeta
        Says who the ego is.
    collisions : iterable of Collision
        Of the scenario.

    Returns
    -------
    frozenset of str
        Their names.
    """
    hits = (one.entities for one in collisions if meta.ego in one.entities)
    return frozenset(name for pair in hits for name in pair if name != meta.ego)


def summarize_with(study: Study, touched: Sequence[frozenset[str]]) -> Summary:
    """Say what was run in a study whose recordings have been read; as `summarize`.

    Parameters
    ----------
    study : Study
        Open.
    touched : sequence of frozenset of str
        Of each scenario that was run whom the ego collides with.

    Returns
    -------
    Summary
        Typed values.
    """
    states = [row.state for row in study.rows()]
    others = frozenset(study.meta.others)
    names, alike = study.meta.metrics, tell_alike(study)
    reduced = read_reduction(study)
    return Summary(
        meta=study.meta,
        searched=Objective.of_study(study.meta).text,
        run=states.count("done"),
        failed=states.count("failed"),
        pending=states.count("pending"),
        collisions=sum(not one.isdisjoint(others) for one in touched),
        beside={name: sum(name in one for one in touched) for name in sorted(frozenset().union(*touched) - others)},
        metrics={name: _of_metric(study, name, alike.get(name, "")) for name in names} if "done" in states else {},
        analyses=read_analyses(study),
        agreements=compare_clusterings(study),
        seconds=study.elapsed(),
        knowledge=find_knowledge(study),
        reduced=None if reduced is None else grade_anew(study, reduced),
        probability=_probability(study),
        references=count_references(study),
        failures=_failures(study.failed()),
    )


def _failures(failed: Sequence[Row]) -> dict[str, FailureSummary]:
    groups = group_reasons(row.error or "" for row in failed)
    found = {why: (len(members), failed[members[0]]) for why, members in list(groups.items())[:_MOST_REASONS]}
    return {why: FailureSummary(count, first.id, first.values) for why, (count, first) in found.items()}


def _probability(study: Study) -> dict[str, Any] | None:
    found = study.estimate()
    if found is not None:
        with damage_told(study.path):
            for event in ("critical", "collision"):
                low, high = found[event]["95 % interval"]
                require(all(isinstance(one, float | int) for one in (found[event]["probability"], low, high)), event)
            require(isinstance(found["critical is"], str) and isinstance(found["scenarios"], int), "its estimate")
            require(all(isinstance(one, str) for one in found["warnings"]), "the warnings of its estimate")
    return found


def _of_metric(study: Study, name: str, alike: str) -> MetricSummary:
    metric, scores = METRICS.create(name), study.scores(name)
    worst = int(metric.oriented(scores).argmin())
    row = study.done()[worst]
    between = study.spread(name)
    against = study.against(name)
    counts = Counter(one for one in against.values() if one is not None)
    width = None if between is None else between[:, 1] - between[:, 0]
    return MetricSummary(
        name=name,
        unit=metric.unit,
        lower_is_critical=metric.lower_is_critical,
        most_critical=float(scores[worst]),
        median=float(np.median(scores)),
        scenario=row.id,
        at=row.values,
        spread=None if width is None else (float(np.median(width)), float(width.max())),
        alike=alike,
        against=against.get(row.id),
        counts={one: counts[one] for one in study.meta.others} if against else {},
    )
