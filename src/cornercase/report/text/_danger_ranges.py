"""Ranges of the parameters in which dangerous scenarios lie."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from cornercase.report._report_data import ReportData
from cornercase.report.text._phrases import append_unit, format_range

# Fewer scenarios say nothing about a range. A range is named if it is at most this part of what was varied.
_MIN_SCENARIOS: Final = 5
_MAX_PART: Final = 0.6


def describe_danger_ranges(data: ReportData) -> Iterator[str]:
    """Say of each parameter where all collisions lie, or all critical scenarios, if that is a small part of its range.

    A parameter that hardly changes the score between collisions may still decide whether there is one.
    """
    collisions = [row for row in data.rows if row.id in data.hardest_impacts]
    critical = [row for row, is_critical in zip(data.rows, data.is_critical.tolist(), strict=True) if is_critical]
    rows, kind = (collisions, "collisions") if len(collisions) >= _MIN_SCENARIOS else (critical, "critical scenarios")
    if len(rows) < _MIN_SCENARIOS:
        return
    for parameter in data.parameters:
        if parameter.choices or parameter.low == parameter.high:
            continue
        values = [float(row.values[parameter.name]) for row in rows]
        low, high = min(values), max(values)
        if high - low <= _MAX_PART * (parameter.high - parameter.low):
            lie = append_unit(f"{low:.3g} to {high:.3g}", parameter.unit)
            yield f"All {len(rows)} {kind} have {parameter.name} from {lie}, of {format_range(parameter)}."
