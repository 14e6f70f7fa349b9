"""Describe a comparison of two versions in words."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, TypeAlias

from cornercase.evidence import Estimate
from cornercase.suite.compare._change_sentences import (
    describe_changes,
    describe_unpaired_scenarios,
    describe_verdict,
    format_outcomes,
)
from cornercase.suite.compare._comparison import (
    ALPHA,
    Comparison,
    ScenarioPair,
    SpaceChange,
    describe_findings,
    format_pair_ids,
)

Cell: TypeAlias = str | tuple[tuple[int, int], ...]
"""A cell of a table: a text, or ids of scenarios in both studies."""

MAX_TABLE_SCENARIOS: Final = 40
"""Largest number of scenarios that a finding names in a table."""


@dataclass(frozen=True)
class ComparisonSection:
    """A section of a comparison report; `header` is the first row of the table in the section, empty without a table.

    `key` is ``"answer"``, ``"changes"``, ``"findings"``, ``"pairs"``, ``"scores"``, ``"outcomes"``, ``"verdicts"``,
    ``"tests"``, ``"space"``, ``"kinds"`` or ``"telling"``.
    """

    key: str
    title: str
    sentences: tuple[str, ...] = ()
    header: tuple[str, ...] = ()
    rows: tuple[tuple[Cell, ...], ...] = ()

    @property
    def text_rows(self) -> tuple[tuple[str, ...], ...]:
        """Rows of the table, with all cells as text."""
        return tuple(tuple(map(_format_cell, row)) for row in self.rows)


def describe_comparison(comparison: Comparison) -> tuple[ComparisonSection, ...]:
    """Describe a comparison in sections; the answer comes first, and empty sections are left out."""
    return tuple(_iter_sections(comparison))


def _iter_sections(comparison: Comparison) -> Iterator[ComparisonSection]:
    yield _answer_section(comparison)
    yield ComparisonSection("changes", describe_verdict(comparison), describe_changes(comparison))
    if comparison.worse or comparison.better:
        yield _findings_section(comparison)
    yield from _pair_sections(comparison)
    if comparison.tests:
        yield _tests_section(comparison)
    if comparison.space is not None:
        yield _space_section(comparison.space)
    yield from _cluster_sections(comparison)
    if comparison.examples:
        rows = tuple(
            ((example.pair.ids,), _format_parameters(example.pair), example.reason) for example in comparison.examples
        )
        yield ComparisonSection("telling", "Example scenarios", header=("scenario", "parameters", "why"), rows=rows)


def _answer_section(comparison: Comparison) -> ComparisonSection:
    differences = comparison.differences or ("The studies were made with the same settings.",)
    sentences = list(differences)
    if not comparison.verdict_reason.startswith(comparison.reason):
        sentences.append(f"{'Changed' if comparison.changed else 'No change'}: {comparison.reason}")
    if comparison.within_tolerance:
        sentences.append(
            f"Within the tolerances, so it does not count: {describe_findings(comparison.within_tolerance)}"
        )
    sentences.append(f"Tolerances: {', '.join(_format_tolerances(comparison))}")
    if comparison.critical is not None:
        sentences.append(f"Threshold of criticality: {comparison.critical:g}.")
    return ComparisonSection("answer", comparison.headline, tuple(sentences))


def _format_tolerances(comparison: Comparison) -> Iterator[str]:
    for name, value in comparison.tolerances.items():
        unit = comparison.metrics[name].unit
        yield f"{name} {value:g}" if unit == "1" else f"{name} {value:g} {unit}"


def _findings_section(comparison: Comparison) -> ComparisonSection:
    findings = (*comparison.worse, *comparison.better)
    tests = ("test",) if any(finding.test for finding in findings) else ()
    rows: tuple[tuple[Cell, ...], ...] = tuple(
        (
            finding.direction,
            finding.change_text,
            finding.ids,
            *([finding.describe_test()] if tests else []),
        )
        for finding in findings
    )
    return ComparisonSection("findings", "Worse and better", header=("", "what", "scenarios", *tests), rows=rows)


def _pair_sections(comparison: Comparison) -> Iterator[ComparisonSection]:
    runs = {
        "identical": comparison.count_pairs("the same"),
        "the same up to rounding": comparison.count_pairs("within rounding"),
        "different": comparison.count_pairs("otherwise"),
        "with one version only": comparison.count_pairs("not in one"),
        "with neither": comparison.count_pairs("in neither"),
    }
    counts = ", ".join(f"{count} {label}" for label, count in runs.items() if count)
    sentences = [f"{len(comparison.pairs)} scenarios with the same parameters" + (f": {counts}" if counts else "")]
    sentences += describe_unpaired_scenarios(comparison)
    if not comparison.is_deterministic and comparison.pairs:
        n_independent = sum(item.is_score_independent for item in comparison.pairs)
        sentences.append(f"{n_independent} of them were chosen independently of scores; only those are tested")
    yield ComparisonSection("pairs", "Pairs", tuple(sentences))
    if any(item.moved for item in comparison.scores):
        yield ComparisonSection(
            "scores",
            "Scores",
            header=("metric", "moved", "more critical", "less critical", "median change", "largest", "in scenario"),
            rows=tuple(
                (
                    item.metric,
                    f"{item.moved} of {item.pairs}",
                    str(item.worse),
                    str(item.better),
                    _format_signed(item.median, item.unit),
                    _format_signed(item.largest, item.unit),
                    "" if item.ids is None else (item.ids,),
                )
                for item in comparison.scores
            ),
        )
    changed = sorted(
        (pair for pair in comparison.outcomes.items() if pair[0][0] != pair[0][1]), key=lambda item: (-item[1], item[0])
    )
    if changed:
        rows = tuple(
            (
                before,
                after,
                str(count),
                tuple(pair.ids for pair in comparison.pairs if pair.outcomes == (before, after)),
            )
            for (before, after), count in changed
        )
        header = ("old", "new", "number", "scenarios")
        yield ComparisonSection("outcomes", "Outcomes that changed", header=header, rows=rows)
    if comparison.verdicts:
        changed_verdicts = sorted((item, count) for item, count in comparison.verdicts.items() if item[1] != item[2])
        verdicts = tuple(
            (*item, str(count), tuple(pair.ids for pair in comparison.pairs if item in _verdict_changes(pair)))
            for item, count in changed_verdicts
        )
        n_same = sum(count for item, count in comparison.verdicts.items() if item[1] == item[2])
        columns = ("requirement", "old", "new", "number", "scenarios") if verdicts else ()
        yield ComparisonSection("verdicts", "Verdicts", (f"{n_same} are the same",), columns, verdicts)


def _verdict_changes(pair: ScenarioPair) -> set[tuple[str, str, str]]:
    return {(old.requirement, old.state, new.state) for old, new in pair.changed_verdicts}


def _tests_section(comparison: Comparison) -> ComparisonSection:
    rows = []
    for test in comparison.tests:
        if test.differ is None:
            about = f"{test.old} and {test.new} scenarios"
        else:
            about = f"{test.differ} of {test.old} pairs differ"
        claim = "differs" if test.corrected <= ALPHA else "–"
        rows.append((test.about, test.method, about, f"{test.p:.2g}", f"{test.corrected:.2g}", claim))
    level = f"the false positive rate over all tests is at most {ALPHA:.0%} (Holm)"
    return ComparisonSection("tests", "Tests", (level,), ("of", "test", "looked at", "p", "corrected", ""), tuple(rows))


def _space_section(space: SpaceChange) -> ComparisonSection:
    sentences: list[str] = []
    if space.gained is not None and space.lost is not None:
        sentences.append(
            f"by {space.pairs} space-filling scenarios that ran with both: critical only now"
            f" {_format_percentage(space.gained)}, no longer {_format_percentage(space.lost)} (90"
            f" %, Clopper and Pearson)"
        )
    else:
        sentences.append(f"no interval from pairs: {space.pairs_doubt}")
    if space.sets is None:
        sentences.append(f"no interval from all scenarios: {space.sets_doubt}")
        return ComparisonSection("space", "The critical part of the space", tuple(sentences))
    sets = space.sets
    rows: list[tuple[str, ...]] = [
        ("critical share", _format_percentage(sets.old), _format_percentage(sets.new), _format_percentage(sets.change)),
        ("critical only now", "", _format_percentage(sets.gained), ""),
        ("no longer critical", _format_percentage(sets.lost), "", ""),
    ]
    for name, unit, middle in zip(space.parameters, space.units, sets.middles, strict=True):
        if middle is not None:
            rows.append((f"middle in {name}", *(_format_estimate(value, unit) for value in middle)))
    return ComparisonSection(
        "space",
        "The critical part of the space",
        (*sentences, "from all scenarios of both, with 90 % intervals:"),
        ("", "old", "new", "change"),
        tuple(rows),
    )


def _cluster_sections(comparison: Comparison) -> Iterator[ComparisonSection]:
    for by, kinds in comparison.clusters.items():
        if any(cluster.old != cluster.new for cluster in kinds):
            rows = tuple(
                (
                    cluster.label,
                    str(cluster.old),
                    format_outcomes(cluster.old_outcomes),
                    str(cluster.new),
                    format_outcomes(cluster.new_outcomes),
                    _describe_size_change(cluster.old, cluster.new),
                    cluster.ids,
                )
                for cluster in kinds
            )
            old, new = comparison.names
            yield ComparisonSection(
                "kinds",
                f"Kinds by {by}, among the pairs",
                (f"named by what they are in {old}; what they do with {new} may be something else",),
                ("kind", "old", "what it does there", "new", "what it does there", "", "scenarios in it once"),
                rows,
            )


def _describe_size_change(old: int, new: int) -> str:
    if old == new:
        return ""
    return "vanished" if not new else "appeared" if not old else "grew" if new > old else "shrank"


def _format_cell(cell: Cell) -> str:
    """Return a cell as text; at most `MAX_TABLE_SCENARIOS` scenarios are named, the others are counted."""
    if isinstance(cell, str):
        return cell
    n_more = len(cell) - MAX_TABLE_SCENARIOS
    return ", ".join(map(format_pair_ids, cell[:MAX_TABLE_SCENARIOS])) + (f" and {n_more} more" if n_more > 0 else "")


def _format_parameters(pair: ScenarioPair) -> str:
    return ", ".join(
        f"{name} {value:.6g}" if isinstance(value, float) else f"{name} {value}" for name, value in pair.values.items()
    )


def _format_signed(value: float, unit: str) -> str:
    return f"{value:+.3g} {'' if unit == '1' else unit}".rstrip() if value else "0"


def _format_percentage(estimate: Estimate) -> str:
    value, low, high = (f"{round(number, 3) + 0.0:.1%}" for number in (estimate.value, estimate.low, estimate.high))
    return f"{value} ({low} to {high})"


def _format_estimate(estimate: Estimate, unit: str) -> str:
    # Only digits that the interval supports.
    digits = max(0, 2 - math.ceil(math.log10(max(estimate.high - estimate.low, 1e-9))))
    value, low, high = (
        f"{number + 0.0:.{digits}f}"
        for number in (round(x, digits) for x in (estimate.value, estimate.low, estimate.high))
    )
    return f"{value} ({low} to {high}) {'' if unit == '1' else unit}".rstrip()
