"""All figures of a study, one after the other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cornercase.clustering import Analysis
from cornercase.report import captions
from cornercase.report.data import ReportData
from cornercase.report.figures.examples import MOST_EXAMPLES, draw_examples
from cornercase.report.figures.parameter_space import draw_clusters, draw_criticality, draw_hulls
from cornercase.report.figures.scores import draw_courses, draw_coverage, draw_front, draw_sensitivities
from cornercase.report.words import name_kind

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Drawing:
    """A figure with its caption."""

    name: str  # file name without ending
    figure: Figure
    caption: str  # plain text


def draw_all(data: ReportData) -> Iterator[Drawing]:
    """Draw every figure the study has data for, one at a time to save memory."""
    for metric in data.metrics:
        figure = draw_criticality(data.values, data.parameters, data.scores[metric.name], metric)
        yield Drawing(f"criticality-{metric.name}", figure, captions.of_scores(data, metric))
    yield from _draw_knowledge(data)
    for analysis in data.summary.analyses.values():
        if analysis.clustering.n_clusters > 1:
            yield from _draw_kinds(data, analysis)
    yield from _draw_kept(data)


def _draw_knowledge(data: ReportData) -> Iterator[Drawing]:
    estimates = data.summary.knowledge
    if estimates.front is not None:
        scores, chosen = [data.scores[metric.name] for metric in data.metrics], data.rows_of(list(estimates.front))
        yield Drawing("front", draw_front(scores, data.metrics, chosen), captions.of_front(len(chosen)))
    if estimates.sensitivity is not None:
        caption = captions.of_sensitivity(estimates.sensitivity, data.summary.searched)
        yield Drawing("sensitivity", draw_sensitivities(estimates.sensitivity), caption)


def _draw_kinds(data: ReportData, analysis: Analysis) -> Iterator[Drawing]:
    name, labels, clustering = analysis.by, analysis.labels, analysis.clustering
    ids = analysis.ids.tolist()
    rows = data.rows_of(ids)
    names = {profile.cluster: name_kind(profile) for profile in analysis.profiles if profile.name}
    examples = [profile for profile in analysis.profiles if profile.name and profile.example is not None][
        :MOST_EXAMPLES
    ]
    if examples:
        recordings = {
            name_kind(profile): data.examples[profile.example] for profile in examples if profile.example is not None
        }
        left_out = sum(bool(profile.name) for profile in analysis.profiles) - len(examples)
        yield Drawing(
            f"examples-{name}",
            draw_examples(recordings, data.summary.meta.ego, data.other),
            captions.of_examples(left_out),
        )
    yield Drawing(
        f"clusters-{name}",
        draw_clusters(clustering.embedding, labels, data.values[rows], data.parameters, data.influential[:2], names),
        captions.of_kernel_space(analysis),
    )
    metric = data.metric_of(name)
    times, courses = [data.times[i] for i in ids], [data.courses[metric.name][i] for i in ids]
    yield Drawing(f"courses-{name}", draw_courses(times, courses, labels, metric, names), captions.of_courses(metric))


def _draw_kept(data: ReportData) -> Iterator[Drawing]:
    reduced = data.summary.reduced
    if reduced is None or not reduced.kept:
        return
    figure = draw_hulls(data.values, [row.id for row in data.rows], data.parameters, reduced, data.influential)
    yield Drawing("hulls", figure, captions.of_hulls(reduced))
    analyses = data.summary.analyses
    curves = {
        name: (gaps, data.critical[data.rows_of(analyses[name].ids.tolist())]) for name, gaps in data.gaps.items()
    }
    if curves:
        units = [analyses[name].unit for name in curves]
        yield Drawing("coverage", draw_coverage(curves, units), captions.of_coverage())
