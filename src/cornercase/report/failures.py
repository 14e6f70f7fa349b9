"""Report page of a study in which no scenario could be run."""

from __future__ import annotations

from typing import Final

from markupsafe import Markup

from cornercase._common.texts import plain_text
from cornercase.report.sections.overview import tell_provenance, tell_reasons
from cornercase.report.study_files import tell_again
from cornercase.report.summary import Summary, summarize_with
from cornercase.report.tables import make_table
from cornercase.report.templates import fill_template
from cornercase.report.words import format_value, tell_roles
from cornercase.study import Row, Study, StudyMeta

# Rows that somebody may still read.
_MOST: Final = 1000
_MISSING: Final = (
    "No scenario was run, so there are no scores, critical scenarios, kinds, reduced set or replays. The report shows"
    " them once a scenario was run."
)
_POLICY: Final = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"


def fill_failures(study: Study) -> str:
    """Render the page of an open study in which all scenarios that ended have failed; HTML without scripts."""
    summary, failed = summarize_with(study, []), study.failed()
    meta = summary.meta
    return fill_template(
        "failures.html.j2",
        ("style.css",),
        (),
        policy=_POLICY,
        title=plain_text(meta.title),
        about=plain_text(f"{tell_roles(meta)} {_count(summary)}"),
        reasons=Markup(tell_reasons(failed)),
        missing=_MISSING,
        again=tell_again(meta),
        left_out=f"The first {_MOST} of {len(failed)}." if len(failed) > _MOST else "",
        scenarios=Markup(_list_scenarios(meta, failed[:_MOST])),
        provenance=tell_provenance(study.path.name, summary),
    )


def _count(summary: Summary) -> str:
    failed = "The one scenario that ended" if summary.failed == 1 else f"All {summary.failed} scenarios that ended"
    pending = f" {summary.pending} not run yet." if summary.pending else ""
    return f"{failed} could not be run.{pending}"


def _list_scenarios(meta: StudyMeta, failed: list[Row]) -> str:
    parameters = meta.space.parameters
    rows = [
        [str(row.id), *(format_value(parameter.read(row.values)) for parameter in parameters), row.error or ""]
        for row in failed
    ]
    text_columns = [k for k, parameter in enumerate(parameters, 1) if parameter.choices]
    head = ["scenario", *(parameter.name for parameter in parameters), "why"]
    return make_table(head, rows, text=(*text_columns, -1))
