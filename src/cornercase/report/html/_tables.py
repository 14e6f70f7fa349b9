"""Sections and tables of the report page, as HTML."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Final

from markupsafe import Markup

from cornercase._common.text.sanitize import escape_control_characters
from cornercase.clustering import Candidate, Clustering, Profile
from cornercase.reduction import ClusterShape, Coverage, CriticalCoverage, HeldOutCriticalCoverage
from cornercase.report.text._phrases import format_cluster_name

_NO_VALUE: Final = "–"
_ARCHETYPE_METHODS: Final = {
    "hull": "corners of the hull",
    "pcha": "archetypal analysis in the parameter space",
    "parts": "corners of the hulls of {parts} near-convex parts",
    "kernel": "archetypal analysis in kernel space",
}


@dataclass(frozen=True)
class Section:
    """A section of the details on the report page; a click on its title opens the section."""

    name: str  # for addresses and tests
    title: str  # plain text
    html: Markup  # all texts are escaped


def make_section(name: str, title: str, html_lines: Iterable[str]) -> Section:
    """Join lines of HTML into a section; texts in the lines must be escaped."""
    return Section(name, title, Markup("\n".join(html_lines)))


def render_table(column_names: Sequence[str], rows: Sequence[Sequence[str]], left_aligned: Sequence[int] = (0,)) -> str:
    """Render an HTML table of plain texts; the columns in `left_aligned` are left-aligned (-1 is the last column)."""
    left = {k % len(column_names) for k in left_aligned}

    # A control character for the writing direction would affect all text after it.
    column_names, rows = (
        [escape_control_characters(name) for name in column_names],
        [[escape_control_characters(cell) for cell in row] for row in rows],
    )

    def render_row(cells: Sequence[str], tag: str) -> str:
        kind = "th scope=col" if tag == "th" else tag
        return "".join(
            f"<{kind}{' class=text' if k in left else ''}>{escape(cell)}</{tag}>" for k, cell in enumerate(cells)
        )

    body = "".join(f"<tr>{render_row(cells, 'td')}</tr>" for cells in rows)
    # A wide table needs focus and a name so that it can be scrolled with the keyboard.
    label = escape(", ".join(column_names[:3]))
    table = f"<table><tr>{render_row(column_names, 'th')}</tr>{body}</table>"
    return f"<div class='wide' tabindex='0' role='region' aria-label='table: {label}'>{table}</div>"


def render_cluster_profiles(profiles: Sequence[Profile]) -> str:
    """Render a table of how the scenarios of each cluster end, and in which parameter ranges they lie."""

    def format_share(value: float) -> str:
        return _NO_VALUE if math.isnan(value) else f"{value:.0%}"

    table = render_table(
        ["cluster", "how it ends", "where", "of the cluster", "purity"],
        [
            [
                format_cluster_name(profile.cluster) if k == 0 else "",
                ", ".join(f"{end} ({count})" for end, count in profile.outcomes.items()) if k == 0 else "",
                rule.text,
                format_share(rule.covers),
                format_share(rule.purity),
            ]
            for profile in profiles
            for k, rule in enumerate(profile.rules)
        ],
        left_aligned=(0, 1, 2),
    )
    return table + (
        "<p>Share of the cluster that lies there, and share of what lies there that is the cluster's: both of scenarios"
        " that the bounds were not found from, each tenth by the bounds of the other nine. Everywhere: no bounds of"
        " parameters hold for scenarios that they were not found from.</p>"
    )


def render_cluster_names(profiles: Sequence[Profile]) -> str:
    """Render a table of cluster names; each name is a condition, shown with the shares of scenarios that fulfil it."""
    return render_table(
        ["cluster", "name", "scenarios", "collide", "true of", "of all others", "example"],
        [
            [
                format_cluster_name(profile.cluster), profile.name, str(profile.size), str(profile.collisions),
                f"{profile.true_of:.0%}", f"{profile.true_elsewhere:.0%}", f"scenario {profile.example}",
            ]
            for profile in profiles
            if profile.name
        ],
        left_aligned=(0, 1, -1),
    )  # fmt: skip


def render_mutual_information(information_by_aspect: Mapping[str, Mapping[str, float]]) -> str:
    """Render a table of the adjusted mutual information between each clustering and facts such as the outcome."""
    facts = list(dict.fromkeys(fact for information in information_by_aspect.values() for fact in information))

    def format_number(value: float) -> str:
        # + 0.0: no "-0.00".
        return f"{round(value, 2) + 0.0:.2f}"

    rows = [
        [by, *(format_number(information[fact]) if fact in information else _NO_VALUE for fact in facts)]
        for by, information in information_by_aspect.items()
    ]
    return render_table(["by", *facts], rows)


def render_clustering_settings(clustering: Clustering) -> str:
    """Render a table of the best clustering setting for each number of clusters; empty if only one number was found."""

    def format_number(value: float) -> str:
        # A single cluster has no separation from others.
        return _NO_VALUE if math.isnan(value) else f"{value:.2f}"

    def format_stability(candidate: Candidate) -> str:
        # If all scenarios are one group or noise, every subsample is stable.
        divides = candidate.clusters > 1 or (candidate.clusters == 1 and candidate.noise > 0.0)
        return format_number(candidate.stability) if divides else _NO_VALUE

    def is_chosen(candidate: Candidate) -> bool:
        return (candidate.gamma, candidate.eps) == (clustering.gamma, clustering.eps)

    best_by_number: dict[int, Candidate] = {}
    for candidate in clustering.candidates:
        # Scores without stability are not comparable.
        if not math.isfinite(candidate.score) or math.isnan(candidate.stability):
            continue
        best = best_by_number.get(candidate.clusters)
        if best is None or is_chosen(candidate) or candidate.score > best.score:
            best_by_number[candidate.clusters] = candidate
    if len(best_by_number) < 2:
        return ""
    return render_table(
        ["clusters", "gamma", "eps", "noise", "DBCV", "silhouette", "stability", "score"],
        [
            [
                f"{number}{' (chosen)' if is_chosen(candidate) else ''}",
                f"{candidate.gamma:.4g}",
                f"{candidate.eps:.4g}",
                f"{candidate.noise:.1%}",
                format_number(candidate.dbcv),
                format_number(candidate.silhouette),
                format_stability(candidate),
                format_number(candidate.score),
            ]
            for number, candidate in sorted(best_by_number.items())
        ],
    )


def render_shapes(shapes: Sequence[ClusterShape]) -> str:
    """Render a table of each cluster: its convexity, and how its archetypes (extreme scenarios) were found."""
    return render_table(
        ["cluster", "convexity of the parameters", "in kernel space", "archetypes"],
        [
            [
                format_cluster_name(shape.cluster),
                f"{shape.convexity:.2f}",
                f"{shape.kernel_convexity:.2f}",
                _ARCHETYPE_METHODS[shape.method].format(parts=shape.parts),
            ]
            for shape in shapes
        ],
        left_aligned=(0, -1),
    )


def render_coverage(coverage: Mapping[str, Coverage]) -> str:
    """Render a table of DTW distances from all scenarios to the reduced set, by aspect (what is compared)."""
    return render_table(
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


def render_distances_of_held_out_scenarios(coverage: Mapping[str, Coverage]) -> str:
    """Render a table of distances from held-out scenarios to the reduced set, to random sets and to k-medoids.

    Held-out scenarios took no part in the selection. The table is empty if these distances were not measured.
    """
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
    return render_table(head, rows) if rows else ""


def render_critical_coverage(critical: Mapping[str, CriticalCoverage]) -> str:
    """Render a table of how well the reduced set covers the critical scenarios, by aspect (what is compared)."""

    def format_share(value: float | None) -> str:
        return _NO_VALUE if value is None else f"{value:.0%}"

    def format_held_out(result: HeldOutCriticalCoverage | None) -> list[str]:
        if result is None:
            return [_NO_VALUE] * 5
        return [
            str(result.scenarios),
            *map(format_share, (result.critical, result.random, result.medoids, result.boundary)),
        ]

    return render_table(
        [
            "compared by", "alike up to", "critical ones like a kept one", "held out", "like a kept one", "random",
            "k-medoids", "on the boundary", "a critical one of the space is unlike all kept", "90 % interval",
        ],
        [
            [
                name, f"{entry.within:.3g}", format_share(entry.critical), *format_held_out(entry.held_out),
                format_share(entry.unlike.value if entry.unlike else None),
                f"{entry.unlike.low:.0%} to {entry.unlike.high:.0%}" if entry.unlike else _NO_VALUE,
            ]
            for name, entry in critical.items()
        ],
    )  # fmt: skip
