"""Tables of the report."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import Any

from cornercase.report import figures


def table(head: Sequence[str], rows: Sequence[Sequence[str]], text: Sequence[int] = (0,)) -> str:
    """Table of texts; columns in `text` begin at the left."""
    left = {k % len(head) for k in text}

    def line(cells: Sequence[str], tag: str) -> str:
        return "".join(
            f"<{tag}{' class=text' if k in left else ''}>{escape(cell)}</{tag}>" for k, cell in enumerate(cells)
        )

    body = "".join(f"<tr>{line(cells, 'td')}</tr>" for cells in rows)
    return f"<div class='wide'><table><tr>{line(head, 'th')}</tr>{body}</table></div>"


def in_words(described: Sequence[dict[str, Any]]) -> str:
    """Clusters by how their scenarios end, and where they lie."""
    return table(
        ["cluster", "how it ends", "where", "of the cluster", "purity"],
        [
            [
                figures.look(one["cluster"])[2] if k == 0 else "",
                ", ".join(f"{end} ({count})" for end, count in one["outcomes"].items()) if k == 0 else "",
                rule["text"],
                f"{rule['covers']:.0%}",
                f"{rule['purity']:.0%}",
            ]
            for one in described
            for k, rule in enumerate(one["rules"])
        ],
        text=(0, 1, 2),
    )


def critical_set(known: dict[str, Any], run: int) -> str:
    """What is known of the critical set."""

    def share(estimate: dict[str, float]) -> list[str]:
        return [f"{estimate['value']:.2%}", f"{estimate['low']:.2%} to {estimate['high']:.2%}"]

    rows = table(
        ["what", "estimate", "90 % interval"],
        [
            ["critical share of the space", *share(known["share"])],
            ["share of the critical set that is missed", *share(known["missed"])],
            [
                f"probability that a region of {known['overlooked']['size']:.0%} of the space was overlooked",
                f"{known['overlooked']['value']:.2%}",
                "",
            ],
            [
                f"share of the space where a region of {known['unvisited']['size']:.0%} would hold nothing run",
                f"{known['unvisited']['value']:.2%}",
                "",
            ],
        ],
    )
    return (
        f"<p>A scenario is critical where {escape(known['is'])}: {known['scenarios']} of the {run} that were run.</p>"
        f"{rows}<p>All but the last figure come from a Gaussian process of the scores, corrected by how well it"
        " foretells each scenario that was run from all others.</p>"
    )


def choices(candidates: Sequence[dict[str, Any]], gamma: float, eps: float) -> str:
    """Best setting that was found for each number of clusters, so that one sees how sure the choice is."""
    best: dict[int, dict[str, Any]] = {}
    for one in candidates:
        chosen = (one["gamma"], one["eps"]) == (gamma, eps)
        # Without stability a score is not comparable.
        comparable = math.isfinite(one["score"]) and not math.isnan(one["stability"])
        if comparable and (chosen or one["score"] > best.get(one["clusters"], {"score": -9.0})["score"]):
            best[one["clusters"]] = one
    if len(best) < 2:
        return ""
    return table(
        ["clusters", "gamma", "eps", "noise", "DBCV", "silhouette", "stability", "score"],
        [
            [
                f"{number}{' (chosen)' if (one['gamma'], one['eps']) == (gamma, eps) else ''}", f"{one['gamma']:.4g}",
                f"{one['eps']:.4g}", f"{one['noise']:.1%}", f"{one['dbcv']:.2f}", f"{one['silhouette']:.2f}",
                f"{one['stability']:.2f}", f"{one['score']:.2f}",
            ]
            for number, one in sorted(best.items())
        ],
    )  # fmt: skip


def shapes(found: Sequence[dict[str, Any]]) -> str:
    """How convex each cluster is, and how its archetypes were found for that."""
    how = {
        "hull": "corners of the hull",
        "pcha": "archetypal analysis in the parameter space",
        "parts": "corners of the hulls of {parts} near-convex parts",
        "kernel": "archetypal analysis in kernel space",
    }
    return table(
        ["cluster", "convexity of the parameters", "in kernel space", "archetypes"],
        [
            [
                figures.look(one["cluster"])[2], f"{one['convexity']:.2f}", f"{one['convexity in kernel space']:.2f}",
                how[one["archetypes by"]].format(**one),
            ]
            for one in found
        ],
        text=(0, -1),
    )  # fmt: skip


def coverage(found: dict[str, dict[str, Any]]) -> str:
    """What the kept scenarios leave out, beside random ones and k-medoids."""
    return table(
        [
            "compared by", "largest distance", "of all", "better than random", "k-medoids", "mean distance", "of all",
            "better than random", "k-medoids",
        ],
        [
            [
                name, f"{c['largest']:.4g}", f"{c['largest_relative']:.1%}", _times(c["better_largest"]),
                _known(c["medoids_largest"], ".4g"), f"{c['mean']:.4g}", f"{c['mean_relative']:.1%}",
                _times(c["better_mean"]), _known(c["medoids_mean"], ".4g"),
            ]
            for name, c in found.items()
            if c
        ],
    )  # fmt: skip


def critical_coverage(found: dict[str, dict[str, Any]]) -> str:
    """What the kept scenarios leave out of the critical set."""

    def share(value: float | None) -> str:
        return "–" if value is None else f"{value:.0%}"

    return table(
        [
            "compared by", "alike up to", "critical ones like a kept one", "random", "k-medoids", "on the boundary",
            "a critical one of the space is unlike all kept", "90 % interval",
        ],
        [
            [
                name, f"{c['within']:.3g}", share(c["critical"]), share(c["random"]), share(c["medoids"]),
                share(c["boundary"]), share(c["unlike"] and c["unlike"]["value"]),
                f"{c['unlike']['low']:.0%} to {c['unlike']['high']:.0%}" if c["unlike"] else "–",
            ]
            for name, c in found.items()
        ],
    )  # fmt: skip


def _known(value: float | None, form: str) -> str:
    # What an earlier version did not measure is not known.
    return "–" if value is None else format(value, form)


def _times(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.0f} of 100"
