"""Earlier runs of the scenarios of a suite, which the report of a run of the suite shows as the expected runs."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, Final

from cornercase._common.errors import InputError, NoticeWarning
from cornercase._common.io.files import MAX_FILE_SIZE
from cornercase._common.text.sanitize import quote_name
from cornercase.drivers._serialization import format_driver
from cornercase.reduction._reduced_set_folder import MANIFEST
from cornercase.report._suite_gaps import describe_suite_gaps
from cornercase.report.encode._page_recordings import encode_recordings
from cornercase.scenario import Value
from cornercase.scenario._scenario_search import find_files_below
from cornercase.study import StudyFile
from cornercase.suite._baseline import find_baseline_study
from cornercase.suite._read_suite import read_suite

# Earlier recordings beyond this size are left out.
_MAX_CHARACTERS: Final = 8_000_000


@dataclass(frozen=True)
class ExpectedRuns:
    """Earlier runs of the scenarios of a suite, which the report page shows as the expected runs beside the new runs.

    `recordings` are encoded recordings of the earlier runs by negative scenario id, since positive ids belong to the
    new runs. `runs` are the texts about each earlier run, by scenario id. If the earlier runs were not found, `missing`
    is the reason, else it is empty. `gaps` are sentences on what the suite did not test.
    """

    recordings: Mapping[int, str] = field(default_factory=dict)
    runs: Mapping[int, Mapping[str, str]] = field(default_factory=dict)
    missing: str = ""
    gaps: tuple[str, ...] = ()

    def to_payload(self) -> dict[str, Any]:
        """Return the texts about the earlier runs as JSON values for the report page, without recordings."""
        runs = {str(scenario): dict(run) for scenario, run in self.runs.items()}
        return {"expected": {"runs": runs, "missing": self.missing}} if runs or self.missing else {}


def read_expected_runs(study: StudyFile, against: Path | None = None) -> ExpectedRuns:
    """Read the earlier runs of the scenarios of a suite from `against`, or from the study that the suite was made from.

    `study` is a run of the suite. Without `against`, the manifest of the suite is looked for beside `study` and in the
    current folder, up to two folders below each. The suite is recognized by its content, and its manifest names the
    study. A suite that was not made from a study has no earlier runs. InputError if `against` has no run of these
    scenarios.
    """
    meta = study.meta
    if not meta.suite:
        if against is not None:
            raise InputError(f"`against`: {study.path} is no run of a suite; leave `against` out.")
        return ExpectedRuns()
    is_named = against is not None
    if against is None:
        if not meta.origin:
            return ExpectedRuns()
        against, why = _find_study_behind_suite(study)
        if against is None:
            return ExpectedRuns(
                missing=f"The expected runs are not shown beside these: {why}. Name the study that the suite was made"
                f" from: cornercase report {quote_name(study.path.name)} --against STUDY.db",
                gaps=(
                    "What the suite leaves out of the study that it was made from is not known here, as that study was"
                    " not found; --against names it.",
                ),
            )
    with StudyFile.open(against, readonly=True) as earlier:
        sources = _match_rows(study, earlier)
        if not sources and is_named:
            raise InputError(
                f"`against` {earlier.path}: has no run of the scenarios of {study.path}; name the study that the suite"
                " was made from, or an earlier run of the suite."
            )
        missing = (
            f"The expected runs are not shown beside these: none of these scenarios ran in {quote_name(against.name)}."
        )
        texts = encode_recordings(earlier, list(sources.values()), max_characters=_MAX_CHARACTERS)
        outcomes = earlier.outcomes()
        driver = earlier.meta.drivers.get(meta.ego, earlier.meta.driver_in_file)
        facts = [f"{meta.ego} driven by {format_driver(driver)}"] if driver else []
        shown = {scenario: source for scenario, source in sources.items() if source in texts}
        return ExpectedRuns(
            {-scenario: texts[source] for scenario, source in shown.items()},
            {
                scenario: {
                    "called": f"Expected: scenario {source} of {against.name}",
                    "facts": " · ".join([*facts, *filter(None, [outcomes.get(source)])]),
                }
                for scenario, source in shown.items()
            },
            missing="" if sources else missing,
            gaps=tuple(describe_suite_gaps(study, earlier, list(sources.values()))),
        )


def _find_study_behind_suite(study: StudyFile) -> tuple[Path | None, str]:
    """Find the study that a suite was made from, given a run of the suite; return None and the reason if not found."""
    for manifest in _manifests(study):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", NoticeWarning)
                suite = read_suite(manifest)
            if suite.content_hash == study.meta.suite:
                return find_baseline_study(suite, None)
        except InputError:
            continue
    name = quote_name(PurePosixPath(study.meta.scenario).name)
    return None, f"the suite {name} was not found as it was run beside {quote_name(study.path.name)}"


def _manifests(study: StudyFile) -> Iterator[Path]:
    """Yield paths of suite manifests near `study`, the run of a suite, that name the same scenario files as `study`."""
    for folder in (study.path.parent, Path()):
        for path in find_files_below(folder, MANIFEST):
            try:
                content = json.loads(path.read_bytes()) if path.stat().st_size <= MAX_FILE_SIZE else {}
                names = {entry["file"] for entry in content["scenarios"]}
            except (OSError, ValueError, KeyError, TypeError, RecursionError):
                continue
            if names == set(study.meta.files):
                yield path


def _match_rows(study: StudyFile, earlier: StudyFile) -> dict[int, int]:
    """Map the id of each scenario in `study` to the id of the same scenario in `earlier`, if it ran in both studies."""
    if earlier.meta.suite:
        by_file = {earlier.meta.files[row.id - 1]: row.id for row in earlier.finished_rows()}
        matched = {row.id: by_file.get(study.meta.files[row.id - 1]) for row in study.finished_rows()}
    elif earlier.meta.fingerprint == study.meta.origin:
        by_values: dict[frozenset[tuple[str, Value]], int] = {}
        for row in earlier.finished_rows():
            by_values.setdefault(frozenset(row.values.items()), row.id)
        matched = {row.id: by_values.get(frozenset(row.values.items())) for row in study.finished_rows()}
    else:
        matched = {}
    return {scenario: source for scenario, source in matched.items() if source is not None}
