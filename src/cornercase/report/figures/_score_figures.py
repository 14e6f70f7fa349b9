"""Figures of metric courses over time, coverage by the reduced set, sensitivities and Pareto fronts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from matplotlib.figure import Figure

from cornercase._common.typing import BoolArray, Float32Array, FloatArray, IntArray
from cornercase.evidence import Sensitivity
from cornercase.metrics import Metric
from cornercase.reduction._coverage import CoverageCurves, percent_within
from cornercase.report.figures._style import COLOURS, GREY, cluster_style, format_score_label, shorten_tick_label


def draw_courses_by_cluster(
    time: Sequence[FloatArray],
    courses: Sequence[Float32Array],
    labels: IntArray,
    metric: Metric,
    name_by_cluster: Mapping[int, str] | None = None,
) -> Figure:
    """Draw the course of a metric over time for each cluster: the median, and the 10th to 90th percentile as a band."""
    figure = Figure(figsize=(11.0, 3.8), layout="constrained")
    axis = figure.add_subplot()
    longest = max(time, key=len)
    table = np.full((len(courses), len(longest)), np.nan)
    for row, course in zip(table, courses, strict=True):
        row[: len(course)] = course
    for label in [cluster for cluster in np.unique(labels).tolist() if cluster >= 0]:
        colour, _, name = cluster_style(label, name_by_cluster)
        rows = table[labels == label]
        is_covered = np.isfinite(rows).sum(axis=0) >= max(1, len(rows) // 2)
        low, median, high = np.nanpercentile(rows[:, is_covered], (10, 50, 90), axis=0)
        axis.fill_between(longest[is_covered], low, high, color=colour, alpha=0.18, linewidth=0)
        style = ("-", "--", "-.", ":")[label % 4]
        axis.plot(longest[is_covered], median, style, color=colour, label=name, linewidth=1.8)
    axis.set_xlabel("time [s]")
    axis.set_ylabel(f"{metric.name} [{metric.unit}]")
    # No legend if all scenarios are noise.
    if axis.get_legend_handles_labels()[0]:
        axis.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    axis.grid(alpha=0.3)
    return figure


def draw_coverage_curves(
    curves_and_critical: Mapping[str, tuple[CoverageCurves, BoolArray]], units: Sequence[str]
) -> Figure:
    """Draw curves of coverage: for each distance, the share of scenarios at most this far from the reduced set.

    The figure has one panel for each aspect (what scenarios are compared by). `curves_and_critical` maps each aspect to
    the coverage by the reduced set and the mask of critical scenarios. `units` are the units of the distances.
    """
    columns = min(3, len(curves_and_critical))
    rows = -(-len(curves_and_critical) // columns)
    figure = Figure(figsize=(4.4 * columns + 1.8, 3.4 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis, (name, (curve, critical)), unit in zip(axes, curves_and_critical.items(), units, strict=False):
        reach = curve.reach
        axis.fill_between(
            reach, curve.random_low, curve.random_high, color=GREY, alpha=0.35, linewidth=0, label="random choices"
        )
        axis.plot(
            reach, percent_within(curve.to_medoids, reach), ":", color=COLOURS[6], linewidth=1.6, label="k-medoids"
        )
        axis.plot(reach, percent_within(curve.to_selected, reach), color=COLOURS[0], linewidth=2.0, label="kept")
        if critical.any():
            axis.plot(
                reach, percent_within(curve.to_selected[critical], reach), "--", color=COLOURS[1], linewidth=2.0,
                label="kept, of the critical ones",
            )  # fmt: skip
        axis.set_title(name)
        axis.set_xlabel(f"distance to the nearest kept one [{unit}]")
        axis.set_ylabel("scenarios [%]")
        axis.set_ylim(0.0, 103.0)
        axis.grid(alpha=0.3)
    for axis in axes[len(curves_and_critical) :]:
        axis.set_visible(False)
    if curves_and_critical:
        axes[0].legend(loc="lower right", frameon=True)
    return figure


def draw_sensitivities(sensitivity: Sensitivity) -> Figure:
    """Draw which fraction of the score's variance is due to each parameter, with 90 % credible intervals.

    Each parameter has two bars: for the parameter alone, and together with all other parameters.
    """
    figure = Figure(figsize=(8.0, 1.2 + 0.5 * len(sensitivity.names)), layout="constrained")
    axis = figure.add_subplot()
    positions = np.arange(len(sensitivity.names))
    axis.barh(positions - 0.2, sensitivity.total, 0.38, color=COLOURS[0], label="with all others (total)")
    axis.barh(
        positions + 0.2,
        sensitivity.first,
        0.38,
        color=COLOURS[4],
        hatch="//",
        edgecolor="white",
        label="alone (first order)",
    )
    for height, intervals in (
        (positions - 0.2, sensitivity.total_interval),
        (positions + 0.2, sensitivity.first_interval),
    ):
        axis.hlines(height, *np.transpose(intervals), color="black", linewidth=1.2)
    axis.set_yticks(positions, [shorten_tick_label(name) for name in sensitivity.names])
    axis.invert_yaxis()
    axis.set_xlim(0.0, 1.0)
    axis.set_xlabel("share of the variance of the score [1]")
    axis.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    return figure


def draw_pareto_front(scores: Sequence[FloatArray], metrics: Sequence[Metric], front_rows: IntArray) -> Figure:
    """Draw the Pareto front in up to six pairs of metrics; `front_rows` are the rows of the front in `scores`."""
    pairs = list(combinations(range(len(metrics)), 2))[:6]
    figure = Figure(figsize=(5.0 * min(3, len(pairs)) + 1.6, 4.2 * -(-len(pairs) // 3)), layout="constrained")
    for axis, (i, j) in zip(figure.subplots(-(-len(pairs) // 3), min(3, len(pairs)), squeeze=False).ravel(), pairs,
                            strict=False):  # fmt: skip
        axis.scatter(scores[i], scores[j], c=GREY, s=16, linewidths=0, label="run")
        axis.scatter(scores[i][front_rows], scores[j][front_rows], c=COLOURS[1], marker="D", s=30, label="Pareto front")
        axis.set_xlabel(format_score_label(metrics[i]))
        axis.set_ylabel(format_score_label(metrics[j]))
    axis.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    return figure
