"""The page of a study of which no scenario could be run: what failed, and what is missing."""

from __future__ import annotations

from typing import Final

from markupsafe import Markup

from cornercase._common.texts import plain_text
from cornercase.report.repeating import tell_again
from cornercase.report.sections.overview import tell_provenance, tell_reasons
from cornercase.report.summary import Summary, summarize_with
from cornercase.report.tables import make_table
from cornercase.report.templates import fill_template
from cornercase.report.words import format_value, tell_roles
from cornercase.study import Row, Study, StudyMeta

# Rows of a table that somebody may still read.
_MOST: Final = 1000
_MISSING: Final = (
    "Without a scenario that was run there is no score, and so no critical scenarios, no kinds, no reduced set and no"
    " replay. All of this is in the report once a scenario was run."
)
_POLICY: Final = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"


def fill_failures(study: Study) -> str:
    """Put the page of a study together of which all scenarios that ended have failed.

    Parameters
    ----------
    study : Study
        Open.

    Returns
    -------
    str
        HTML without scripts.
    """
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
        [str(row.id), *(format_value(one.read(row.values)) for one in parameters), row.error or ""] for row in failed
    ]
    words = [k for k, one in enumerate(parameters, 1) if one.choices]
    return make_table(["scenario", *(one.name for one in parameters), "why"], rows, text=(*words, -1))
