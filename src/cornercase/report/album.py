"""The figures of a study for a paper: PNG and SVG in a folder."""

from __future__ import annotations

import io
import warnings
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from cornercase._common.files import portable_name, written_whole
from cornercase._common.texts import plain_text, wrapped
from cornercase.report.data import ReportData
from cornercase.report.drawings import draw_all
from cornercase.report.figures.style import default_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# Characters of a line in a figure, and lines of a text: what is longer is no reason for a huge figure.
_LINE, _LINES = 60, 10
# What would differ from one time to the next is left out.
_FORMATS: Final[dict[str, dict[str, Any]]] = {
    "png": {"dpi": 110, "metadata": {"Software": None}},
    "svg": {"metadata": {"Date": None, "Creator": None}},
}
_CAPTIONS: Final = "captions.txt"


def write_figures(data: ReportData, folder: Path) -> None:
    """Write all figures of a study, and ``captions.txt``, which says what is in each.

    Parameters
    ----------
    data : ReportData
        What is drawn.
    folder : Path
        Made where it is missing; figures of the same name are replaced.

    Raises
    ------
    InputError
        It cannot be written.
    """
    captions: list[str] = []
    taken: set[str] = set()
    with default_style():
        for drawing in draw_all(data):
            name = _another(portable_name(drawing.name), taken)
            for ending, content in draw_files(drawing.figure).items():
                with written_whole(folder / f"{name}.{ending}") as temporary:
                    temporary.write_bytes(content)
            captions.append(f"{name}: {plain_text(drawing.caption)}\n")
    with written_whole(folder / _CAPTIONS) as temporary:
        temporary.write_text("".join(captions), encoding="utf-8", newline="\n")


def _another(name: str, taken: set[str]) -> str:
    """A name that no file has yet; formulas may differ by what no name of a file may hold."""
    free = next(one for n in count(1) if (one := f"{name}-{n}" if n > 1 else name).lower() not in taken)
    taken.add(free.lower())
    return free


def draw_files(figure: Figure) -> dict[str, bytes]:
    """Draw a figure as PNG and as SVG; the same figure gives the same bytes.

    Parameters
    ----------
    figure : Figure
        The figure.

    Returns
    -------
    dict of str to bytes
        Content of the files by their ending.
    """
    FigureCanvasAgg(figure)
    for text in figure.findobj(Text):
        # Names come from files: a dollar sign in them begins no formula.
        text.set_parse_math(False)
        text.set_text(wrapped(plain_text(text.get_text()), _LINE, _LINES))
    found = {}
    with rc_context({"text.parse_math": False, "svg.hashsalt": "cornercase"}), warnings.catch_warnings():
        # Signs that the font lacks are drawn as boxes; the page has the names as they are.
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing")
        for ending, options in _FORMATS.items():
            buffer = io.BytesIO()
            figure.savefig(buffer, format=ending, bbox_inches="tight", pad_inches=0.25, **options)
            found[ending] = buffer.getvalue()
    return found
