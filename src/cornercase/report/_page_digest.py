"""What a report tells of itself in its head, so that an index of many studies need not estimate again."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path
from typing import Any, Final

from cornercase.report._report_data import ReportData
from cornercase.study import StudyFile, StudyMeta

# The digest is in the first bytes of a page, before its styles.
_HEAD_BYTES: Final = 16_384
_PATTERN: Final = re.compile(r'<meta name="cornercase-study" content="([^"]*)">')


def page_digest(data: ReportData) -> str:
    """Return the digest of a report, as JSON."""
    summary = data.summary
    digest = study_identity(data.file_name, summary.meta, summary.n_run, summary.n_failed)
    critical = summary.estimates.critical
    # The scenarios of a suite were chosen, so their share is none of a space.
    if critical is not None and summary.represents_space:
        digest["threshold"] = critical.threshold
        if (estimates := critical.critical_set) is not None:
            share = estimates.critical_fraction
            has_interval = estimates.interval_unavailable is None
            digest["share"] = [share.value, *((share.low, share.high) if has_interval else (None, None))]
    return json.dumps(digest, sort_keys=True)


def study_identity(file_name: str, meta: StudyMeta, n_run: int, n_failed: int) -> dict[str, Any]:
    """Return what a page and the study that it shows have in common."""
    return {
        "study": file_name,
        "fingerprint": meta.fingerprint,
        "optimizer": meta.optimizer,
        "seed": meta.seed,
        "run": n_run,
        "failed": n_failed,
    }


def read_page_digest(page: Path) -> dict[str, Any] | None:
    """Read the digest of a page; None if it has none."""
    try:
        with page.open("rb") as file:
            head = file.read(_HEAD_BYTES).decode("utf-8", errors="replace")
        match = _PATTERN.search(head)
        digest = None if match is None else json.loads(html.unescape(match[1]))
    except (OSError, ValueError):
        return None
    return digest if isinstance(digest, dict) else None


def find_page_of_study(study: StudyFile, n_run: int, n_failed: int) -> tuple[Path | None, list[float | None] | None]:
    """Find a report beside a study that shows it as it is now, and the share of the space that it says is critical.

    The share is its value and the bounds of its interval, or None if the page has none for the study's threshold.
    """
    identity = study_identity(study.path.name, study.meta, n_run, n_failed)
    for page in sorted(study.path.parent.glob("*.html")):
        digest = read_page_digest(page)
        if digest is None or any(digest.get(name) != value for name, value in identity.items()):
            continue
        share = digest.get("share")
        numbers = isinstance(share, list) and len(share) == 3 and isinstance(share[0], float | int)
        return page, share if numbers and digest.get("threshold") == study.critical else None
    return None, None
