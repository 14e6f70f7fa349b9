"""Digest of a report page: main results in the HTML head, from which an index page reads them."""

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


def format_page_metadata(data: ReportData) -> str:
    """Return the digest of a report (JSON for its HTML head): identity of the study and critical share of the space."""
    summary = data.summary
    digest = study_identity(data.file_name, summary.meta, summary.n_run, summary.n_failed)
    critical = summary.estimates.critical
    # The scenarios of a suite were selected, so their critical share is no estimate for a space.
    if critical is not None and summary.represents_space:
        digest["threshold"] = critical.threshold
        if (estimates := critical.critical_set) is not None:
            share = estimates.critical_fraction
            has_interval = estimates.interval_unavailable is None
            digest["share"] = [share.value, *((share.low, share.high) if has_interval else (None, None))]
    return json.dumps(digest, sort_keys=True)


def study_identity(file_name: str, meta: StudyMeta, n_run: int, n_failed: int) -> dict[str, Any]:
    """Return named facts of a study; a report page with the same facts is the up-to-date report of the study."""
    return {
        "study": file_name,
        "fingerprint": meta.fingerprint,
        "optimizer": meta.optimizer,
        "seed": meta.seed,
        "run": n_run,
        "failed": n_failed,
    }


def read_page_metadata(page: Path) -> dict[str, Any] | None:
    """Read the digest (JSON with main results) from the HTML head of a report page; None if there is no digest."""
    try:
        with page.open("rb") as file:
            head = file.read(_HEAD_BYTES).decode("utf-8", errors="replace")
        match = _PATTERN.search(head)
        digest = None if match is None else json.loads(html.unescape(match[1]))
    except (OSError, ValueError):
        return None
    return digest if isinstance(digest, dict) else None


def find_page_of_study(study: StudyFile, n_run: int, n_failed: int) -> tuple[Path | None, list[float | None] | None]:
    """Find an up-to-date report page beside a study, and read the critical share of the space from the page.

    The share is a list of value, lower and upper bound. It is None if the page has no share for the threshold of the
    study. Both results are None if there is no up-to-date page.
    """
    identity = study_identity(study.path.name, study.meta, n_run, n_failed)
    for page in sorted(study.path.parent.glob("*.html")):
        digest = read_page_metadata(page)
        if digest is None or any(digest.get(name) != value for name, value in identity.items()):
            continue
        share = digest.get("share")
        numbers = isinstance(share, list) and len(share) == 3 and isinstance(share[0], float | int)
        return page, share if numbers and digest.get("threshold") == study.critical else None
    return None, None
