"""Sections on scores, failures and how the study was made."""

from __future__ import annotations

import platform
from collections.abc import Iterator, Sequence
from html import escape
from importlib.metadata import version
from pathlib import PurePosixPath, PureWindowsPath
from typing import Any, Final

from markupsafe import Markup

from cornercase._common.texts import plain_text
from cornercase._common.version import __version__
from cornercase.drivers import driver_text
from cornercase.report.data import ReportData
from cornercase.report.study_files import name_command, tell_limits
from cornercase.report.summary import Summary
from cornercase.report.tables import Part, make_part, make_table
from cornercase.report.words import find_reasons, format_value, list_scenarios, name_range
from cornercase.study import Row, StudyMeta

# Columns of the table of scores that contain text.
_WORDS: Final = ("metric", "unit", "critical is", "against", "in", "scenarios against")
# Libraries whose version may change the results.
_LIBRARIES: Final = {"NumPy": "numpy", "SciPy": "scipy", "scikit-learn": "scikit-learn"}
# Stages whose names are not verbs.
_STAGES: Final = {"files": "read the scenario"}


def tell_scores(data: ReportData) -> Iterator[Part]:
    """Render the scores by each metric."""
    rows = []
    for summary in data.summary.metrics.values():
        spread = "" if summary.spread is None else f"{summary.spread[0]:.3g}, at most {summary.spread[1]:.3g}"
        location = ", ".join(
            f"{parameter.name} = {format_value(parameter.read(summary.at))}" for parameter in data.parameters
        )
        scores_per_other = ", ".join(f"{other} in {count}" for other, count in summary.counts.items() if count)
        rows.append(
            [
                summary.name, summary.unit, "low" if summary.lower_is_critical else "high",
                f"{summary.most_critical:.4g}", summary.against or "", f"scenario {summary.scenario} ({location})",
                f"{summary.median:.4g}", scores_per_other, spread, summary.alike,
            ]
        )  # fmt: skip
    head = [
        "metric", "unit", "critical is", "most critical", "against", "in", "median", "scenarios against",
        "between runs of one scenario", "note",
    ]  # fmt: skip
    columns = [k for k in range(len(head)) if any(row[k] for row in rows)]
    text_columns = [at for at, k in enumerate(columns) if head[k] in _WORDS]
    lines = [
        make_table([head[k] for k in columns], [[row[k] for k in columns] for row in rows], text=tuple(text_columns))
    ]
    yield make_part("scores", "Scores by each metric", lines)


def tell_failures(data: ReportData) -> Iterator[Part]:
    """Render why scenarios failed; nothing if none did."""
    if data.failed:
        yield make_part("failures", "Scenarios that could not be run", [tell_reasons(data.failed)])


def tell_reasons(failed: Sequence[Row]) -> str:
    """Render the reasons of failed scenarios, with their ids."""
    rows = [[str(len(ids)), why, list_scenarios(ids)] for why, ids in find_reasons(failed).items()]
    return make_table(["scenarios", "why", "which"], rows, text=(1, 2))


def tell_provenance(study: str, summary: Summary) -> Markup:
    """Render how the study was made: command, settings and versions; `file_name` is the study's."""
    meta = summary.meta
    settings = {k: v for k, v in meta.settings.items() if k != "drivers" and v not in ({}, [], None, "")}
    facts: dict[str, Any] = {
        "study": study,
        "scenario file": meta.file_name,
        "fingerprint (SHA-256 of the scenario and all files that it uses)": meta.fingerprint,
        **{f"range of {parameter.name}": name_range(parameter) for parameter in meta.space.parameters},
        "optimizer": meta.optimizer,
        "seed": meta.seed,
        "simulator": meta.simulator,
        **{f"simulator's {key}": _plain(value) for key, value in settings.items()},
        **{f"driver of {entity}": driver_text(driver) for entity, driver in meta.drivers.items()},
        **{f"time to {_STAGES.get(name, name)} [s]": _in_seconds(time) for name, time in summary.seconds.items()},
        **_versions(meta),
    }
    table = make_table(["what", "value"], [[key, str(value)] for key, value in facts.items()], text=(0, 1))
    limits = "".join(f"<p>{escape(sentence)}</p>" for sentence in tell_limits(meta, summary.run + summary.failed))
    command = f"<pre id='command' tabindex='0'><code>{escape(plain_text(name_command(meta)))}</code></pre>"
    return Markup(f"<p>This command makes it again:</p>{command}{limits}{table}")


def _in_seconds(seconds: float) -> str:
    return f"{seconds:.3g}" if seconds < 100.0 else f"{seconds:.0f}"


def _plain(value: Any) -> str:
    """Format a setting without Python syntax."""
    if isinstance(value, dict):
        return ", ".join(f"{name}: {_plain(item)}" for name, item in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value))
    # Only the file name, as folders of the author are private.
    path = next((kind(str(value)) for kind in (PurePosixPath, PureWindowsPath) if kind(str(value)).is_absolute()), None)
    return str(value) if path is None else path.name


def _versions(meta: StudyMeta) -> dict[str, str]:
    return {
        "cornercase that made the study": meta.version,
        "cornercase that wrote this page": __version__,
        **{name: version(package) for name, package in _LIBRARIES.items()},
        "Python": platform.python_version(),
    }
