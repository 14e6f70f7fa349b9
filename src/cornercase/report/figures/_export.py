"""Export of the figures of a study as PNG and SVG files with captions."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterable
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from cornercase._common.io.files import atomic_write, make_portable_file_name
from cornercase._common.text.sanitize import escape_control_characters, wrap_text
from cornercase.report.figures._all_figures import CaptionedFigure
from cornercase.report.figures._style import matplotlib_defaults

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# Longest line of a text in a figure (characters) and most lines, so that long texts do not blow up the figure.
_MAX_LINE_LENGTH, _MAX_LINES = 60, 10
# Metadata that would differ between runs are left out.
_FORMATS: Final[dict[str, dict[str, Any]]] = {
    "png": {"dpi": 110, "metadata": {"Software": None}},
    "svg": {"metadata": {"Date": None, "Creator": None}},
}
_CAPTIONS_FILE: Final = "captions.txt"


def write_figures(drawings: Iterable[CaptionedFigure], folder: Path) -> None:
    """Write figures into `folder`, and a file ``captions.txt`` with their captions."""
    captions: list[str] = []
    taken: set[str] = set()
    with matplotlib_defaults():
        for drawing in drawings:
            name = _make_unique_name(make_portable_file_name(drawing.name), taken)
            for ending, content in render_figure(drawing.figure).items():
                with atomic_write(folder / f"{name}.{ending}") as temporary:
                    temporary.write_bytes(content)
            captions.append(f"{name}: {escape_control_characters(drawing.caption)}\n")
    with atomic_write(folder / _CAPTIONS_FILE) as temporary:
        temporary.write_text("".join(captions), encoding="utf-8", newline="\n")


def _make_unique_name(name: str, taken: set[str]) -> str:
    """Return `name`, with a number appended if the name is already in `taken`, and add the result to `taken`."""
    candidates = (name if n == 1 else f"{name}-{n}" for n in count(1))
    free = next(candidate for candidate in candidates if candidate.lower() not in taken)
    taken.add(free.lower())
    return free


def render_figure(figure: Figure) -> dict[str, bytes]:
    """Render a figure as PNG and SVG; return the bytes by file ending. The same figure gives the same bytes."""
    FigureCanvasAgg(figure)
    for text in figure.findobj(Text):
        # A dollar sign in a name from a file must not start a formula.
        text.set_parse_math(False)
        text.set_text(wrap_text(escape_control_characters(text.get_text()), _MAX_LINE_LENGTH, _MAX_LINES))
    files = {}
    with rc_context({"text.parse_math": False, "svg.hashsalt": "cornercase"}), warnings.catch_warnings():
        # Characters missing in the font are drawn as boxes.
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing")
        for ending, options in _FORMATS.items():
            buffer = io.BytesIO()
            figure.savefig(buffer, format=ending, bbox_inches="tight", pad_inches=0.25, **options)
            files[ending] = buffer.getvalue()
    return files
