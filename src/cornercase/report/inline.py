"""The page of a study in a notebook."""

from __future__ import annotations

import tempfile
from html import escape
from pathlib import Path
from typing import Final

from cornercase.report.page import write_report
from cornercase.study import Study

# Pages of larger studies would make a notebook of tens of megabytes.
_MOST: Final = 1000
_HEIGHT: Final = 700


def show_study(path: Path) -> str | None:
    """Show a study in a notebook, as its page.

    Parameters
    ----------
    path : Path
        Of the study.

    Returns
    -------
    str or None
        HTML with the whole page in a frame, in which it can reach nothing of the notebook. None where no scenario was
        run, or more than 1,000 were.

    Raises
    ------
    InputError
        The study cannot be read.
    """
    with Study.open(path, readonly=True) as study:
        if not 0 < len(study.done()) <= _MOST:
            return None
        with tempfile.TemporaryDirectory() as folder:
            page = write_report(study, Path(folder) / "study.html").read_text(encoding="utf-8")
        name = f"Report of {study.meta.title}"
    return (
        f'<iframe srcdoc="{escape(page)}" title="{escape(name)}" sandbox="allow-scripts allow-downloads"'
        f' style="width: 100%; height: {_HEIGHT}px; border: 0"></iframe>'
    )
