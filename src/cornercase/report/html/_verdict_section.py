"""Section with the verdicts of a suite."""

from __future__ import annotations

from collections.abc import Iterator

from cornercase.report._report_data import ReportData
from cornercase.report.html._tables import Section, make_section, render_table


def render_verdicts(data: ReportData) -> Iterator[Section]:
    """Yield the section with all verdicts, scenario by scenario; nothing without requirements."""
    if not data.verdicts:
        return
    meta, rows = data.summary.meta, []
    for scenario, verdicts in data.verdicts.items():
        names = [
            str(scenario),
            *(column[scenario - 1] if scenario <= len(column) else "" for column in (meta.files, meta.kinds)),
        ]
        for k, verdict in enumerate(verdicts):
            rows.append([*(names if k == 0 else [""] * len(names)), verdict.state, verdict.requirement, verdict.reason])
        if not verdicts:
            rows.append([*names, "passed", "", "no requirement is for it"])
    head = ["scenario", "file", "kind", "verdict", "requirement", "why"]
    columns = [k for k in range(len(head)) if any(row[k] for row in rows)]
    lines = [
        render_table(
            [head[k] for k in columns], [[row[k] for k in columns] for row in rows], left_aligned=range(len(columns))
        )
    ]
    yield make_section("verdicts", "Verdicts", lines)
