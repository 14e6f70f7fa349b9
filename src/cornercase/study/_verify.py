"""Verify that the content of a study is as it was written."""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cornercase._common import validation
from cornercase._common.errors import InputError
from cornercase.study._checksums import describe_row_key, is_checksum_valid, require_checksum_totals
from cornercase.study._connection import (
    is_unreachable_error,
    iter_sqlite_problems,
    open_connection,
    read_schema_version,
    require_current_schema,
    require_known_tables,
    require_nonempty_file,
    reraise_sqlite_errors,
)
from cornercase.study._damage import DamageError
from cornercase.study._recovery.recover_rows import has_intact_rows
from cornercase.study._schema import APPLICATION_ID, SCHEMA_VERSION, TABLES
from cornercase.study._study_file import StudyFile

# Largest number of listed problems, from SQLite and per table.
_MAX_LISTED: Final = 20


@dataclass(frozen=True)
class Verification:
    """Result of `verify`: the problems found in a study.

    Attributes
    ----------
    path : Path
        Path of the study.
    problems : tuple of str
        Description of each problem, as a part of a sentence; empty if there is no problem.
    checked : bool, default True
        Whether the study has checksums; True, since all studies have checksums.

    Examples
    --------
    >>> from cornercase.study import verify
    >>> verification = verify("damaged.db")  # doctest: +SKIP
    >>> verification.is_sound, verification.problems[-1]  # doctest: +SKIP
    (False, 'SQLite says: database disk image is malformed')
    """

    path: Path
    problems: tuple[str, ...]
    checked: bool = True

    @property
    def is_sound(self) -> bool:
        """True if the study has no problem."""
        return not self.problems


def verify(study: Path | str) -> Verification:
    """Check everything in a study: SQLite's integrity, checksums, counts, references and types.

    Parameters
    ----------
    study : path
        Path of the study.

    Returns
    -------
    Verification

    Raises
    ------
    InputError
        There is no such file, or the file cannot be opened. Or the file is not a study, since another program wrote it
        or nothing in it is from cornercase. Or a newer version of cornercase wrote the study.

    Examples
    --------
    >>> from cornercase.study import verify
    >>> verify("missing.db")
    Traceback (most recent call last):
        ...
    cornercase._common.errors.InputError: missing.db: there is no such study; make one with `Study.create`.
    """
    path = validation.check_path("study", study)
    require_nonempty_file(path)
    _require_study(path)
    problems = list(dict.fromkeys(_iter_problems(path)))
    return Verification(path, tuple(problems))


def _require_study(path: Path) -> None:
    """Raise `InputError` unless the file is a study, intact or damaged."""
    try:
        with closing(open_connection(path)) as connection:
            connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
            (application,) = connection.execute("PRAGMA application_id").fetchone()
            version = read_schema_version(connection)
            if application not in (0, APPLICATION_ID) or (application == APPLICATION_ID and version > SCHEMA_VERSION):
                # It is unknown whether this number itself is damaged.
                require_current_schema(path, connection)
            if application == APPLICATION_ID:
                return
    except (sqlite3.Error, UnicodeDecodeError) as error:
        _raise_if_unreachable(path, error)
    try:
        has_rows = has_intact_rows(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    if not has_rows:
        raise InputError(f"{path}: is not a cornercase study, or nothing is left of one.")


def _iter_problems(path: Path) -> Iterator[str]:
    is_damaged = False
    for problem in _iter_file_problems(path):
        is_damaged = True
        yield problem
    if is_damaged:
        return
    # All checksums are valid. Reading the content shows whether it is that of a study.
    try:
        with StudyFile.open(path) as opened:
            for _ in zip(opened.iter_recordings(), opened.iter_digests(), strict=True):
                pass
            opened.table()
            opened.result_order()
            opened.elapsed_by_stage()
            opened.warm_start_data()
            for name in opened.analyzed_aspects():
                opened.read_analysis(name)
            opened.read_reduction(), opened.read_estimate()
            for row in opened.rows():
                opened.scenario_scores(row.id), opened.scenario_score_sources(row.id)
    except InputError as error:
        _raise_if_unreachable(path, error.__cause__)
        yield str(error).removeprefix(f"{path}: ")
    yield from _iter_broken_references(path)


def _iter_broken_references(path: Path) -> Iterator[str]:
    try:
        with closing(open_connection(path)) as connection:
            broken = [(table, parent) for table, _, parent, _ in connection.execute("PRAGMA foreign_key_check")]
    except sqlite3.Error as error:
        yield _describe_error(path, error)
        return
    for (table, parent), count in Counter(broken).items():
        yield f"its table {table} has rows that belong to no row of its table {parent}: {count}"


def _iter_file_problems(path: Path) -> Iterator[str]:
    try:
        with closing(open_connection(path)) as connection:
            connection.execute("PRAGMA trusted_schema = OFF")
            connection.execute("PRAGMA cell_size_check = ON")
            require_current_schema(path, connection)
            for line in iter_sqlite_problems(connection, _MAX_LISTED):
                yield f"SQLite says: {line}"
            require_known_tables(path, connection)
    except (sqlite3.Error, UnicodeDecodeError, InputError) as error:
        yield _describe_error(path, error)
        return
    with closing(open_connection(path)) as connection:
        tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        for table in (name for name in TABLES if name in tables):
            yield from _iter_table_problems(path, connection, table)


def _iter_table_problems(path: Path, connection: sqlite3.Connection, table: str) -> Iterator[str]:
    definition = TABLES[table]
    count = 0
    try:
        for stored in connection.execute(f"SELECT {', '.join(definition.stored_columns)} FROM {table}"):
            if not is_checksum_valid(table, stored):
                count += 1
                if count <= _MAX_LISTED:
                    yield f"its table {table} has a wrong checksum for {describe_row_key(table, stored)}"
        if count > _MAX_LISTED:
            yield f"its table {table} has {count - _MAX_LISTED} more such rows"
        require_checksum_totals(connection, table)
    except (sqlite3.Error, UnicodeDecodeError, DamageError) as error:
        yield _describe_error(path, error)


def _raise_if_unreachable(path: Path, error: BaseException | None) -> None:
    """Raise the error again if it means that the file is locked or cannot be opened: the content may be intact."""
    if error is not None and is_unreachable_error(error):
        with reraise_sqlite_errors(path):
            raise error


def _describe_error(path: Path, error: Exception) -> str:
    _raise_if_unreachable(path, error)
    if isinstance(error, UnicodeDecodeError):
        return "SQLite says: damaged text"
    if isinstance(error, sqlite3.Error):
        return f"SQLite says: {error}"
    text = str(error).removeprefix(f"{path}: ")
    with suppress(ValueError):
        text = text.removeprefix("is damaged: ").split("; `verify`")[0]
    return text
