"""Show the report of a study in a notebook."""

from __future__ import annotations

import tempfile
from html import escape
from pathlib import Path
from typing import Final

from cornercase.report._page import write_report
from cornercase.study import StudyFile

_FRAME_HEIGHT: Final = 700


def render_notebook_report(path: Path, *, max_scenarios: int = 1000) -> str | None:
    """Return the report of the study at `path` as an HTML iframe, isolated from the notebook.

    None without scenarios, and for larger studies, whose reports would make the notebook tens of megabytes large.
    """
    with StudyFile.open(path, readonly=True) as study:
        if not 0 < len(study.finished_rows()) <= max_scenarios:
            return None
        with tempfile.TemporaryDirectory() as folder:
            page = write_report(study, Path(folder) / "study.html").read_text(encoding="utf-8")
        name = f"Report of {study.meta.title}"
    return (
        f'<iframe srcdoc="{escape(page)}" title="{escape(name)}" sandbox="allow-scripts allow-downloads"'
        f' style="width: 100%; height: {_FRAME_HEIGHT}px; border: 0"></iframe>'
    )
