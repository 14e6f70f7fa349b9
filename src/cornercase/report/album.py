"""The figures of a report: in the page, and as PNG in a folder beside it."""

from __future__ import annotations

import base64
import io
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from cornercase._common.files import portable_name, written_whole
from cornercase._common.texts import plain_text, wrapped
from cornercase.report.template import fill_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# Characters of a line in a figure, and lines of a text: what is longer is no reason for a huge figure.
_LINE, _LINES = 60, 10


class Album:
    """Figures of one report.

    Parameters
    ----------
    page : Path
        Of the page; the folder is called after it, with ``-figures`` at the end.
    """

    def __init__(self, page: Path) -> None:
        self._folder = page.with_name(f"{page.stem}-figures")

    def add(self, figure: Figure, name: str, caption: str) -> str:
        """Write a figure, and give the HTML that shows it.

        Parameters
        ----------
        figure : Figure
            The figure.
        name : str
            Of the file, without ending.
        caption : str
            Plain text below it.

        Returns
        -------
        str
            HTML with the figure in it.

        Raises
        ------
        InputError
            It cannot be written.
        """
        data = draw_png(figure)
        with written_whole(self._folder / f"{portable_name(name)}.png") as temporary:
            temporary.write_bytes(data)
        return fill_figure(caption, base64.b64encode(data).decode())


def draw_png(figure: Figure) -> bytes:
    """Draw a figure as PNG; the same figure gives the same bytes.

    Parameters
    ----------
    figure : Figure
        The figure.

    Returns
    -------
    bytes
        Content of the file.
    """
    buffer = io.BytesIO()
    FigureCanvasAgg(figure)
    for text in figure.findobj(Text):
        # Names come from files: a dollar sign in them begins no formula.
        text.set_parse_math(False)
        text.set_text(wrapped(plain_text(text.get_text()), _LINE, _LINES))
    with rc_context({"text.parse_math": False}), warnings.catch_warnings():
        # Signs that the font lacks are drawn as boxes; the page has the names as they are.
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing")
        figure.savefig(buffer, format="png", dpi=110, metadata={"Software": None}, bbox_inches="tight", pad_inches=0.25)
    return buffer.getvalue()
