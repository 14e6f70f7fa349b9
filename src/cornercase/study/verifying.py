"""Verify that everything in a study is as it was written."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cornercase._common import arguments
from cornercase._common.errors import InputError
from cornercase.study._study import Study
from cornercase.study.connecting import (
    connected,
    is_unreachable,
    require_file,
    require_plain,
    require_study,
    schema_version,
    sentences,
    told_by_sqlite,
)
from cornercase.study.damage import DamageError
from cornercase.study.salvaging import holds_rows
from cornercase.study.schema import APPLICATION, SCHEMA_VERSION, TABLES
from cornercase.study.seals import is_sound, name_of, require_tally

# Largest number of listed problems, from SQLite and per table.
_MOST: Final = 20


@dataclass(frozen=True)
class Verification:
    """Result of a verification.

    Attributes
    ----------
    path : Path
    problems : tuple of str
        Part of a sentence for each problem; empty if there is none.
    checked : bool, default True
        Whether the study has checksums; all have.
    """

    path: Path
    problems: tuple[str, ...]
    checked: bool = True

    @property
    def sound(self) -> bool:
        """Whether there is no problem."""
        return not self.problems


def verify(study: Path | str) -> Verification:
    """Check everything in a study: SQLite's integrity, checksums, counts, references and types.

    Parameters
    ----------
    study : path

    Returns
    -------
    Verification

    Raises
    ------
    InputError
        There is no such file, it cannot be opened, or it is not a study: it belongs to another program or has another
        schema version, or cornercase wrote nothing in it.

    Examples
    --------
    >>> from cornercase.study import verify
    >>> verify("missing.db")
    Traceback (most recent call last):
        ...
    cornercase._common.errors.InputError: missing.db: there is no such study; make one with `explore`.
    """
    path = arguments.path("study", study)
    require_file(path)
    _require_own(path)
    problems = list(dict.fromkeys(_problems(path)))
    return Verification(path, tuple(problems))


def _require_own(path: Path) -> None:
    """Raise `InputError` unless the file is a study, damaged or not."""
    try:
        with closing(connected(path)) as connection:
            connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
            (application,) = connection.execute("PRAGMA application_id").fetchone()
            version = schema_version(connection)
            if application not in (0, APPLICATION) or (application == APPLICATION and version > SCHEMA_VERSION):
                # It is unknown whether this number itself is damaged.
                require_study(path, connection)
            if application == APPLICATION:
                return
    except (sqlite3.Error, UnicodeDecodeError) as error:
        _require_reached(path, error)
    try:
        has_rows = holds_rows(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    if not has_rows:
        raise InputError(f"{path}: is not a cornercase study, or nothing is left of one.")


def _problems(path: Path) -> Iterator[str]:
    is_damaged = False
    for problem in _of_file(path):
        is_damaged = True
        yield problem
    if is_damaged:
        return
    # All checksums are valid. Reading the content shows whether it is that of a study.
    try:
        with Study.open(path) as opened:
            for _ in opened.recorded():
                pass
            opened.table()
            opened.results()
            opened.elapsed()
            opened.elsewhere()
            for name in opened.analyses():
                opened.analysis(name)
            opened.reduction(), opened.estimate()
            for row in opened.rows():
                opened.scores_of(row.id), opened.against_of(row.id)
    except InputError as error:
        _require_reached(path, error.__cause__)
        yield str(error).removeprefix(f"{path}: ")


def _of_file(path: Path) -> Iterator[str]:
    try:
        with closing(connected(path)) as connection:
            connection.execute("PRAGMA trusted_schema = OFF")
            connection.execute("PRAGMA cell_size_check = ON")
            require_study(path, connection)
            for line in told_by_sqlite(connection, _MOST):
                yield f"SQLite says: {line}"
            require_plain(path, connection)
    except (sqlite3.Error, UnicodeDecodeError, InputError) as error:
        yield _words(path, error)
        return
    with closing(connected(path)) as connection:
        tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        for table in (name for name in TABLES if name in tables):
            yield from _of_table(path, connection, table)


def _of_table(path: Path, connection: sqlite3.Connection, table: str) -> Iterator[str]:
    definition = TABLES[table]
    count = 0
    try:
        for stored in connection.execute(f"SELECT {', '.join(definition.stored)} FROM {table}"):
            if not is_sound(table, stored):
                count += 1
                if count <= _MOST:
                    yield f"its table {table} has a wrong checksum for {name_of(table, stored)}"
        if count > _MOST:
            yield f"its table {table} has {count - _MOST} more such rows"
        require_tally(connection, table)
    except (sqlite3.Error, UnicodeDecodeError, DamageError) as error:
        yield _words(path, error)


def _require_reached(path: Path, error: BaseException | None) -> None:
    """Raise an error that says nothing about the content: the file is locked or cannot be opened."""
    if error is not None and is_unreachable(error):
        with sentences(path):
            raise error


def _words(path: Path, error: Exception) -> str:
    _require_reached(path, error)
    if isinstance(error, UnicodeDecodeError):
        return "SQLite says: damaged text"
    if isinstance(error, sqlite3.Error):
        return f"SQLite says: {error}"
    text = str(error).removeprefix(f"{path}: ")
    with suppress(ValueError):
        text = text.removeprefix("is damaged: ").split("; `verify`")[0]
    return text
