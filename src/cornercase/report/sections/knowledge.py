"""What the scenarios that were run say of all others."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape

from cornercase.evidence import Estimate, Sensitivity
from cornercase.report.data import ReportData
from cornercase.report.knowledge import CriticalKnowledge
from cornercase.report.sections.part import Part, make_part
from cornercase.report.tables import make_table
from cornercase.report.words import format_value, name_axis, name_criterion, tell_asked, tell_front, tell_unforetold


def show_knowledge(data: ReportData) -> Iterator[Part]:
    """Tell of the Pareto front, or what is known of the critical set and of the influence of each parameter.

    Parameters
    ----------
    data : ReportData
        What the report shows.

    Yields
    ------
    Part
        As far as something is known.
    """
    known, searched = data.summary.knowledge, data.summary.searched
    if known.front is not None:
        yield make_part("front", "The Pareto front", _tell_front(data, known.front))
    if known.critical is not None and known.critical.known is not None:
        criterion = name_criterion(known.critical, searched)
        lines = _tell_critical(known.critical, criterion, data.summary.run, tell_asked(data.summary))
        yield make_part("critical", "What is known of the critical set", lines)
    if known.sensitivity is not None:
        yield make_part("sensitivity", "Which parameters matter", _tell_sensitivity(known.sensitivity, searched))


def _tell_front(data: ReportData, front: Mapping[int, Mapping[str, float]]) -> Iterator[str]:
    parameters, rows = data.parameters, {row.id: row for row in data.rows}
    yield f"<p>{escape(tell_front(len(front)))}</p>"
    yield make_table(
        ["scenario", *map(name_axis, parameters), *(f"{one.name} [{one.unit}]" for one in data.metrics)],
        [
            [
                str(scenario),
                *(format_value(one.read(rows[scenario].values)) for one in parameters),
                *(f"{scores[one.name]:.4g}" for one in data.metrics),
            ]
            for scenario, scores in front.items()
        ],
    )


def _tell_critical(known: CriticalKnowledge, criterion: str, run: int, asked: str) -> Iterator[str]:
    found = known.known
    assert found is not None

    def share(estimate: Estimate, given: bool = True) -> list[str]:
        return [f"{estimate.value:.2%}", f"{estimate.low:.2%} to {estimate.high:.2%}" if given else "not given"]

    yield f"<p>A scenario is critical if {escape(criterion)}: {known.scenarios} of the {run} that were run."
    yield f"{f' {escape(asked)}' if asked else ''}</p>"
    yield make_table(
        ["what", "estimate", "90 % interval"],
        [
            ["critical share of the space", *share(found.share, found.share_doubt is None)],
            ["share of the critical set that is missed", *share(found.missed, found.missed_doubt is None)],
            ["share of the critical set that an unknown region could hold", f"{found.hidden:.2%}", ""],
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
                f"share of the space around which a region of {found.region:.0%} holds nothing that was run",
                f"{found.unvisited:.2%}",
                "",
            ],
        ],
    )
    if found.missed_doubt is not None:
        both = "the share and of " if found.share_doubt is not None else ""
        yield f"<p>There is no interval of {both}what is missed: {escape(found.missed_doubt)}.</p>"
    judge = "a Gaussian process of the scores"
    if found.by_committee:
        judge = (
            f"a committee of trees that learn from what happened in the runs, a forest of the parameters and {judge}"
        )
    yield (
        f"<p>The share, what is missed and what is overlooked come from {judge}. They are corrected by how well it"
        " predicts the scenarios of the filling, each from all others, and by the audits. The other rows need no"
        " model.</p>"
    )


def _tell_sensitivity(found: Sensitivity, searched: str) -> Iterator[str]:
    if not found.foretold:
        yield f"<p>{tell_unforetold()}</p>"
        return

    def share(value: float, interval: tuple[float, float]) -> list[str]:
        return [f"{value:.0%}", f"{interval[0]:.0%} to {interval[1]:.0%}"]

    yield make_table(
        ["parameter", "alone (first order)", "90 % interval", "with all others (total)", "90 % interval"],
        [
            [
                found.names[k],
                *share(found.first[k], found.first_interval[k]),
                *share(found.total[k], found.total_interval[k]),
            ]
            for k in range(len(found.names))
        ],
    )
    yield (
        f"<p>How much of the variance of {escape(searched)} comes from each parameter, by a Gaussian process"
        f" with a cross-validated R² of {found.predicted:.2f}.</p>"
    )
