"""Sections on the clusters by each aspect (what scenarios are compared by), and on how far clusterings agree."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape

import numpy as np

from cornercase._common.typing import IntArray
from cornercase.clustering import Agreement, Analysis
from cornercase.report._report_data import ReportData
from cornercase.report.html import _tables as tables
from cornercase.report.html._tables import Section, make_section
from cornercase.report.text._phrases import (
    describe_clustering_method,
    describe_informativeness,
    format_assign_command,
    format_cluster_name,
    format_explore_settings_command,
    format_scenario_ids,
)


def render_clusterings(data: ReportData) -> Iterator[Section]:
    """Yield one section for each aspect (what scenarios are compared by), on the clusters found by it."""
    for name, analysis in data.summary.analyses.items():
        title = f"the course of {name}" if name in data.summary.meta.metrics else name
        yield make_section(f"kinds-{name}", f"Kinds of scenario, by {title}", _render_clustering(data, analysis))


def render_agreement(data: ReportData) -> Iterator[Section]:
    """Yield sections on how much the clusterings say about outcomes, and how far clusterings agree with each other."""
    analyses = data.summary.analyses
    information = {by: analysis.fact_agreement for by, analysis in analyses.items() if analysis.fact_agreement}
    if information:
        yield make_section("facts", "Do the clusterings say what happened?", _render_mutual_information(information))
    if data.summary.agreements:
        yield make_section("agreement", "Do the clusterings agree?", _render_agreement_table(data.summary.agreements))


def _render_mutual_information(information_by_aspect: Mapping[str, Mapping[str, float]]) -> Iterator[str]:
    yield tables.render_mutual_information(information_by_aspect)
    yield (
        "<p>Adjusted mutual information of the clusters with how a scenario ends (outcome), who is first, who"
        " collides, whether the ego stopped, and, with a threshold, what is critical: 1 if the clusters say all of it,"
        " about 0 if they say nothing. Facts that are the same in all scenarios are left out.</p>"
    )


def _render_agreement_table(agreements: Mapping[tuple[str, str], Agreement]) -> Iterator[str]:
    yield tables.render_table(
        ["by", "and by", "adjusted Rand", "adjusted mutual information", "differ", "scenarios"],
        [
            [
                aspect,
                other,
                f"{agreement.adjusted_rand:.2f}",
                f"{agreement.mutual_information:.2f}",
                str(len(agreement.differing)),
                format_scenario_ids(agreement.differing),
            ]
            for (aspect, other), agreement in agreements.items()
        ],
        left_aligned=(0, 1, -1),
    )
    yield (
        "<p>1 if two clusterings are the same, about 0 if one says nothing about the other. To count scenarios that"
        " differ, each cluster is matched with at most one of the other clustering.</p>"
    )


def _render_clustering(data: ReportData, analysis: Analysis) -> Iterator[str]:
    labels, clustering = analysis.labels, analysis.clustering
    ids = analysis.ids.tolist()
    rows = data.row_indices(ids)
    if information := describe_informativeness(analysis):
        yield f"<p>{escape(information)}</p>"
    if n_unassigned := data.summary.n_run - len(ids):
        yield (
            f"<p>{n_unassigned} of {data.summary.n_run} scenarios were run since and are in no"
            f" cluster yet: add them with"
            f" <code>{escape(format_assign_command(analysis))}</code>; without <code>--keep-clusters</code>"
            " all are clustered again.</p>"
        )
    yield (
        f"<p><code>{escape(format_explore_settings_command(analysis))}</code> shows what other settings of gamma and"
        " eps would find.</p>"
    )
    if clustering.n_clusters < 2:
        return
    if any(profile.name for profile in analysis.profiles):
        yield tables.render_cluster_names(analysis.profiles)
    yield f"<p>{escape(describe_clustering_method(analysis))}</p>"
    if settings := tables.render_clustering_settings(clustering):
        yield settings
        yield (
            "<p>The best setting for each number of clusters. DBCV and silhouette say how dense and how far apart"
            " clusters are (1 is best). Stability says how much of them is found again in random parts of 80 %.</p>"
        )
    medians = [f"median {metric.name} [{metric.unit}]" for metric in data.metrics]
    yield tables.render_table(
        ["cluster", "scenarios", "collisions", *medians, "shortest [s]", "longest [s]"],
        [_cluster_row(data, label, rows[labels == label]) for label in np.unique(labels).tolist()],
    )
    # Studies analyzed by an early version have no profiles.
    if analysis.profiles:
        yield tables.render_cluster_profiles(analysis.profiles)


def _cluster_row(data: ReportData, cluster: int, row_indices: IntArray) -> list[str]:
    ids = [data.rows[k].id for k in row_indices.tolist()]
    seconds = [end - begin for begin, end in (data.time_spans[i] for i in ids)]
    medians = [f"{np.median(data.scores[metric.name][row_indices]):.3g}" for metric in data.metrics]
    n_collisions = sum(bool(data.entities_hit[i]) for i in ids)
    durations = [f"{min(seconds):.2f}", f"{max(seconds):.2f}"]
    return [format_cluster_name(cluster), str(len(ids)), str(n_collisions), *medians, *durations]
