"""Figures of the report, drawn without any display."""

from __future__ import annotations

import io
from collections.abc import Sequence
from itertools import combinations
from typing import Any, Final

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.metrics import Metric
from cornercase.reduction import Gaps
from cornercase.scenario import Parameter

# Okabe and Ito's colours, which the colour-blind tell apart; markers say the same again.
_COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#F0E442")
_MARKERS: Final = ("o", "s", "^", "D", "v", "P", "*", "X")
_NOISE: Final = "#999999"
_LONGEST: Final = 16


def look(label: int) -> tuple[str, str, str]:
    """Colour, marker and name of a cluster."""
    if label < 0:
        return _NOISE, "x", "noise"
    return _COLOURS[label % len(_COLOURS)], _MARKERS[label % len(_MARKERS)], f"cluster {label}"


def png(figure: Figure) -> bytes:
    """Figure as PNG; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(buffer, format="png", dpi=110, metadata={"Software": None}, bbox_inches="tight", pad_inches=0.25)
    return buffer.getvalue()


def axis_name(parameter: Parameter) -> str:
    """Name, with the unit where it is known."""
    return f"{parameter.name} [{parameter.unit}]" if parameter.unit else parameter.name


def _name_axis(axis: Any, parameter: Parameter) -> None:
    axis.set_label_text(axis_name(parameter))
    if parameter.choices:
        axis.set_ticks(range(len(parameter.choices)), [_shortened(choice) for choice in parameter.choices])


def _shortened(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"


def criticality(values: FloatArray, parameters: Sequence[Parameter], scores: FloatArray, metric: Metric) -> Figure:
    """Scores over each pair of parameters, dark being critical.

    Parameters
    ----------
    values : ndarray of float64, shape (n, d)
    parameters : sequence of Parameter, length d
    scores : ndarray of float64, shape (n,)
    metric : Metric
    """
    # Numbers first: more is seen of them; what has one value shows nothing.
    varied = [i for i, one in enumerate(parameters) if one.size != 1] or [0]
    varied.sort(key=lambda i: bool(parameters[i].choices))
    pairs = list(combinations(varied, 2))[:6] or [(varied[0], varied[0])]
    columns = min(3, len(pairs))
    rows = -(-len(pairs) // columns)
    figure = Figure(figsize=(4.6 * columns + 1.0, 4.0 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    # Drawing the critical ones last keeps them on top.
    order = np.argsort(metric.oriented(scores))[::-1]
    colours = "viridis" if metric.lower_is_critical else "viridis_r"
    points: Any = None
    for axis, (i, j) in zip(axes, pairs, strict=False):
        y = scores[order] if i == j else values[order, j]
        points = axis.scatter(values[order, i], y, c=scores[order], cmap=colours, s=22, linewidths=0)
        _name_axis(axis.xaxis, parameters[i])
        if i == j:
            axis.set_ylabel(_score_name(metric))
        else:
            _name_axis(axis.yaxis, parameters[j])
    for axis in axes[len(pairs) :]:
        axis.set_visible(False)
    figure.colorbar(points, ax=list(axes), label=_score_name(metric), shrink=0.9)
    return figure


def clusters(
    embedding: FloatArray,
    labels: IntArray,
    values: FloatArray,
    parameters: Sequence[Parameter],
    chosen: Sequence[int],
) -> Figure:
    """Kernel space and parameter space side by side, coloured by cluster.

    Parameters
    ----------
    embedding : ndarray of float64, shape (n, 3)
    labels : ndarray of int64, shape (n,)
    values : ndarray of float64, shape (n, d)
    parameters : sequence of Parameter, length d
    chosen : sequence of int
        The two parameters to draw; one where there is no more.
    """
    figure = Figure(figsize=(12.5, 5.0))
    # Wide between the two: the tick labels of three-dimensional axes reach beyond them.
    grid = figure.add_gridspec(1, 2, wspace=0.28, left=0.02, right=0.84, bottom=0.12, top=0.92)
    space: Any = figure.add_subplot(grid[0], projection="3d")
    plane = figure.add_subplot(grid[1])
    i, j = chosen[0], chosen[-1]
    for label in np.unique(labels).tolist():
        colour, marker, name = look(label)
        rows = labels == label
        space.scatter(*embedding[rows].T, c=colour, marker=marker, s=20)
        y = embedding[rows, 0] if i == j else values[rows, j]
        plane.scatter(values[rows, i], y, c=colour, marker=marker, s=22, label=f"{name} ({int(rows.sum())})")
    for k, setter in enumerate((space.set_xlabel, space.set_ylabel, space.set_zlabel)):
        setter(f"component {k + 1} [–]")
    space.set_title("kernel space")
    plane.set_title("parameter space")
    _name_axis(plane.xaxis, parameters[i])
    if i == j:
        plane.set_ylabel("component 1 [–]")
    else:
        _name_axis(plane.yaxis, parameters[j])
    plane.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    return figure


def courses(time: Sequence[FloatArray], values: Sequence[FloatArray], labels: IntArray, metric: Metric) -> Figure:
    """Course of a metric over time for each cluster: median, and the band from the 10th to the 90th percentile.

    Parameters
    ----------
    time, values : sequence of ndarray of float64, each (T_i,)
        In s, and as capped courses.
    labels : ndarray of int64, shape (n,)
    metric : Metric
    """
    figure = Figure(figsize=(11.0, 3.8), layout="constrained")
    axis = figure.add_subplot()
    longest = max(time, key=len)
    table = np.full((len(values), len(longest)), np.nan)
    for row, course in zip(table, values, strict=True):
        row[: len(course)] = course
    for label in [one for one in np.unique(labels).tolist() if one >= 0]:
        colour, _, name = look(label)
        rows = table[labels == label]
        there = np.isfinite(rows).sum(axis=0) >= max(1, len(rows) // 2)
        low, middle, high = np.nanpercentile(rows[:, there], (10, 50, 90), axis=0)
        axis.fill_between(longest[there], low, high, color=colour, alpha=0.18, linewidth=0)
        style = ("-", "--", "-.", ":")[label % 4]
        axis.plot(longest[there], middle, style, color=colour, label=name, linewidth=1.8)
    axis.set_xlabel("time [s]")
    axis.set_ylabel(f"{metric.name} [{metric.unit}]")
    axis.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    axis.grid(alpha=0.3)
    return figure


def hulls(
    values: FloatArray,
    ids: Sequence[int],
    parameters: Sequence[Parameter],
    reduction: dict[str, Any],
    chosen: Sequence[int],
) -> Figure:
    """Hull of each cluster in the parameter space, with what was kept.

    Parameters
    ----------
    values : ndarray of float64, shape (n, d)
    ids : sequence of int, length n
    parameters : sequence of Parameter, length d
    reduction : dict
        As of `Study.reduction`.
    chosen : sequence of int
        Up to three parameters to draw.
    """
    row = {scenario: k for k, scenario in enumerate(ids)}
    solid = len(chosen) >= 3
    chosen = list(chosen[: 3 if solid else 2])
    figure = Figure(figsize=(8.6, 6.4), layout="constrained")
    axis: Any = figure.add_subplot(projection="3d") if solid else figure.add_subplot()

    def place(k: Any) -> FloatArray:
        points = values[k][..., chosen]
        return np.asarray(points if points.shape[-1] > 1 else np.concatenate([points, 0 * points], axis=-1))

    for label, facets in reduction["hulls"].items():
        colour, _, _ = look(int(label))
        edges = {tuple(sorted(pair)) for facet in facets for pair in combinations(facet, 2)}
        for a, b in sorted(edges):
            axis.plot(*place([row[a], row[b]]).T, color=colour, linewidth=0.7, alpha=0.55)
    for label in sorted({item["cluster"] for item in reduction["kept"]}):
        colour, _, name = look(label)
        for role, marker, size in (("archetype", "o", 42), ("prototype", "*", 190), ("gap", "^", 52)):
            members = [row[i["id"]] for i in reduction["kept"] if i["cluster"] == label and i["role"] == role]
            if members:
                axis.scatter(
                    *place(members).T, c=colour, marker=marker, s=size, edgecolors="black", linewidths=0.6,
                    label=f"{role}, {name}",
                )  # fmt: skip
    for one, k in zip((axis.xaxis, axis.yaxis, *([axis.zaxis] if solid else [])), chosen, strict=False):
        _name_axis(one, parameters[k])
    axis.legend(loc="center left", bbox_to_anchor=(1.05, 0.5), frameon=False)
    return figure


def coverage(curves: dict[str, tuple[Gaps, BoolArray]], units: Sequence[str]) -> Figure:
    """Share of the scenarios that have a kept one within a distance, by the distance.

    Parameters
    ----------
    curves : dict of str to tuple
        By clustering, what `cornercase.reduction.coverage.gaps` says, and a mask of the critical scenarios.
    units : sequence of str
        Of each clustering's distance.
    """
    columns = min(3, len(curves))
    rows = -(-len(curves) // columns)
    figure = Figure(figsize=(4.4 * columns + 1.8, 3.4 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis, (name, (found, critical)), unit in zip(axes, curves.items(), units, strict=False):
        farthest = max(
            float(found.kept.max()), float(found.medoids.max()), float(np.quantile(found.random, 0.99)), 1e-9
        )
        reach = np.linspace(0.0, 1.05 * farthest, 300)

        def share(gaps: FloatArray, reach: FloatArray = reach) -> FloatArray:
            return np.asarray(np.searchsorted(np.sort(gaps), reach, side="right") / max(len(gaps), 1))

        band = np.quantile([share(one) for one in found.random], (0.05, 0.95), axis=0)
        axis.fill_between(reach, *(100.0 * band), color=_NOISE, alpha=0.35, linewidth=0, label="random choices")
        axis.plot(reach, 100.0 * share(found.medoids), ":", color=_COLOURS[6], linewidth=1.6, label="k-medoids")
        axis.plot(reach, 100.0 * share(found.kept), color=_COLOURS[0], linewidth=2.0, label="kept")
        if critical.any():
            axis.plot(
                reach, 100.0 * share(found.kept[critical]), "--", color=_COLOURS[1], linewidth=2.0,
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


def sensitivities(names: Sequence[str], first: Sequence[float], total: Sequence[float]) -> Figure:
    """Share of the score's variance that each parameter explains, alone and with the others.

    Parameters
    ----------
    names : sequence of str, length d
    first, total : sequence of float, length d
    """
    figure = Figure(figsize=(8.0, 1.2 + 0.5 * len(names)), layout="constrained")
    axis = figure.add_subplot()
    place = np.arange(len(names))
    axis.barh(place - 0.2, total, 0.38, color=_COLOURS[0], label="with all others (total)")
    axis.barh(place + 0.2, first, 0.38, color=_COLOURS[4], hatch="//", edgecolor="white", label="alone (first order)")
    axis.set_yticks(place, [_shortened(name) for name in names])
    axis.invert_yaxis()
    axis.set_xlim(0.0, 1.0)
    axis.set_xlabel("share of the variance of the score [1]")
    axis.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    return figure


def front(scores: Sequence[FloatArray], metrics: Sequence[Metric], chosen: Sequence[int]) -> Figure:
    """Scores of each pair of metrics, with the Pareto front.

    Parameters
    ----------
    scores : sequence of ndarray of float64, each (n,)
    metrics : sequence of Metric, length k
    chosen : sequence of int
        Scenarios on the front, by their row.
    """
    pairs = list(combinations(range(len(metrics)), 2))[:6]
    figure = Figure(figsize=(5.0 * min(3, len(pairs)) + 1.6, 4.2 * -(-len(pairs) // 3)), layout="constrained")
    for axis, (i, j) in zip(figure.subplots(-(-len(pairs) // 3), min(3, len(pairs)), squeeze=False).ravel(), pairs,
                            strict=False):  # fmt: skip
        axis.scatter(scores[i], scores[j], c=_NOISE, s=16, linewidths=0, label="run")
        rows = list(chosen)
        axis.scatter(scores[i][rows], scores[j][rows], c=_COLOURS[1], marker="D", s=30, label="Pareto front")
        axis.set_xlabel(_score_name(metrics[i]))
        axis.set_ylabel(_score_name(metrics[j]))
    axis.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    return figure


def _score_name(metric: Metric) -> str:
    return f"{metric.name} score [{metric.unit}], {'low' if metric.lower_is_critical else 'high'} is critical"
