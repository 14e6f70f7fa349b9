"""Sections on the Pareto front, the critical set and sensitivities."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape

from cornercase.evidence import Estimate, Sensitivity
from cornercase.report._estimates import CriticalEstimates
from cornercase.report._report_data import ReportData
from cornercase.report.html._tables import Section, make_section, render_table
from cornercase.report.text._phrases import (
    describe_front,
    describe_missing_sensitivity,
    describe_threshold_override,
    format_axis_label,
    format_criterion,
    format_value,
)


def render_estimates(data: ReportData) -> Iterator[Section]:
    """Yield the sections on the Pareto front, the critical set and sensitivities, as far as they are known."""
    estimates, searched = data.summary.estimates, data.summary.objective
    if estimates.pareto_front is not None:
        yield make_section("front", "The Pareto front", _render_front(data, estimates.pareto_front))
    if estimates.critical is not None and estimates.critical.critical_set is not None:
        criterion = format_criterion(estimates.critical.criterion, searched)
        lines = _render_critical_set(
            estimates.critical, criterion, data.summary.n_run, describe_threshold_override(data.summary)
        )
        yield make_section("critical", "What is known of the critical set", lines)
    if estimates.sensitivity is not None:
        yield make_section(
            "sensitivity", "Which parameters matter", _render_sensitivity(estimates.sensitivity, searched)
        )


def _render_front(data: ReportData, front: Mapping[int, Mapping[str, float]]) -> Iterator[str]:
    parameters, rows = data.parameters, {row.id: row for row in data.rows}
    yield f"<p>{escape(describe_front(len(front)))}</p>"
    yield render_table(
        [
            "scenario",
            *map(format_axis_label, parameters),
            *(f"{metric.name} [{metric.unit}]" for metric in data.metrics),
        ],
        [
            [
                str(scenario),
                *(format_value(parameter.extract_value(rows[scenario].values)) for parameter in parameters),
                *(f"{scores[metric.name]:.4g}" for metric in data.metrics),
            ]
            for scenario, scores in front.items()
        ],
    )


def _render_critical_set(critical: CriticalEstimates, criterion: str, n_run: int, threshold_note: str) -> Iterator[str]:
    estimates = critical.critical_set
    assert estimates is not None

    def format_estimate(estimate: Estimate, has_interval: bool = True) -> list[str]:
        return [f"{estimate.value:.2%}", f"{estimate.low:.2%} to {estimate.high:.2%}" if has_interval else "not given"]

    yield f"<p>A scenario is critical if {escape(criterion)}: {critical.n_critical} of the {n_run} that were run."
    yield f"{f' {escape(threshold_note)}' if threshold_note else ''}</p>"
    rows = [
        [
            "critical share of the space",
            *format_estimate(estimates.critical_fraction, estimates.interval_unavailable is None),
        ],
        [
            "share of the critical set that is missed",
            *format_estimate(estimates.missed_fraction, estimates.missed_interval_unavailable is None),
        ],
        [
            "share of the critical set that an unknown region could hold",
            f"{estimates.max_fraction_in_empty_region:.2%}",
            "",
        ],
    ]
    if audit := critical.audits:
        rows.append([f"critical share by {audit.n_scenarios} audits alone", *format_estimate(audit.critical_fraction)])
        rows.append(
            [
                "missed by the audits alone",
                *(format_estimate(audit.missed_fraction) if audit.missed_fraction else ["", ""]),
            ]
        )
    overlooked = f"probability that a region of {estimates.region_fraction:.0%} of the space was overlooked"
    unvisited = (
        f"share of the space around which a region of {estimates.region_fraction:.0%} holds nothing that was run"
    )
    rows += [
        [overlooked, f"{estimates.p_overlooked_region:.2%}", ""],
        [unvisited, f"{estimates.unexplored_fraction:.2%}", ""],
    ]
    yield render_table(["what", "estimate", "90 % interval"], rows)
    if estimates.missed_interval_unavailable is not None:
        prefix = "the share and of " if estimates.interval_unavailable is not None else ""
        yield f"<p>There is no interval of {prefix}what is missed: {escape(estimates.missed_interval_unavailable)}.</p>"
    model, record = "a Gaussian process of the scores", "the scenarios of the filling"
    if estimates.by_committee:
        model = (
            f"a committee of trees that learn from what happened in the runs, a forest of the parameters and {model}"
        )
        record += " and those that the search chose"
    yield (
        f"<p>The share, what is missed and what is overlooked come from {model}. They are corrected by how well it"
        f" predicts {record}, each from others, and by the audits. The other rows need no"
        " model.</p>"
    )


def _render_sensitivity(sensitivity: Sensitivity, objective: str) -> Iterator[str]:
    if not sensitivity.is_meaningful:
        yield f"<p>{describe_missing_sensitivity()}</p>"
        return

    def format_share(value: float, interval: tuple[float, float]) -> list[str]:
        return [f"{value:.0%}", f"{interval[0]:.0%} to {interval[1]:.0%}"]

    yield render_table(
        ["parameter", "alone (first order)", "90 % interval", "with all others (total)", "90 % interval"],
        [
            [
                sensitivity.names[k],
                *format_share(sensitivity.first[k], sensitivity.first_interval[k]),
                *format_share(sensitivity.total[k], sensitivity.total_interval[k]),
            ]
            for k in range(len(sensitivity.names))
        ],
    )
    yield (
        f"<p>How much of the variance of {escape(objective)} comes from each parameter, by a Gaussian process"
        f" with a cross-validated R² of {sensitivity.predicted:.2f}.</p>"
    )
