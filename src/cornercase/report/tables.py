"""Sections and tables of the report, as HTML."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Final

from markupsafe import Markup

from cornercase._common.texts import plain_text
from cornercase.clustering import Candidate, Clustering, Profile
from cornercase.reduction import ClusterShape, Coverage, CriticalCoverage, HeldOutCritical
from cornercase.report.words import name_cluster

_UNKNOWN: Final = "–"
_ARCHETYPES: Final = {
    "hull": "corners of the hull",
    "pcha": "archetypal analysis in the parameter space",
    "parts": "corners of the hulls of {parts} near-convex parts",
    "kernel": "archetypal analysis in kernel space",
}


@dataclass(frozen=True)
class Part:
    """Section of the page's details that opens when its title is clicked."""

    name: str  # for addresses and tests
    title: str  # plain text
    html: Markup  # all texts are escaped


def make_part(name: str, title: str, lines: Iterable[str]) -> Part:
    """Join lines of HTML (texts already escaped) into a section."""
    return Part(name, title, Markup("\n".join(lines)))


def make_table(head: Sequence[str], rows: Sequence[Sequence[str]], text: Sequence[int] = (0,)) -> str:
    """Render an HTML table of plain texts; columns in `left_aligned` are left-aligned (-1: the last)."""
    left = {k % len(head) for k in text}

    # A control character for the writing direction would affect all text after it.
    head, rows = [plain_text(name) for name in head], [[plain_text(cell) for cell in row] for row in rows]

    def line(cells: Sequence[str], tag: str) -> str:
        kind = "th scope=col" if tag == "th" else tag
        return "".join(
            f"<{kind}{' class=text' if k in left else ''}>{escape(cell)}</{tag}>" for k, cell in enumerate(cells)
        )

    body = "".join(f"<tr>{line(cells, 'td')}</tr>" for cells in rows)
    # A wide table needs focus and a name so that it can be scrolled with the keyboard.
    label = escape(", ".join(head[:3]))
    table = f"<table><tr>{line(head, 'th')}</tr>{body}</table>"
    return f"<div class='wide' tabindex='0' role='region' aria-label='table: {label}'>{table}</div>"


def tell_profiles(profiles: Sequence[Profile]) -> str:
    """Render how the scenarios of each cluster end, and where in the space they lie."""

    def share(value: float) -> str:
        return _UNKNOWN if math.isnan(value) else f"{value:.0%}"

    table = make_table(
        ["cluster", "how it ends", "where", "of the cluster", "purity"],
        [
            [
                name_cluster(profile.cluster) if k == 0 else "",
                ", ".join(f"{end} ({count})" for end, count in profile.outcomes.items()) if k == 0 else "",
                rule.text,
                share(rule.covers),
                share(rule.purity),
            ]
            for profile in profiles
            for k, rule in enumerate(profile.rules)
        ],
        text=(0, 1, 2),
    )
    return table + (
        "<p>Share of the cluster that lies there, and share of what lies there that is the cluster's: both of scenarios"
        " that the bounds were not found from, each tenth by the bounds of the other nine. Everywhere: no bounds of"
        " parameters hold for scenarios that they were not found from.</p>"
    )


def tell_names(profiles: Sequence[Profile]) -> str:
    """Render the name of each cluster and how many scenarios it is true of."""
    return make_table(
        ["cluster", "name", "scenarios", "collide", "true of", "of all others", "example"],
        [
            [
                name_cluster(profile.cluster), profile.name, str(profile.size), str(profile.collisions),
                f"{profile.true_of:.0%}", f"{profile.true_elsewhere:.0%}", f"scenario {profile.example}",
            ]
            for profile in profiles
            if profile.name
        ],
        text=(0, 1, -1),
    )  # fmt: skip


def tell_facts(tells: Mapping[str, Mapping[str, float]]) -> str:
    """Render how much each clustering says about facts: adjusted mutual information by aspect and fact."""
    facts = list(dict.fromkeys(fact for information in tells.values() for fact in information))

    def figure(value: float) -> str:
        # + 0.0: no "-0.00".
        return f"{round(value, 2) + 0.0:.2f}"

    rows = [
        [by, *(figure(information[fact]) if fact in information else _UNKNOWN for fact in facts)]
        for by, information in tells.items()
    ]
    return make_table(["by", *facts], rows)


def tell_choices(found: Clustering) -> str:
    """Render the best setting for each number of clusters; empty if there are fewer than two numbers."""

    def figure(value: float) -> str:
        # A single cluster has no separation from others.
        return _UNKNOWN if math.isnan(value) else f"{value:.2f}"

    def stability(candidate: Candidate) -> str:
        # If all scenarios are one group or noise, every subsample is stable.
        divides = candidate.clusters > 1 or (candidate.clusters == 1 and candidate.noise > 0.0)
        return figure(candidate.stability) if divides else _UNKNOWN

    def chosen(candidate: Candidate) -> bool:
        return (candidate.gamma, candidate.eps) == (found.gamma, found.eps)

    best_by_number: dict[int, Candidate] = {}
    for candidate in found.candidates:
        # Scores without stability are not comparable.
        if not math.isfinite(candidate.score) or math.isnan(candidate.stability):
            continue
        best = best_by_number.get(candidate.clusters)
        if best is None or chosen(candidate) or candidate.score > best.score:
            best_by_number[candidate.clusters] = candidate
    if len(best_by_number) < 2:
        return ""
    return make_table(
        ["clusters", "gamma", "eps", "noise", "DBCV", "silhouette", "stability", "score"],
        [
            [
                f"{number}{' (chosen)' if chosen(candidate) else ''}", f"{candidate.gamma:.4g}", f"{candidate.eps:.4g}",
                f"{candidate.noise:.1%}", figure(candidate.dbcv), figure(candidate.silhouette), stability(candidate),
                figure(candidate.score),
            ]
            for number, candidate in sorted(best_by_number.items())
        ],
    )  # fmt: skip


def tell_shapes(shapes: Sequence[ClusterShape]) -> str:
    """Render the convexity of each cluster and the method that found its archetypes."""
    return make_table(
        ["cluster", "convexity of the parameters", "in kernel space", "archetypes"],
        [
            [
                name_cluster(shape.cluster), f"{shape.convexity:.2f}", f"{shape.kernel_convexity:.2f}",
                _ARCHETYPES[shape.method].format(parts=shape.parts),
            ]
            for shape in shapes
        ],
        text=(0, -1),
    )  # fmt: skip


def tell_coverage(coverage: Mapping[str, Coverage]) -> str:
    """Render the distances from the run scenarios to the reduced set, by aspect."""
    return make_table(
        ["compared by", "largest distance", "of all", "mean distance", "of all"],
        [
            [
                name,
                f"{entry.largest:.4g}",
                f"{entry.largest_relative:.1%}",
                f"{entry.mean:.4g}",
                f"{entry.mean_relative:.1%}",
            ]
            for name, entry in coverage.items()
        ],
    )


def tell_held_out(coverage: Mapping[str, Coverage]) -> str:
    """Render held-out distances of reduced sets, compared with random sets and k-medoids; empty if not measured."""
    rows = [
        [
            name, str(held_out.scenarios), f"{held_out.largest:.4g}", f"{100 * held_out.better_largest:.0f} of 100",
            f"{held_out.medoids_largest:.4g}", f"{held_out.mean:.4g}", f"{100 * held_out.better_mean:.0f} of 100",
            f"{held_out.medoids_mean:.4g}",
        ]
        for name, entry in coverage.items()
        if (held_out := entry.held_out) is not None
    ]  # fmt: skip
    head = [
        "compared by", "held out", "largest distance", "better than random", "k-medoids", "mean distance",
        "better than random", "k-medoids",
    ]  # fmt: skip
    return make_table(head, rows) if rows else ""


def tell_critical_coverage(critical: Mapping[str, CriticalCoverage]) -> str:
    """Render how well the reduced set covers the critical scenarios, by aspect."""

    def share(value: float | None) -> str:
        return _UNKNOWN if value is None else f"{value:.0%}"

    def held_out(one: HeldOutCritical | None) -> list[str]:
        if one is None:
            return [_UNKNOWN] * 5
        return [str(one.scenarios), *map(share, (one.critical, one.random, one.medoids, one.boundary))]

    return make_table(
        [
            "compared by", "alike up to", "critical ones like a kept one", "held out", "like a kept one", "random",
            "k-medoids", "on the boundary", "a critical one of the space is unlike all kept", "90 % interval",
        ],
        [
            [
                name, f"{entry.within:.3g}", share(entry.critical), *held_out(entry.held_out),
                share(entry.unlike.value if entry.unlike else None),
                f"{entry.unlike.low:.0%} to {entry.unlike.high:.0%}" if entry.unlike else _UNKNOWN,
            ]
            for name, entry in critical.items()
        ],
    )  # fmt: skip
