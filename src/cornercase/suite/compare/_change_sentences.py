"""Describe in sentences what changed between two versions: verdict, collisions, critical share, tests, clusters."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from cornercase._common.text.sanitize import quote_name
from cornercase.suite.compare._comparison import (
    ALPHA,
    CRITICAL_SETS_METHOD,
    ChangeTest,
    ClusterChange,
    Comparison,
    ScenarioPair,
    format_pair_ids,
)

# Largest number of scenarios, and of kinds, that a sentence names.
_MAX_SCENARIOS: Final = 5
_MAX_KINDS: Final = 4
_HEADLINES: Final[Mapping[str, str]] = {
    "worse": "Worse: nothing is better",
    "better": "Better: nothing is worse",
    "mixed": "Mixed: some scenarios are worse, others better",
    "the same": "The same: nothing is better or worse",
    "cannot say": "It cannot be said which is better",
}


def describe_verdict(comparison: Comparison) -> str:
    """Return the verdict of a comparison as a sentence without a period."""
    return _HEADLINES[comparison.verdict]


def describe_changes(comparison: Comparison) -> tuple[str, ...]:
    """Return sentences on what changed: collisions, critical share, significance tests, and clusters of scenarios."""
    return tuple(_iter_changes(comparison))


def _iter_changes(comparison: Comparison) -> Iterator[str]:
    ran = [pair for pair in comparison.pairs if pair.both_ran]
    if ran:
        yield _describe_collisions(ran)
    else:
        yield "No scenario ran with both versions, so none can be set beside another."
    yield _describe_critical_share(comparison, ran)
    yield from _describe_tests(comparison)
    yield from _describe_kinds(comparison)


def _describe_collisions(ran: Sequence[ScenarioPair]) -> str:
    new = [pair for pair in ran if pair.collides == (False, True)]
    lost = [pair for pair in ran if pair.collides == (True, False)]
    both = [pair for pair in ran if pair.collides == (True, True)]
    of = f"of {_format_count(len(ran), 'scenario')} that ran with both"
    if not new and not lost:
        others = (
            f"{len(both)} {_format_collide_verb(len(both))} in both versions{_describe_faults(both, 1)}"
            if both
            else "none collides"
        )
        return f"Collisions: none is new and none is gone; {of}, {others}."
    parts = [
        f"{len(new) or 'none'} new{_list_pair_ids(new)}{_describe_faults(new, 1)}",
        f"{len(lost) or 'none'} gone{_list_pair_ids(lost)}{_describe_faults(lost, 0)}",
    ]
    verb = _format_collide_verb(len(both))
    return f"Collisions: {'; '.join(parts)}; {of}, {len(both) or 'none'} {verb} in both versions."


def _list_pair_ids(pairs: Sequence[ScenarioPair]) -> str:
    n_more = len(pairs) - _MAX_SCENARIOS
    texts = [format_pair_ids(pair.ids) for pair in pairs[:_MAX_SCENARIOS]]
    return f" ({', '.join(texts)}{f' and {n_more} more' if n_more > 0 else ''})" if pairs else ""


def _describe_faults(pairs: Sequence[ScenarioPair], side: int) -> str:
    """Return as text who is at fault in collisions with the old (`side` 0) or new (1) version; empty if unknown."""
    counts = Counter(pair.faults[side] for pair in pairs)
    unknown = counts.pop("", 0)
    if not counts:
        return ""
    if len(pairs) == 1:
        return f", {next(iter(counts))}"
    texts = [
        f"{fault} in {'all' if count == len(pairs) else count}"
        for fault, count in sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    ]
    return f", {', '.join(texts)}{f', unknown in {unknown}' if unknown else ''}"


def _describe_critical_share(comparison: Comparison, ran: Sequence[ScenarioPair]) -> str:
    space = comparison.space
    if space is not None and space.shares is not None and space.change is not None:
        before, after = (f"{100.0 * estimate.value:.1f} %" for estimate in space.shares)
        change = space.change
        points = ", ".join(f"{100.0 * value + 0.0:+.1f}" for value in (change.low, change.high)).replace(", ", " to ")
        n_old, n_new = space.counts
        sample = (
            f"{n_old} scenarios that fill the space and ran with both"
            if space.pairs == n_old
            else f"{n_old} and {n_new} scenarios that fill the space, which are not the same ones"
        )
        certain = _describe_direction(change.low, change.high)
        return (
            f"Critical share of the space: {before} before, {after} now; change {100.0 * change.value + 0.0:+.1f}"
            f" percentage points (90 % interval {points}), so {certain}; from {sample}."
        )
    judged = [pair.is_critical for pair in ran if pair.is_critical is not None]
    if not judged:
        return (
            "Critical share: not compared, as there is no threshold that both studies have; give one with --critical."
        )
    counts = [sum(both[side] for both in judged) for side in (0, 1)]
    why = "they do not stand for the space" if space is None else space.pairs_doubt
    return (
        f"Critical: {counts[0]} before and {counts[1]} now, of {_format_count(len(judged), 'scenario')} that ran with"
        f" both; there is no interval, as {why}."
    )


def _describe_direction(low: float, high: float) -> str:
    if low > 0.0:
        return "it has grown"
    if high < 0.0:
        return "it has shrunk"
    return "it may have grown or shrunk, or be the same"


def _describe_tests(comparison: Comparison) -> Iterator[str]:
    """Yield sentences on the tests of collisions and criticality, on other significant tests, and on determinism."""
    facts = [test for test in comparison.tests if test.about in ("collision", "critical") and test.differ != 0]
    for test in facts:
        claim = "more than chance" if test.corrected <= ALPHA else "that may be chance"
        n_tests = _format_count(len(comparison.tests), "test")
        p = f"p = {test.p:.2g}, {test.corrected:.2g} after correction for {n_tests}"
        if test.method == CRITICAL_SETS_METHOD:
            yield f"Draws of both critical sets, whether their shares of the space are the same: {p}; {claim}."
            continue
        if test.differ is None:
            yield (
                f"Fisher's exact test, whether {_describe_null_hypothesis(test)} in both samples ({test.old} and"
                f" {test.new} scenarios that fill the space): {p}; {claim}."
            )
            continue
        came = round((test.differ + test.shift * test.old) / 2.0)
        went = test.differ - came
        event = "became critical" if test.about == "critical" else "began to collide"
        end = "are critical no longer" if test.about == "critical" else "collide no longer"
        yield (
            f"McNemar's exact test on {test.old} pairs, whether as many scenarios {event} as {end}: {came} and {went};"
            f" {p}; {claim}."
        )
    for test in comparison.tests:
        if test.about not in ("collision", "critical") and test.differ != 0 and test.corrected <= ALPHA:
            yield (
                f"{test.method} test of {test.about}: p = {test.p:.2g}, {test.corrected:.2g} after"
                f" correction for {_format_count(len(comparison.tests), 'test')}; more than chance."
            )
    if comparison.is_deterministic and any(test.differ for test in facts):
        yield (
            "Runs are deterministic, so each pair that differs shows a change; the tests say whether it is more than a"
            " matter of which scenarios were run."
        )


def _describe_null_hypothesis(test: ChangeTest) -> str:
    return "as many are critical" if test.about == "critical" else "as many collide"


def _describe_kinds(comparison: Comparison) -> Iterator[str]:
    old, new = comparison.names
    if not any(pair.both_ran for pair in comparison.pairs):
        return
    kinds = comparison.clusters.get(comparison.main_aspect, ())
    if not kinds:
        yield f"Kinds of scenarios: not compared, as {old} was not analysed; cornercase analyze {old} finds them."
        return
    named = [kind for kind in kinds if kind.cluster >= 0]
    changes = {
        "grew": [kind for kind in named if 0 < kind.old < kind.new],
        "shrank": [kind for kind in named if 0 < kind.new < kind.old],
        "appeared": [kind for kind in named if not kind.old and kind.new],
        "vanished": [kind for kind in named if kind.old and not kind.new],
    }
    parts = [f"{verb}: {_list_kinds(group, old)}" for verb, group in changes.items() if group]
    text = "; ".join(parts) or "none grew or shrank"
    unlike = next((kind.new - kind.old for kind in kinds if kind.cluster < 0 and kind.new > kind.old), 0)
    if unlike:
        text += f"; {unlike} more are like no kind of {old}, and cornercase analyze {new} finds what kinds they are"
    yield f"Kinds by {comparison.main_aspect}, by the names of {old}, among the pairs: {text}."


def _list_kinds(kinds: Sequence[ClusterChange], old: str) -> str:
    ordered = sorted(kinds, key=lambda kind: (-abs(kind.new - kind.old), kind.cluster))
    texts = [f"“{kind.label}” {kind.old} → {kind.new}{_describe_new_endings(kind)}" for kind in ordered[:_MAX_KINDS]]
    more = len(ordered) - _MAX_KINDS
    return ", ".join(texts) + (f" and {more} more" if more > 0 else "")


def _describe_new_endings(kind: ClusterChange) -> str:
    """Return as text how the scenarios of a cluster end now, if some end in a way that is new in this cluster.

    The name of the cluster may be outdated then. Otherwise the text is empty.
    """
    if not kind.new or set(kind.new_outcomes) <= set(kind.old_outcomes):
        return ""
    return f" (now: {format_outcomes(kind.new_outcomes)})"


def format_outcomes(outcomes: Mapping[str, int]) -> str:
    """Return endings with the number of scenarios for each as text, such as ``"no collision 12, collision 3"``."""
    return ", ".join(f"{outcome} {count}" for outcome, count in outcomes.items())


def describe_unpaired_scenarios(comparison: Comparison) -> Iterator[str]:
    """Yield sentences on the scenarios that ran in one study only: how many, why, and what follows for the verdict."""
    if comparison.unpaired is None or not any(comparison.n_unmatched):
        return
    for name, side in zip(comparison.names, comparison.unpaired, strict=True):
        if side.count:
            facts = [f"{side.collisions or 'none'} collide"]
            if side.critical is not None:
                facts.append(f"{side.critical or 'none'} critical")
            facts.append(f"{side.chosen_by_scores or 'none'} chosen by the scores of this version")
            yield f"Without a partner: {side.count} of {name} ({', '.join(facts)})"
    if any(side.chosen_by_scores for side in comparison.unpaired) and comparison.same_search:
        yield (
            "Why: a search goes where its own scores lead it, so with each version it ran other scenarios after the"
            " same beginning"
        )
    elif not comparison.same_search:
        yield "Why: the studies were explored with other searches or seeds, which choose other scenarios"
    else:
        yield "Why: one study ran scenarios that the other did not"
    counted = (
        "in the verdict only tests of samples without pairs count them"
        if any(test.differ is None for test in comparison.tests)
        else "no number of the verdict is of them"
    )
    yield f"What follows: what changed in them is not known, and {counted}"
    if comparison.unpaired[0].chosen_by_scores:
        old, new = map(quote_name, comparison.names)
        yield (
            f"To run those that stand for {old} with the new version: cornercase reduce {old} -o suite, then cornercase"
            f" test suite -o run.db with the driver of {new}, then cornercase compare {old} run.db"
        )


def _format_collide_verb(number: int) -> str:
    return "collide" if number > 1 else "collides"


def _format_count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
