"""Write verdicts as a Markdown table, which GitHub shows on the page of a job."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from cornercase._common.files import written_whole
from cornercase._common.texts import plain_text
from cornercase.suite.result import SuiteResult

# Characters with a meaning in Markdown.
_SIGNS: Final = re.compile(r"([\\`*_\[\]<>|#~&$!@])")

HEADING: Final = b"### "
"""Start of each file."""


def write_summary(result: SuiteResult, path: Path) -> None:
    """Write a table with one row per scenario."""
    head = ["scenario", "kind", "verdict", "why", "recording"]
    rows = [
        [
            scenario.file,
            scenario.kind,
            "not run" if scenario.state == "error" else scenario.state,
            scenario.reason,
            "" if scenario.difference is None else scenario.difference.text,
        ]
        for scenario in result.scenarios
    ]
    used = [k for k in range(len(head)) if any(row[k] for row in rows)]
    lines = [
        f"{HEADING.decode()}{_text(result.text)}",
        "",
        _line([head[k] for k in used]),
        _line(["---"] * len(used)),
        *(_line([_text(row[k]) for k in used]) for row in rows),
        "",
        f"{_text(result.comparison)}.",
    ]
    with written_whole(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8", errors="backslashreplace", newline="\n")


def _line(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _text(text: str) -> str:
    return _SIGNS.sub(r"\\\1", " ".join(plain_text(text).split()))
