"""Sections on the Pareto front, the critical set and sensitivities."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape

from cornercase.evidence import Estimate, Sensitivity
from cornercase.report.data import ReportData
from cornercase.report.knowledge import CriticalKnowledge
from cornercase.report.tables import Part, make_part, make_table
from cornercase.report.words import format_value, name_axis, name_criterion, tell_asked, tell_front, tell_unforetold


def show_knowledge(data: ReportData) -> Iterator[Part]:
    """Render the sections on what was estimated about the whole space."""
    estimates, searched = data.summary.knowledge, data.summary.searched
    if estimates.front is not None:
        yield make_part("front", "The Pareto front", _tell_front(data, estimates.front))
    if estimates.critical is not None and estimates.critical.known is not None:
        criterion = name_criterion(estimates.critical, searched)
        lines = _tell_critical(estimates.critical, criterion, data.summary.run, tell_asked(data.summary))
        yield make_part("critical", "What is known of the critical set", lines)
    if estimates.sensitivity is not None:
        yield make_part("sensitivity", "Which parameters matter", _tell_sensitivity(estimates.sensitivity, searched))


def _tell_front(data: ReportData, front: Mapping[int, Mapping[str, float]]) -> Iterator[str]:
    parameters, rows = data.parameters, {row.id: row for row in data.rows}
    yield f"<p>{escape(tell_front(len(front)))}</p>"
    yield make_table(
        ["scenario", *map(name_axis, parameters), *(f"{metric.name} [{metric.unit}]" for metric in data.metrics)],
        [
            [
                str(scenario),
                *(format_value(parameter.read(rows[scenario].values)) for parameter in parameters),
                *(f"{scores[metric.name]:.4g}" for metric in data.metrics),
            ]
            for scenario, scores in front.items()
        ],
    )


def _tell_critical(known: CriticalKnowledge, criterion: str, run: int, asked: str) -> Iterator[str]:
    estimates = known.known
    assert estimates is not None

    def share(estimate: Estimate, given: bool = True) -> list[str]:
        return [f"{estimate.value:.2%}", f"{estimate.low:.2%} to {estimate.high:.2%}" if given else "not given"]

    yield f"<p>A scenario is critical if {escape(criterion)}: {known.scenarios} of the {run} that were run."
    yield f"{f' {escape(asked)}' if asked else ''}</p>"
    rows = [
        ["critical share of the space", *share(estimates.share, estimates.share_doubt is None)],
        ["share of the critical set that is missed", *share(estimates.missed, estimates.missed_doubt is None)],
        ["share of the critical set that an unknown region could hold", f"{estimates.hidden:.2%}", ""],
    ]
    if audit := known.audit:
        rows.append([f"critical share by {audit.scenarios} audits alone", *share(audit.share)])
        rows.append(["missed by the audits alone", *(share(audit.missed) if audit.missed else ["", ""])])
    overlooked = f"probability that a region of {estimates.region:.0%} of the space was overlooked"
    unvisited = f"share of the space around which a region of {estimates.region:.0%} holds nothing that was run"
    rows += [[overlooked, f"{estimates.overlooked:.2%}", ""], [unvisited, f"{estimates.unvisited:.2%}", ""]]
    yield make_table(["what", "estimate", "90 % interval"], rows)
    if estimates.missed_doubt is not None:
        prefix = "the share and of " if estimates.share_doubt is not None else ""
        yield f"<p>There is no interval of {prefix}what is missed: {escape(estimates.missed_doubt)}.</p>"
    model = "a Gaussian process of the scores"
    if estimates.by_committee:
        model = (
            f"a committee of trees that learn from what happened in the runs, a forest of the parameters and {model}"
        )
    yield (
        f"<p>The share, what is missed and what is overlooked come from {model}. They are corrected by how well it"
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
