"""Questions and answers at the top of the report page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from cornercase._common.text.sanitize import escape_control_characters
from cornercase.clustering._headline_aspect import find_headline_aspect, has_useful_clusters
from cornercase.evidence import Estimate
from cornercase.metrics._outcome import Fault, Manner
from cornercase.reduction import ReducedSet
from cornercase.report._collision_reactions import CollisionReactionCounts
from cornercase.report._estimates import CriticalEstimates
from cornercase.report._near_misses import describe_near_misses, sort_near_misses
from cornercase.report._reference_driver_results import describe_reference_drivers
from cornercase.report._report_data import ReportData
from cornercase.report.text._danger_ranges import describe_danger_ranges
from cornercase.report.text._phrases import (
    append_unit,
    describe_aspect,
    describe_dangers,
    describe_front,
    describe_little_influence,
    describe_missing_sensitivity,
    describe_selection_threshold,
    describe_threshold_override,
    describe_too_few_scores,
    describe_unmeasured_collisions,
    describe_warm_start,
    format_cluster_title,
    format_criterion_with_signs,
    format_percent,
    group_failures_by_reason,
    join_with_and,
    use_math_signs,
)
from cornercase.report.text._reaction_sentences import describe_reactions
from cornercase.report.text._tested_space import describe_tested_space
from cornercase.report.text._what_next import (
    describe_next_steps,
    describe_next_steps_after_suite,
    describe_repeatability,
)
from cornercase.study._import_recordings import IMPORTED_SIMULATOR
from cornercase.suite._verdict import worst_state

# Most points listed below an answer; the details of the page have all.
_MAX_POINTS = 6
_MAX_NEAR_MISSES = 5
_NEGLIGIBLE_SHARE = 0.01
_NEARLY_ALL: Final = 0.9
_ROLE_NAMES: Final[dict[str, tuple[str, str]]] = {
    "critical prototype": ("prototype of critical ones", "prototypes of critical ones"),
    "prototype": ("prototype", "prototypes"),
    "archetype": ("archetype", "archetypes"),
    "gap": ("that fills a gap between these", "that fill gaps between these"),
    "exposing": ("that exposes mutants of the driver", "that expose mutants of the driver"),
}

_MANNERS: Final[dict[Manner, str]] = {
    "from behind": "drives into the other from behind",
    "its rear": "is hit from behind",
    "while it stands": "is hit while it stands",
}


@dataclass(frozen=True)
class Answer:
    """Answer to a question at the top of the report page, such as "Does it collide?"."""

    name: str  # for addresses and tests
    question: str
    text: str
    points: tuple[str, ...] = ()  # listed below the text

    def to_json(self) -> dict[str, Any]:
        """Return the fields as a dictionary for JSON, with control characters escaped."""
        return {
            "name": self.name,
            "question": self.question,
            "text": escape_control_characters(self.text),
            "points": [escape_control_characters(point) for point in self.points],
        }


def page_answers(data: ReportData) -> Iterator[Answer]:
    """Yield the answers at the top of the report page, in the order of the page.

    Numbers of scenarios and estimated shares are also values in the result of `summary_to_dict`. Further numbers, on
    single collisions, near misses and dangerous ranges, are not.
    """
    summary = data.summary
    if data.verdicts:
        yield _answer_verdicts(data)
    if summary.probability is not None:
        yield _answer_probability(summary.probability)
    yield _answer_collisions(data)
    if summary.replies is not None:
        yield _answer_replies(data, summary.replies)
    elif summary.represents_space and not data.hardest_impacts and not summary.unmeasured_collisions:
        yield _answer_nothing_to_avoid(data)
    if summary.represents_space:
        yield from _answer_search(data)
    elif summary.analyses:
        yield _answer_clusters(data)
    if data.verdicts:
        yield Answer("next", "What next?", *describe_next_steps_after_suite(data))
        yield Answer("sure", "How sure is that?", describe_repeatability(data))
    yield _answer_failures(data)


def _answer_search(data: ReportData) -> Iterator[Answer]:
    """Yield the answers for a study that searched a parameter space or imported recordings."""
    estimates = data.summary.estimates
    if estimates.pareto_front is not None:
        yield _answer_front(data)
    else:
        yield _answer_critical_share(data)
    yield _answer_clusters(data)
    yield _answer_parameters(data)
    yield _answer_reduced_set(data)
    if estimates.pareto_front is None and estimates.critical is not None:
        yield _answer_missed(data, estimates.critical)
    yield Answer("next", "What next?", *describe_next_steps(data))


def describe_study(data: ReportData, *, include_counts: bool = True) -> str:
    """Describe a study: roles of the entities, search, and numbers of scenarios.

    Without `include_counts` the numbers are left out, because the page shows its own counts.
    """
    summary, meta = data.summary, data.summary.meta
    sentences = [meta.roles_text]
    begin = f"{_format_scenarios_were(summary.n_run)} " if include_counts else "Scenarios "
    if meta.simulator == IMPORTED_SIMULATOR:
        sentences.append(f"{begin}imported, measured by {', '.join(meta.metrics)}.")
    elif meta.suite:
        sentences.append(f"{begin}run, of a suite, measured by {', '.join(meta.metrics)}.")
    else:
        if include_counts:
            sentences.append(f"{begin}run.")
        sentences.append(f"Search: {meta.optimizer}, on {'the ' if meta.pareto else ''}{summary.objective}.")
        if meta.asynchronous:
            sentences.append("Each scenario was proposed as soon as one had ended.")
        if meta.elsewhere:
            sentences.append(f"The search began from {describe_warm_start(meta)}.")
    if unmeasured := describe_unmeasured_collisions(summary, counts=include_counts):
        sentences.append(unmeasured)
    if meta.nondeterminism_text:
        sentences.append(f"Runs differ: {meta.nondeterminism_text}.")
    if include_counts and summary.n_pending:
        sentences.append(f"{_format_scenarios_were(summary.n_pending)} not run yet.")
    return escape_control_characters(" ".join(sentences))


def _format_scenarios_were(count: int) -> str:
    return "One scenario was" if count == 1 else f"{count} scenarios were"


def _describe_share(share: float) -> str:
    text = format_percent(share)
    return f"About {text}" if text[0].isdigit() else text.capitalize()


def _format_interval(estimate: Estimate) -> str:
    low, high = format_percent(estimate.low), format_percent(estimate.high)
    if low == high and estimate.low < estimate.high:
        low, high = (f"{100.0 * bound:.4g} %" for bound in (estimate.low, estimate.high))
    return f"90 % interval {low} to {high}"


def _answer_collisions(data: ReportData) -> Answer:
    name, question, ego = "collisions", "Does it collide?", data.summary.meta.ego
    hardest = data.hardest_first
    scenarios = "the one scenario" if data.summary.n_run == 1 else f"the {data.summary.n_run} scenarios"
    misses = sort_near_misses(data.approaches, data.hardest_impacts)
    if not hardest:
        text = f"No: {ego} touches {' or '.join(data.summary.meta.others)} in none of {scenarios}."
        if misses:
            text += f" The nearest miss is {misses[0][1].describe()}, in scenario {misses[0][0]}."
        nearest = misses[: _MAX_NEAR_MISSES if len(misses) > 1 else 0]
        return Answer(name, question, text, tuple(describe_near_misses(nearest)))
    others = data.summary.meta.others
    counts = Counter(name for names in data.entities_hit.values() for name in names if name in others)
    hit = join_with_and([f"{entity} in {count}" for entity, count in counts.most_common()])
    worst, impact = hardest[0]
    hard = f"hardest in scenario {worst}, at a relative speed of {impact.speed:.2g} m/s"
    sentences = [f"Yes: {ego} collides with {hit} of {scenarios}, {hard}."]
    manners = Counter(impact.shown_manner for _, impact in hardest)
    for manner, description in _MANNERS.items() if len(others) == 1 else ():
        if count := manners[manner]:
            sentences.append(f"{f'In {count}' if count < len(hardest) else 'Each time'} it {description}.")
    if faults := _describe_faults(data):
        sentences.append(faults)
    points = [
        f"Scenario {scenario}: {impact.speed:.2g} m/s, with {impact.entity} at {impact.time:.3g} s"
        + ("." if impact.fault is None else f"; {_describe_fault_with_reason(impact.fault, ego, impact.entity)}.")
        for scenario, impact in hardest[:_MAX_POINTS]
    ]
    room = min(_MAX_NEAR_MISSES, _MAX_POINTS - len(points))
    return Answer(name, question, " ".join(sentences), (*points, *describe_near_misses(misses[:room])))


def _describe_fault_with_reason(fault: Fault, ego: str, other: str) -> str:
    return f"{fault.describe(ego, other)}: {', '.join(fault.reasons)}" if fault.reasons else fault.describe(ego, other)


def _answer_replies(data: ReportData, replies: CollisionReactionCounts) -> Answer:
    meta = data.summary.meta
    other = meta.others[0] if len(meta.others) == 1 else "the other"
    text, points = describe_reactions(replies, meta.ego, other)
    references = describe_reference_drivers(data.summary.references).strip()
    return Answer("fix", "What do I fix?", text, (*filter(None, [references]), *points))


def _answer_nothing_to_avoid(data: ReportData) -> Answer:
    """Answer "What do I fix?" if nothing collides: name the nearest miss and the most critical scenario."""
    summary, sentences = data.summary, ["Nothing collided, so there is no collision to avoid."]
    if misses := sort_near_misses(data.approaches, {}):
        sentences.append(f"The margin was smallest in scenario {misses[0][0]}: {misses[0][1].describe()}.")
    if summary.estimates.critical is not None and summary.estimates.critical.n_critical and summary.metrics:
        name, metric = next(iter(summary.metrics.items()))
        score = append_unit(f"{metric.most_critical:.3g}", metric.unit)
        sentences.append(f"The most critical by {name} is scenario {metric.most_critical_id}, with {score}.")
    return Answer("fix", "What do I fix?", " ".join(sentences))


def _describe_faults(data: ReportData) -> str:
    """Describe who is at fault in how many collisions; empty for studies of early versions, which store no faults."""
    meta, counts = data.summary.meta, data.summary.faults
    other = meta.others[0] if len(meta.others) == 1 else "the other"
    subjects = {"ego": meta.ego, "other": other, "both": "both"}
    parts = [f"{name} in {counts[who]}" for who, name in subjects.items() if counts.get(who)]
    undecided = f"in {counts['undecided']} it is undecided" if counts.get("undecided") else ""
    if not parts:
        return f"Whose fault it is: {undecided}." if undecided else ""
    verb = "are" if len(parts) > 1 or counts["both"] else "is"
    return "; ".join(filter(None, (f"At fault {verb} {join_with_and(parts)}", undecided))) + "."


def _answer_critical_share(data: ReportData) -> Answer:
    name, question = "critical", "How much of the space is critical?"
    summary, critical = data.summary, data.summary.estimates.critical
    if critical is None:
        none = "There is no threshold from which a scenario is critical; give one with --critical."
        return Answer(name, question, none)
    criterion = format_criterion_with_signs(critical.criterion, summary.objective)
    estimates = critical.critical_set
    which_ran = "" if summary.meta.simulator == IMPORTED_SIMULATOR else " that were run"
    if summary.n_run == 1:
        counts = f"The one scenario that was run is {'' if critical.n_critical else 'not '}critical ({criterion})."
    elif critical.n_critical:
        verb = "is" if critical.n_critical == 1 else "are"
        who = "All" if critical.n_critical == summary.n_run else f"{critical.n_critical} of the"
        counts = f"{who} {summary.n_run} scenarios{which_ran} {verb} critical ({criterion})."
    else:
        counts = f"None of the {summary.n_run} scenarios{which_ran} is critical ({criterion})."
    # After collisions, the answer to "What do I fix?" has the references.
    counts += "" if summary.replies is not None else describe_reference_drivers(summary.references)
    if override := describe_threshold_override(summary):
        counts += f" {override}"
    if estimates is None:
        return Answer(name, question, f"{counts} {describe_too_few_scores()}")
    space = "the space, as far as it can be run," if data.failed else "the space"
    if estimates.interval_unavailable is not None:
        estimate = (
            f"{_describe_share(estimates.critical_fraction.value)} of {space} is critical. "
            if critical.n_critical
            else ""
        )
        return Answer(name, question, f"{estimate}{counts} There is no interval: {estimates.interval_unavailable}.")
    if not critical.n_critical:
        bound = (
            f"At most {format_percent(estimates.critical_fraction.high)} of {space} is critical"
            f" (upper end of a 90 % interval)."
        )
        if estimates.missed_interval_unavailable is None:
            bound = "These are all scenarios of the space."
        return Answer(name, question, f"{counts} {bound}")
    share = (
        f"{_describe_share(estimates.critical_fraction.value)} of {space} is critical"
        f" ({_format_interval(estimates.critical_fraction)})."
    )
    return Answer(name, question, f"{share} {counts}")


def _answer_missed(data: ReportData, critical: CriticalEstimates) -> Answer:
    sentences, estimates = [], critical.critical_set
    if estimates is None:
        sentences.append("That is unknown: there are too few different scores.")
    elif estimates.is_exhausted:
        sentences.append(
            f"Nothing: all scenarios of the space were run{'' if critical.n_critical else ', and none is critical'}."
        )
    elif not critical.n_critical:
        sentences.append("Nothing critical was found, so whatever is critical was missed.")
    elif estimates.missed_interval_unavailable is not None:
        sentences.append(f"{_describe_share(estimates.missed_fraction.value)} of the critical set.")
        sentences.append(f"There is no interval: {estimates.missed_interval_unavailable}.")
    # As long as no prediction missed a critical scenario, the interval begins at 0 in any case.
    elif estimates.missed_fraction.value >= _NEARLY_ALL and not 0.0 < estimates.missed_fraction.low < _NEARLY_ALL:
        # The share is one of volume, and single scenarios have no volume.
        subject = "one that was" if critical.n_critical == 1 else f"{critical.n_critical} that were"
        sentences.append(
            "By the model nearly all of the critical set, but it predicts hardly anything critical even around the"
            f" {subject} found, so it is of little use here."
        )
    else:
        sentences.append(
            f"{_describe_share(estimates.missed_fraction.value)} of the critical set"
            f" ({_format_interval(estimates.missed_fraction)})."
        )
    if estimates is not None and critical.n_critical and not estimates.is_exhausted:
        sentences.append(
            "That relies on a model. Without one: a region in which nothing was run could hide"
            f" {format_percent(estimates.max_fraction_in_empty_region)} of the critical set."
        )
    if critical.audits is not None:
        audits = f"{critical.audits.n_critical} of {critical.audits.n_scenarios} audits, drawn at random, are critical"
        if critical.audits.missed_fraction is not None and critical.audits.n_critical:
            audits += (
                f"; from these alone, without a model,"
                f" {format_percent(critical.audits.missed_fraction.value)} is missed"
                f" ({_format_interval(critical.audits.missed_fraction)})"
            )
        sentences.append(f"{audits}.")
    return Answer("missed", "What may be missed?", " ".join(sentences), tuple(describe_tested_space(data)))


def _answer_clusters(data: ReportData) -> Answer:
    name, question, analyses = "kinds", "Which kinds are there?", data.summary.analyses
    chosen = find_headline_aspect(data.summary.analyses)
    if chosen is None:
        return Answer(name, question, "The study has not been analysed yet; cornercase analyze finds the kinds.")
    divided = [by for by, analysis in analyses.items() if analysis.clustering.n_clusters > 1 and by != chosen]
    undivided = [by for by, analysis in analyses.items() if analysis.clustering.n_clusters <= 1]
    bands = tuple(f"{bands.describe()}." for by, bands in data.summary.bands.items() if by in undivided)
    if analyses[chosen].clustering.n_clusters <= 1:
        return Answer(name, question, f"There are no separate kinds by {join_with_and(undivided)}.", bands)
    analysis = analyses[chosen]
    noise = int((analysis.labels < 0).sum())
    outside = f", and {noise} scenarios of noise" if noise else ""
    compared = f" ({description})" if (description := describe_aspect(chosen)) else ""
    sentences = [f"By {chosen}{compared} there are {analysis.clustering.n_clusters} kinds{outside}."]
    if not has_useful_clusters(analysis):
        sentences.insert(0, "No useful kinds: none tell apart how scenarios end; points show the outcome.")
    points = [
        f"{format_cluster_title(profile, chosen)} ({profile.size} scenarios)."
        for profile in analysis.profiles
        if profile.cluster >= 0
    ]
    if len(points) > _MAX_POINTS:
        points = [*points[:_MAX_POINTS], f"{len(points) - _MAX_POINTS} smaller ones are listed below."]
    if divided:
        sentences.append(f"There are also kinds by {join_with_and(divided)}.")
    if undivided:
        sentences.append(f"There are no separate kinds by {join_with_and(undivided)}.")
    # Names of clusters that do not separate outcomes say nothing here; the details have them.
    points = [*(points if has_useful_clusters(analysis) else []), *bands]
    return Answer(name, question, " ".join(sentences), tuple(points))


def _answer_parameters(data: ReportData) -> Answer:
    name, question, sensitivity = "parameters", "Which parameters matter?", data.summary.estimates.sensitivity
    if data.summary.estimates.pareto_front is not None:
        return Answer(
            name, question, "This is known for a single score only; this study searches the Pareto front of several."
        )
    ranges = tuple(describe_danger_ranges(data))
    if sensitivity is None:
        return Answer(name, question, "There are too few different scores to say.", ranges)
    if not sensitivity.is_meaningful:
        return Answer(name, question, describe_missing_sensitivity(), ranges)
    order = sorted(range(len(sensitivity.names)), key=lambda k: (-sensitivity.total[k], k))
    points = [
        f"{sensitivity.names[k]}:"
        f" {_format_share_with_interval(sensitivity.total[k], sensitivity.total_interval[k])} together with the"
        f" others, {_format_share_with_interval(sensitivity.first[k], sensitivity.first_interval[k])} alone."
        for k in order[:_MAX_POINTS]
    ]
    little = describe_little_influence(sensitivity, " on that variance")
    text = (
        f"{sensitivity.names[order[0]]} matters most: {format_percent(sensitivity.total[order[0]])} of the variance of"
        f" {data.summary.objective} comes from it, alone or together with the others.{little} The shares come from a"
        f" Gaussian process that explains {format_percent(sensitivity.predicted)} of the variance"
        f" (cross-validated); intervals"
        " are of 90 %."
    )
    return Answer(name, question, text, (*points, *ranges))


def _format_share_with_interval(value: float, interval: tuple[float, float]) -> str:
    if interval[1] < _NEGLIGIBLE_SHARE:
        return f"below {format_percent(_NEGLIGIBLE_SHARE)}"
    return f"{format_percent(value)} ({format_percent(interval[0])} to {format_percent(interval[1])})"


def _answer_reduced_set(data: ReportData) -> Answer:
    name, question, reduced = "kept", "Which scenarios should be kept?", data.summary.reduced_set
    if reduced is None:
        return Answer(name, question, "The study has not been reduced yet; cornercase reduce finds the few to keep.")
    roles = Counter(str(scenario.role) for scenario in reduced.scenarios)
    counts = join_with_and([f"{n} {forms[n != 1]}" for role, forms in _ROLE_NAMES.items() if (n := roles[role])])
    sentences = [f"Keep {len(reduced.scenarios)} of the {reduced.n_run} scenarios: {counts or 'none'}."]
    sentences.append(_describe_selected_outcomes(data, reduced))
    if later := data.summary.n_run - reduced.n_run:
        sentences.append(f"{_format_scenarios_were(later)} run since.")
    headline = find_headline_aspect(data.summary.analyses)
    if headline is not None and reduced.by != headline and data.summary.analyses[headline].clustering.n_clusters > 1:
        sentences.append(f"They were chosen by {reduced.by}; 'cornercase reduce' chooses from the kinds above.")
    if chosen := describe_selection_threshold(data.summary):
        sentences.append(chosen)
    return Answer(name, question, " ".join([*sentences, *_describe_coverage(data, reduced)]))


def _describe_selected_outcomes(data: ReportData, reduced: ReducedSet) -> str:
    """Describe how many of the kept scenarios are critical, and in how many the ego collides."""
    selected = set(reduced.ids)
    n_critical = None
    if data.summary.estimates.critical is not None:
        n_critical = sum(data.rows[k].id in selected for k in np.flatnonzero(data.is_critical))
    return describe_dangers(
        len(selected), n_critical, len(selected & data.hardest_impacts.keys()), data.summary.meta.ego
    )


def _describe_coverage(data: ReportData, reduced: ReducedSet) -> Iterator[str]:
    critical = {name: entry.held_out for name, entry in reduced.critical.items() if entry.held_out is not None}
    by = reduced.by if reduced.by in critical else next(iter(critical), None)
    if by is not None:
        count = critical[by].scenarios
        covered = round(count * critical[by].critical)
        which = "every one is" if covered == count else f"{format_percent(critical[by].critical)} are"
        yield f"Of the held-out critical scenarios, {which} like a kept one by {by} ({covered} of {count})."
    elif reduced.by in reduced.critical and (share := reduced.critical[reduced.by].critical) is not None:
        # The threshold is not the one of the selection, so there are no held-out scenarios.
        yield f"{_describe_share(share)} of the critical scenarios that were run are like a kept one by {reduced.by}."
    graded = {name: entry.held_out for name, entry in reduced.coverage.items() if entry.held_out is not None}
    by = reduced.by if reduced.by in graded else next(iter(graded), None)
    if by is not None and by in data.summary.analyses:
        held_out, unit = graded[by], data.summary.analyses[by].unit
        yield (
            "The distance from a held-out scenario to the nearest kept one is"
            f" {append_unit(f'{held_out.mean:.3g}', unit)} on average by {by} (DTW distance);"
            f" {100.0 * held_out.better_mean:.0f} of 100 random choices of the same size leave more; k-medoids"
            f" leaves {append_unit(f'{held_out.medoids_mean:.3g}', unit)}."
        )


def _answer_front(data: ReportData) -> Answer:
    front = data.summary.estimates.pareto_front or {}
    return Answer(
        "front",
        "Which scenarios are on the Pareto front?",
        describe_front(len(front)),
        tuple(describe_most_critical_on_front(data)),
    )


def describe_most_critical_on_front(data: ReportData) -> Iterator[str]:
    """Yield a sentence for each metric that names the most critical scenario by this metric on the Pareto front."""
    front = data.summary.estimates.pareto_front or {}
    for metric in data.metrics:
        ids = sorted(front, key=lambda scenario: (metric.to_minimize(front[scenario][metric.name]), scenario))
        if ids:
            value = append_unit(f"{front[ids[0]][metric.name]:.3g}", metric.unit)
            yield f"The most critical {metric.name} on it is {value}, in scenario {ids[0]}."


def _answer_failures(data: ReportData) -> Answer:
    name, failed = "failed", data.failed
    # "Failed" is a verdict, too.
    question = "What could not be run?" if data.verdicts else "What failed, and why?"
    total = data.summary.n_run + data.summary.n_failed
    if not failed:
        return Answer(
            name,
            question,
            "Nothing: " + ("the one scenario" if total == 1 else f"all {total} scenarios") + " could be run.",
        )
    reasons = group_failures_by_reason(failed)
    points = [f"{len(ids)}: {why}" for why, ids in list(reasons.items())[:_MAX_POINTS]]
    note = f" The {_MAX_POINTS} most frequent reasons:" if len(reasons) > _MAX_POINTS else ""
    return Answer(name, question, f"{len(failed)} of {total} scenarios could not be run.{note}", tuple(points))


def _answer_verdicts(data: ReportData) -> Answer:
    failed = {row.id for row in data.failed}
    states = {scenario: worst_state(verdicts) for scenario, verdicts in data.verdicts.items()}
    counts = Counter("not run" if scenario in failed else state for scenario, state in states.items())
    parts = [f"{counts[state]} {state}" for state in ("passed", "failed", "inconclusive", "not run") if counts[state]]
    files = data.summary.meta.files
    violations = [
        f"{files[scenario - 1]} (scenario {scenario}): {verdict.reason}; required: {verdict.requirement}."
        for scenario, verdicts in data.verdicts.items()
        for verdict in verdicts
        if verdict.state == "failed"
    ]
    note = f" The first {_MAX_POINTS} requirements that failed:" if len(violations) > _MAX_POINTS else ""
    text = f"{', '.join(parts)} of {len(states)} scenarios.{note}"
    if len(violations) == 1:
        return Answer("verdicts", "Did it pass?", f"{text} {violations[0]}")
    return Answer("verdicts", "Did it pass?", text, tuple(violations[:_MAX_POINTS]))


def _answer_probability(estimate: Any) -> Answer:
    criterion = use_math_signs(estimate["critical is"])
    sentences = []
    for event, description in (("critical", f"A scenario is critical ({criterion})"), ("collision", "It collides")):
        low, high = estimate[event]["95 % interval"]
        if not estimate[event]["met in"]:
            bound = f"with a probability of at most {high:.3g} (95 %)" if high else "in no scenario of the space"
            sentences.append(f"{description} {bound}.")
            continue
        sentences.append(
            f"{description} with a probability of {estimate[event]['probability']:.3g}"
            f" (95 % interval {low:.3g} to {high:.3g})."
        )
    sentences.append(f"Estimated from {estimate['scenarios']} scenarios.")
    return Answer("probability", "How probable is it?", " ".join([*sentences, *estimate["warnings"]]))
