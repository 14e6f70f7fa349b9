"""Figures of scenarios in the parameter space, and in the kernel space in which clusters were found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from cornercase._common.typing import FloatArray, IntArray
from cornercase.metrics import Metric
from cornercase.reduction import ReducedSet
from cornercase.reduction._hulls import find_hull_edges
from cornercase.report.figures._style import cluster_style, format_score_label, label_axis
from cornercase.scenario import Parameter

# By role: symbol and size in points².
_ROLE_MARKERS: Final = (
    ("archetype", "o", 42),
    ("prototype", "*", 190),
    ("critical prototype", "P", 110),
    ("gap", "^", 52),
    ("exposing", "D", 40),
)


def draw_scores_by_parameter_pair(
    values: FloatArray, parameters: Sequence[Parameter], scores: FloatArray, metric: Metric
) -> Figure:
    """Draw the scores of n scenarios over up to six pairs of parameters; critical scenarios are dark.

    `scores` has shape (n,), and `values` shape (n, d) with d parameters.
    """
    # Numeric parameters first; parameters with a single value are left out.
    varied = [i for i, parameter in enumerate(parameters) if parameter.size != 1] or [0]
    varied.sort(key=lambda i: bool(parameters[i].choices))
    pairs = list(combinations(varied, 2))[:6] or [(varied[0], varied[0])]
    columns = min(3, len(pairs))
    rows = -(-len(pairs) // columns)
    figure = Figure(figsize=(4.6 * columns + 1.0, 4.0 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    # Critical ones last, so that they are on top.
    order = np.argsort(metric.to_minimize(scores))[::-1]
    colours = "viridis" if metric.lower_is_critical else "viridis_r"
    points: Any = None
    for axis, (i, j) in zip(axes, pairs, strict=False):
        y = scores[order] if i == j else values[order, j]
        points = axis.scatter(values[order, i], y, c=scores[order], cmap=colours, s=22, linewidths=0)
        label_axis(axis.xaxis, parameters[i])
        if i == j:
            axis.set_ylabel(format_score_label(metric))
        else:
            label_axis(axis.yaxis, parameters[j])
    for axis in axes[len(pairs) :]:
        axis.set_visible(False)
    figure.colorbar(points, ax=list(axes), label=format_score_label(metric), shrink=0.9)
    return figure


def draw_kernel_and_parameter_space(
    embedding: FloatArray,
    labels: IntArray,
    values: FloatArray,
    parameters: Sequence[Parameter],
    parameter_indices: Sequence[int],
    name_by_cluster: Mapping[int, str] | None = None,
) -> Figure:
    """Draw scenarios in kernel space and over two parameters, side by side, coloured by cluster.

    `embedding`, shape (n, k), are coordinates in kernel space; `values`, shape (n, d), are parameters. The label -1
    means noise.
    """
    figure = Figure(figsize=(12.5, 5.0))
    # A wide gap, as the tick labels of 3D axes extend beyond the axes.
    grid = figure.add_gridspec(1, 2, wspace=0.28, left=0.02, right=0.84, bottom=0.12, top=0.92)
    space: Any = figure.add_subplot(grid[0], projection="3d")
    plane = figure.add_subplot(grid[1])
    i, j = parameter_indices[0], parameter_indices[-1]
    for label in np.unique(labels).tolist():
        colour, marker, name = cluster_style(label, name_by_cluster)
        rows = labels == label
        space.scatter(*embedding[rows, :3].T, c=colour, marker=marker, s=20)
        y = embedding[rows, 0] if i == j else values[rows, j]
        plane.scatter(values[rows, i], y, c=colour, marker=marker, s=22, label=f"{name} ({int(rows.sum())})")
    for k, setter in enumerate((space.set_xlabel, space.set_ylabel, space.set_zlabel)):
        setter(f"component {k + 1} [–]")
    space.set_title("kernel space")
    plane.set_title("parameter space")
    label_axis(plane.xaxis, parameters[i])
    if i == j:
        plane.set_ylabel("component 1 [–]")
    else:
        label_axis(plane.yaxis, parameters[j])
    plane.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    return figure


def draw_hulls_and_reduced_set(
    values: FloatArray,
    ids: Sequence[int],
    parameters: Sequence[Parameter],
    reduced: ReducedSet,
    parameter_indices: Sequence[int],
) -> Figure:
    """Draw the reduced set and the hull of each cluster in the parameter space.

    The axes are the first three of `parameter_indices`. With fewer than three parameters, the figure is 2D.
    """
    row_by_id = {scenario: k for k, scenario in enumerate(ids)}
    is_3d = len(parameter_indices) >= 3
    parameter_indices = list(parameter_indices[: 3 if is_3d else 2])
    figure = Figure(figsize=(8.6, 6.4), layout="constrained")
    axis: Any = figure.add_subplot(projection="3d") if is_3d else figure.add_subplot()

    def coordinates(k: Any) -> FloatArray:
        points = values[k][..., parameter_indices]
        return np.asarray(points if points.shape[-1] > 1 else np.concatenate([points, 0 * points], axis=-1))

    for label, facets in reduced.hulls.items():
        colour, _, _ = cluster_style(label)
        for a, b in find_hull_edges(facets):
            axis.plot(*coordinates([row_by_id[a], row_by_id[b]]).T, color=colour, linewidth=0.7, alpha=0.55)
    for label in sorted({scenario.cluster for scenario in reduced.scenarios}):
        colour, _, name = cluster_style(label)
        for role, marker, size in _ROLE_MARKERS:
            members = [
                row_by_id[scenario.id]
                for scenario in reduced.scenarios
                if (scenario.cluster, scenario.role) == (label, role)
            ]
            if members:
                axis.scatter(
                    *coordinates(members).T, c=colour, marker=marker, s=size, edgecolors="black", linewidths=0.6,
                    label=f"{role}, {name}",
                )  # fmt: skip
    for panel_axis, k in zip(
        (axis.xaxis, axis.yaxis, *([axis.zaxis] if is_3d else [])), parameter_indices, strict=False
    ):
        label_axis(panel_axis, parameters[k])
    axis.legend(loc="center left", bbox_to_anchor=(1.05, 0.5), frameon=False)
    return figure
