"""Figures of scenarios in the parameter space and in kernel space."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from cornercase._common.typing import FloatArray, IntArray
from cornercase.metrics import Metric
from cornercase.reduction import ReducedSet
from cornercase.report.figures.style import look_of, name_score, set_axis
from cornercase.scenario import Parameter

# By role: symbol and size in points².
_MARKS: Final = (("archetype", "o", 42), ("prototype", "*", 190), ("gap", "^", 52), ("exposing", "D", 40))


def draw_criticality(values: FloatArray, parameters: Sequence[Parameter], scores: FloatArray, metric: Metric) -> Figure:
    """Draw the scores (n,) over up to six pairs of parameters, values (n, d); critical ones dark."""
    # Numeric parameters first; parameters with a single value are left out.
    varied = [i for i, parameter in enumerate(parameters) if parameter.size != 1] or [0]
    varied.sort(key=lambda i: bool(parameters[i].choices))
    pairs = list(combinations(varied, 2))[:6] or [(varied[0], varied[0])]
    columns = min(3, len(pairs))
    rows = -(-len(pairs) // columns)
    figure = Figure(figsize=(4.6 * columns + 1.0, 4.0 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    # Critical ones last, so that they are on top.
    order = np.argsort(metric.oriented(scores))[::-1]
    colours = "viridis" if metric.lower_is_critical else "viridis_r"
    points: Any = None
    for axis, (i, j) in zip(axes, pairs, strict=False):
        y = scores[order] if i == j else values[order, j]
        points = axis.scatter(values[order, i], y, c=scores[order], cmap=colours, s=22, linewidths=0)
        set_axis(axis.xaxis, parameters[i])
        if i == j:
            axis.set_ylabel(name_score(metric))
        else:
            set_axis(axis.yaxis, parameters[j])
    for axis in axes[len(pairs) :]:
        axis.set_visible(False)
    figure.colorbar(points, ax=list(axes), label=name_score(metric), shrink=0.9)
    return figure


def draw_clusters(
    embedding: FloatArray,
    labels: IntArray,
    values: FloatArray,
    parameters: Sequence[Parameter],
    chosen: Sequence[int],
    names: Mapping[int, str] | None = None,
) -> Figure:
    """Draw kernel space, embedding (n, k), and two parameters side by side, coloured by cluster label (-1: noise)."""
    figure = Figure(figsize=(12.5, 5.0))
    # A wide gap, as the tick labels of 3D axes extend beyond the axes.
    grid = figure.add_gridspec(1, 2, wspace=0.28, left=0.02, right=0.84, bottom=0.12, top=0.92)
    space: Any = figure.add_subplot(grid[0], projection="3d")
    plane = figure.add_subplot(grid[1])
    i, j = chosen[0], chosen[-1]
    for label in np.unique(labels).tolist():
        colour, marker, name = look_of(label, names)
        rows = labels == label
        space.scatter(*embedding[rows, :3].T, c=colour, marker=marker, s=20)
        y = embedding[rows, 0] if i == j else values[rows, j]
        plane.scatter(values[rows, i], y, c=colour, marker=marker, s=22, label=f"{name} ({int(rows.sum())})")
    for k, setter in enumerate((space.set_xlabel, space.set_ylabel, space.set_zlabel)):
        setter(f"component {k + 1} [–]")
    space.set_title("kernel space")
    plane.set_title("parameter space")
    set_axis(plane.xaxis, parameters[i])
    if i == j:
        plane.set_ylabel("component 1 [–]")
    else:
        set_axis(plane.yaxis, parameters[j])
    plane.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    return figure


def draw_hulls(
    values: FloatArray, ids: Sequence[int], parameters: Sequence[Parameter], reduced: ReducedSet, chosen: Sequence[int]
) -> Figure:
    """Draw the hull of each cluster in the parameter space (3D if possible) with the reduced set."""
    row_by_id = {scenario: k for k, scenario in enumerate(ids)}
    is_3d = len(chosen) >= 3
    chosen = list(chosen[: 3 if is_3d else 2])
    figure = Figure(figsize=(8.6, 6.4), layout="constrained")
    axis: Any = figure.add_subplot(projection="3d") if is_3d else figure.add_subplot()

    def place(k: Any) -> FloatArray:
        points = values[k][..., chosen]
        return np.asarray(points if points.shape[-1] > 1 else np.concatenate([points, 0 * points], axis=-1))

    for label, facets in reduced.hulls.items():
        colour, _, _ = look_of(label)
        edges = {tuple(sorted(pair)) for facet in facets for pair in combinations(facet, 2)}
        for a, b in sorted(edges):
            axis.plot(*place([row_by_id[a], row_by_id[b]]).T, color=colour, linewidth=0.7, alpha=0.55)
    for label in sorted({scenario.cluster for scenario in reduced.kept}):
        colour, _, name = look_of(label)
        for role, marker, size in _MARKS:
            members = [
                row_by_id[scenario.id]
                for scenario in reduced.kept
                if (scenario.cluster, scenario.role) == (label, role)
            ]
            if members:
                axis.scatter(
                    *place(members).T, c=colour, marker=marker, s=size, edgecolors="black", linewidths=0.6,
                    label=f"{role}, {name}",
                )  # fmt: skip
    for panel_axis, k in zip((axis.xaxis, axis.yaxis, *([axis.zaxis] if is_3d else [])), chosen, strict=False):
        set_axis(panel_axis, parameters[k])
    axis.legend(loc="center left", bbox_to_anchor=(1.05, 0.5), frameon=False)
    return figure
