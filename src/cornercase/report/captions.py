"""What is to be seen in each figure, in words."""

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
    """Say what is to be seen in each view of the page.

    Parameters
    ----------
    data : ReportData
        What the report shows.

    Returns
    -------
    dict of str to object
        By the name of the view: a text, or texts by metric ("space", "histogram") or aspect ("kernel"). A view that
        is not among them says the same of every study.
    """
    summary = data.summary
    known, analyses = summary.knowledge, summary.analyses
    found: dict[str, Any] = {
        "space": {metric.name: of_scores(data, metric) for metric in data.metrics},
        "histogram": {metric.name: of_distribution(data, metric) for metric in data.metrics},
        "search": of_search(data),
        "kernel": {name: of_clusters(one) for name, one in analyses.items()},
    }
    if known.front is not None:
        found["front"] = " ".join(ends_of_front(data))
    if known.sensitivity is not None:
        found["matters"] = of_influence(known.sensitivity)
    return {view: _plain(one) for view, one in found.items()}


def _plain(caption: Any) -> Any:
    if isinstance(caption, dict):
        return {name: plain_text(text) for name, text in caption.items()}
    return plain_text(caption)


def of_clusters(analysis: Analysis) -> str:
    """Say how many clusters there are by an aspect.

    Parameters
    ----------
    analysis : Analysis
        The clusters.

    Returns
    -------
    str
        A sentence.
    """
    count, noise = analysis.clustering.n_clusters, int((analysis.labels < 0).sum())
    if count < 2:
        return judge_clusters(analysis)
    outside = f", and {noise} scenarios of noise" if noise else ""
    return f"{count} kinds by {analysis.by}{outside}."


def of_influence(found: Sensitivity) -> str:
    """Say which parameter matters most.

    Parameters
    ----------
    found : Sensitivity
        The sensitivities.

    Returns
    -------
    str
        Sentences.
    """
    if not found.foretold:
        return tell_unforetold()
    little = f" {' and '.join(found.little)} {'has' if len(found.little) == 1 else 'have'} little influence."
    return f"{found.names[int(np.argmax(found.total))]} matters most.{little if found.little else ''}"


def of_distribution(data: ReportData, metric: Metric) -> str:
    """Say how the scores of a metric are distributed.

    Parameters
    ----------
    data : ReportData
        What the report shows.
    metric : Metric
        One of the study.

    Returns
    -------
    str
        A sentence.
    """
    scores = data.scores[metric.name]
    low, middle, high = (with_unit(f"{value:.3g}", metric.unit) for value in np.quantile(scores, (0.0, 0.5, 1.0)))
    if low == high:
        whose = "All scenarios have" if len(scores) > 1 else "The one scenario has"
        return f"{whose} the {metric.name} score {low}."
    said = f"{metric.name} scores lie between {low} and {high}; the median is {middle}."
    known = data.summary.knowledge.critical
    if known is not None and metric.name == data.summary.searched:
        said += f" {known.scenarios} of {len(scores)} are critical ({tell_criterion(known, data.summary.searched)})."
    return said


def of_search(data: ReportData) -> str:
    """Say when the search found the most critical scenario.

    Parameters
    ----------
    data : ReportData
        What the report shows.

    Returns
    -------
    str
        Sentences.
    """
    said = []
    for name, one in data.summary.metrics.items():
        at = next(row.round for row in data.rows if row.id == one.scenario)
        best = with_unit(f"{one.most_critical:.3g}", one.unit)
        said.append(
            f"The most critical {name} of all, {best}, was first found in round {at} (scenario {one.scenario})."
        )
    return " ".join(said)


def of_scores(data: ReportData, metric: Metric) -> str:
    """Say which scenario is the most critical by a metric.

    Parameters
    ----------
    data : ReportData
        What the report shows.
    metric : Metric
        One of the study.

    Returns
    -------
    str
        Sentences.
    """
    one = data.summary.metrics[metric.name]
    at = ", ".join(
        f"{parameter.name} = {with_unit(format_value(parameter.read(one.at), 4), parameter.unit)}"
        for parameter in data.parameters
    )
    many = int((data.scores[metric.name] == one.most_critical).sum())
    which = f"One of the {many} most critical scenarios" if many > 1 else "The most critical"
    best = with_unit(f"{one.most_critical:.3g}", metric.unit)
    said = f"{which} is scenario {one.scenario}, {metric.name} {best} at {at}."
    if one.alike:
        said += f" {one.alike}"
    if one.spread is not None:
        median, largest = (with_unit(f"{value:.3g}", metric.unit) for value in one.spread)
        said += (
            f" Each was run {data.summary.meta.runs_of_each} times; its scores differ by {median} in the median"
            f" scenario, and by {largest} at most."
        )
    return said


def of_front(count: int) -> str:
    """Say what a figure of the Pareto front shows.

    Parameters
    ----------
    count : int
        Number of scenarios on it.

    Returns
    -------
    str
        Sentences.
    """
    return f"The scores of each scenario that was run. {tell_front(count)}"


def of_sensitivity(found: Sensitivity, searched: str) -> str:
    """Say what a figure of sensitivities shows.

    Parameters
    ----------
    found : Sensitivity
        The sensitivities.
    searched : str
        What is searched.

    Returns
    -------
    str
        Sentences.
    """
    said = (
        f"How much of the variance of {searched} comes from each parameter, by a Gaussian process with a"
        f" cross-validated R² of {max(found.predicted, 0.0):.2f}; the lines are 90 % intervals."
    )
    if not found.foretold:
        return f"{said} {tell_unforetold()}"
    return said + (f" Of little influence: {', '.join(found.little)}." if found.little else "")


def of_examples(left_out: int) -> str:
    """Say what a figure of one scenario of each kind shows.

    Parameters
    ----------
    left_out : int
        Number of kinds that are not drawn.

    Returns
    -------
    str
        Sentences.
    """
    return (
        "One scenario of each kind: the one with the smallest sum of distances to the others of its kind. Seen from"
        " above, with times in s along the trajectories and the boxes where they are closest; and speeds over time."
        + (f" {left_out} smaller kinds are not drawn." if left_out else "")
    )


def of_kernel_space(analysis: Analysis) -> str:
    """Say what a figure of kernel space shows.

    Parameters
    ----------
    analysis : Analysis
        The clusters.

    Returns
    -------
    str
        Sentences.
    """
    return (
        "Similar scenarios are near each other; those of a cluster have one colour and one symbol."
        f" {tell_how_found(analysis)}"
    )


def of_courses(metric: Metric) -> str:
    """Say what a figure of courses shows.

    Parameters
    ----------
    metric : Metric
        Whose courses they are.

    Returns
    -------
    str
        A sentence.
    """
    return f"Course of {metric.name} in each cluster: median, and the band that holds 80 % of its scenarios."


def of_hulls(reduced: ReducedSet) -> str:
    """Say what a figure of the kept scenarios in the parameter space shows.

    Parameters
    ----------
    reduced : ReducedSet
        The kept scenarios.

    Returns
    -------
    str
        A sentence.
    """
    exposing = " or expose mutants of the driver (diamonds)" if reduced.exposing is not None else ""
    return (
        f"The hull of each cluster by {reduced.by}, or of its nearly convex parts, and the kept scenarios: archetypes"
        f" (circles), the prototype of each cluster (star), and scenarios that fill gaps (triangles){exposing}."
    )


def of_coverage() -> str:
    """Say what a figure of coverage shows.

    Returns
    -------
    str
        Sentences.
    """
    return (
        "Share of all scenarios, and of the critical ones, that have a kept scenario within this DTW distance. For"
        " comparison: k-medoids, and the range of 90 of 100 random choices of the same size. The kept scenarios and"
        " k-medoids were chosen from these scenarios."
    )
