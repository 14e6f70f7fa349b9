"""Questions and answers at the top of the report."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

from cornercase._common.texts import plain_text
from cornercase.evidence import Estimate
from cornercase.reduction import ReducedSet
from cornercase.report.data import ReportData
from cornercase.report.knowledge import CriticalKnowledge
from cornercase.report.references import tell_references
from cornercase.report.words import (
    find_reasons,
    percent,
    tell_asked,
    tell_beginning,
    tell_beside,
    tell_chosen,
    tell_compared,
    tell_criterion,
    tell_front,
    tell_roles,
    tell_unforetold,
    tell_unknown,
    with_signs,
    with_unit,
)
from cornercase.study import IMPORTED
from cornercase.suite import worst_state

# Points listed below an answer; the details have all.
_MOST_POINTS = 6
_NEGLIGIBLE = 0.01
_ROLES: Final[dict[str, tuple[str, str]]] = {
    "prototype": ("prototype", "prototypes"),
    "archetype": ("archetype", "archetypes"),
    "gap": ("that fills a gap between these", "that fill gaps between these"),
    "exposing": ("that exposes mutants of the driver", "that expose mutants of the driver"),
}


@dataclass(frozen=True)
class Answer:
    """Answer to a question that is asked of every study."""

    name: str  # for addresses and tests
    question: str
    text: str
    points: tuple[str, ...] = ()  # listed below the text

    def to_json(self) -> dict[str, Any]:
        """Return the fields as plain text."""
        return {
            "name": self.name,
            "question": self.question,
            "text": plain_text(self.text),
            "points": [plain_text(point) for point in self.points],
        }


def page_answers(data: ReportData) -> Iterator[Answer]:
    """Answer all questions in the order of the page; every number also appears in `summary_to_dict`."""
    summary = data.summary
    estimates = summary.knowledge
    if data.verdicts:
        yield _of_verdicts(data)
    if summary.probability is not None:
        yield _of_probability(summary.probability)
    if estimates.front is not None:
        yield _of_front(data)
    else:
        yield _of_share(data)
    yield _of_kinds(data)
    yield _of_parameters(data)
    yield _of_kept(data)
    if estimates.front is None and estimates.critical is not None:
        yield _of_missed(estimates.critical)
    yield _of_failures(data)


def tell_about(data: ReportData, *, counts: bool = True) -> str:
    """Describe the study: roles, search and, unless the page counts itself (`include_counts`), numbers of scenarios."""
    summary, meta = data.summary, data.summary.meta
    sentences = [tell_roles(meta)]
    begin = f"{_scenarios(summary.run)} " if counts else "Scenarios "
    if meta.simulator == IMPORTED:
        sentences.append(f"{begin}imported, measured by {', '.join(meta.metrics)}.")
    elif meta.suite:
        sentences.append(f"{begin}run, of a suite, measured by {', '.join(meta.metrics)}.")
    else:
        if counts:
            sentences.append(f"{begin}run.")
        sentences.append(f"Search: {meta.optimizer}, on {'the ' if meta.pareto else ''}{summary.searched}.")
        if meta.asynchronous:
            sentences.append("Each scenario was proposed as soon as one had ended.")
        if meta.elsewhere:
            sentences.append(f"The search began from {tell_beginning(meta)}.")
    if unmeasured := tell_beside(summary, counts=counts):
        sentences.append(unmeasured)
    if meta.runs_differ:
        sentences.append(f"Runs differ: {meta.runs_differ}.")
    if counts and summary.pending:
        sentences.append(f"{_scenarios(summary.pending)} not run yet.")
    return plain_text(" ".join(sentences))


def _scenarios(count: int) -> str:
    return "One scenario was" if count == 1 else f"{count} scenarios were"


def _about(share: float) -> str:
    text = percent(share)
    return f"About {text}" if text[0].isdigit() else text.capitalize()


def _interval(estimate: Estimate) -> str:
    low, high = percent(estimate.low), percent(estimate.high)
    if low == high and estimate.low < estimate.high:
        low, high = (f"{100.0 * bound:.4g} %" for bound in (estimate.low, estimate.high))
    return f"90 % interval {low} to {high}"


def _of_share(data: ReportData) -> Answer:
    name, question = "critical", "How much of the space is critical?"
    summary, critical = data.summary, data.summary.knowledge.critical
    if critical is None:
        none = "There is no threshold from which a scenario is critical; set one with --critical of cornercase explore."
        return Answer(name, question, none)
    criterion = tell_criterion(critical, summary.searched)
    estimates = critical.known
    which_ran = "" if summary.meta.simulator == IMPORTED else " that were run"
    if summary.run == 1:
        counts = f"The one scenario that was run is {'' if critical.scenarios else 'not '}critical ({criterion})."
    elif critical.scenarios:
        verb = "is" if critical.scenarios == 1 else "are"
        counts = f"{critical.scenarios} of the {summary.run} scenarios{which_ran} {verb} critical ({criterion})."
    else:
        counts = f"None of the {summary.run} scenarios{which_ran} is critical ({criterion})."
    counts += tell_references(summary.references)
    if override := tell_asked(summary):
        counts += f" {override}"
    if estimates is None:
        return Answer(name, question, f"{counts} {tell_unknown()}")
    space = "the space, as far as it can be run," if data.failed else "the space"
    if estimates.share_doubt is not None:
        estimate = f"{_about(estimates.share.value)} of {space} is critical. " if critical.scenarios else ""
        return Answer(name, question, f"{estimate}{counts} There is no interval: {estimates.share_doubt}.")
    if not critical.scenarios:
        bound = f"At most {percent(estimates.share.high)} of {space} is critical (upper end of a 90 % interval)."
        if estimates.missed_doubt is None:
            bound = "These are all scenarios of the space."
        return Answer(name, question, f"{counts} {bound}")
    share = f"{_about(estimates.share.value)} of {space} is critical ({_interval(estimates.share)})."
    return Answer(name, question, f"{share} {counts}")


def _of_missed(known: CriticalKnowledge) -> Answer:
    sentences, estimates = [], known.known
    if estimates is None:
        sentences.append("That is unknown: there are too few different scores.")
    elif not known.scenarios and estimates.missed_doubt is None:
        sentences.append("Nothing: all scenarios of the space were run, and none is critical.")
    elif not known.scenarios:
        sentences.append("Nothing critical was found, so whatever is critical was missed.")
    elif estimates.missed_doubt is not None:
        sentences.append(f"{_about(estimates.missed.value)} of the critical set.")
        sentences.append(f"There is no interval: {estimates.missed_doubt}.")
    else:
        sentences.append(f"{_about(estimates.missed.value)} of the critical set ({_interval(estimates.missed)}).")
    if estimates is not None and known.scenarios:
        sentences.append(
            "That relies on a model of the scores. Without a model: a region in which nothing was run could hide"
            f" {percent(estimates.hidden)} of the critical set."
        )
    if known.audit is not None:
        audits = f"{known.audit.critical} of {known.audit.scenarios} audits, drawn at random, are critical"
        if known.audit.missed is not None and known.audit.critical:
            audits += (
                f"; from these alone, without a model, {percent(known.audit.missed.value)} is missed"
                f" ({_interval(known.audit.missed)})"
            )
        sentences.append(f"{audits}.")
    return Answer("missed", "What may be missed?", " ".join(sentences))


def find_default_aspect(data: ReportData) -> str | None:
    """Return the aspect whose clusters say most about how scenarios end; None before the study was analyzed."""
    highest, aspect = -1.0, None
    for by, analysis in data.summary.analyses.items():
        # If tied, the later aspect wins: aspects are ordered by how much they say about what happens.
        information = round(analysis.tells.get("outcome", 0.0), 3) if analysis.clustering.n_clusters > 1 else -1.0
        if information >= highest:
            highest, aspect = information, by
    return aspect


def _of_kinds(data: ReportData) -> Answer:
    name, question, analyses = "kinds", "Which kinds are there?", data.summary.analyses
    chosen = find_default_aspect(data)
    if chosen is None:
        return Answer(name, question, "The study has not been analysed yet; cornercase analyze finds the kinds.")
    divided = [by for by, analysis in analyses.items() if analysis.clustering.n_clusters > 1 and by != chosen]
    undivided = [by for by, analysis in analyses.items() if analysis.clustering.n_clusters <= 1]
    if analyses[chosen].clustering.n_clusters <= 1:
        return Answer(name, question, f"There are no separate kinds by {_listed(undivided)}.")
    analysis = analyses[chosen]
    noise = int((analysis.labels < 0).sum())
    outside = f", and {noise} scenarios of noise" if noise else ""
    compared = f" ({description})" if (description := tell_compared(chosen)) else ""
    sentences = [f"By {chosen}{compared} there are {analysis.clustering.n_clusters} kinds{outside}."]
    points = [
        f"{profile.label or f'cluster {profile.cluster}'} ({profile.size} scenarios)."
        for profile in analysis.profiles
        if profile.cluster >= 0
    ]
    if len(points) > _MOST_POINTS:
        points = [*points[:_MOST_POINTS], f"{len(points) - _MOST_POINTS} smaller ones are listed below."]
    if divided:
        sentences.append(f"There are also kinds by {_listed(divided)}.")
    if undivided:
        sentences.append(f"There are no separate kinds by {_listed(undivided)}.")
    return Answer(name, question, " ".join(sentences), tuple(points))


def _of_parameters(data: ReportData) -> Answer:
    name, question, sensitivity = "parameters", "Which parameters matter?", data.summary.knowledge.sensitivity
    if data.summary.knowledge.front is not None:
        return Answer(
            name, question, "This is known for a single score only; this study searches the Pareto front of several."
        )
    if sensitivity is None:
        return Answer(name, question, "There are too few different scores to say.")
    if not sensitivity.foretold:
        return Answer(name, question, tell_unforetold())
    order = sorted(range(len(sensitivity.names)), key=lambda k: (-sensitivity.total[k], k))
    points = [
        f"{sensitivity.names[k]}: {_share_of(sensitivity.total[k], sensitivity.total_interval[k])} together with the"
        f" others, {_share_of(sensitivity.first[k], sensitivity.first_interval[k])} alone."
        for k in order[:_MOST_POINTS]
    ]
    has = "has" if len(sensitivity.little) == 1 else "have"
    little = f" {_listed(list(sensitivity.little))} {has} little influence." if sensitivity.little else ""
    text = (
        f"{sensitivity.names[order[0]]} matters most: {percent(sensitivity.total[order[0]])} of the variance of"
        f" {data.summary.searched} comes from it, alone or together with the others.{little} The shares come from a"
        f" Gaussian process that explains {percent(sensitivity.predicted)} of the variance (cross-validated); intervals"
        " are of 90 %."
    )
    return Answer(name, question, text, tuple(points))


def _share_of(value: float, interval: tuple[float, float]) -> str:
    if interval[1] < _NEGLIGIBLE:
        return f"below {percent(_NEGLIGIBLE)}"
    return f"{percent(value)} ({percent(interval[0])} to {percent(interval[1])})"


def _of_kept(data: ReportData) -> Answer:
    name, question, reduced = "kept", "Which scenarios should be kept?", data.summary.reduced
    if reduced is None:
        return Answer(name, question, "The study has not been reduced yet; cornercase reduce finds the few to keep.")
    roles = Counter(str(scenario.role) for scenario in reduced.kept)
    counts = _listed([f"{n} {forms[n != 1]}" for role, forms in _ROLES.items() if (n := roles[role])])
    sentences = [f"Keep {len(reduced.kept)} of the {reduced.run} scenarios: {counts or 'none'}."]
    if later := data.summary.run - reduced.run:
        sentences.append(f"{_scenarios(later)} run since.")
    if chosen := tell_chosen(data.summary):
        sentences.append(chosen)
    return Answer(name, question, " ".join([*sentences, *_left_out(data, reduced)]))


def _left_out(data: ReportData, reduced: ReducedSet) -> Iterator[str]:
    critical = {name: entry.held_out for name, entry in reduced.critical.items() if entry.held_out is not None}
    by = reduced.by if reduced.by in critical else next(iter(critical), None)
    if by is not None:
        count = critical[by].scenarios
        covered = round(count * critical[by].critical)
        which = "every one is" if covered == count else f"{percent(critical[by].critical)} are"
        yield f"Of the held-out critical scenarios, {which} like a kept one by {by} ({covered} of {count})."
    elif reduced.by in reduced.critical and (share := reduced.critical[reduced.by].critical) is not None:
        # Evaluated with another threshold than that of the selection.
        yield f"{_about(share)} of the critical scenarios that were run are like a kept one by {reduced.by}."
    graded = {name: entry.held_out for name, entry in reduced.coverage.items() if entry.held_out is not None}
    by = reduced.by if reduced.by in graded else next(iter(graded), None)
    if by is not None and by in data.summary.analyses:
        held_out, unit = graded[by], data.summary.analyses[by].unit
        yield (
            "The distance from a held-out scenario to the nearest kept one is"
            f" {with_unit(f'{held_out.mean:.3g}', unit)} on average by {by} (DTW distance);"
            f" {100.0 * held_out.better_mean:.0f} of 100 random choices of the same size leave more; k-medoids"
            f" leaves {with_unit(f'{held_out.medoids_mean:.3g}', unit)}."
        )


def _of_front(data: ReportData) -> Answer:
    front = data.summary.knowledge.front or {}
    return Answer(
        "front", "Which scenarios are on the Pareto front?", tell_front(len(front)), tuple(ends_of_front(data))
    )


def ends_of_front(data: ReportData) -> Iterator[str]:
    """Describe for each metric which scenario of the Pareto front is the most critical."""
    front = data.summary.knowledge.front or {}
    for metric in data.metrics:
        ids = sorted(front, key=lambda scenario: (metric.oriented(front[scenario][metric.name]), scenario))
        if ids:
            value = with_unit(f"{front[ids[0]][metric.name]:.3g}", metric.unit)
            yield f"The most critical {metric.name} on it is {value}, in scenario {ids[0]}."


def _of_failures(data: ReportData) -> Answer:
    name, question, failed = "failed", "What failed, and why?", data.failed
    total = data.summary.run + data.summary.failed
    if not failed:
        return Answer(
            name,
            question,
            "Nothing: " + ("the one scenario" if total == 1 else f"all {total} scenarios") + " could be run.",
        )
    reasons = find_reasons(failed)
    points = [f"{len(ids)}: {why}" for why, ids in list(reasons.items())[:_MOST_POINTS]]
    note = f" The {_MOST_POINTS} most frequent reasons:" if len(reasons) > _MOST_POINTS else ""
    return Answer(name, question, f"{len(failed)} of {total} scenarios could not be run.{note}", tuple(points))


def _of_verdicts(data: ReportData) -> Answer:
    failed = {row.id for row in data.failed}
    states = {scenario: worst_state(verdicts) for scenario, verdicts in data.verdicts.items()}
    counts = Counter("not run" if scenario in failed else state for scenario, state in states.items())
    parts = [f"{counts[state]} {state}" for state in ("passed", "failed", "inconclusive", "not run") if counts[state]]
    violations = [
        f"Scenario {scenario}: {verdict.requirement}: {verdict.reason}."
        for scenario, verdicts in data.verdicts.items()
        for verdict in verdicts
        if verdict.state == "failed"
    ]
    note = f" The first {_MOST_POINTS} requirements that failed:" if len(violations) > _MOST_POINTS else ""
    text = f"{', '.join(parts)} of {len(states)} scenarios.{note}"
    return Answer("verdicts", "Did it pass?", text, tuple(violations[:_MOST_POINTS]))


def _of_probability(found: Any) -> Answer:
    criterion = with_signs(found["critical is"])
    points = []
    for event, description in (("critical", f"a critical scenario ({criterion})"), ("collision", "a collision")):
        low, high = found[event]["95 % interval"]
        points.append(f"Of {description}: {found[event]['probability']:.3g} (95 % interval {low:.3g} to {high:.3g}).")
    text = f"Under the distributions of the space, from {found['scenarios']} scenarios:"
    return Answer("probability", "How probable is it?", text, (*points, *found["warnings"]))


def _listed(words: list[str]) -> str:
    return " and ".join(filter(None, (", ".join(words[:-1]), words[-1]))) if words else ""
