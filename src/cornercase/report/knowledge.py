"""What is known of the Pareto front, of the critical scenarios, and of the influence of each parameter."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from cornercase._common.errors import left_out_if_too_little
from cornercase._common.typing import FloatArray
from cornercase.evidence import REGION, Estimate, Sensitivity, bounds_of_share, estimate_sensitivity
from cornercase.exploration import Objective, critical_set_of, learns_from_features, on_front
from cornercase.study import Study

# What was missed is found after so many scenarios, and at so many sizes.
_FEWEST, _MOST_JUDGED, _MOST_SIZES = 10, 1000, 8


@dataclass(frozen=True)
class CriticalKnowledge:
    """What is known of the critical scenarios of a study.

    Attributes
    ----------
    threshold : float
        Score from which a scenario is critical, in the unit of what is searched.
    lower_is_critical : bool
        Whether a score up to the threshold is critical, or one from it on.
    unit : str
        Empty for none.
    scenarios : int
        Number of critical scenarios that were run.
    known : CriticalSetKnowledge or None
        None where too few scenarios were run to say something of the others.
    audit : AuditKnowledge or None
        None without audits.
    """

    threshold: float
    lower_is_critical: bool
    unit: str
    scenarios: int
    known: CriticalSetKnowledge | None
    audit: AuditKnowledge | None = None


@dataclass(frozen=True)
class CriticalSetKnowledge:
    """What is known of all critical scenarios of a space, those that were not run too.

    Attributes
    ----------
    share, missed : Estimate
        Critical share of the space, and share of the critical set that was not found.
    overlooked, unvisited : float
        Probability that a critical region of size `region` holds nothing that was run; share of the space around which
        a region of this size holds nothing that was run.
    region : float
        Share of the space.
    hidden : float
        Share of the critical set that a region could have which nothing was run in.
    share_doubt, missed_doubt : str or None, default None
        Why the intervals of `share` and `missed` cannot be given; None where they can.
    by_committee : bool, default False
        Whether a committee predicts which scenarios are critical, rather than a Gaussian process of the scores.
    """

    share: Estimate
    missed: Estimate
    overlooked: float
    unvisited: float
    region: float
    hidden: float
    share_doubt: str | None = None
    missed_doubt: str | None = None
    by_committee: bool = False


@dataclass(frozen=True)
class AuditKnowledge:
    """What the audits of a study say: scenarios that were drawn at random, and that the search was not told.

    Attributes
    ----------
    scenarios, critical : int
        Number of audits that were run, and of those of them that are critical.
    share : Estimate
        Critical share of the space.
    missed : Estimate or None
        Share of the critical set that was not found; None where too few scenarios were run to say what was.
    """

    scenarios: int
    critical: int
    share: Estimate
    missed: Estimate | None


@dataclass(frozen=True)
class Knowledge:
    """What the scenarios that were run say of all others.

    Attributes
    ----------
    front : mapping of int to mapping of str to float, or None
        By id, the scores of the scenarios on the Pareto front by metric; None where no front was searched.
    critical : CriticalKnowledge or None
        None where a front was searched, or no threshold says what is critical.
    sensitivity : Sensitivity or None
        None where a front was searched, or too few scenarios were run.
    """

    front: Mapping[int, Mapping[str, float]] | None = None
    critical: CriticalKnowledge | None = None
    sensitivity: Sensitivity | None = None


@dataclass(frozen=True)
class MissedAfter:
    """How much of the critical set was not found after some of the scenarios.

    Attributes
    ----------
    run : int
        Number of scenarios that had been run.
    share : Estimate
        Share of the critical set that was not found.
    doubt : str or None
        Why its interval cannot be given; None where it can.
    """

    run: int
    share: Estimate
    doubt: str | None


def find_missed(study: Study, knowledge: Knowledge) -> Iterator[MissedAfter]:
    """Find how much of the critical set was missed at the ends of some rounds.

    Parameters
    ----------
    study : Study
        What was run.
    knowledge : Knowledge
        What is known at its end.

    Yields
    ------
    MissedAfter
        At most eight: each of about twice as many scenarios as the one before, and the last of all. Of more than
        1,000 scenarios, and by a committee, which takes long to fit, only the last is found.
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
        wanted = [len(rows) / 2.0**k for k in range(_MOST_SIZES - 1, 0, -1)]
        nearest = {min(ends, key=lambda end: abs(end - size)) for size in wanted if ends}
        sizes = sorted(size for size in nearest if _FEWEST <= size <= _MOST_JUDGED)
    for size in sizes:
        with left_out_if_too_little():
            found = critical_set_of(study, scores, threshold, last=rows[size - 1].id)
            yield MissedAfter(size, found.missed, found.missed_doubt)
    yield MissedAfter(len(rows), critical.known.missed, critical.known.missed_doubt)


def find_knowledge(study: Study) -> Knowledge:
    """Find what the scenarios that were run say of all others.

    Parameters
    ----------
    study : Study
        Nothing is known before a scenario was run.

    Returns
    -------
    Knowledge
        As far as there is enough to say something.
    """
    rows, meta = study.done(), study.meta
    if not rows:
        return Knowledge()
    objective = Objective.of_study(meta)
    oriented = objective.oriented_of(study)
    if objective.pareto:
        scores = {metric.name: study.scores(metric.name) for metric in objective.metrics}
        front = np.flatnonzero(on_front(oriented)).tolist()
        return Knowledge({rows[k].id: {name: float(each[k]) for name, each in scores.items()} for k in front})
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
    known, missed = None, None
    with left_out_if_too_little():
        found = critical_set_of(study, oriented, threshold)
        known = CriticalSetKnowledge(
            found.share,
            found.missed,
            found.overlooked(),
            found.unvisited(),
            REGION,
            found.hidden,
            found.doubt,
            found.missed_doubt,
            found.by_committee,
        )
        missed = found.audited_missed
    hits = int((oriented[audits] <= threshold).sum())
    drawn = int(audits.sum())
    audit = AuditKnowledge(drawn, hits, bounds_of_share(hits, drawn), missed) if drawn else None
    return CriticalKnowledge(
        threshold=float(study.critical),
        lower_is_critical=objective.lower_is_critical,
        unit=objective.unit,
        scenarios=int((oriented <= threshold).sum()),
        known=known,
        audit=audit,
    )
