"""Figures of courses, coverage, sensitivities and Pareto fronts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from matplotlib.figure import Figure

from cornercase._common.typing import BoolArray, Float32Array, FloatArray, IntArray
from cornercase.evidence import Sensitivity
from cornercase.metrics import Metric
from cornercase.reduction import Gaps
from cornercase.report.figures.style import COLOURS, GREY, look_of, name_score, shorten


def draw_courses(
    time: Sequence[FloatArray],
    values: Sequence[Float32Array],
    labels: IntArray,
    metric: Metric,
    names: Mapping[int, str] | None = None,
) -> Figure:
    """Draw a metric's course over time per cluster: median, and the band from the 10th to the 90th percentile."""
    figure = Figure(figsize=(11.0, 3.8), layout="constrained")
    axis = figure.add_subplot()
    longest = max(time, key=len)
    table = np.full((len(values), len(longest)), np.nan)
    for row, course in zip(table, values, strict=True):
        row[: len(course)] = course
    for label in [cluster for cluster in np.unique(labels).tolist() if cluster >= 0]:
        colour, _, name = look_of(label, names)
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


def draw_coverage(curves: Mapping[str, tuple[Gaps, BoolArray]], units: Sequence[str]) -> Figure:
    """Draw the share of scenarios within a distance of the reduced set, one panel per aspect.

    `gaps_and_critical` holds the gaps and the mask of critical scenarios by aspect, `units` the units of distances.
    """
    columns = min(3, len(curves))
    rows = -(-len(curves) // columns)
    figure = Figure(figsize=(4.4 * columns + 1.8, 3.4 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis, (name, (coverage, critical)), unit in zip(axes, curves.items(), units, strict=False):
        farthest = max(
            float(coverage.kept.max()), float(coverage.medoids.max()), float(np.quantile(coverage.random, 0.99)), 1e-9
        )
        reach = np.linspace(0.0, 1.05 * farthest, 300)

        def share(gaps: FloatArray, reach: FloatArray = reach) -> FloatArray:
            return np.asarray(np.searchsorted(np.sort(gaps), reach, side="right") / max(len(gaps), 1))

        band = np.quantile([share(distances) for distances in coverage.random], (0.05, 0.95), axis=0)
        axis.fill_between(reach, *(100.0 * band), color=GREY, alpha=0.35, linewidth=0, label="random choices")
        axis.plot(reach, 100.0 * share(coverage.medoids), ":", color=COLOURS[6], linewidth=1.6, label="k-medoids")
        axis.plot(reach, 100.0 * share(coverage.kept), color=COLOURS[0], linewidth=2.0, label="kept")
        if critical.any():
            axis.plot(
                reach, 100.0 * share(coverage.kept[critical]), "--", color=COLOURS[1], linewidth=2.0,
                label="kept, of the critical ones",
            )  # fmt: skip
        axis.set_title(name)
        axis.set_xlabel(f"distance to the nearest kept one [{unit}]")
        axis.set_ylabel("scenarios [%]")
        axis.set_ylim(0.0, 103.0)
        axis.grid(alpha=0.3)
    for axis in axes[len(curves) :]:
        axis.set_visible(False)
    if curves:
        axes[0].legend(loc="lower right", frameon=True)
    return figure


def draw_sensitivities(found: Sensitivity) -> Figure:
    """Draw the share of the score's variance per parameter, alone and in total, with intervals."""
    figure = Figure(figsize=(8.0, 1.2 + 0.5 * len(found.names)), layout="constrained")
    axis = figure.add_subplot()
    positions = np.arange(len(found.names))
    axis.barh(positions - 0.2, found.total, 0.38, color=COLOURS[0], label="with all others (total)")
    axis.barh(
        positions + 0.2, found.first, 0.38, color=COLOURS[4], hatch="//", edgecolor="white", label="alone (first order)"
    )
    for height, intervals in ((positions - 0.2, found.total_interval), (positions + 0.2, found.first_interval)):
        axis.hlines(height, *np.transpose(intervals), color="black", linewidth=1.2)
    axis.set_yticks(positions, [shorten(name) for name in found.names])
    axis.invert_yaxis()
    axis.set_xlim(0.0, 1.0)
    axis.set_xlabel("share of the variance of the score [1]")
    axis.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    return figure


def draw_front(scores: Sequence[FloatArray], metrics: Sequence[Metric], chosen: IntArray) -> Figure:
    """Draw the scores of up to six pairs of metrics with the Pareto front, whose rows are `front_rows`."""
    pairs = list(combinations(range(len(metrics)), 2))[:6]
    figure = Figure(figsize=(5.0 * min(3, len(pairs)) + 1.6, 4.2 * -(-len(pairs) // 3)), layout="constrained")
    for axis, (i, j) in zip(figure.subplots(-(-len(pairs) // 3), min(3, len(pairs)), squeeze=False).ravel(), pairs,
                            strict=False):  # fmt: skip
        axis.scatter(scores[i], scores[j], c=GREY, s=16, linewidths=0, label="run")
        axis.scatter(scores[i][chosen], scores[j][chosen], c=COLOURS[1], marker="D", s=30, label="Pareto front")
        axis.set_xlabel(name_score(metrics[i]))
        axis.set_ylabel(name_score(metrics[j]))
    axis.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    return figure
