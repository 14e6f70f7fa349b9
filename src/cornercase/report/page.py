"""Report of a study: one HTML file without external references."""

from __future__ import annotations

import base64
import importlib.resources
import time
import zlib
from collections.abc import Iterator, Mapping
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
from cornercase.report.failures import fill_failures
from cornercase.report.packing import PackedRecordings, pack_most, tell_left_out
from cornercase.report.rerun import tell_rerun
from cornercase.report.roads import find_roads, is_of_map, pack_roads
from cornercase.report.sections.kept import show_kept
from cornercase.report.sections.kinds import compare_kinds, show_kinds
from cornercase.report.sections.knowledge import show_knowledge
from cornercase.report.sections.overview import tell_failures, tell_provenance, tell_scores
from cornercase.report.sections.verdicts import show_verdicts
from cornercase.report.tables import Part
from cornercase.report.templates import fill_template
from cornercase.scenario import Scenario
from cornercase.study import Study, open_study

_REPLAY_NAMES: Final = "motion sight clock camera road scene course neighbour pane controls panel"
REPLAY_SCRIPTS: Final = tuple(f"replay/{name}.js" for name in _REPLAY_NAMES.split())
"""Scripts of the replay, in load order."""

_STYLES: Final = ("style.css", "replay.css")
_SCRIPTS: Final = (
    "store.js", "recordings.js", "knowledge.js", "live.js", "running.js", "notes.js", "actions.js", "colours.js",
    "describe.js", "plot.js", "raster.js", "points.js", "legend.js", "ranges.js", "filters.js", "link.js", "theme.js",
    "answers.js", "views.js", "views/space.js", "views/courses.js", "views/kernel.js", "views/histogram.js",
    "views/parallel.js", "views/front.js", "views/charts.js", "views/table.js", *REPLAY_SCRIPTS, "main.js",
)  # fmt: skip
_ENDINGS: Final = (".html", ".htm")
POLICY: Final = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:;"
    " font-src data:; worker-src blob:; connect-src 'self'"
)
"""Content security policy: nothing is loaded from outside, and only the page's own scripts run."""


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
    """Write the report of a study as one HTML page without external references.

    Parameters
    ----------
    study : Study or path
        Sections that the study was not analyzed for are left out. The drawing time is stored in a study that is open
        for writing. If all scenarios failed, the page shows why, without figures.
    path : path
        Of the page; ends with ``.html`` or ``.htm``.
    figures : bool or path, default False
        Also write the figures as PNG and SVG with ``captions.txt`` into this folder; True for a folder beside the page
        with its name and ``-figures``.
    scenario : path or Scenario, optional
        Scenario file that was explored, to draw the road. By default it is searched beside the study and in the current
        folder, and recognized by its fingerprint; without it no road is drawn, and the page says so.
    critical : float, optional
        Score from which a scenario is critical, in the unit of the objective; default: that of the study. The study
        keeps its own.
    memory : str or float, default "4 GB"
        Memory limit of the process, as ``"500 MB"`` or in bytes.
    progress : bool, default False
        Show a progress bar for steps that take more than two seconds.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        No scenario has ended, `path` is the study itself, a file cannot be written, `scenario` is not the explored one,
        or the report exceeds the memory limit.

    See Also
    --------
    cornercase.summarize : The same as values, for programs.

    Examples
    --------
    >>> import cornercase as cc
    >>> cc.write_report("study.db", "report.html")  # doctest: +SKIP
    PosixPath('report.html')
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
        start = time.monotonic()
        with bars_wanted(progress), step(len(opened.done()), "reading", "recordings") as tell:
            data = read_report_data(opened, figures=folder is not False, memory=limit, tell=tell)
        packed = pack_most(opened, data)
        sketch, missing = find_roads(opened, data.region, scenario, data.rows[0].values)
        if is_of_map(missing):
            warn(missing.removesuffix("."))
        rerun = tell_rerun(opened, scenario)
        if not opened.readonly:
            # Stored, so that later reports of the study, opened read-only, are identical.
            opened.writer.add_elapsed("draw", time.monotonic() - start)
            data = replace(data, summary=replace(data.summary, seconds=opened.elapsed()))
    roads = {"roads": None if sketch is None else pack_roads(sketch), "roads_missing": missing, "rerun": rerun}
    # Written together, so that page and figures always match.
    with written_together():
        if folder is not False:
            from cornercase.report.album import write_figures

            write_figures(data, arguments.path("figures", folder))
        _write(path, fill_page(data, packed, roads))
    return path


def fill_page(data: ReportData, packed: PackedRecordings, roads: Mapping[str, Any]) -> str:
    """Render the report; `road_payload` holds ``roads``, ``roads_missing`` (why there are none) and ``rerun``."""
    recording_payload = {"recordings": packed.index, "recordings_left_out": tell_left_out(data, packed)}
    contents = page_contents(data) | recording_payload | dict(roads)
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


def page_details(data: ReportData) -> Iterator[Part]:
    """Render all detail sections in the order of the page."""
    sections = (show_verdicts, tell_scores, show_knowledge, show_kinds, compare_kinds, show_kept, tell_failures)
    for section in sections:
        yield from section(data)


def fill_frame(title: str) -> str:
    """Render a page without a study: it loads its contents from the live server and grows with the study."""
    empty: dict[str, Any] = {"left_out": "", "about": "", "contents": None, "answers": [], "details": [], "blocks": ()}
    return _fill(live=True, title=title, provenance=Markup(), **empty)


def _fill(**parts: Any) -> str:
    return fill_template("page.html.j2", _STYLES, _SCRIPTS, policy=POLICY, plotly=_plotly(), **parts)


@cache
def _plotly() -> str:
    code = importlib.resources.files("plotly.package_data").joinpath("plotly.min.js").read_bytes()
    return base64.b64encode(zlib.compress(code, 9)).decode()


def _write(path: Path, page: str) -> None:
    with written_whole(path) as temporary:
        temporary.write_text(page, encoding="utf-8", errors="backslashreplace", newline="\n")
