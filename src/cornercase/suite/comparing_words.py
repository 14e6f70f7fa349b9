"""Describe a comparison of two versions in words."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from cornercase.evidence import Estimate
from cornercase.metrics import METRICS
from cornercase.suite.comparing_results import LEVEL, Comparison, Pair, SpaceChange, tell_findings

NAMED: Final = 40
"""Largest number of scenarios that a finding names in a table."""


@dataclass(frozen=True)
class Section:
    """A section of a comparison report; `header` is empty without a table.

    `key` is ``"answer"``, ``"findings"``, ``"pairs"``, ``"scores"``, ``"outcomes"``, ``"verdicts"``, ``"tests"``,
    ``"space"``, ``"kinds"`` or ``"telling"``.
    """

    key: str
    title: str
    sentences: tuple[str, ...] = ()
    header: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()


def tell_comparison(found: Comparison) -> tuple[Section, ...]:
    """Describe a comparison in sections, the answer first; empty sections are left out."""
    return tuple(_sections(found))


def _sections(found: Comparison) -> Iterator[Section]:
    yield _answer(found)
    if found.worse or found.better:
        yield _findings(found)
    yield from _pairs(found)
    if found.tests:
        yield _tests(found)
    if found.space is not None:
        yield _space(found.space)
    yield from _kinds(found)
    if found.telling:
        rows = tuple((_both(example.pair.ids), _values(example.pair), example.why) for example in found.telling)
        yield Section("telling", "Example scenarios", header=("old, new", "parameters", "why"), rows=rows)


def _answer(found: Comparison) -> Section:
    differences = found.differences or ("The studies were made with the same settings.",)
    sentences = list(differences)
    if not found.verdict_reason.startswith(found.reason):
        sentences.append(f"{'Changed' if found.changed else 'No change'}: {found.reason}")
    if found.within:
        sentences.append(f"Within the tolerances, so it does not count: {tell_findings(found.within)}")
    sentences.append(f"Tolerances: {', '.join(_tolerances(found))}")
    if found.critical is not None:
        sentences.append(f"Threshold of criticality: {found.critical:g}.")
    return Section("answer", found.headline, tuple(sentences))


def _tolerances(found: Comparison) -> Iterator[str]:
    for name, value in found.tolerances.items():
        unit = METRICS.create(name).unit
        yield f"{name} {value:g}" if unit == "1" else f"{name} {value:g} {unit}"


def _findings(found: Comparison) -> Section:
    findings = (*found.worse, *found.better)
    tests = ("test",) if any(finding.test for finding in findings) else ()
    rows = tuple(
        (finding.direction, finding.what, finding.name_scenarios(NAMED), *([finding.tell_test()] if tests else []))
        for finding in findings
    )
    return Section("findings", "Worse and better", header=("", "what", "scenarios", *tests), rows=rows)


def _pairs(found: Comparison) -> Iterator[Section]:
    old, new = found.names
    runs = {
        "the same bytes": found.count("the same"),
        "the same up to rounding": found.count("within rounding"),
        "different": found.count("otherwise"),
        "with one version only": found.count("not in one"),
        "with neither": found.count("in neither"),
    }
    counts = ", ".join(f"{count} {label}" for label, count in runs.items() if count)
    sentences = [f"{len(found.pairs)} scenarios with the same parameters" + (f": {counts}" if counts else "")]
    if any(found.alone):
        sentences.append(f"without a partner: {found.alone[0]} of {old}, {found.alone[1]} of {new}")
    if not found.certain and found.pairs:
        n_independent = sum(item.unselected for item in found.pairs)
        sentences.append(f"{n_independent} of them were chosen independently of scores; only those are tested")
    yield Section("pairs", "Pairs", tuple(sentences))
    if any(item.moved for item in found.scores):
        yield Section(
            "scores",
            "Scores",
            header=("metric", "moved", "more critical", "less critical", "median change", "largest", "in (old, new)"),
            rows=tuple(
                (
                    item.metric,
                    f"{item.moved} of {item.pairs}",
                    str(item.worse),
                    str(item.better),
                    _signed(item.median, item.unit),
                    _signed(item.largest, item.unit),
                    "" if item.ids is None else _both(item.ids),
                )
                for item in found.scores
            ),
        )
    changed = sorted(
        (pair for pair in found.outcomes.items() if pair[0][0] != pair[0][1]), key=lambda item: (-item[1], item[0])
    )
    if changed:
        rows = tuple((before, after, str(count)) for (before, after), count in changed)
        yield Section("outcomes", "Outcomes that changed", header=("old", "new", "scenarios"), rows=rows)
    if found.verdicts:
        changed_verdicts = sorted((item, count) for item, count in found.verdicts.items() if item[1] != item[2])
        verdicts = tuple((*item, str(count)) for item, count in changed_verdicts)
        n_same = sum(count for item, count in found.verdicts.items() if item[1] == item[2])
        header = ("requirement", "old", "new", "scenarios") if verdicts else ()
        yield Section("verdicts", "Verdicts", (f"{n_same} are the same",), header, verdicts)


def _tests(found: Comparison) -> Section:
    rows = []
    for test in found.tests:
        if test.differ is None:
            about = f"{test.old} and {test.new} scenarios"
        else:
            about = f"{test.differ} of {test.old} pairs differ"
        claim = "differs" if test.corrected <= LEVEL else "–"
        rows.append((test.about, test.method, about, f"{test.p:.2g}", f"{test.corrected:.2g}", claim))
    level = f"the false positive rate over all tests is at most {LEVEL:.0%} (Holm)"
    return Section("tests", "Tests", (level,), ("of", "test", "looked at", "p", "corrected", ""), tuple(rows))


def _space(space: SpaceChange) -> Section:
    sentences: list[str] = []
    if space.gained is not None and space.lost is not None:
        sentences.append(
            f"by {space.pairs} space-filling scenarios that ran with both: critical only now"
            f" {_share(space.gained)}, no longer {_share(space.lost)} (90 %, Clopper and Pearson)"
        )
    else:
        sentences.append(f"no interval from pairs: {space.pairs_doubt}")
    if space.sets is None:
        sentences.append(f"no interval from all scenarios: {space.sets_doubt}")
        return Section("space", "The critical part of the space", tuple(sentences))
    sets = space.sets
    rows: list[tuple[str, ...]] = [
        ("critical share", _share(sets.old), _share(sets.new), _share(sets.change)),
        ("critical only now", "", _share(sets.gained), ""),
        ("no longer critical", _share(sets.lost), "", ""),
    ]
    for name, unit, middle in zip(space.parameters, space.units, sets.middles, strict=True):
        if middle is not None:
            rows.append((f"middle in {name}", *(_estimate(value, unit) for value in middle)))
    return Section(
        "space",
        "The critical part of the space",
        (*sentences, "from all scenarios of both, with 90 % intervals:"),
        ("", "old", "new", "change"),
        tuple(rows),
    )


def _kinds(found: Comparison) -> Iterator[Section]:
    for by, kinds in found.kinds.items():
        if any(cluster.old != cluster.new for cluster in kinds):
            rows = tuple(
                (cluster.label, str(cluster.old), str(cluster.new), _fate(cluster.old, cluster.new))
                for cluster in kinds
            )
            yield Section("kinds", f"Kinds by {by}, among the pairs", header=("kind", "old", "new", ""), rows=rows)


def _fate(old: int, new: int) -> str:
    if old == new:
        return ""
    return "vanished" if not new else "appeared" if not old else "grew" if new > old else "shrank"


def _both(ids: tuple[int, int]) -> str:
    return f"{ids[0]}, {ids[1]}"


def _values(pair: Pair) -> str:
    return ", ".join(
        f"{name} {value:.6g}" if isinstance(value, float) else f"{name} {value}" for name, value in pair.values.items()
    )


def _signed(value: float, unit: str) -> str:
    return f"{value:+.3g} {'' if unit == '1' else unit}".rstrip() if value else "0"


def _share(one: Estimate) -> str:
    value, low, high = (f"{round(number, 3) + 0.0:.1%}" for number in (one.value, one.low, one.high))
    return f"{value} ({low} to {high})"


def _estimate(one: Estimate, unit: str) -> str:
    # Only digits that the interval supports.
    digits = max(0, 2 - math.ceil(math.log10(max(one.high - one.low, 1e-9))))
    value, low, high = (
        f"{number + 0.0:.{digits}f}" for number in (round(x, digits) for x in (one.value, one.low, one.high))
    )
    return f"{value} ({low} to {high}) {'' if unit == '1' else unit}".rstrip()
