"""Report page of a study: one HTML file without external references."""

from __future__ import annotations

import base64
import importlib.resources
import time
import zlib
from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, Final

from markupsafe import Markup

from cornercase._common import validation
from cornercase._common.errors import InputError
from cornercase._common.io.atomic import atomic_write_group
from cornercase._common.io.files import check_output_differs_from_source
from cornercase._common.io.support_table import issue_notice_warning
from cornercase._common.memory import DEFAULT_MEMORY, MemoryLimit
from cornercase._common.progress import progress_step, show_bars
from cornercase._common.text.sanitize import escape_control_characters
from cornercase._common.unknown_names import suggest_arguments
from cornercase.report._event_payload import find_events_of_scenarios
from cornercase.report._expected_runs import ExpectedRuns, read_expected_runs
from cornercase.report._failure_page import render_failure_page
from cornercase.report._page_metadata import format_page_metadata
from cornercase.report._report_data import ReportData, read_report_data
from cornercase.report._report_payload import page_payload
from cornercase.report._rerun import rerun_payload
from cornercase.report._road_drawing import encode_road_outline, find_road_outline, is_missing_map
from cornercase.report.encode._page_recordings import describe_left_out_recordings, encode_important_recordings
from cornercase.report.html._boundary_section import render_boundary_pairs
from cornercase.report.html._cluster_sections import render_agreement, render_clusterings
from cornercase.report.html._estimate_sections import render_estimates
from cornercase.report.html._overview_sections import render_failures, render_provenance, render_scores
from cornercase.report.html._probability_section import render_probability
from cornercase.report.html._reduced_set_sections import render_reduced_set
from cornercase.report.html._tables import Section
from cornercase.report.html._templates import check_page_path, render_template, write_page
from cornercase.report.html._verdict_section import render_verdicts
from cornercase.scenario._file import ScenarioFile
from cornercase.study import StudyFile
from cornercase.study._study_file import open_study

_REPLAY_NAMES: Final = "motion sight clock camera road scene course events neighbour pane controls film panel"
REPLAY_SCRIPTS: Final = tuple(f"replay/{name}.js" for name in _REPLAY_NAMES.split())
"""Paths of the scripts that replay recordings, in load order."""

_STYLES: Final = ("style.css", "replay.css")
_SCRIPTS: Final = (
    "store.js", "recordings.js", "knowledge.js", "live.js", "running.js", "notes.js", "clipboard.js", "actions.js",
    "colours.js", "describe.js", "plot.js", "raster.js", "points.js", "legend.js", "ranges.js", "filters.js", "link.js",
    "theme.js", "answers.js", "views.js", "predictor.js", "surface.js", "views/space.js", "views/courses.js",
    "views/histogram.js", "views/parallel.js", "views/front.js", "views/charts.js", "views/kernel.js", "ticks.js",
    "columns.js", "thumbnails.js", "views/table.js", *REPLAY_SCRIPTS, "main.js",
)  # fmt: skip
CONTENT_SECURITY_POLICY: Final = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:;"
    " font-src data:; worker-src blob:; connect-src 'self'"
)
"""Content security policy: nothing is loaded from outside, and only the page's own scripts run."""


@suggest_arguments
def write_report(
    study: StudyFile | Path | str,
    path: Path | str,
    *,
    figures: Path | str | bool = False,
    scenario: Path | str | ScenarioFile | None = None,
    against: Path | str | None = None,
    critical: float | None = None,
    memory: str | float = DEFAULT_MEMORY,
    progress: bool = False,
) -> Path:
    """Write the report of a study as one HTML page without external references.

    Parameters
    ----------
    study : Study, StudyFile or path
        Study whose results are shown. Sections for which the study lacks data are left out. If all scenarios failed,
        the page shows why, without figures. If the study is open for writing, the time that the report took is stored
        in the study.
    path : path
        Page to write; the name ends with ``.html`` or ``.htm``.
    figures : bool or path, default False
        Also write the figures as PNG and SVG, and ``captions.txt``, into this folder. True stands for a folder beside
        the page, with its name and ``-figures``.
    scenario : path or ScenarioFile, optional
        Scenario file that was explored, to draw the road. By default the file is looked for where this machine explored
        it, then beside the study and in the current folder, and recognized by its fingerprint. If the file is not
        found, no road is drawn, and the page says so.
    against : path, optional
        Only if `study` is the run of a suite: the study that the suite was made from (the default), or an earlier run
        of the suite. The page shows the recordings of this study as the expected runs, beside the recordings of
        `study`. By default, the suite is looked for beside `study` and in the current folder, then the study that the
        suite was made from is looked for beside the manifest of the suite and in the folder above.
    critical : float, optional
        Threshold for this report only, in the unit of the objective; by default the threshold of the study.
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
        No scenario has ended, `path` is the study itself, a file cannot be written, `scenario` is not the explored
        file, `against` has none of the scenarios, or the report exceeds the memory limit.

    See Also
    --------
    cornercase.summarize : The same results as values, for programs.

    Examples
    --------
    >>> import cornercase as cc
    >>> cc.write_report("study.db", "report.html")  # doctest: +SKIP
    PosixPath('report.html')
    """
    path = validation.check_path("path", path)
    folder = path.with_name(f"{path.stem}-figures") if figures is True else figures
    limit = MemoryLimit.from_value(memory)
    with (
        open_study(study, readonly=True, critical=critical) as opened,
        # Another process may be writing.
        opened.snapshot() if opened.readonly else nullcontext(),
    ):
        check_output_differs_from_source(path, opened.path)
        check_page_path(path, "report")
        if not opened.finished_rows():
            if not opened.failed_rows():
                raise InputError(f"{opened.path}: no scenario was run yet, so there is nothing to report.")
            write_page(path, render_failure_page(opened))
            return path
        start = time.monotonic()
        with show_bars(progress), progress_step(len(opened.finished_rows()), "reading", "recordings") as tell:
            data = read_report_data(opened, figures=folder is not False, memory=limit, on_read=tell)
        recordings = encode_important_recordings(opened, data)
        replies = data.summary.replies
        known_events = {} if replies is None else replies.events
        events = find_events_of_scenarios(opened, recordings, data.impacts, known_events)
        sketch, missing = find_road_outline(opened, data.region, scenario, data.rows[0].values)
        if is_missing_map(missing):
            issue_notice_warning(missing.removesuffix("."))
        rerun = rerun_payload(opened, scenario)
        expected = read_expected_runs(opened, None if against is None else validation.check_path("against", against))
        if not opened.readonly:
            # Stored, so that later reports of the study, opened read-only, are identical.
            opened.writer.add_elapsed_time("draw", time.monotonic() - start)
            data = replace(data, summary=replace(data.summary, seconds_by_stage=opened.elapsed_by_stage()))
    roads = {"roads": None if sketch is None else encode_road_outline(sketch), "roads_missing": missing, "rerun": rerun}
    # Written together, so that page and figures always match.
    with atomic_write_group():
        if folder is not False:
            from cornercase.report.figures._all_figures import draw_all_figures
            from cornercase.report.figures._export import write_figures

            write_figures(draw_all_figures(data), validation.check_path("figures", folder))
        write_page(path, render_report(data, recordings, roads | {"events": events}, expected))
    return path


def render_report(
    data: ReportData,
    recordings: Mapping[int, str],
    more: Mapping[str, Any],
    expected: ExpectedRuns | None = None,
) -> str:
    """Render the report page of a study as HTML.

    `recordings` are the encoded recordings that the page contains, by scenario id. `more` has the keys ``roads``
    (drawing of the road), ``roads_missing`` (why there is no drawing), ``rerun`` (how to run a scenario again) and
    ``events`` (times of sight, braking and contact, by scenario id). `expected` are the earlier runs of the scenarios
    of a suite.
    """
    expected = expected or ExpectedRuns()
    recording_payload = {
        "recordings": [*recordings, *expected.recordings],
        "recordings_left_out": describe_left_out_recordings(data, recordings),
    }
    contents = page_payload(data) | recording_payload | dict(more) | expected.to_payload()
    details = list(render_details(data))
    verdicts = next((section for section in details if section.name == "verdicts"), None)
    return _render(
        live=False,
        digest=format_page_metadata(data),
        left_out=contents["recordings_left_out"],
        title=escape_control_characters(contents["title"]),
        about=contents["about"],
        contents=contents,
        answers=contents["answers"],
        verdicts=verdicts,
        gaps=[escape_control_characters(sentence) for sentence in expected.gaps],
        details=[section for section in details if section is not verdicts],
        provenance=render_provenance(data.file_name, data.summary),
        recordings={**recordings, **expected.recordings},
    )


def render_details(data: ReportData) -> Iterator[Section]:
    """Yield all detail sections of the report page, from the first to the last."""
    sections = (
        render_verdicts,
        render_probability,
        render_scores,
        *((render_estimates,) if data.summary.represents_space else ()),
        render_boundary_pairs,
        render_clusterings,
        render_agreement,
        render_reduced_set,
        render_failures,
    )
    for section in sections:
        yield from section(data)


def render_live_page(title: str) -> str:
    """Render the live page of a study as HTML without content; the page loads the content from the live server."""
    empty: dict[str, Any] = {"digest": "", "left_out": "", "about": "", "contents": None, "answers": [], "details": []}
    return _render(live=True, title=title, provenance=Markup(), recordings={}, **empty)


def _render(**parts: Any) -> str:
    return render_template(
        "page.html.j2", _STYLES, _SCRIPTS, policy=CONTENT_SECURITY_POLICY, plotly=_compressed_plotly(), **parts
    )


@cache
def _compressed_plotly() -> str:
    code = importlib.resources.files("plotly.package_data").joinpath("plotly.min.js").read_bytes()
    return base64.b64encode(zlib.compress(code, 9)).decode()
