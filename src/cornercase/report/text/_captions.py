"""Captions of the figures of a study, and of the views (diagrams) of its report page."""

from __future__ import annotations

from typing import Any

import numpy as np

from cornercase._common.text.sanitize import escape_control_characters
from cornercase.clustering import Analysis
from cornercase.evidence import Sensitivity
from cornercase.metrics import Metric
from cornercase.reduction import ReducedSet
from cornercase.report._report_data import ReportData
from cornercase.report.text._answers import describe_most_critical_on_front
from cornercase.report.text._phrases import (
    append_unit,
    describe_clustering_method,
    describe_front,
    describe_informativeness,
    describe_little_influence,
    describe_missing_sensitivity,
    format_criterion_with_signs,
    format_value,
)


def describe_views(data: ReportData) -> dict[str, Any]:
    """Return the captions of the views (diagrams) of the report page, by name of the view.

    A caption is a text, or a mapping from metric or aspect (what scenarios are compared by) to text. Views that have
    the same caption in every study are left out.
    """
    summary = data.summary
    estimates, analyses = summary.estimates, summary.analyses
    captions: dict[str, Any] = {
        "space": {metric.name: describe_most_critical(data, metric) for metric in data.metrics},
        "histogram": {metric.name: describe_score_distribution(data, metric) for metric in data.metrics},
        "search": describe_search_progress(data),
        "kernel": {name: describe_cluster_count(analysis) for name, analysis in analyses.items()},
    }
    if estimates.pareto_front is not None:
        captions["front"] = " ".join(describe_most_critical_on_front(data))
    if estimates.sensitivity is not None:
        captions["matters"] = describe_most_influential(estimates.sensitivity)
    return {view: _to_plain_text(caption) for view, caption in captions.items()}


def _to_plain_text(caption: Any) -> Any:
    if isinstance(caption, dict):
        return {name: escape_control_characters(text) for name, text in caption.items()}
    return escape_control_characters(caption)


def describe_cluster_count(analysis: Analysis) -> str:
    """Describe how many clusters were found by an aspect (what scenarios are compared by)."""
    count, noise = analysis.clustering.n_clusters, int((analysis.labels < 0).sum())
    if count < 2:
        return describe_informativeness(analysis)
    outside = f", and {noise} scenarios of noise" if noise else ""
    return f"{count} kinds by {analysis.by}{outside}."


def describe_most_influential(sensitivity: Sensitivity) -> str:
    """Describe which parameter influences the score most."""
    if not sensitivity.is_meaningful:
        return describe_missing_sensitivity()
    most = sensitivity.names[int(np.argmax(sensitivity.total))]
    return f"{most} matters most.{describe_little_influence(sensitivity)}"


def describe_score_distribution(data: ReportData, metric: Metric) -> str:
    """Describe how the scores by a metric are distributed."""
    scores = data.scores[metric.name]
    low, middle, high = (append_unit(f"{value:.3g}", metric.unit) for value in np.quantile(scores, (0.0, 0.5, 1.0)))
    if low == high:
        subject = "All scenarios have" if len(scores) > 1 else "The one scenario has"
        return f"{subject} the {metric.name} score {low}."
    text = f"{metric.name} scores lie between {low} and {high}; the median is {middle}."
    critical = data.summary.estimates.critical
    if critical is not None and metric.name == data.summary.objective:
        text += (
            f" {critical.n_critical} of {len(scores)} are critical"
            f" ({format_criterion_with_signs(critical.criterion, data.summary.objective)})."
        )
    return text


def describe_search_progress(data: ReportData) -> str:
    """Describe when the search found the most critical scenario by each metric."""
    sentences = []
    for name, summary in data.summary.metrics.items():
        first = data.rows[int((data.scores[name] == summary.most_critical).argmax())]
        score = append_unit(f"{summary.most_critical:.3g}", summary.unit)
        sentences.append(
            f"The most critical {name} of all, {score}, was first found in round {first.round} (scenario {first.id})."
        )
    return " ".join(sentences)


def describe_most_critical(data: ReportData, metric: Metric) -> str:
    """Describe the most critical scenario by a metric."""
    summary = data.summary.metrics[metric.name]
    at = ", ".join(
        f"{parameter.name} ="
        f" {append_unit(format_value(parameter.extract_value(summary.parameters), 4), parameter.unit)}"
        for parameter in data.parameters
    )
    n_most_critical = int((data.scores[metric.name] == summary.most_critical).sum())
    subject = f"One of the {n_most_critical} most critical scenarios" if n_most_critical > 1 else "The most critical"
    score = append_unit(f"{summary.most_critical:.3g}", metric.unit)
    text = f"{subject} is scenario {summary.most_critical_id}, {metric.name} {score} at {at}."
    if summary.constant_note:
        text += f" {summary.constant_note}"
    if summary.repeat_spread is not None:
        median, largest = (append_unit(f"{value:.3g}", metric.unit) for value in summary.repeat_spread)
        text += (
            f" Each was run {data.summary.meta.repeats_text} times; its scores differ by {median} in the median"
            f" scenario, and by {largest} at most."
        )
    return text


def caption_front(n_scenarios: int) -> str:
    """Return the caption of the figure of a Pareto front with `n_scenarios` scenarios."""
    return f"The scores of each scenario that was run. {describe_front(n_scenarios)}"


def caption_sensitivity(sensitivity: Sensitivity, objective: str) -> str:
    """Return the caption of the figure of sensitivities."""
    text = (
        f"How much of the variance of {objective} comes from each parameter, by a Gaussian process with a"
        f" cross-validated R² of {max(sensitivity.predicted, 0.0):.2f}; the lines are 90 % intervals."
    )
    if not sensitivity.is_meaningful:
        return f"{text} {describe_missing_sensitivity()}"
    return text + (
        f" Of little influence: {', '.join(sensitivity.uninfluential_parameters)}."
        if sensitivity.uninfluential_parameters
        else ""
    )


def caption_examples(n_not_drawn: int) -> str:
    """Return the caption of the figure with one scenario per cluster, without `n_not_drawn` clusters."""
    return (
        "One scenario of each kind: the one with the smallest sum of distances to the others of its kind. Seen from"
        " above, with times in s along the trajectories and the boxes where they are closest; and speeds over time."
        + (f" {n_not_drawn} smaller kinds are not drawn." if n_not_drawn else "")
    )


def caption_kernel_space(analysis: Analysis) -> str:
    """Return the caption of the figure of the kernel space in which the clusters of an analysis were found."""
    return (
        "Similar scenarios are near each other; those of a cluster have one colour and one symbol."
        f" {describe_clustering_method(analysis)}"
    )


def caption_courses(metric: Metric) -> str:
    """Return the caption of the figure of a metric's course over time in each cluster."""
    return f"Course of {metric.name} in each cluster: median, and the band that holds 80 % of its scenarios."


def caption_reduced_set(reduced: ReducedSet) -> str:
    """Return the caption of the figure of the reduced set in the parameter space."""
    exposing = " or expose mutants of the driver (diamonds)" if reduced.exposing is not None else ""
    return (
        f"The hull of each cluster by {reduced.by}, or of its nearly convex parts, and the kept scenarios: archetypes"
        f" (circles), the prototype of each cluster (star), and scenarios that fill gaps (triangles){exposing}."
    )


def caption_coverage() -> str:
    """Return the caption of the figure of how well the reduced set covers all scenarios."""
    return (
        "Share of all scenarios, and of the critical ones, that have a kept scenario within this DTW distance. For"
        " comparison: k-medoids, and the range of 90 of 100 random choices of the same size. The kept scenarios and"
        " k-medoids were chosen from these scenarios."
    )
