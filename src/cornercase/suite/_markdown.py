"""Write verdicts as a Markdown table, which GitHub shows on the summary page of a job."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

from cornercase._common.io.files import atomic_write
from cornercase._common.text.sanitize import escape_control_characters

if TYPE_CHECKING:
    from cornercase.suite._suite_result import SuiteResult

# Characters with a meaning in Markdown.
_MARKDOWN_SPECIAL: Final = re.compile(r"([\\`*_\[\]<>|#~&$!@])")

SUMMARY_START: Final = re.compile(rb"### (\d+ (passed|failed|inconclusive|not run)(, )?)+ of \d+ scenarios?\r?\n")
"""Begin of each Markdown file: the heading with the summary of the verdicts."""


def write_markdown_summary(result: SuiteResult, path: Path) -> None:
    """Write the verdicts on a suite in Markdown: a heading with the summary, and a table with one row per scenario."""
    # With another driver, all recordings differ.
    compared = result.against if result.has_comparable_recordings else None
    head = ["scenario", "kind", "verdict", "why", "" if compared is None else f"against {compared.name}"]
    rows = [
        [
            scenario.file,
            scenario.kind,
            "not run" if scenario.state == "error" else scenario.state,
            scenario.reason,
            "" if scenario.difference is None or compared is None else scenario.difference.text,
        ]
        for scenario in result.scenarios
    ]
    used = [k for k in range(len(head)) if any(row[k] for row in rows)]
    lines = [
        f"### {_escape_markdown(result.summary)}",
        "",
        _format_row([_escape_markdown(head[k]) for k in used]),
        _format_row(["---"] * len(used)),
        *(_format_row([_escape_markdown(row[k]) for k in used]) for row in rows),
        "",
        f"{_escape_markdown(result.comparison_summary)}.",
    ]
    with atomic_write(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8", errors="backslashreplace", newline="\n")


def _format_row(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _escape_markdown(text: str) -> str:
    return _MARKDOWN_SPECIAL.sub(r"\\\1", " ".join(escape_control_characters(text).split()))
