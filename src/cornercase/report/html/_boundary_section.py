"""Section with pairs of scenarios that are near each other in the parameter space but end differently."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape

import numpy as np

from cornercase._common.text.sanitize import escape_control_characters
from cornercase._common.typing import FloatArray
from cornercase.evidence._boundary_pairs import find_boundary_pairs
from cornercase.report._report_data import ReportData
from cornercase.report.html._tables import Section, make_section, render_table
from cornercase.report.text._phrases import append_unit, format_value


def render_boundary_pairs(data: ReportData) -> Iterator[Section]:
    """Yield the section with pairs of neighbouring scenarios that end differently; nothing if there are none.

    Runs of suites and estimates of probabilities do not explore the parameter space, so they have no such section.
    """
    if not data.summary.represents_space:
        return
    outcomes = [
        data.outcomes.get(row.id, "critical" if is_critical else "not critical")
        for row, is_critical in zip(data.rows, data.is_critical, strict=True)
    ]
    points, weights = np.array([row.point for row in data.rows]), _parameter_weights(data)
    pairs = find_boundary_pairs(points, outcomes, weights)
    if not pairs:
        return
    links, rows = [], []
    for first, second, _ in pairs:
        ids = data.rows[first].id, data.rows[second].id
        links.append(f"<a href='#id={ids[0]}&amp;beside={ids[1]}'>{ids[0]} beside {ids[1]}</a>")
        rows.append(
            [
                f"{ids[0]} and {ids[1]}",
                outcomes[first],
                outcomes[second],
                _describe_parameter_changes(data, first, second),
            ]
        )
    weighed = "" if weights is None else ", each parameter weighed by its share of the score's variance"
    yield make_section(
        "boundary",
        "Where the outcome changes",
        [
            render_table(["scenarios", "the first", "the second", "from the first to the second"], rows, range(4)),
            f"<p>Replay: {', '.join(links)}. The nearest pairs that end differently{escape(weighed)}.</p>",
        ],
    )


def _describe_parameter_changes(data: ReportData, first: int, second: int) -> str:
    """Describe how each parameter changes from the first scenario to the second."""
    steps = []
    for parameter in data.parameters:
        old, new = (parameter.extract_value(data.rows[k].values) for k in (first, second))
        if old != new:
            unit = parameter.unit or ""
            steps.append(f"{parameter.name} {format_value(old, 4)} → {append_unit(format_value(new, 4), unit)}")
    return escape_control_characters(", ".join(steps))


def _parameter_weights(data: ReportData) -> FloatArray | None:
    """Return the share of each of d parameters in the score's variance, shape (d,); None if the shares are unknown."""
    sensitivity = data.summary.estimates.sensitivity
    if sensitivity is None or not sensitivity.is_meaningful:
        return None
    total = dict(zip(sensitivity.names, sensitivity.total, strict=True))
    # Parameters with a single value have no index.
    return np.array([total.get(parameter.name, 0.0) for parameter in data.parameters])
