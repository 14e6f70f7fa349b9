"""Class `Page`, a file that was written as HTML page or film, and that a notebook shows."""

from __future__ import annotations

import os
from html import escape
from pathlib import Path
from typing import Final

from cornercase._common.text.notebook_html import render_html

_FRAME_HEIGHT: Final = 700
# Larger pages would make notebooks too large.
_MAX_BYTES: Final = 20_000_000


class Page(os.PathLike[str]):
    """File that was written, an HTML page or a film; a notebook shows the HTML page, but only the path of a film.

    Parameters
    ----------
    path : Path
        The file.

    Attributes
    ----------
    path : Path

    Examples
    --------
    >>> import cornercase as cc
    >>> page = cc.Study.open("study.db").report("report.html")  # doctest: +SKIP
    >>> page, page.path.name  # doctest: +SKIP
    (<Page 'report.html'>, 'report.html')
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def __fspath__(self) -> str:
        return str(self.path)

    def __str__(self) -> str:
        return str(self.path)

    def __repr__(self) -> str:
        return f"<Page {str(self.path)!r}>"

    def _repr_html_(self) -> str:
        """Return the page as HTML in an ``iframe`` that cannot access the notebook.

        Return a line of text instead if the file is a film, is large, or was removed.
        """
        try:
            if self.path.suffix.lower() not in (".html", ".htm") or self.path.stat().st_size > _MAX_BYTES:
                return render_html(str(self.path))
            page = self.path.read_text(encoding="utf-8")
        except OSError:
            return render_html(f"{self.path}: was removed")
        return (
            f'<iframe srcdoc="{escape(page)}" title="{escape(self.path.name)}" sandbox="allow-scripts allow-downloads"'
            f' style="width: 100%; height: {_FRAME_HEIGHT}px; border: 0"></iframe>'
        )
