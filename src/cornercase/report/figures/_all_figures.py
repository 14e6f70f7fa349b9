"""All figures of a study with their captions, drawn one after the other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cornercase.clustering import Analysis
from cornercase.report._report_data import ReportData
from cornercase.report.figures._example_scenarios import MAX_EXAMPLES, draw_example_scenarios
from cornercase.report.figures._parameter_space import (
    draw_hulls_and_reduced_set,
    draw_kernel_and_parameter_space,
    draw_scores_by_parameter_pair,
)
from cornercase.report.figures._score_figures import (
    draw_courses_by_cluster,
    draw_coverage_curves,
    draw_pareto_front,
    draw_sensitivities,
)
from cornercase.report.text import _captions as captions
from cornercase.report.text._phrases import format_cluster_title

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class CaptionedFigure:
    """A figure with its caption."""

    name: str  # file name without ending
    figure: Figure
    caption: str  # plain text


def draw_all_figures(data: ReportData) -> Iterator[CaptionedFigure]:
    """Yield every figure for which the study has data, one at a time to save memory."""
    for metric in data.metrics:
        figure = draw_scores_by_parameter_pair(data.values, data.parameters, data.scores[metric.name], metric)
        yield CaptionedFigure(f"criticality-{metric.name}", figure, captions.describe_most_critical(data, metric))
    yield from _draw_estimates(data)
    for analysis in data.summary.analyses.values():
        if analysis.clustering.n_clusters > 1:
            yield from _draw_clusters(data, analysis)
    yield from _draw_reduced_set(data)


def _draw_estimates(data: ReportData) -> Iterator[CaptionedFigure]:
    estimates = data.summary.estimates
    if estimates.pareto_front is not None:
        scores, chosen = (
            [data.scores[metric.name] for metric in data.metrics],
            data.row_indices(list(estimates.pareto_front)),
        )
        yield CaptionedFigure(
            "front", draw_pareto_front(scores, data.metrics, chosen), captions.caption_front(len(chosen))
        )
    if estimates.sensitivity is not None:
        caption = captions.caption_sensitivity(estimates.sensitivity, data.summary.objective)
        yield CaptionedFigure("sensitivity", draw_sensitivities(estimates.sensitivity), caption)


def _draw_clusters(data: ReportData, analysis: Analysis) -> Iterator[CaptionedFigure]:
    name, labels, clustering = analysis.by, analysis.labels, analysis.clustering
    ids = analysis.ids.tolist()
    rows = data.row_indices(ids)
    names = {profile.cluster: format_cluster_title(profile, name) for profile in analysis.profiles if profile.name}
    examples = [profile for profile in analysis.profiles if profile.name and profile.example is not None][:MAX_EXAMPLES]
    if examples:
        recordings = {
            format_cluster_title(profile, name): data.examples[profile.example]
            for profile in examples
            if profile.example is not None
        }
        left_out = sum(bool(profile.name) for profile in analysis.profiles) - len(examples)
        yield CaptionedFigure(
            f"examples-{name}",
            draw_example_scenarios(recordings, data.summary.meta.ego, data.reference_other),
            captions.caption_examples(left_out),
        )
    yield CaptionedFigure(
        f"clusters-{name}",
        draw_kernel_and_parameter_space(
            clustering.embedding, labels, data.values[rows], data.parameters, data.influential_parameters[:2], names
        ),
        captions.caption_kernel_space(analysis),
    )
    metric = data.metric_for_aspect(name)
    times, courses = [data.times[i] for i in ids], [data.courses[metric.name][i] for i in ids]
    yield CaptionedFigure(
        f"courses-{name}",
        draw_courses_by_cluster(times, courses, labels, metric, names),
        captions.caption_courses(metric),
    )


def _draw_reduced_set(data: ReportData) -> Iterator[CaptionedFigure]:
    reduced = data.summary.reduced_set
    if reduced is None or not reduced.scenarios:
        return
    figure = draw_hulls_and_reduced_set(
        data.values, [row.id for row in data.rows], data.parameters, reduced, data.influential_parameters
    )
    yield CaptionedFigure("hulls", figure, captions.caption_reduced_set(reduced))
    analyses = data.summary.analyses
    curves = {
        name: (curve, data.is_critical[data.row_indices(analyses[name].ids.tolist())])
        for name, curve in data.coverage_curves.items()
    }
    if curves:
        units = [analyses[name].unit for name in curves]
        yield CaptionedFigure("coverage", draw_coverage_curves(curves, units), captions.caption_coverage())
