"""Sections on the clusters by each aspect and their agreement."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape

import numpy as np

from cornercase._common.typing import IntArray
from cornercase.clustering import Agreement, Analysis
from cornercase.report import tables
from cornercase.report.data import ReportData
from cornercase.report.tables import Part, make_part
from cornercase.report.words import judge_clusters, list_scenarios, name_cluster, name_joining, tell_how_found


def show_kinds(data: ReportData) -> Iterator[Part]:
    """Render one section on the clusters of each aspect."""
    for name, analysis in data.summary.analyses.items():
        title = f"the course of {name}" if name in data.summary.meta.metrics else name
        yield make_part(f"kinds-{name}", f"Kinds of scenario, by {title}", _tell_clusters(data, analysis))


def compare_kinds(data: ReportData) -> Iterator[Part]:
    """Render how much the clusterings say about facts, and how far they agree with each other."""
    tells = {by: analysis.tells for by, analysis in data.summary.analyses.items() if analysis.tells}
    if tells:
        yield make_part("facts", "Do the clusterings say what happened?", _tell_facts(tells))
    if data.summary.agreements:
        yield make_part("agreement", "Do the clusterings agree?", _tell_agreement(data.summary.agreements))


def _tell_facts(tells: Mapping[str, Mapping[str, float]]) -> Iterator[str]:
    yield tables.tell_facts(tells)
    yield (
        "<p>Adjusted mutual information of the clusters with how a scenario ends (outcome), who is first, who"
        " collides, whether the ego stopped, and, with a threshold, what is critical: 1 if the clusters say all of it,"
        " about 0 if they say nothing. Facts that are the same in all scenarios are left out.</p>"
    )


def _tell_agreement(agreements: Mapping[tuple[str, str], Agreement]) -> Iterator[str]:
    yield tables.make_table(
        ["by", "and by", "adjusted Rand", "adjusted mutual information", "differ", "scenarios"],
        [
            [
                aspect,
                other,
                f"{agreement.rand:.2f}",
                f"{agreement.mutual:.2f}",
                str(len(agreement.differ)),
                list_scenarios(agreement.differ),
            ]
            for (aspect, other), agreement in agreements.items()
        ],
        text=(0, 1, -1),
    )
    yield (
        "<p>1 if two clusterings are the same, about 0 if one says nothing about the other. To count scenarios that"
        " differ, each cluster is matched with at most one of the other clustering.</p>"
    )


def _tell_clusters(data: ReportData, analysis: Analysis) -> Iterator[str]:
    labels, clustering = analysis.labels, analysis.clustering
    ids = analysis.ids.tolist()
    rows = data.rows_of(ids)
    if information := judge_clusters(analysis):
        yield f"<p>{escape(information)}</p>"
    if n_unassigned := data.summary.run - len(ids):
        yield (
            f"<p>{n_unassigned} of {data.summary.run} scenarios were run since and are in no cluster yet: add them with"
            f" <code>{escape(name_joining(analysis))}</code>; without <code>--keep-clusters</code>"
            " all are clustered again.</p>"
        )
    if clustering.n_clusters < 2:
        return
    if any(profile.name for profile in analysis.profiles):
        yield tables.tell_names(analysis.profiles)
    yield f"<p>{escape(tell_how_found(analysis))}</p>"
    if settings := tables.tell_choices(clustering):
        yield settings
        yield (
            "<p>The best setting for each number of clusters. DBCV and silhouette say how dense and how far apart"
            " clusters are (1 is best). Stability says how much of them is found again in random parts of 80 %.</p>"
        )
    medians = [f"median {metric.name} [{metric.unit}]" for metric in data.metrics]
    yield tables.make_table(
        ["cluster", "scenarios", "collisions", *medians, "shortest [s]", "longest [s]"],
        [_tell_cluster(data, label, rows[labels == label]) for label in np.unique(labels).tolist()],
    )
    # Studies analyzed by an early version have no profiles.
    if analysis.profiles:
        yield tables.tell_profiles(analysis.profiles)


def _tell_cluster(data: ReportData, label: int, members: IntArray) -> list[str]:
    ids = [data.rows[k].id for k in members.tolist()]
    seconds = [float(data.times[i][-1]) for i in ids]
    medians = [f"{np.median(data.scores[metric.name][members]):.3g}" for metric in data.metrics]
    n_collisions = sum(bool(data.touched[i]) for i in ids)
    durations = [f"{min(seconds):.2f}", f"{max(seconds):.2f}"]
    return [name_cluster(label), str(len(ids)), str(n_collisions), *medians, *durations]
