"""Figures 5 and 6 of the paper by B. Schütt, S. Otten and E. Sax (2023), drawn from a study."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from string import ascii_lowercase
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from cornercase._common import validation
from cornercase._common.errors import InputError, suggest_name
from cornercase._common.io.atomic import atomic_write_group
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering import Analysis, read_analysis
from cornercase.metrics import Metric
from cornercase.reduction._hulls import find_convex_hull, find_hull_archetypes
from cornercase.report._report_data import order_parameters_by_influence
from cornercase.report.figures._all_figures import CaptionedFigure
from cornercase.report.figures._export import write_figures
from cornercase.report.figures._style import cluster_style, format_score_label, label_axis
from cornercase.scenario import Parameter
from cornercase.study import StudyFile
from cornercase.study._study_file import open_study

# Number of corners of each hull in the paper.
_HULL_CORNERS: Final = 15
_COLOURS_TEXT: Final = (
    "Scenarios of one cluster have one colour and symbol within a column; each column has its own clusters."
)


@dataclass(frozen=True)
class PaperScenario:
    """What figure 5 or 6 of the paper by B. Schütt, S. Otten and E. Sax (2023) shows of one of the paper's scenarios.

    Attributes
    ----------
    figure : str
        Name of the figure.
    aspects : tuple of str
        Aspects (what concrete scenarios are compared by), in the order of the panels.
    hulls : str
        Hulls are drawn around the clusters found by this aspect; empty for figure 6.
    score : str
        Metric whose scores are drawn; empty for figure 6.

    Examples
    --------
    >>> from cornercase.report import PAPER_SCENARIOS
    >>> PAPER_SCENARIOS["scenario-1"].aspects
    ('ego-trajectory', 'trajectory-distance', 'wttc')
    """

    figure: str
    aspects: tuple[str, str, str]
    hulls: str = ""
    score: str = ""


PAPER_SCENARIOS: Final[Mapping[str, PaperScenario]] = MappingProxyType(
    {
        "scenario-1": PaperScenario(
            "figure-5", ("ego-trajectory", "trajectory-distance", "wttc"), hulls="trajectory-distance", score="wttc"
        ),
        "scenario-2": PaperScenario("figure-6", ("ego-trajectory", "distance", "traffic-quality")),
    }
)
"""The paper's scenarios by name."""


def write_paper_figures(study: StudyFile | Path | str, scenario: str, folder: Path | str) -> Path:
    """Draw figure 5 or 6 of the paper by B. Schütt, S. Otten and E. Sax (2023) from a study.

    Scenario 1 gives figure 5: kernel spaces, hulls, clusters and WTTC in the parameter space. Scenario 2 gives figure
    6: clusters in the parameter space and in the kernel spaces. A second figure, ``criticality``, shows the scores of
    all metrics of the study over the parameter space. The clusters are read from the study.

    Parameters
    ----------
    study : Study, StudyFile or path
        Study that was analyzed by the aspects that the figure shows.
    scenario : {"scenario-1", "scenario-2"}
        Scenario of the paper, which selects the figure. The aspects are the ego's trajectory, and two metrics:
        ``trajectory-distance`` and ``wttc``, or ``distance`` and ``traffic-quality``.
    folder : path
        Folder to write: each figure as PNG and SVG, and ``captions.txt``. The same study gives the same bytes.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InputError
        There is no such scenario in the paper, the study was not analyzed by one of the aspects, or a file cannot be
        written.

    See Also
    --------
    cornercase.write_report : Writes figures of any study.

    Examples
    --------
    >>> from cornercase.report import write_paper_figures
    >>> write_paper_figures("study.db", "scenario-1", "figures")  # doctest: +SKIP
    PosixPath('figures')
    """
    folder = validation.check_path("folder", folder)
    if scenario not in PAPER_SCENARIOS:
        raise InputError(f"`scenario` {scenario}: {suggest_name(scenario, PAPER_SCENARIOS)}")
    layout = PAPER_SCENARIOS[scenario]
    with open_study(study, readonly=True) as opened:
        data = _read_data(opened, layout)
    with atomic_write_group():
        write_figures(_draw_paper_figures(data, layout), folder)
    return folder


@dataclass(frozen=True, eq=False)
class _PaperData:
    """Data for the paper's figures: n scenarios with d parameters, their scores and analyses.

    `values` are parameter values, and `points` are the same values scaled to 0 to 1, both of shape (n, d).
    `influential` has the indices of parameters, the most influential first, but the first two in the order of the
    columns. `row_of` maps the id of a scenario to its row in these arrays.
    """

    parameters: tuple[Parameter, ...]
    influential: tuple[int, ...]
    row_of: dict[int, int]
    values: FloatArray
    points: FloatArray
    metrics: tuple[Metric, ...]
    scores: dict[str, FloatArray]
    analyses: dict[str, Analysis]

    def rows(self, analysis: Analysis) -> IntArray:
        """Return the rows of the scenarios of an analysis."""
        return np.array([self.row_of[scenario] for scenario in analysis.ids.tolist()], dtype=np.int64)


def _read_data(study: StudyFile, layout: PaperScenario) -> _PaperData:
    analyses = {name: read_analysis(study, name) for name in layout.aspects}
    rows = study.finished_rows()
    parameters = tuple(study.space.parameters)
    metrics = tuple(study.meta.create_metrics())
    scores = {metric.name: study.scores(metric.name) for metric in metrics}
    values = np.array([[parameter.extract_number(row.values) for parameter in parameters] for row in rows])
    return _PaperData(
        parameters,
        order_parameters_by_influence(values, scores[metrics[0].name]),
        {row.id: k for k, row in enumerate(rows)},
        values,
        np.array([row.point for row in rows]),
        metrics,
        scores,
        analyses,
    )


def _draw_paper_figures(data: _PaperData, layout: PaperScenario) -> Iterator[CaptionedFigure]:
    if layout.hulls:
        yield CaptionedFigure(layout.figure, _draw_figure_5(data, layout), _caption_figure_5(data, layout))
    else:
        yield CaptionedFigure(layout.figure, _draw_figure_6(data, layout), _caption_figure_6(data, layout))
    figure = _draw_criticality(data, dimensions=2 if layout.hulls else 3)
    yield CaptionedFigure("criticality", figure, _caption_criticality(data))


def _draw_figure_5(data: _PaperData, layout: PaperScenario) -> Figure:
    figure, grid = _make_grid(2, 4)
    for k, name in enumerate(layout.aspects):
        analysis = data.analyses[name]
        _draw_kernel_space(
            figure.add_subplot(grid[0, k], projection="3d"), analysis, _panel_title(k, f"kernel space, by {name}")
        )
        axis = figure.add_subplot(grid[1, k])
        _draw_clusters(axis, data, analysis, data.influential[:2])
        axis.set_title(_panel_title(k + 4, f"by {name}"))
        _add_legend(axis)
    _draw_hulls(figure.add_subplot(grid[0, 3], **_projection(data, 3)), data, data.analyses[layout.hulls])
    axis = figure.add_subplot(grid[1, 3])
    metric = next(metric for metric in data.metrics if metric.name == layout.score)
    _draw_scores(figure, axis, data, metric, data.influential[:2])
    axis.set_title(_panel_title(7, f"{metric.name} score"))
    return figure


def _draw_figure_6(data: _PaperData, layout: PaperScenario) -> Figure:
    figure, grid = _make_grid(2, 3)
    for k, name in enumerate(layout.aspects):
        analysis = data.analyses[name]
        axis = figure.add_subplot(grid[0, k], **_projection(data, 3))
        _draw_clusters(axis, data, analysis, data.influential[:3])
        axis.set_title(_panel_title(k, f"by {name}"))
        axis = figure.add_subplot(grid[1, k], projection="3d")
        _draw_kernel_space(axis, analysis, _panel_title(k + 3, f"kernel space, by {name}"))
        _add_legend(axis)
    return figure


def _draw_criticality(data: _PaperData, dimensions: int) -> Figure:
    columns = min(2, len(data.metrics))
    figure, grid = _make_grid(-(-len(data.metrics) // columns), columns)
    for k, metric in enumerate(data.metrics):
        axis = figure.add_subplot(grid[divmod(k, columns)], **_projection(data, dimensions))
        _draw_scores(figure, axis, data, metric, data.influential[:dimensions])
        axis.set_title(_panel_title(k, metric.name))
    return figure


def _make_grid(rows: int, columns: int) -> tuple[Figure, Any]:
    figure = Figure(figsize=(4.9 * columns, 4.6 * rows))
    # Labels of 3D axes extend beyond the axes, which no layout of matplotlib takes into account.
    grid = figure.add_gridspec(rows, columns, wspace=0.3, hspace=0.3, left=0.05, right=0.97, bottom=0.08, top=0.95)
    return figure, grid


def _projection(data: _PaperData, dimensions: int) -> dict[str, Any]:
    return {"projection": "3d"} if min(dimensions, len(data.parameters)) > 2 else {}


def _panel_title(panel: int, text: str) -> str:
    return f"({ascii_lowercase[panel % 26]}) {text}"


def _draw_kernel_space(axis: Any, analysis: Analysis, title: str) -> None:
    embedding = np.zeros((len(analysis.ids), 3))
    components = min(3, analysis.clustering.embedding.shape[1])
    embedding[:, :components] = analysis.clustering.embedding[:, :components]
    for label in np.unique(analysis.labels).tolist():
        colour, marker, name = cluster_style(label)
        members = embedding[analysis.labels == label]
        axis.scatter(*members.T, c=colour, marker=marker, s=16, label=f"{name} ({len(members)})")
    for k, setter in enumerate((axis.set_xlabel, axis.set_ylabel, axis.set_zlabel)):
        setter(f"component {k + 1} [–]")
    _fit_3d_axes(axis)
    axis.set_title(title)


def _draw_clusters(axis: Any, data: _PaperData, analysis: Analysis, parameter_indices: tuple[int, ...]) -> None:
    rows = data.rows(analysis)
    for label in np.unique(analysis.labels).tolist():
        colour, marker, name = cluster_style(label)
        members = rows[analysis.labels == label]
        axis.scatter(
            *_coordinates(data.values[members], parameter_indices), c=colour, marker=marker, s=18,
            label=f"{name} ({len(members)})",
        )  # fmt: skip
    _label_parameters(axis, data, parameter_indices)


def _draw_hulls(axis: Any, data: _PaperData, analysis: Analysis) -> None:
    parameter_indices = data.influential[:3]
    # Hulls are found in the unit cube, as by `reduce`.
    points, rows = data.points[:, sorted(parameter_indices)], data.rows(analysis)
    examples = {profile.cluster: profile.example for profile in analysis.profiles}
    for label in np.unique(analysis.labels[analysis.labels >= 0]).tolist():
        colour, marker, name = cluster_style(label)
        members = rows[analysis.labels == label]
        axis.scatter(*_coordinates(data.values[members], parameter_indices), c=colour, marker=marker, s=5, alpha=0.35)
        corners = members[find_hull_archetypes(points[members], _HULL_CORNERS)]
        facets = corners[find_convex_hull(points[corners]).simplices]
        for a, b in sorted({tuple(sorted(pair)) for facet in facets.tolist() for pair in combinations(facet, 2)}):
            axis.plot(*_coordinates(data.values[[a, b]], parameter_indices), color=colour, linewidth=0.8)
        axis.scatter(
            *_coordinates(data.values[corners], parameter_indices), c=colour, marker=marker, s=30, edgecolors="black",
            linewidths=0.6, label=f"{len(corners)} archetypes, {name}",
        )  # fmt: skip
        if (example := examples.get(label)) is not None:
            prototype = data.values[[data.row_of[example]]]
            axis.scatter(
                *_coordinates(prototype, parameter_indices), c=colour, marker="*", s=170, edgecolors="black",
                linewidths=0.6, label=f"prototype, {name}",
            )  # fmt: skip
    _label_parameters(axis, data, parameter_indices)
    axis.set_title(_panel_title(3, f"hulls, by {analysis.by}"))
    _add_legend(axis)


def _draw_scores(
    figure: Figure, axis: Any, data: _PaperData, metric: Metric, parameter_indices: tuple[int, ...]
) -> None:
    scores = data.scores[metric.name]
    # The most critical ones last, so that they are on top.
    order = np.argsort(metric.to_minimize(scores), kind="stable")[::-1]
    points = axis.scatter(
        *_coordinates(data.values[order], parameter_indices), c=scores[order], s=18, linewidths=0,
        cmap="viridis" if metric.lower_is_critical else "viridis_r",
    )  # fmt: skip
    _label_parameters(axis, data, parameter_indices)
    position: Any = {"location": "bottom", "pad": 0.07} if axis.name == "3d" else {"pad": 0.03}
    figure.colorbar(points, ax=axis, label=format_score_label(metric), shrink=0.8, **position)


def _coordinates(values: FloatArray, parameter_indices: tuple[int, ...]) -> FloatArray:
    """Return the values of the given parameters, one row for each axis; with one parameter, the second row is 0."""
    columns = values[:, sorted(parameter_indices)].T
    return columns if len(columns) > 1 else np.concatenate([columns, np.zeros_like(columns)])


def _label_parameters(axis: Any, data: _PaperData, parameter_indices: tuple[int, ...]) -> None:
    is_3d = axis.name == "3d"
    if is_3d:
        _fit_3d_axes(axis)
    for panel_axis, k in zip(
        (axis.xaxis, axis.yaxis, *([axis.zaxis] if is_3d else [])), sorted(parameter_indices), strict=False
    ):
        label_axis(panel_axis, data.parameters[k])


def _fit_3d_axes(axis: Any) -> None:
    """Scale 3D axes so that labels do not reach into the next panel and numbers do not overlap."""
    axis.set_box_aspect(None, zoom=0.95)
    for panel_axis in (axis.xaxis, axis.yaxis, axis.zaxis):
        panel_axis.set_major_locator(MaxNLocator(4))
    axis.tick_params(labelsize=8, pad=1)


def _add_legend(axis: Any) -> None:
    # If all scenarios are noise, there are no hulls.
    if not axis.get_legend_handles_labels()[0]:
        return
    height = -0.04 if axis.name == "3d" else -0.14
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, height), ncols=2, frameon=False, fontsize=8)


def _describe_clusters(analysis: Analysis) -> str:
    clustering, n = analysis.clustering, analysis.clustering.n_clusters
    count = "1 cluster" if n == 1 else f"{n} clusters"
    noise = int((analysis.labels < 0).sum())
    outside = f" and {noise} scenarios of noise" if noise else ""
    return (
        f"{analysis.by}, gamma {clustering.gamma:.3g}, eps {clustering.eps:.3g}, min. points {clustering.min_samples}:"
        f" {count}{outside}"
    )


def _describe_comparison(data: _PaperData, layout: PaperScenario) -> str:
    described = "; ".join(_describe_clusters(data.analyses[name]) for name in layout.aspects)
    return f"Compared by {described}. {_COLOURS_TEXT}"


def _caption_figure_5(data: _PaperData, layout: PaperScenario) -> str:
    return (
        f"{_count_text(data)} of scenario 1, as in figure 5 of Schütt, Otten and Sax (2023). (a)-(c) The scenarios in"
        " the first three components of each kernel space. (d) The clusters by"
        f" {layout.hulls} in the parameter space, each with the hull of at most {_HULL_CORNERS} archetypes and its"
        " prototype (star). (e)-(g) The clusters of (a)-(c) over the two parameters with most influence."
        f" (h) The {layout.score} score over the same parameters. {_describe_comparison(data, layout)}"
    )


def _caption_figure_6(data: _PaperData, layout: PaperScenario) -> str:
    return (
        f"{_count_text(data)} of scenario 2, as in figure 6 of Schütt, Otten and Sax (2023). (a)-(c) The clusters in"
        " the parameter space. (d)-(f) The same clusters in the first three components of the kernel space of each way"
        f" to compare. {_describe_comparison(data, layout)}"
    )


def _caption_criticality(data: _PaperData) -> str:
    names = ", ".join(_panel_title(k, metric.name) for k, metric in enumerate(data.metrics))
    return (
        f"{_count_text(data)}, coloured by score: {names}. Dark is critical; critical ones are drawn last, on top of"
        " the others."
    )


def _count_text(data: _PaperData) -> str:
    return f"{len(data.values)} scenarios"
