"""Captions of the figures and of the page's views."""

from __future__ import annotations

from typing import Any

import numpy as np

from cornercase._common.texts import plain_text
from cornercase.clustering import Analysis
from cornercase.evidence import Sensitivity
from cornercase.metrics import Metric
from cornercase.reduction import ReducedSet
from cornercase.report.answers import ends_of_front
from cornercase.report.data import ReportData
from cornercase.report.words import (
    format_value,
    judge_clusters,
    tell_criterion,
    tell_front,
    tell_how_found,
    tell_unforetold,
    with_unit,
)


def page_captions(data: ReportData) -> dict[str, Any]:
    """Return the captions of the page's views by name: a text, or texts by metric or aspect.

    Views that are missing have the same caption in every study.
    """
    summary = data.summary
    estimates, analyses = summary.knowledge, summary.analyses
    captions: dict[str, Any] = {
        "space": {metric.name: of_scores(data, metric) for metric in data.metrics},
        "histogram": {metric.name: of_distribution(data, metric) for metric in data.metrics},
        "search": of_search(data),
        "kernel": {name: of_clusters(analysis) for name, analysis in analyses.items()},
    }
    if estimates.front is not None:
        captions["front"] = " ".join(ends_of_front(data))
    if estimates.sensitivity is not None:
        captions["matters"] = of_influence(estimates.sensitivity)
    return {view: _plain(caption) for view, caption in captions.items()}


def _plain(caption: Any) -> Any:
    if isinstance(caption, dict):
        return {name: plain_text(text) for name, text in caption.items()}
    return plain_text(caption)


def of_clusters(analysis: Analysis) -> str:
    """Describe how many clusters an aspect has."""
    count, noise = analysis.clustering.n_clusters, int((analysis.labels < 0).sum())
    if count < 2:
        return judge_clusters(analysis)
    outside = f", and {noise} scenarios of noise" if noise else ""
    return f"{count} kinds by {analysis.by}{outside}."


def of_influence(found: Sensitivity) -> str:
    """Describe which parameter matters most."""
    if not found.foretold:
        return tell_unforetold()
    little = f" {' and '.join(found.little)} {'has' if len(found.little) == 1 else 'have'} little influence."
    return f"{found.names[int(np.argmax(found.total))]} matters most.{little if found.little else ''}"


def of_distribution(data: ReportData, metric: Metric) -> str:
    """Describe the distribution of a metric's scores."""
    scores = data.scores[metric.name]
    low, middle, high = (with_unit(f"{value:.3g}", metric.unit) for value in np.quantile(scores, (0.0, 0.5, 1.0)))
    if low == high:
        subject = "All scenarios have" if len(scores) > 1 else "The one scenario has"
        return f"{subject} the {metric.name} score {low}."
    text = f"{metric.name} scores lie between {low} and {high}; the median is {middle}."
    critical = data.summary.knowledge.critical
    if critical is not None and metric.name == data.summary.searched:
        text += (
            f" {critical.scenarios} of {len(scores)} are critical ({tell_criterion(critical, data.summary.searched)})."
        )
    return text


def of_search(data: ReportData) -> str:
    """Describe when the search found the most critical scenario of each metric."""
    sentences = []
    for name, summary in data.summary.metrics.items():
        round_number = next(row.round for row in data.rows if row.id == summary.scenario)
        score = with_unit(f"{summary.most_critical:.3g}", summary.unit)
        sentences.append(
            f"The most critical {name} of all, {score}, was first found in round {round_number}"
            f" (scenario {summary.scenario})."
        )
    return " ".join(sentences)


def of_scores(data: ReportData, metric: Metric) -> str:
    """Describe the most critical scenario by a metric."""
    summary = data.summary.metrics[metric.name]
    at = ", ".join(
        f"{parameter.name} = {with_unit(format_value(parameter.read(summary.at), 4), parameter.unit)}"
        for parameter in data.parameters
    )
    n_most_critical = int((data.scores[metric.name] == summary.most_critical).sum())
    subject = f"One of the {n_most_critical} most critical scenarios" if n_most_critical > 1 else "The most critical"
    score = with_unit(f"{summary.most_critical:.3g}", metric.unit)
    text = f"{subject} is scenario {summary.scenario}, {metric.name} {score} at {at}."
    if summary.alike:
        text += f" {summary.alike}"
    if summary.spread is not None:
        median, largest = (with_unit(f"{value:.3g}", metric.unit) for value in summary.spread)
        text += (
            f" Each was run {data.summary.meta.runs_of_each} times; its scores differ by {median} in the median"
            f" scenario, and by {largest} at most."
        )
    return text


def of_front(count: int) -> str:
    """Caption of the figure of a Pareto front with `n_scenarios`."""
    return f"The scores of each scenario that was run. {tell_front(count)}"


def of_sensitivity(found: Sensitivity, searched: str) -> str:
    """Caption of the figure of sensitivities."""
    text = (
        f"How much of the variance of {searched} comes from each parameter, by a Gaussian process with a"
        f" cross-validated R² of {max(found.predicted, 0.0):.2f}; the lines are 90 % intervals."
    )
    if not found.foretold:
        return f"{text} {tell_unforetold()}"
    return text + (f" Of little influence: {', '.join(found.little)}." if found.little else "")


def of_examples(left_out: int) -> str:
    """Caption of the figure of one scenario per cluster; `n_not_drawn` are left out."""
    return (
        "One scenario of each kind: the one with the smallest sum of distances to the others of its kind. Seen from"
        " above, with times in s along the trajectories and the boxes where they are closest; and speeds over time."
        + (f" {left_out} smaller kinds are not drawn." if left_out else "")
    )


def of_kernel_space(analysis: Analysis) -> str:
    """Caption of the figure of kernel space."""
    return (
        "Similar scenarios are near each other; those of a cluster have one colour and one symbol."
        f" {tell_how_found(analysis)}"
    )


def of_courses(metric: Metric) -> str:
    """Caption of the figure of a metric's courses per cluster."""
    return f"Course of {metric.name} in each cluster: median, and the band that holds 80 % of its scenarios."


def of_hulls(reduced: ReducedSet) -> str:
    """Caption of the figure of the reduced set in the parameter space."""
    exposing = " or expose mutants of the driver (diamonds)" if reduced.exposing is not None else ""
    return (
        f"The hull of each cluster by {reduced.by}, or of its nearly convex parts, and the kept scenarios: archetypes"
        f" (circles), the prototype of each cluster (star), and scenarios that fill gaps (triangles){exposing}."
    )


def of_coverage() -> str:
    """Caption of the figure of coverage."""
    return (
        "Share of all scenarios, and of the critical ones, that have a kept scenario within this DTW distance. For"
        " comparison: k-medoids, and the range of 90 of 100 random choices of the same size. The kept scenarios and"
        " k-medoids were chosen from these scenarios."
    )
