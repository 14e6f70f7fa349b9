"""Sections on the reduced set, and on how well it covers the other scenarios."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape

from cornercase.reduction import ReducedSet
from cornercase.report._report_data import ReportData
from cornercase.report.html import _tables as tables
from cornercase.report.html._tables import Section, make_section
from cornercase.report.text._phrases import describe_selection_threshold, format_axis_label, format_value


def render_reduced_set(data: ReportData) -> Iterator[Section]:
    """Yield the sections on the reduced set; nothing if the study was not reduced."""
    reduced = data.summary.reduced_set
    if reduced is None or not reduced.scenarios:
        return
    yield make_section("kept", "The few to keep", _render_selected(data, reduced))
    yield make_section(
        "left-out",
        "What the kept scenarios leave out",
        _render_coverage(reduced, describe_selection_threshold(data.summary)),
    )


def _render_selected(data: ReportData, reduced: ReducedSet) -> Iterator[str]:
    yield tables.render_table(
        [
            "file", "cluster", "role", *map(format_axis_label, data.parameters),
            *(f"{metric.name} [{metric.unit}]" for metric in data.metrics), "why",
        ],
        [
            [
                scenario.file, str(scenario.cluster), scenario.role,
                *(format_value(parameter.extract_value(scenario.values)) for parameter in data.parameters),
                *(f"{scenario.scores[metric.name]:.3g}" for metric in data.metrics), scenario.why,
            ]
            for scenario in reduced.scenarios
        ],
        left_aligned=(0, 2, -1),
    )  # fmt: skip
    # Studies reduced by an early version have no shapes.
    if reduced.shapes:
        yield "<h3>Shapes of the clusters</h3>"
        yield tables.render_shapes(reduced.shapes)
        yield (
            "<p>Convexity: the share of the lines between the scenarios of a cluster that lies in the cluster; from 0.8"
            " on it counts as convex.</p>"
        )


def _render_coverage(reduced: ReducedSet, threshold_note: str) -> Iterator[str]:
    yield tables.render_coverage(reduced.coverage)
    yield (
        "<p>DTW distance from each scenario that was run to the nearest kept one, also as a share of the largest"
        " distance between any two. The kept scenarios were chosen to make these distances small.</p>"
    )
    if held_out := tables.render_distances_of_held_out_scenarios(reduced.coverage):
        yield held_out
        yield (
            "<p>The same for held-out scenarios, which the choice has not seen: each fifth of the scenarios (only one"
            " fifth if there are many) grades a set that was chosen in the same way from the other four fifths. For"
            " comparison: how many of 100 random choices from these four fifths are worse, and k-medoids of them,"
            " which make the mean distance small in that one clustering.</p>"
        )
    if reduced.critical:
        if threshold_note:
            yield f"<p>{escape(threshold_note)}</p>"
        yield tables.render_critical_coverage(reduced.critical)
        yield (
            "<p>Two scenarios are alike if they are closer than a share of the median distance within clusters. Held"
            " out: critical scenarios that the choice has not seen, as above. A critical scenario is on the boundary if"
            " one of its neighbours in the parameter space is not critical. The last two columns predict scenarios that"
            " were not run, by Gaussian processes.</p>"
        )
