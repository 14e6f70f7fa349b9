"""Sentences on the next steps after a comparison: what to fix, what to look at, and what was not tested."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from cornercase._common.text.sanitize import quote_name
from cornercase.report.comparison._replayed_pairs import format_ids
from cornercase.study import StudyFile
from cornercase.suite import Comparison, ScenarioPair

_MAX_NAMED: Final = 3
_MAX_ON_TRACK: Final = 5


def describe_next_steps(comparison: Comparison, new: StudyFile) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield questions about the next steps after a comparison, each with sentences as answer.

    Scenario ids in the sentences are in brackets, except in commands.
    """
    yield "What to fix?", tuple(_describe_fixes(comparison, new))
    yield "What next?", tuple(_describe_hand_over(comparison))
    yield "What was not tested?", tuple(_describe_gaps(comparison))


def _describe_fixes(comparison: Comparison, new: StudyFile) -> Iterator[str]:
    hits = [pair for pair in comparison.pairs if pair.both_ran and pair.collides[1]]
    lost = [pair for pair in hits if not pair.collides[0]]
    impacts = {pair.ids: new.digest(pair.ids[1]).outcomes[0].impacts for pair in hits}

    def hardest(pairs: list[ScenarioPair]) -> list[ScenarioPair]:
        def speed(pair: ScenarioPair) -> float:
            speeds = [impact.speed for impact in impacts[pair.ids] if math.isfinite(impact.speed)]
            return max(speeds, default=0.0)

        return sorted(pairs, key=lambda pair: (-speed(pair), pair.ids))

    for pair in hardest(lost or hits)[:_MAX_NAMED]:
        impact = impacts[pair.ids][0]
        fault = "" if impact.fault is None else f"; {impact.fault.describe(new.meta.ego, impact.entity)}"
        reasons = f": {', '.join(impact.fault.reasons)}" if impact.fault is not None and impact.fault.reasons else ""
        yield (
            f"{'A new collision' if lost else 'A collision with both versions'} ({format_ids(pair.ids)}), with"
            f" {quote_name(impact.entity)} at {impact.time:.3g} s and a relative speed of {impact.speed:.2g}"
            f" m/s{fault}{reasons}."
        )
    others = [finding for finding in comparison.worse if finding.kind != "collision" and finding.ids]
    # Worse scores are named only if nothing else is worse.
    grave = [finding for finding in others if finding.kind != "score"]
    if not lost:
        for finding in grave or others[:1]:
            yield f"{finding.change_text[0].upper()}{finding.change_text[1:]} ({finding.format_scenario_ids()})."
    if not hits and not comparison.worse:
        yield "Nothing is worse, and nothing that both ran collides with the new version."
    elif not lost and not comparison.worse:
        yield "Nothing is worse; these collisions were there before."


def _describe_hand_over(comparison: Comparison) -> Iterator[str]:
    """Yield sentences on the files to hand over to developers and authorities, and on tests for a proving ground."""
    findings = (*comparison.worse, *comparison.better)
    # What is worse comes before what is better; each scenario once.
    changed = list(dict.fromkeys(ids for finding in findings for ids in finding.ids))[:_MAX_ON_TRACK]
    name = quote_name(comparison.names[1])
    if comparison.worse and changed:
        yield f"Developer: this page, and the replay of one: cornercase replay {name} {changed[0][1]} -o run.html"
    yield "Safety and authority: the verdict above, with the tests beside it, and this page for the details."
    if changed:
        ids, named = ",".join(str(pair_ids[1]) for pair_ids in changed), ", ".join(map(format_ids, changed))
        steps = f"cornercase report {name} --test-cards --ids {ids} -o cards.html"
        yield f"Proving ground: what changed, with both versions ({named}): {steps}"


def _describe_gaps(comparison: Comparison) -> Iterator[str]:
    failed = comparison.count_pairs("in neither")
    n_in_one = comparison.count_pairs("not in one")
    if any(comparison.n_unmatched):
        old, new = comparison.n_unmatched
        names = comparison.names
        yield f"{old} scenarios of {names[0]} with the new version, and {new} of {names[1]} with the old one."
    if failed or n_in_one:
        yield f"{failed} scenarios could be run with neither version, and {n_in_one} with one only."
    n_pairs = comparison.space.pairs if comparison.space is not None else 0
    if n_pairs:
        # A region with this share of the space is missed by all of n random draws with a probability of 5 %.
        share = 1.0 - 0.05 ** (1.0 / n_pairs)
        yield (
            f"What changed only in a small part of the space: {n_pairs} scenarios that fill it miss a region of"
            f" {100.0 * share:.1f} % of the space with a probability of 5 %, and smaller ones more probably."
        )
    else:
        yield "How much of the space changed: no scenarios that fill the space ran with both versions."
    yield "Anything outside of the ranges of the parameters, which are listed below."
