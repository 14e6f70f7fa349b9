"""Summary of a study on one A4 page, for decision makers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from markupsafe import Markup

from cornercase._common import validation
from cornercase._common.errors import InputError
from cornercase._common.io.files import check_output_differs_from_source
from cornercase._common.memory import DEFAULT_MEMORY, MemoryLimit
from cornercase._common.text.sanitize import escape_control_characters, shorten
from cornercase.drivers._serialization import format_driver
from cornercase.report._repeat_command import describe_inexpressible_parts, format_repeat_command
from cornercase.report._report_data import ReportData, read_report_data
from cornercase.report.html._space_sketch import draw_space_sketch
from cornercase.report.html._templates import check_page_path, render_template, write_page
from cornercase.report.text._answers import page_answers
from cornercase.report.text._phrases import format_percent, format_range, format_value
from cornercase.study import StudyFile
from cornercase.study._import_recordings import IMPORTED_SIMULATOR
from cornercase.study._study_file import open_study

# What fits on the page.
_MAX_RANGES: Final = 8
_MAX_SELECTED: Final = 10
_MAX_SELECTED_PARAMETERS: Final = 4
_MAX_TEXT: Final = 330
_MAX_NAME: Final = 44
_MAX_COMMAND: Final = 620
_POLICY: Final = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
_QUESTIONS: Final = ("verdicts", "probability", "collisions", "critical", "front", "missed", "failed")


def write_one_page_summary(
    study: StudyFile | Path | str,
    path: Path | str,
    *,
    critical: float | None = None,
    memory: str | float = DEFAULT_MEMORY,
) -> Path:
    """Write the summary of a study as an HTML file without scripts, which fits on one A4 page when printed."""
    path = validation.check_path("path", path)
    check_page_path(path, "summary")
    with open_study(study, readonly=True, critical=critical) as opened, opened.snapshot():
        check_output_differs_from_source(path, opened.path)
        if not opened.finished_rows():
            next_step = "'cornercase report' lists what failed" if opened.failed_rows() else "run some with `explore`"
            raise InputError(f"{opened.path}: no scenario was run, so there is nothing to summarize; {next_step}.")
        data = read_report_data(opened, charts=False, memory=MemoryLimit.from_value(memory))
    write_page(path, render_one_page_summary(data))
    return path


def render_one_page_summary(data: ReportData) -> str:
    """Render the summary of a study on one A4 page, as HTML."""
    meta = data.summary.meta
    command = escape_control_characters(format_repeat_command(meta))
    if len(command) > _MAX_COMMAND:
        command = f"cornercase show {data.file_name} --config"
    selected_head, selected_rows, selected_note = _selected_table(data)
    return render_template(
        "one-page.html.j2",
        ("one-page.css",),
        (),
        policy=_POLICY,
        title=shorten(escape_control_characters(meta.title), 80),
        tested=[(name, shorten(text, 200)) for name, text in _describe_tested(data)],
        ranges=[
            (
                shorten(escape_control_characters(parameter.name), _MAX_NAME),
                shorten(escape_control_characters(format_range(parameter)), 60),
            )
            for parameter in meta.space.parameters[:_MAX_RANGES]
        ],
        more_ranges=max(0, len(meta.space.parameters) - _MAX_RANGES),
        answers=list(_short_answers(data)),
        not_tested=[escape_control_characters(sentence) for sentence in _describe_not_tested(data)],
        selected_head=selected_head,
        selected_rows=selected_rows,
        selected_note=selected_note,
        sketch=_draw_space(data),
        has_threshold=data.summary.estimates.critical is not None,
        file_name=shorten(escape_control_characters(data.file_name), 80),
        fingerprint=meta.fingerprint,
        seed=meta.seed,
        version=meta.version,
        command=command,
        limits=[shorten(escape_control_characters(text), 200) for text in _describe_limits_of_command(data)],
        is_config=command.endswith("--config"),
    )


def _describe_limits_of_command(data: ReportData) -> Iterator[str]:
    return describe_inexpressible_parts(data.summary.meta, data.summary.n_run + data.summary.n_failed)


def _describe_tested(data: ReportData) -> Iterator[tuple[str, str]]:
    """Yield the facts about what was tested and how, as pairs of label and text."""
    summary, meta = data.summary, data.summary.meta
    driver = meta.ego_driver
    function = f"{format_driver(driver)}, which drives {meta.ego}" if driver else meta.ego
    yield "function", escape_control_characters(function)
    yield "against", escape_control_characters(", ".join(meta.others))
    yield "scenario", escape_control_characters(meta.file_name)
    yield "simulator", escape_control_characters(f"{meta.simulator}; cornercase {meta.version}")
    search = "imported recordings" if meta.simulator == IMPORTED_SIMULATOR else meta.optimizer
    yield "search", escape_control_characters(f"{search}, on {summary.objective}")
    counts = [f"{summary.n_run} run"]
    counts += [f"{summary.n_failed} could not be run"] if summary.n_failed else []
    counts += [f"{summary.n_pending} not run yet"] if summary.n_pending else []
    yield "scenarios", ", ".join(counts)


def _short_answers(data: ReportData) -> Iterator[tuple[str, str]]:
    """Yield the most important questions of the report page with their answers, shortened to the space available."""
    for answer in page_answers(data):
        if answer.name in _QUESTIONS:
            yield answer.question, _shorten_at_sentence(escape_control_characters(answer.text), _MAX_TEXT)


def _describe_not_tested(data: ReportData) -> Iterator[str]:
    """Yield sentences about what the study did not test."""
    summary, meta = data.summary, data.summary.meta
    if meta.simulator == IMPORTED_SIMULATOR:
        yield "Only what the recordings show; nothing was run."
    else:
        driver = meta.ego_driver
        other = f"no driver but {format_driver(driver)}, and " if driver else ""
        yield shorten(f"Nothing outside the ranges, {other}no simulator but {meta.simulator}.", 150)
    critical = summary.estimates.critical
    if critical is not None and critical.critical_set is not None:
        region, unvisited = critical.critical_set.region_fraction, critical.critical_set.unexplored_fraction
        yield (
            f"Around {format_percent(unvisited)} of the space, a region of {format_percent(region)} of it holds no"
            " scenario."
        )
    if summary.n_failed:
        yield f"{summary.n_failed} scenarios that could not be run."
    if summary.n_pending:
        yield f"{summary.n_pending} scenarios that were not run yet."
    if summary.unmeasured_collisions:
        names = ", ".join(summary.unmeasured_collisions)
        yield shorten(f"Distances to {names}, which the ego also hits, were not measured.", 150)


def _selected_table(data: ReportData) -> tuple[list[str], list[list[str]], str]:
    """Return header and rows of a table of the reduced set, and a note on how many scenarios the table shows."""
    reduced, meta = data.summary.reduced_set, data.summary.meta
    if reduced is None:
        return [], [], "No scenarios were selected yet; cornercase reduce does it."
    metric = data.metrics[0]
    parameters = [meta.space.parameters[k] for k in data.influential_parameters[:_MAX_SELECTED_PARAMETERS]]
    unit = "" if metric.unit in ("", "1") else f" [{metric.unit}]"
    head = ["scenario", "kept as", "ends", f"{metric.name}{unit}"]
    head += [f"{parameter.name}{f' [{parameter.unit}]' if parameter.unit else ''}" for parameter in parameters]
    # The most critical ones first.
    order = sorted(
        reduced.scenarios, key=lambda scenario: (float(metric.to_minimize(scenario.scores[metric.name])), scenario.id)
    )
    rows = []
    for scenario in order[:_MAX_SELECTED]:
        values = [format_value(parameter.extract_value(scenario.values), 4) for parameter in parameters]
        score = f"{scenario.scores[metric.name]:.3g}"
        outcome = data.outcomes.get(scenario.id, "–")
        rows.append([str(scenario.id), str(scenario.role), outcome, score, *values])
    note = f"The {len(order)} kept scenarios" if len(order) <= _MAX_SELECTED else (
        f"The {_MAX_SELECTED} most critical of {len(order)} kept scenarios, by {metric.name}"
    )  # fmt: skip
    clean = [[shorten(escape_control_characters(cell), 22) for cell in row] for row in [head, *rows]]
    return clean[0], clean[1:], f"{note}; of {reduced.n_run} that were run."


def _draw_space(data: ReportData) -> Markup:
    selected = () if data.summary.reduced_set is None else data.summary.reduced_set.ids
    is_selected = np.isin([row.id for row in data.rows], list(selected))
    indices = data.influential_parameters[:2]
    return (
        draw_space_sketch(data.values, data.parameters, indices, data.is_critical, is_selected) if indices else Markup()
    )


def _shorten_at_sentence(text: str, length: int) -> str:
    """Shorten a text to at most `length` characters: leave out its last sentences, or cut a long first one."""
    if len(text) <= length:
        return text
    end = text.rfind(". ", 0, length)
    return text[: end + 1] if end > 0 else shorten(text, length)
