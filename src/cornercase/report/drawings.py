"""Every figure of a study, one after the other."""

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
    """A figure, and what is to be seen in it.

    Attributes
    ----------
    name : str
        Of its file, without ending.
    figure : Figure
        As it is drawn.
    caption : str
        Plain text.
    """

    name: str
    figure: Figure
    caption: str


def draw_all(data: ReportData) -> Iterator[Drawing]:
    """Draw every figure for which the study has something.

    Parameters
    ----------
    data : ReportData
        What is drawn.

    Yields
    ------
    Drawing
        One at a time, so that one only is in memory.
    """
    for metric in data.metrics:
        drawn = draw_criticality(data.values, data.parameters, data.scores[metric.name], metric)
        yield Drawing(f"criticality-{metric.name}", drawn, captions.of_scores(data, metric))
    yield from _draw_knowledge(data)
    for analysis in data.summary.analyses.values():
        if analysis.clustering.n_clusters > 1:
            yield from _draw_kinds(data, analysis)
    yield from _draw_kept(data)


def _draw_knowledge(data: ReportData) -> Iterator[Drawing]:
    known = data.summary.knowledge
    if known.front is not None:
        scores, chosen = [data.scores[one.name] for one in data.metrics], data.rows_of(list(known.front))
        yield Drawing("front", draw_front(scores, data.metrics, chosen), captions.of_front(len(chosen)))
    if known.sensitivity is not None:
        caption = captions.of_sensitivity(known.sensitivity, data.summary.searched)
        yield Drawing("sensitivity", draw_sensitivities(known.sensitivity), caption)


def _draw_kinds(data: ReportData, analysis: Analysis) -> Iterator[Drawing]:
    name, labels, found = analysis.by, analysis.labels, analysis.clustering
    ids = analysis.ids.tolist()
    rows = data.rows_of(ids)
    names = {one.cluster: name_kind(one) for one in analysis.profiles if one.name}
    drawn = [one for one in analysis.profiles if one.name and one.example is not None][:MOST_EXAMPLES]
    if drawn:
        recordings = {name_kind(one): data.examples[one.example] for one in drawn if one.example is not None}
        left_out = sum(bool(one.name) for one in analysis.profiles) - len(drawn)
        yield Drawing(
            f"examples-{name}",
            draw_examples(recordings, data.summary.meta.ego, data.other),
            captions.of_examples(left_out),
        )
    yield Drawing(
        f"clusters-{name}",
        draw_clusters(found.embedding, labels, data.values[rows], data.parameters, data.influential[:2], names),
        captions.of_kernel_space(analysis),
    )
    metric = data.metric_of(name)
    times, courses = [data.times[i] for i in ids], [data.courses[metric.name][i] for i in ids]
    yield Drawing(f"courses-{name}", draw_courses(times, courses, labels, metric, names), captions.of_courses(metric))


def _draw_kept(data: ReportData) -> Iterator[Drawing]:
    reduced = data.summary.reduced
    if reduced is None or not reduced.kept:
        return
    drawn = draw_hulls(data.values, [row.id for row in data.rows], data.parameters, reduced, data.influential)
    yield Drawing("hulls", drawn, captions.of_hulls(reduced))
    analyses = data.summary.analyses
    curves = {
        name: (gaps, data.critical[data.rows_of(analyses[name].ids.tolist())]) for name, gaps in data.gaps.items()
    }
    if curves:
        units = [analyses[name].unit for name in curves]
        yield Drawing("coverage", draw_coverage(curves, units), captions.of_coverage())
