"""What the scenarios that were run say of all others."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape

from cornercase.evidence import Estimate, Sensitivity
from cornercase.report.album import Album
from cornercase.report.data import ReportData
from cornercase.report.figures.scores import draw_front, draw_sensitivities
from cornercase.report.knowledge import CriticalKnowledge
from cornercase.report.tables import make_table
from cornercase.report.words import name_criterion, tell_unforetold


def show_knowledge(data: ReportData, album: Album) -> Iterator[str]:
    """Show the Pareto front, or what is known of the critical set and of the influence of each parameter.

    Parameters
    ----------
    data : ReportData
        What the report shows.
    album : Album
        Takes the figures.

    Yields
    ------
    str
        HTML.
    """
    known, searched = data.summary.knowledge, data.summary.searched
    if known.front is not None:
        yield "<h2>The Pareto front</h2>"
        yield album.add(
            draw_front([data.scores[one.name] for one in data.metrics], data.metrics, data.rows_of(list(known.front))),
            "front",
            f"Each scenario that was run, by its scores. Of {len(known.front)} no other is as critical in every metric"
            " and more critical in one.",
        )
    if known.critical is not None and known.critical.known is not None:
        yield "<h2>What is known of the critical set</h2>"
        yield from _tell_critical(known.critical, name_criterion(known.critical, searched), data.summary.run)
    if known.sensitivity is not None:
        yield "<h2>What matters</h2>"
        yield _show_sensitivity(known.sensitivity, searched, album)


def _tell_critical(known: CriticalKnowledge, criterion: str, run: int) -> Iterator[str]:
    found = known.known
    assert found is not None

    def share(estimate: Estimate, given: bool = True) -> list[str]:
        return [f"{estimate.value:.2%}", f"{estimate.low:.2%} to {estimate.high:.2%}" if given else "not given"]

    yield f"<p>A scenario is critical where {escape(criterion)}: {known.scenarios} of the {run} that were run.</p>"
    yield make_table(
        ["what", "estimate", "90 % interval"],
        [
            ["critical share of the space", *share(found.share, found.share_doubt is None)],
            ["share of the critical set that is missed", *share(found.missed, found.missed_doubt is None)],
            ["part of the critical set that a region could be which holds nothing run", f"{found.hidden:.2%}", ""],
            *(
                [
                    [f"critical share by {known.audit.scenarios} audits alone", *share(known.audit.share)],
                    ["missed by the audits alone", *(share(known.audit.missed) if known.audit.missed else ["", ""])],
                ]
                if known.audit
                else []
            ),
            [
                f"probability that a region of {found.region:.0%} of the space was overlooked",
                f"{found.overlooked:.2%}",
                "",
            ],
            [
                f"share of the space where a region of {found.region:.0%} would hold nothing run",
                f"{found.unvisited:.2%}",
                "",
            ],
        ],
    )
    if found.missed_doubt is not None:
        both = "the share and of " if found.share_doubt is not None else ""
        yield f"<p>No interval of {both}what is missed is given: {escape(found.missed_doubt)}.</p>"
    yield (
        "<p>The share, what is missed and what is overlooked come from a Gaussian process of the scores, corrected"
        " by how well it predicts the scenarios that fill the space from all others, and the audits; the rest needs no"
        " process.</p>"
    )


def _show_sensitivity(found: Sensitivity, searched: str, album: Album) -> str:
    little = f" Of little influence: {', '.join(found.little)}." if found.little else ""
    if not found.foretold:
        little = f" {tell_unforetold()}"
    return album.add(
        draw_sensitivities(found),
        "sensitivity",
        f"How much of the variance of {searched} comes from each parameter, by a Gaussian process that predicts"
        f" {max(found.predicted, 0.0):.0%} of the variance of scenarios that it was not told; the lines are 90 %"
        f" intervals.{little}",
    )
