"""Kinds of scenario: the clusters by each aspect, and whether they agree."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from typing import Final

import numpy as np

from cornercase._common.typing import IntArray
from cornercase.clustering import Analysis
from cornercase.report import tables
from cornercase.report.album import Album
from cornercase.report.data import ReportData
from cornercase.report.figures.examples import MOST_EXAMPLES, draw_examples
from cornercase.report.figures.parameter_space import draw_clusters
from cornercase.report.figures.scores import draw_courses
from cornercase.report.words import judge_clusters, name_cluster, name_joining, name_kind

_MOST_NAMED: Final = 12
_METHODS: Final = {"dbscan": "DBSCAN", "hdbscan": "HDBSCAN"}


def show_kinds(data: ReportData, album: Album) -> Iterator[str]:
    """Show the clusters by each aspect.

    Parameters
    ----------
    data : ReportData
        What the report shows.
    album : Album
        Takes the figures.

    Yields
    ------
    str
        HTML.
    """
    for analysis in data.summary.analyses.values():
        yield from _show_clusters(data, album, analysis)


def compare_kinds(data: ReportData) -> Iterator[str]:
    """Say how far the clusters by different aspects agree.

    Parameters
    ----------
    data : ReportData
        What the report shows.

    Yields
    ------
    str
        HTML.
    """
    tells = {by: one.tells for by, one in data.summary.analyses.items() if one.tells}
    if tells:
        yield "<h2>Do the clusterings say what happened?</h2>"
        yield tables.tell_facts(tells)
        yield (
            "<p>Adjusted mutual information with how a scenario ends (outcome), who is first, who collides, whether the"
            " ego stopped, and, where a threshold says so, what is critical: 1 where the clusters say all of it, about"
            " 0 where they say nothing. What is the same in all scenarios is left out.</p>"
        )
    if not data.summary.agreements:
        return
    yield "<h2>Do the clusterings agree?</h2>"
    yield tables.make_table(
        ["by", "and by", "adjusted Rand", "adjusted mutual information", "differ", "scenarios"],
        [
            [one, two, f"{found.rand:.2f}", f"{found.mutual:.2f}", str(len(found.differ)), _listed(found.differ)]
            for (one, two), found in data.summary.agreements.items()
        ],
        text=(0, 1, -1),
    )
    yield (
        "<p>1 where two clusterings are the same, about 0 where one says nothing of the other. Scenarios differ where"
        " their clusters are not matched with each other.</p>"
    )


def _show_clusters(data: ReportData, album: Album, analysis: Analysis) -> Iterator[str]:
    name, labels, found = analysis.by, analysis.labels, analysis.clustering
    ids = analysis.ids.tolist()
    rows = data.rows_of(ids)
    what = f"the course of {name}" if name in data.summary.meta.metrics else name
    names = {one.cluster: name_kind(one) for one in analysis.profiles if one.name}
    yield f"<h2>Kinds of scenario, by {escape(what)}</h2>"
    if judged := judge_clusters(analysis):
        yield f"<p>{escape(judged)}</p>"
    if later := data.summary.run - len(ids):
        yield (
            f"<p>{later} of {data.summary.run} scenarios were run since and are in no cluster yet: they join with"
            f" <code>{escape(name_joining(analysis))}</code>; without <code>--keep</code> all are clustered anew.</p>"
        )
    if found.n_clusters < 2:
        return
    if names:
        yield tables.tell_names(analysis.profiles)
        yield from _show_examples(data, album, analysis)
    yield album.add(
        draw_clusters(found.embedding, labels, data.values[rows], data.parameters, data.influential[:2], names),
        f"clusters-{name}",
        _how_found(analysis),
    )
    if chosen_from := tables.tell_choices(found):
        yield chosen_from
        yield (
            "<p>The best setting for each number of clusters. DBCV and silhouette say how dense and how far apart"
            " clusters are (1 is best), stability how much of them is found again in random parts of 80 %.</p>"
        )
    yield tables.make_table(
        [
            "cluster",
            "scenarios",
            "collisions",
            *(f"median {metric.name} [{metric.unit}]" for metric in data.metrics),
            "shortest [s]",
            "longest [s]",
        ],
        [_tell_cluster(data, label, rows[labels == label]) for label in np.unique(labels).tolist()],
    )
    # A study that was analysed by an early version has none.
    if analysis.profiles:
        yield tables.tell_profiles(analysis.profiles)
    metric = data.metric_of(name)
    yield album.add(
        draw_courses(
            [data.recordings[i].time for i in ids],
            [data.courses[metric.name][i] for i in ids],
            labels,
            metric,
            names,
        ),
        f"courses-{name}",
        f"Course of {metric.name} in each cluster: median, and the band that holds 80 % of its scenarios.",
    )


def _show_examples(data: ReportData, album: Album, analysis: Analysis) -> Iterator[str]:
    drawn = [one for one in analysis.profiles if one.name and one.example is not None][:MOST_EXAMPLES]
    left_out = sum(bool(one.name) for one in analysis.profiles) - len(drawn)
    meta = data.summary.meta
    yield album.add(
        draw_examples(
            {name_kind(one): data.recordings[one.example] for one in drawn if one.example is not None},
            meta.ego,
            meta.other,
        ),
        f"examples-{analysis.by}",
        "One scenario of each kind, the one nearest to all others of its kind: from above, with marks and times in s"
        " along the ways and the boxes when they are nearest; and speeds over time."
        + (f" {left_out} smaller kinds are not drawn." if left_out else ""),
    )


def _how_found(analysis: Analysis) -> str:
    found = analysis.clustering
    text = (
        f"Dynamic Time Warping, RBF kernel PCA (gamma {found.gamma:.4g}, {100 * found.explained:.0f} % of the variance"
        f" in {found.embedding.shape[1]} components), {_METHODS[found.method]} (eps {found.eps:.4g}, min samples"
        f" {found.min_samples})."
    )
    if len(found.landmarks):
        text += (
            f" The kernel space is that of {len(found.landmarks)} landmarks; of the kernel between others"
            f" {found.error:.1%} is lost."
        )
    fitted, joined = len(analysis.fitted), len(analysis.ids) - len(analysis.fitted)
    if joined > 0:
        text += f" Found of {fitted} scenarios; {joined} have joined them since."
    return text


def _tell_cluster(data: ReportData, label: int, members: IntArray) -> list[str]:
    ids = [data.rows[k].id for k in members.tolist()]
    longest = [float(data.recordings[i].time[-1]) for i in ids]
    return [
        name_cluster(label),
        str(len(ids)),
        str(sum(map(data.collides, ids))),
        *(f"{np.median(data.scores[metric.name][members]):.3g}" for metric in data.metrics),
        f"{min(longest):.2f}",
        f"{max(longest):.2f}",
    ]


def _listed(scenarios: Sequence[int]) -> str:
    return ", ".join(map(str, scenarios[:_MOST_NAMED])) + (" …" if len(scenarios) > _MOST_NAMED else "")
