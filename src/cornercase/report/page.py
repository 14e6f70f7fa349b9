"""The report's HTML page."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

from cornercase._common.errors import InputError
from cornercase._common.files import require_other_file, written_whole
from cornercase.report.album import Album
from cornercase.report.data import read_report_data
from cornercase.report.sections import kept, kinds, knowledge, overview
from cornercase.report.template import fill_page
from cornercase.study import Study, open_study


def write_report(study: Study | Path | str, path: Path | str) -> Path:
    """Write one page without outside references, and its figures as PNG in a folder beside it.

    Parameters
    ----------
    study : Study or path
        The page leaves out what the study was not analysed for. A study that is open for writing notes how long
        drawing took.
    path : path
        Of the page; the folder is called after it, with ``-figures`` at the end.

    Returns
    -------
    Path
        Of the page.

    Raises
    ------
    InputError
        No scenario has ended without failing, the page is the study itself, or it cannot be written.

    See Also
    --------
    cornercase.summarize : The same as values, for programs.
    """
    path = Path(path)
    with open_study(study, readonly=True) as opened:
        require_other_file(path, opened.path)
        if not opened.done():
            _tell_why_empty(opened)
        begun = time.monotonic()
        data, album = read_report_data(opened), Album(path)
        found = [
            *overview.show_criticality(data, album),
            *knowledge.show_knowledge(data, album),
            *kinds.show_kinds(data, album),
            *kinds.compare_kinds(data),
            *kept.show_kept(data, album),
            *overview.tell_failures(data),
        ]
        if not opened.readonly:
            # Kept in the study, so that the page of a study that is only read is the same each time.
            opened.add_elapsed("draw", time.monotonic() - begun)
            data = replace(data, summary=replace(data.summary, seconds=opened.elapsed()))
    parts = [*overview.tell_overview(data), *found, *overview.tell_provenance(data)]
    title = f"cornercase: {data.summary.meta.title}"
    with written_whole(path) as temporary:
        temporary.write_text(fill_page(title, "\n".join(parts)), encoding="utf-8", newline="\n")
    return path


def _tell_why_empty(study: Study) -> NoReturn:
    failed = study.failed()
    if not failed:
        raise InputError(f"{study.path}: no scenario was run yet, so there is nothing to report.")
    raise InputError(
        f"{study.path}: all {len(failed)} scenarios failed, so there is nothing to report; the first one as"
        f" {failed[0].error}"
    )
