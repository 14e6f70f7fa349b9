"""Settings with which both studies of a comparison were made, and commands that make the studies again."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cornercase import __version__
from cornercase._common.text.sanitize import escape_control_characters
from cornercase.drivers._serialization import format_driver
from cornercase.report._repeat_command import describe_inexpressible_parts, format_repeat_command
from cornercase.report.html._overview_sections import format_setting
from cornercase.report.text._phrases import format_range
from cornercase.study import StudyFile
from cornercase.suite import Comparison


@dataclass(frozen=True)
class StudyOrigins:
    """Settings of both studies of a comparison, and commands that make the studies and the page again.

    `rows` are tuples of name, old value, new value, and True if the values differ. `commands` are tuples of title,
    command, and sentences on what the command cannot express. The last command makes the page.
    """

    rows: tuple[tuple[str, str, str, bool], ...]
    commands: tuple[tuple[str, str, tuple[str, ...]], ...]


def describe_study_origins(comparison: Comparison, old: StudyFile, new: StudyFile) -> StudyOrigins:
    """Describe the settings of both studies, differing settings first; folders are left out, since they are private."""
    facts = [_describe_study(study) for study in (old, new)]
    names = dict.fromkeys((*facts[0], *facts[1]))
    rows = [(name, facts[0].get(name, "–"), facts[1].get(name, "–")) for name in names]
    compared = [(*row, row[0] != "study" and row[1] != row[2]) for row in rows]
    commands = [
        (f"Makes {study.path.name} again", _format_command_of(study), tuple(_describe_limits_of_study(study)))
        for study in (old, new)
    ]
    commands.append(("Makes this page again", _format_compare_command(comparison), ()))
    return StudyOrigins(
        tuple(
            (name, escape_control_characters(before), escape_control_characters(after), differs)
            for name, before, after, differs in sorted(compared, key=lambda row: (row[0] != "study", not row[3]))
        ),
        tuple((title, escape_control_characters(command), limits) for title, command, limits in commands),
    )


def _describe_study(study: StudyFile) -> dict[str, str]:
    meta, rows = study.meta, study.rows()
    drivers = dict(meta.drivers) or ({meta.ego: meta.driver_in_file} if meta.driver_in_file else {})
    settings: Mapping[str, Any] = meta.settings
    facts = {
        "study": study.path.name,
        "scenario file": meta.file_name,
        "fingerprint (SHA-256 of the scenario and all files that it uses)": meta.fingerprint,
        **{f"driver of {entity}": format_driver(driver) for entity, driver in drivers.items()},
        "simulator": meta.simulator,
        **{
            f"simulator's {name}": format_setting(value)
            for name, value in settings.items()
            if name != "drivers" and value not in ({}, [], None, "")
        },
        "cornercase that made the study": meta.version,
        "search": meta.optimizer,
        "seed": str(meta.seed),
        "scenarios that ran": str(sum(row.state == "done" for row in rows)),
        "scenarios that failed": str(sum(row.state == "failed" for row in rows)),
        "metrics": ", ".join(meta.metrics),
        "critical from": "no threshold" if study.criterion is None else f"{meta.metrics[0]} {study.criterion}",
        **{f"range of {parameter.name}": format_range(parameter) for parameter in meta.space.parameters},
        "requirements": "; ".join(meta.requirements),
    }
    return {name: value for name, value in facts.items() if value}


def _format_command_of(study: StudyFile) -> str:
    """Return the command that makes a study again, with the file name of the study as output."""
    return f"{format_repeat_command(study.meta).removesuffix(' study.db')} {shlex.quote(study.path.name)}"


def _describe_limits_of_study(study: StudyFile) -> list[str]:
    n_ended = sum(row.state != "pending" for row in study.rows())
    return [escape_control_characters(text) for text in describe_inexpressible_parts(study.meta, n_ended)]


def _format_compare_command(comparison: Comparison) -> str:
    names = [score.metric for score in comparison.scores]
    arguments = [*comparison.names, *(word for name in names for word in ("--metric", name))]
    if comparison.critical is not None:
        arguments += ["--critical", f"{comparison.critical:g}"]
    for name, value in comparison.tolerances.items():
        arguments += ["--tolerance", f"{name}={value:g}"]
    text = shlex.join(["cornercase", "compare", *arguments, "-o", "compare.html"])
    return f"{text}  # cornercase {__version__}"
