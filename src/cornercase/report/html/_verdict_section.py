"""Section with the verdicts of a suite."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from typing import Final

from cornercase._common.text.sanitize import escape_control_characters
from cornercase.report._report_data import ReportData
from cornercase.report.html._tables import Section, make_section

# What needs a look comes first.
_ORDER: Final = ("failed", "inconclusive", "passed")
_HEAD: Final = ("verdict", "file", "why", "requirement", "kind", "scenario")


def render_verdicts(data: ReportData) -> Iterator[Section]:
    """Yield the section with all verdicts, those that failed first; nothing without requirements."""
    if not data.verdicts:
        return
    meta, rows = data.summary.meta, []
    for scenario, verdicts in data.verdicts.items():
        file, kind = (column[scenario - 1] if scenario <= len(column) else "" for column in (meta.files, meta.kinds))
        rows += [(verdict.state, file, verdict.reason, verdict.requirement, kind, scenario) for verdict in verdicts]
        if not verdicts:
            rows.append(("inconclusive", file, "no requirement applies", "", kind, scenario))
    rows.sort(key=lambda row: _ORDER.index(row[0]))
    columns = [k for k in range(len(_HEAD)) if any(row[k] for row in rows)]
    head = "".join(f"<th scope=col class=text>{_HEAD[k]}</th>" for k in columns)
    body = "".join(
        f"<tr data-verdict='{row[0]}'>{''.join(f'<td class=text>{_render_cell(row, k)}</td>' for k in columns)}</tr>"
        for row in rows
    )
    label = ", ".join(_HEAD[k] for k in columns[:3])
    table = f"<table><tr>{head}</tr>{body}</table>"
    yield make_section(
        "verdicts",
        "Verdicts",
        [f"<div class='wide' tabindex='0' role='region' aria-label='table: {label}'>{table}</div>"],
    )


def _render_cell(row: tuple[str, str, str, str, str, int], column: int) -> str:
    """Render a cell; the file, or the scenario where files have no names, leads to the replay."""
    text = escape(escape_control_characters(str(row[column])))
    leads = _HEAD[column] == ("file" if row[1] else "scenario")
    return f"<a href='#id={row[-1]}'>{text}</a>" if leads else text
