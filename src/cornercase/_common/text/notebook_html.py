"""HTML that notebooks show for objects."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import pandas as pd

_N_SHOWN_ROWS: Final = 10


def render_html(text: str, body: str = "") -> str:
    """Return a line of text, escaped, followed by the HTML `body`."""
    return f"<p>{escape(text)}</p>{body}"


def render_html_table(text: str, table: pd.DataFrame, n_rows: int = _N_SHOWN_ROWS) -> str:
    """Return a line of text and the first rows of a table as HTML; all cells are escaped."""
    if table.empty:
        return render_html(text)
    more = f"<p>… and {len(table) - n_rows} more</p>" if len(table) > n_rows else ""
    shown = table.head(n_rows).to_html(float_format="{:.4g}".format, na_rep="")
    return f"{render_html(text, shown)}{more}"
