"""The page of a study: one HTML file without outside references."""

from __future__ import annotations

import base64
import importlib.resources
import time
import zlib
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, Final

from markupsafe import Markup

from cornercase._common import arguments
from cornercase._common.errors import InputError
from cornercase._common.files import require_other_file, written_whole
from cornercase._common.ledger import warn
from cornercase._common.memory import DEFAULT_MEMORY, MemoryLimit
from cornercase._common.pending_files import written_together
from cornercase._common.progress import bars_wanted, step
from cornercase._common.texts import plain_text
from cornercase.report.contents import page_contents
from cornercase.report.data import ReportData, read_report_data
from cornercase.report.details import page_details
from cornercase.report.failures import fill_failures
from cornercase.report.packing import PackedRecordings, pack_most, tell_left_out
from cornercase.report.rerun import tell_rerun
from cornercase.report.roads import find_roads, is_of_map, pack_roads
from cornercase.report.sections.overview import tell_provenance
from cornercase.report.templates import fill_template
from cornercase.scenario import Scenario
from cornercase.study import Study, open_study

REPLAY_SCRIPTS: Final = tuple(
    f"replay/{name}.js"
    for name in (
        "motion",
        "sight",
        "clock",
        "camera",
        "road",
        "scene",
        "course",
        "neighbour",
        "pane",
        "controls",
        "panel",
    )
)
"""Scripts of the replay, in this order."""

_STYLES: Final = ("style.css", "replay.css")
_SCRIPTS: Final = (
    "store.js",
    "recordings.js",
    "knowledge.js",
    "live.js",
    "running.js",
    "notes.js",
    "actions.js",
    "colours.js",
    "describe.js",
    "plot.js",
    "raster.js",
    "points.js",
    "legend.js",
    "ranges.js",
    "filters.js",
    "link.js",
    "theme.js",
    "answers.js",
    "views.js",
    "views/space.js",
    "views/courses.js",
    "views/kernel.js",
    "views/histogram.js",
    "views/parallel.js",
    "views/front.js",
    "views/charts.js",
    "views/table.js",
    *REPLAY_SCRIPTS,
    "main.js",
)
_ENDINGS: Final = (".html", ".htm")
POLICY: Final = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:;"
    " font-src data:; worker-src blob:; connect-src 'self'"
)
"""What the page may load: nothing from anywhere; what is in it is all that it may run."""


def write_report(
    study: Study | Path | str,
    path: Path | str,
    *,
    figures: Path | str | bool = False,
    scenario: Path | str | Scenario | None = None,
    critical: float | None = None,
    memory: str | float = DEFAULT_MEMORY,
    progress: bool = False,
) -> Path:
    """Write one page without outside references.

    Parameters
    ----------
    study : Study or path
        The page leaves out what the study was not analysed for. A study that is open for writing notes how long
        drawing took. Where all scenarios failed, the page tells why, and there are no figures.
    path : path
        Of the page.
    figures : bool or path, default False
        Write the figures too, as PNG and SVG, with ``captions.txt``, into this folder; True for one beside the page
        that is called after it, with ``-figures`` at the end.
    scenario : path or Scenario, optional
        File that was explored, whose road is drawn. By default it is looked for beside the study and in the current
        folder, and known by its fingerprint; where it is not found the page says so, and draws no road.
    critical : float, optional
        Score from which a scenario is critical, in the unit of what was searched; by default that of the study, which
        stays as it is.
    memory : str or float, default "4 GB"
        Memory that the process may take, as ``"500 MB"`` or in bytes.
    progress : bool, default False
        Show a bar for what takes more than two seconds.

    Returns
    -------
    Path
        Of the page.

    Raises
    ------
    InputError
        No scenario has ended, the page is the study itself, something cannot be written, `scenario`
        is not what was explored, or the study needs more memory.

    See Also
    --------
    cornercase.summarize : The same as values, for programs.
    """
    path = arguments.path("path", path)
    folder = path.with_name(f"{path.stem}-figures") if figures is True else figures
    limit = MemoryLimit.of(memory)
    with open_study(study, readonly=True, critical=critical) as opened:
        require_other_file(path, opened.path)
        if path.suffix.lower() not in _ENDINGS:
            raise InputError(f"`path` {path}: the report is a page; name a file that ends with .html.")
        if not opened.done():
            if not opened.failed():
                raise InputError(f"{opened.path}: no scenario was run yet, so there is nothing to report.")
            _write(path, fill_failures(opened))
            return path
        begun = time.monotonic()
        with bars_wanted(progress), step(len(opened.done()), "reading", "recordings") as tell:
            data = read_report_data(opened, figures=folder is not False, memory=limit, tell=tell)
        packed = pack_most(opened, data)
        sketch, missing = find_roads(opened, data.region, scenario, data.rows[0].values)
        if is_of_map(missing):
            warn(missing.removesuffix("."))
        rerun = tell_rerun(opened, scenario)
        if not opened.readonly:
            # Kept in the study, so that the page of a study that is only read is the same each time.
            opened.writer.add_elapsed("draw", time.monotonic() - begun)
            data = replace(data, summary=replace(data.summary, seconds=opened.elapsed()))
    roads = {"roads": None if sketch is None else pack_roads(sketch), "roads_missing": missing, "rerun": rerun}
    # The page and its figures tell the same.
    with written_together():
        if folder is not False:
            from cornercase.report.album import write_figures

            write_figures(data, arguments.path("figures", folder))
        _write(path, fill_page(data, packed, roads))
    return path


def fill_page(data: ReportData, packed: PackedRecordings, roads: Mapping[str, Any]) -> str:
    """Put the page of a study together.

    Parameters
    ----------
    data : ReportData
        What the report shows.
    packed : PackedRecordings
        The recordings that it holds.
    roads : mapping of str to object
        What is drawn of roads, as ``roads``, why nothing is, as ``roads_missing``, and how a scenario is run again,
        as ``rerun``.

    Returns
    -------
    str
        HTML.
    """
    there = {"recordings": packed.index, "recordings_left_out": tell_left_out(data, packed)}
    contents = page_contents(data) | there | dict(roads)
    return _fill(
        live=False,
        left_out=contents["recordings_left_out"],
        title=plain_text(contents["title"]),
        about=contents["about"],
        contents=contents,
        answers=contents["answers"],
        details=list(page_details(data)),
        provenance=tell_provenance(data.study, data.summary),
        blocks=packed.blocks,
    )


def fill_frame(title: str) -> str:
    """Put a page together that holds no study: it asks for one, and grows with it.

    Parameters
    ----------
    title : str
        Plain text.

    Returns
    -------
    str
        HTML.
    """
    return _fill(
        live=True,
        left_out="",
        title=title,
        about="",
        contents=None,
        answers=[],
        details=[],
        provenance=Markup(),
        blocks=(),
    )


def _fill(**parts: Any) -> str:
    return fill_template("page.html.j2", _STYLES, _SCRIPTS, policy=POLICY, plotly=_plotly(), **parts)


@cache
def _plotly() -> str:
    code = importlib.resources.files("plotly.package_data").joinpath("plotly.min.js").read_bytes()
    return base64.b64encode(zlib.compress(code, 9)).decode()


def _write(path: Path, page: str) -> None:
    with written_whole(path) as temporary:
        temporary.write_text(page, encoding="utf-8", errors="backslashreplace", newline="\n")
