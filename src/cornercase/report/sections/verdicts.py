"""Whether each scenario of a suite fulfilled what is required."""

from __future__ import annotations

from collections.abc import Iterator

from cornercase.report.data import ReportData
from cornercase.report.sections.part import Part, make_part
from cornercase.report.tables import make_table


def show_verdicts(data: ReportData) -> Iterator[Part]:
    """Show all verdicts, scenario by scenario.

    Parameters
    ----------
    data : ReportData
        What the report shows.

    Yields
    ------
    Part
        One where something is required.
    """
    if not data.verdicts:
        return
    meta, rows = data.summary.meta, []
    for scenario, verdicts in data.verdicts.items():
        names = [str(scenario), *(of[scenario - 1] if scenario <= len(of) else "" for of in (meta.files, meta.kinds))]
        for k, one in enumerate(verdicts):
            rows.append([*(names if k == 0 else [""] * len(names)), one.state, one.requirement, one.reason])
        if not verdicts:
            rows.append([*names, "passed", "", "no requirement is for it"])
    head = ["scenario", "file", "kind", "verdict", "requirement", "why"]
    shown = [k for k in range(len(head)) if any(row[k] for row in rows)]
    lines = [make_table([head[k] for k in shown], [[row[k] for k in shown] for row in rows], text=range(len(shown)))]
    yield make_part("verdicts", "Verdicts", lines)
