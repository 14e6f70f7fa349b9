"""The recordings that a suite was made from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError
from cornercase.study import Row, Study, damage_told
from cornercase.suite.contents import SuiteContents
from cornercase.suite.difference import Difference, find_difference

# Bytes of a name; no system takes more.
_LONGEST: Final = 255


def find_origin(suite: SuiteContents, against: Path | None) -> tuple[Path | None, str]:
    """Find the study whose recordings those of a suite are compared with.

    Parameters
    ----------
    suite : SuiteContents
    against : Path or None
        A study that was named. By default it is looked for beside the manifest and in the folder above, by its name,
        and known by its fingerprint.

    Returns
    -------
    study : Path or None
        None where there is none.
    why : str
        Why there is none, as a sentence without a full stop.

    Raises
    ------
    InputError
        The one that was named is of something else, or cannot be used.
    """
    if against is not None:
        with Study.open(against, readonly=True) as study, damage_told(against):
            _read(suite, study)
        return against, ""
    if not suite.study:
        return None, "no study is known that the files were made from"
    # Only its name counts: the manifest may come from anywhere.
    name = Path(suite.study.replace("\\", "/")).name
    for folder in (suite.folder, suite.folder.resolve().parent):
        path = folder / name
        if name and len(name.encode(errors="replace")) <= _LONGEST and path.is_file():
            try:
                with Study.open(path, readonly=True) as study, damage_told(path):
                    _read(suite, study)
            except InputError:
                continue
            return path, ""
    return None, f"{name} lies neither beside the manifest nor in the folder above as it was, or cannot be read"


def find_differences(suite: SuiteContents, origin: Path, study: Study) -> dict[int, Difference]:
    """Compare the recordings of a suite with those that it was made from.

    Parameters
    ----------
    suite : SuiteContents
    origin : Path
        Study with the earlier recordings.
    study : Study
        Of the suite, open.

    Returns
    -------
    dict of int to Difference
        By id in the study of the suite; of those that ran in both.
    """
    with Study.open(origin, readonly=True) as earlier, damage_told(origin):
        sources = _sources(suite, earlier)
        found = {}
        for row in study.done():
            before = sources.get(row.id)
            if before is not None and before.state == "done":
                mine, theirs = study.scores_of(row.id), earlier.scores_of(before.id)
                scores = {name: (theirs[name], mine[name]) for name in mine if name in theirs}
                found[row.id] = find_difference(
                    earlier.recording(before.id), study.recording(row.id), study.meta.ego, scores
                )
        return found


def _read(suite: SuiteContents, study: Study) -> None:
    """Read what is compared later, so that damage is told before anything is run."""
    for row in _sources(suite, study).values():
        if row.state == "done":
            study.recording(row.id)
            study.scores_of(row.id)


def _sources(suite: SuiteContents, study: Study) -> Mapping[int, Row]:
    """Scenario of an earlier study, by the id in that of the suite."""
    rows = {row.id: row for row in study.rows()}
    if study.meta.suite:
        places = {file: k for k, file in enumerate(study.meta.files, start=1)}
        pairs = {k: places.get(one.file) for k, one in enumerate(suite.scenarios, start=1)}
        found = {k: rows[place] for k, place in pairs.items() if place in rows}
        if not found:
            raise InputError(f"`against` {study.path}: has none of the files of {suite.place}; name another study.")
        return found
    if study.meta.fingerprint != suite.fingerprint:
        raise InputError(
            f"`against` {study.path}: is not the study that {suite.place} was made from; name the one that was reduced,"
            " or an earlier run of the suite."
        )
    found = {}
    for k, one in enumerate(suite.scenarios, start=1):
        row = rows.get(one.origin or 0)
        if row is None or dict(row.values) != dict(one.values):
            raise InputError(
                f"`against` {study.path}: has another scenario {one.origin} than {suite.place} was made from; name the"
                " study that was reduced."
            )
        found[k] = row
    return found
