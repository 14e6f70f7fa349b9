"""Compare the recordings of a suite run with those in its baseline, an earlier study of the same scenarios."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError
from cornercase.drivers import DRIVERS
from cornercase.drivers._serialization import format_driver
from cornercase.study import ScenarioRecord, StudyFile
from cornercase.study._damage import reraise_read_errors
from cornercase.suite._recording_difference import RecordingDifference, compare_recording_pair
from cornercase.suite._suite_contents import SuiteContents

# Largest number of bytes of a file name.
_MAX_NAME_BYTES: Final = 255


def find_baseline_study(suite: SuiteContents, against: Path | None) -> tuple[Path | None, str]:
    """Return the study to compare a suite run with, and an empty text; or None, and the reason why there is none.

    If `against` is None, the study that the suite was selected from is searched beside the manifest and in the folder
    above.
    """
    if against is not None:
        with StudyFile.open(against, readonly=True) as study, reraise_read_errors(against):
            _check_baseline_readable(suite, study)
        return against, ""
    if not suite.study:
        return None, "the study that the files were made from is unknown"
    # Only use the name, since the manifest may come from anywhere.
    name = Path(suite.study.replace("\\", "/")).name
    for folder in (suite.folder, suite.folder.resolve().parent):
        path = folder / name
        if name and len(name.encode(errors="replace")) <= _MAX_NAME_BYTES and path.is_file():
            try:
                with StudyFile.open(path, readonly=True) as study, reraise_read_errors(path):
                    _check_baseline_readable(suite, study)
            except InputError:
                continue
            return path, ""
    return None, f"{name} was not found unchanged and readable beside the manifest or in the folder above"


def compare_with_baseline(suite: SuiteContents, baseline: Path, study: StudyFile) -> dict[int, RecordingDifference]:
    """Return how the recordings in `study`, a suite run, differ from those in the baseline, by scenario id in `study`.

    Scenarios that did not run in both studies are left out.
    """
    with StudyFile.open(baseline, readonly=True) as earlier, reraise_read_errors(baseline):
        sources = _match_baseline_rows(suite, earlier)
        differences = {}
        for row in study.finished_rows():
            earlier_row = sources.get(row.id)
            if earlier_row is not None and earlier_row.state == "done":
                scores_now, scores_before = study.scenario_scores(row.id), earlier.scenario_scores(earlier_row.id)
                scores = {name: (scores_before[name], scores_now[name]) for name in scores_now if name in scores_before}
                differences[row.id] = compare_recording_pair(
                    earlier.recording(earlier_row.id), study.recording(row.id), study.meta.ego, scores
                )
        return differences


def find_changed_driver(baseline: Path, study: StudyFile) -> tuple[str, str] | None:
    """Return the ego's drivers in the baseline and in `study` if their names differ.

    None if the names are equal, or if a driver is unknown. Options and versions of a driver do not matter, since a
    suite is run to compare versions of the same driver.
    """
    with StudyFile.open(baseline, readonly=True) as earlier, reraise_read_errors(baseline):
        drivers = [meta.ego_driver for meta in (earlier.meta, study.meta)]
    if None in drivers:
        return None
    before, now = (format_driver(driver) if driver else "its storyboard" for driver in drivers)
    return (before, now) if _driver_name(before) != _driver_name(now) else None


def _driver_name(text: str) -> str:
    """Return the name of a formatted driver without options: a preset, a kind such as ``fmu``, or ``module:Class``."""
    name, *rest = re.split("[:,]", text, maxsplit=2)
    is_class = name not in DRIVERS and text.startswith(f"{name}:") and "=" not in rest[0]
    return f"{name}:{rest[0]}" if is_class else name


def _check_baseline_readable(suite: SuiteContents, study: StudyFile) -> None:
    """Read everything in the baseline that is compared later, so that damage is reported before the suite is run."""
    for row in _match_baseline_rows(suite, study).values():
        if row.state == "done":
            study.recording(row.id)
            study.scenario_scores(row.id)


def _match_baseline_rows(suite: SuiteContents, study: StudyFile) -> Mapping[int, ScenarioRecord]:
    """Return the scenarios of the baseline, by the id of the same scenario in the suite."""
    rows = {row.id: row for row in study.rows()}
    if study.meta.suite:
        id_of = {file: k for k, file in enumerate(study.meta.files, start=1)}
        matches = {k: id_of.get(scenario.file_name) for k, scenario in enumerate(suite.scenarios, start=1)}
        sources = {k: rows[source] for k, source in matches.items() if source in rows}
        if not sources:
            raise InputError(f"`against` {study.path}: contains no scenario file of {suite.path}; name another study.")
        return sources
    if study.meta.fingerprint != suite.fingerprint:
        raise InputError(
            f"`against` {study.path}: is not the study that {suite.path} was made from; name the study that was"
            " reduced, or an earlier run of the suite."
        )
    sources = {}
    for k, scenario in enumerate(suite.scenarios, start=1):
        row = rows.get(scenario.source_id or 0)
        if row is None or dict(row.values) != dict(scenario.values):
            raise InputError(
                f"`against` {study.path}: its scenario {scenario.source_id} is missing or has other values than in"
                f" {suite.path}; name the study that was reduced."
            )
        sources[k] = row
    return sources
