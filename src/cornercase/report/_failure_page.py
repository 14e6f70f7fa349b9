"""Report page of a study in which all scenarios failed."""

from __future__ import annotations

from typing import Final

from markupsafe import Markup

from cornercase._common.text.sanitize import escape_control_characters
from cornercase.report._repeat_command import describe_retry
from cornercase.report._summary import Summary, summarize_with_collisions
from cornercase.report.html._overview_sections import render_failure_reasons, render_provenance
from cornercase.report.html._tables import render_table
from cornercase.report.html._templates import render_template
from cornercase.report.text._phrases import format_value
from cornercase.study import ScenarioRecord, StudyFile, StudyMeta

# Longest table that somebody may still read, in rows.
_MAX_ROWS: Final = 1000
_MISSING_TEXT: Final = (
    "No scenario was run, so there are no scores, critical scenarios, kinds, reduced set or replays. The report shows"
    " them once a scenario was run."
)
_POLICY: Final = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"


def render_failure_page(study: StudyFile) -> str:
    """Render the report page of an open study, in which every scenario so far failed, as HTML without scripts."""
    summary, failed = summarize_with_collisions(study, [], []), study.failed_rows()
    meta = summary.meta
    return render_template(
        "failures.html.j2",
        ("style.css",),
        (),
        policy=_POLICY,
        title=escape_control_characters(meta.title),
        about=escape_control_characters(f"{meta.roles_text} {_describe_counts(summary)}"),
        reasons=Markup(render_failure_reasons(failed)),
        missing=_MISSING_TEXT,
        again=escape_control_characters(describe_retry(meta, study.path.name)),
        left_out=f"The first {_MAX_ROWS} of {len(failed)}." if len(failed) > _MAX_ROWS else "",
        scenarios=Markup(_render_scenarios(meta, failed[:_MAX_ROWS])),
        provenance=render_provenance(study.path.name, summary),
    )


def _describe_counts(summary: Summary) -> str:
    failed = "The one scenario that ended" if summary.n_failed == 1 else f"All {summary.n_failed} scenarios that ended"
    pending = f" {summary.n_pending} not run yet." if summary.n_pending else ""
    return f"{failed} could not be run.{pending}"


def _render_scenarios(meta: StudyMeta, failed: list[ScenarioRecord]) -> str:
    parameters = meta.space.parameters
    rows = [
        [str(row.id), *(format_value(parameter.extract_value(row.values)) for parameter in parameters), row.error or ""]
        for row in failed
    ]
    text_columns = [k for k, parameter in enumerate(parameters, 1) if parameter.choices]
    head = ["scenario", *(parameter.name for parameter in parameters), "why"]
    return render_table(head, rows, left_aligned=(*text_columns, -1))
