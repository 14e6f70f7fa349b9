"""A comparison of two versions in words, and as plain values."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from cornercase.evidence import Estimate
from cornercase.metrics import METRICS
from cornercase.suite.comparing_results import LEVEL, Comparison, Pair, SpaceChange, tell_findings

NAMED: Final = 40
"""Scenarios that a finding names in a table."""


@dataclass(frozen=True)
class Section:
    """A part of a comparison, as a person reads it.

    Attributes
    ----------
    key : str
        What it is about: ``"answer"``, ``"findings"``, ``"pairs"``, ``"scores"``, ``"outcomes"``, ``"verdicts"``,
        ``"tests"``, ``"space"``, ``"kinds"`` or ``"telling"``.
    title : str
    sentences : tuple of str
    header : tuple of str
        Of the table; empty without one.
    rows : tuple of tuple of str
    """

    key: str
    title: str
    sentences: tuple[str, ...] = ()
    header: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()


def tell_comparison(found: Comparison) -> tuple[Section, ...]:
    """Put a comparison in words.

    Parameters
    ----------
    found : Comparison

    Returns
    -------
    tuple of Section
        The answer first; only what there is to say.
    """
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
        rows = tuple((_both(one.pair.ids), _values(one.pair), one.why) for one in found.telling)
        yield Section(
            "telling", "Scenarios that tell the versions apart", header=("old, new", "parameters", "why"), rows=rows
        )


def _answer(found: Comparison) -> Section:
    other = found.differences or ("The studies were made with the same settings.",)
    sentences = list(other)
    if not found.verdict_reason.startswith(found.reason):
        sentences.append(f"{'Changed' if found.changed else 'No change'}: {found.reason}")
    if found.within:
        sentences.append(f"Within the tolerances, so that it does not count: {tell_findings(found.within)}")
    sentences.append(f"Tolerances: {', '.join(_tolerances(found))}")
    if found.critical is not None:
        sentences.append(f"Scenarios count as critical from a score of {found.critical:g} on.")
    return Section("answer", found.headline, tuple(sentences))


def _tolerances(found: Comparison) -> Iterator[str]:
    for name, value in found.tolerances.items():
        unit = METRICS.create(name).unit
        yield f"{name} {value:g}" if unit == "1" else f"{name} {value:g} {unit}"


def _findings(found: Comparison) -> Section:
    each = (*found.worse, *found.better)
    tests = ("test",) if any(one.test for one in each) else ()
    rows = tuple(
        (one.direction, one.what, one.name_scenarios(NAMED), *([one.tell_test()] if tests else [])) for one in each
    )
    return Section("findings", "Worse and better", header=("", "what", "scenarios", *tests), rows=rows)


def _pairs(found: Comparison) -> Iterator[Section]:
    old, new = found.names
    runs = {
        "the same bytes": found.count("the same"),
        "the same up to rounding": found.count("within rounding"),
        "otherwise": found.count("otherwise"),
        "with one version only": found.count("not in one"),
        "with neither": found.count("in neither"),
    }
    how = ", ".join(f"{count} {words}" for words, count in runs.items() if count)
    sentences = [f"{len(found.pairs)} scenarios with the same parameters" + (f": {how}" if how else "")]
    if any(found.alone):
        sentences.append(f"without a partner: {found.alone[0]} of {old}, {found.alone[1]} of {new}")
    if not found.certain and found.pairs:
        blind = sum(one.unselected for one in found.pairs)
        sentences.append(f"{blind} of them were chosen by no search by its scores; the tests look at those")
    yield Section("pairs", "Pairs", tuple(sentences))
    if any(one.moved for one in found.scores):
        yield Section(
            "scores",
            "Scores",
            header=("metric", "moved", "more critical", "less critical", "median change", "largest", "in (old, new)"),
            rows=tuple(
                (
                    one.metric,
                    f"{one.moved} of {one.pairs}",
                    str(one.worse),
                    str(one.better),
                    _signed(one.median, one.unit),
                    _signed(one.largest, one.unit),
                    "" if one.ids is None else _both(one.ids),
                )
                for one in found.scores
            ),
        )
    changed = sorted(
        (pair for pair in found.outcomes.items() if pair[0][0] != pair[0][1]), key=lambda one: (-one[1], one[0])
    )
    if changed:
        rows = tuple((before, after, str(count)) for (before, after), count in changed)
        yield Section("outcomes", "Outcomes that changed", header=("old", "new", "scenarios"), rows=rows)
    if found.verdicts:
        turned = sorted((one, count) for one, count in found.verdicts.items() if one[1] != one[2])
        verdicts = tuple((*one, str(count)) for one, count in turned)
        same = sum(count for one, count in found.verdicts.items() if one[1] == one[2])
        header = ("requirement", "old", "new", "scenarios") if verdicts else ()
        yield Section("verdicts", "Verdicts", (f"{same} are the same",), header, verdicts)


def _tests(found: Comparison) -> Section:
    rows = []
    for one in found.tests:
        if one.differ is None:
            about = f"{one.old} and {one.new} scenarios"
        else:
            about = f"{one.differ} of {one.old} pairs differ"
        claim = "differs" if one.corrected <= LEVEL else "–"
        rows.append((one.about, one.method, about, f"{one.p:.2g}", f"{one.corrected:.2g}", claim))
    level = f"a version is said to differ from itself in at most {LEVEL:.0%} of all comparisons (Holm)"
    return Section("tests", "Tests", (level,), ("of", "test", "looked at", "p", "corrected", ""), tuple(rows))


def _space(space: SpaceChange) -> Section:
    sentences: list[str] = []
    if space.gained is not None and space.lost is not None:
        sentences.append(
            f"by {space.pairs} scenarios that fill the space and were run with both: critical now only"
            f" {_share(space.gained)}, no more {_share(space.lost)} (90 %, Clopper and Pearson)"
        )
    else:
        sentences.append(f"no interval by pairs: {space.pairs_doubt}")
    if space.sets is None:
        sentences.append(f"no interval by all scenarios: {space.sets_doubt}")
        return Section("space", "The critical part of the space", tuple(sentences))
    sets = space.sets
    rows: list[tuple[str, ...]] = [
        ("critical share", _share(sets.old), _share(sets.new), _share(sets.change)),
        ("critical now only", "", _share(sets.gained), ""),
        ("critical no more", _share(sets.lost), "", ""),
    ]
    for name, unit, middle in zip(space.parameters, space.units, sets.middles, strict=True):
        if middle is not None:
            rows.append((f"middle in {name}", *(_estimate(one, unit) for one in middle)))
    return Section(
        "space",
        "The critical part of the space",
        (*sentences, "by all scenarios of both, with 90 % intervals:"),
        ("", "old", "new", "change"),
        tuple(rows),
    )


def _kinds(found: Comparison) -> Iterator[Section]:
    for by, kinds in found.kinds.items():
        if any(one.old != one.new for one in kinds):
            rows = tuple((one.label, str(one.old), str(one.new), _fate(one.old, one.new)) for one in kinds)
            yield Section("kinds", f"Kinds by {by}, among the pairs", header=("kind", "old", "new", ""), rows=rows)


def _fate(old: int, new: int) -> str:
    if old == new:
        return ""
    return "vanished" if not new else "came up" if not old else "grew" if new > old else "shrank"


def _both(ids: tuple[int, int]) -> str:
    return f"{ids[0]}, {ids[1]}"


def _values(pair: Pair) -> str:
    return ", ".join(
        f"{name} {value:.6g}" if isinstance(value, float) else f"{name} {value}" for name, value in pair.values.items()
    )


def _signed(value: float, unit: str) -> str:
    return f"{value:+.3g} {'' if unit == '1' else unit}".rstrip() if value else "0"


def _share(one: Estimate) -> str:
    value, low, high = (f"{round(each, 3) + 0.0:.1%}" for each in (one.value, one.low, one.high))
    return f"{value} ({low} to {high})"


def _estimate(one: Estimate, unit: str) -> str:
    # No digit that the interval leaves open.
    places = max(0, 2 - math.ceil(math.log10(max(one.high - one.low, 1e-9))))
    value, low, high = (
        f"{each + 0.0:.{places}f}" for each in (round(x, places) for x in (one.value, one.low, one.high))
    )
    return f"{value} ({low} to {high}) {'' if unit == '1' else unit}".rstrip()
