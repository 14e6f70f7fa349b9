"""Sections on the scores, on failures, and on how the study was made."""

from __future__ import annotations

import platform
from collections.abc import Iterator, Sequence
from html import escape
from importlib.metadata import version
from pathlib import PurePosixPath, PureWindowsPath
from typing import Any, Final

from markupsafe import Markup

from cornercase._common.text.sanitize import escape_control_characters
from cornercase._common.version import __version__
from cornercase.drivers._serialization import format_driver
from cornercase.report._repeat_command import describe_inexpressible_parts, format_repeat_command
from cornercase.report._report_data import ReportData
from cornercase.report._summary import Summary
from cornercase.report.html._tables import Section, make_section, render_table
from cornercase.report.text._phrases import format_range, format_scenario_ids, format_value, group_failures_by_reason
from cornercase.study import ScenarioRecord, StudyMeta

# Columns of the table of scores that contain text.
_TEXT_COLUMNS: Final = ("metric", "unit", "critical is", "against", "in", "scenarios against")
# Libraries whose version may change the results.
_PACKAGE_NAMES: Final = {"NumPy": "numpy", "SciPy": "scipy", "scikit-learn": "scikit-learn"}
# Stages whose names are not verbs.
_STAGE_NAMES: Final = {"files": "read the scenario"}


def render_scores(data: ReportData) -> Iterator[Section]:
    """Yield the section with the scores by each metric."""
    rows = []
    for summary in data.summary.metrics.values():
        spread = (
            ""
            if summary.repeat_spread is None
            else f"{summary.repeat_spread[0]:.3g}, at most {summary.repeat_spread[1]:.3g}"
        )
        location = ", ".join(
            f"{parameter.name} = {format_value(parameter.extract_value(summary.parameters))}"
            for parameter in data.parameters
        )
        scores_per_other = ", ".join(
            f"{other} in {count}" for other, count in summary.scores_per_other.items() if count
        )
        rows.append(
            [
                summary.name, summary.unit, "low" if summary.lower_is_critical else "high",
                f"{summary.most_critical:.4g}", summary.most_critical_other or "", f"scenario"
                    f" {summary.most_critical_id} ({location})",
                f"{summary.median:.4g}", scores_per_other, spread, summary.constant_note,
            ]
        )  # fmt: skip
    head = [
        "metric", "unit", "critical is", "most critical", "against", "in", "median", "scenarios against",
        "between runs of one scenario", "note",
    ]  # fmt: skip
    columns = [k for k in range(len(head)) if any(row[k] for row in rows)]
    text_columns = [at for at, k in enumerate(columns) if head[k] in _TEXT_COLUMNS]
    lines = [
        render_table(
            [head[k] for k in columns], [[row[k] for k in columns] for row in rows], left_aligned=tuple(text_columns)
        )
    ]
    yield make_section("scores", "Scores by each metric", lines)


def render_failures(data: ReportData) -> Iterator[Section]:
    """Yield the section on why scenarios failed; nothing if none failed."""
    if data.failed:
        yield make_section("failures", "Scenarios that could not be run", [render_failure_reasons(data.failed)])


def render_failure_reasons(failed: Sequence[ScenarioRecord]) -> str:
    """Render the reasons why scenarios failed, with the ids of the scenarios."""
    rows = [[str(len(ids)), why, format_scenario_ids(ids)] for why, ids in group_failures_by_reason(failed).items()]
    return render_table(["scenarios", "why", "which"], rows, left_aligned=(1, 2))


def render_provenance(file_name: str, summary: Summary) -> Markup:
    """Render how the study was made: command, settings and versions; `file_name` is the name of the study."""
    meta = summary.meta
    settings = {k: v for k, v in meta.settings.items() if k != "drivers" and v not in ({}, [], None, "")}
    facts: dict[str, Any] = {
        "study": file_name,
        "scenario file": meta.file_name,
        "fingerprint (SHA-256 of the scenario and all files that it uses)": meta.fingerprint,
        **{f"range of {parameter.name}": format_range(parameter) for parameter in meta.space.parameters},
        "optimizer": meta.optimizer,
        "seed": meta.seed,
        "simulator": meta.simulator,
        **{f"simulator's {key}": format_setting(value) for key, value in settings.items()},
        **{f"driver of {entity}": format_driver(driver) for entity, driver in meta.drivers.items()},
        **{
            f"time to {_STAGE_NAMES.get(name, name)} [s]": _format_seconds(time)
            for name, time in summary.seconds_by_stage.items()
        },
        **_study_and_page_versions(meta),
    }
    table = render_table(["what", "value"], [[key, str(value)] for key, value in facts.items()], left_aligned=(0, 1))
    limits = "".join(
        f"<p>{escape(sentence)}</p>"
        for sentence in describe_inexpressible_parts(meta, summary.n_run + summary.n_failed)
    )
    text = escape(escape_control_characters(format_repeat_command(meta)))
    command = f"<pre id='command' tabindex='0'><code>{text}</code></pre>"
    return Markup(f"<p>This command makes it again:</p>{command}{limits}{table}")


def _format_seconds(seconds: float) -> str:
    return f"{seconds:.3g}" if seconds < 100.0 else f"{seconds:.0f}"


def format_setting(value: Any) -> str:
    """Format the value of a setting, without the syntax of Python's dictionaries and lists.

    An absolute path is cut to its file name.
    """
    if isinstance(value, dict):
        return ", ".join(f"{name}: {format_setting(item)}" for name, item in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(format_setting, value))
    # Only the file name, since folders of the author are private.
    path = next((kind(str(value)) for kind in (PurePosixPath, PureWindowsPath) if kind(str(value)).is_absolute()), None)
    return str(value) if path is None else path.name


def _study_and_page_versions(meta: StudyMeta) -> dict[str, str]:
    return {
        "cornercase that made the study": meta.version,
        "cornercase that wrote this page": __version__,
        **{name: version(package) for name, package in _PACKAGE_NAMES.items()},
        "Python": platform.python_version(),
    }
