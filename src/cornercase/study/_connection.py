"""Open SQLite connections to study files; reject unusable files before anything is read."""

from __future__ import annotations

import os
import sqlite3
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError
from cornercase._common.io.atomic import SQLITE_SUFFIXES
from cornercase.study._damage import DamageError
from cornercase.study._schema import APPLICATION_ID, CREATE_STATEMENTS, REQUIRED_TABLES, SCHEMA_VERSION

# Error codes for a file that cannot be opened or is locked.
_UNREACHABLE_CODES: Final = {
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_LOCKED,
    sqlite3.SQLITE_PROTOCOL,
    sqlite3.SQLITE_CANTOPEN,
}


@contextmanager
def reraise_sqlite_errors(path: Path) -> Iterator[None]:
    """Turn each SQLite error in the block into an `InputError` whose message names the study."""
    try:
        yield
    except UnicodeDecodeError as error:
        # SQLite quotes damaged text in its message.
        raise InputError(f"{path}: cannot be used as a study (damaged text). `verify` says what is damaged.") from error
    except sqlite3.Error as error:
        if is_unreachable_error(error):
            raise InputError(_describe_unreachable(path, error)) from error
        if "readonly" in str(error):
            raise InputError(
                f"{path}: cannot be written: it was opened for reading only, or its file or folder is read-only; use a"
                " copy in a folder where you can write."
            ) from error
        # SQLite's message for unreadable pages.
        advice = " `verify` says what is damaged." if "malformed" in str(error) else ""
        raise InputError(f"{path}: cannot be used as a study ({error}).{advice}") from error


def is_unreachable_error(error: BaseException) -> bool:
    """Return whether SQLite could not open or lock the file; if so, the content of the file may still be intact."""
    # Errors of Python's own module have no code. The lower byte is the primary code.
    return isinstance(error, sqlite3.Error) and vars(error).get("sqlite_errorcode", 0) & 0xFF in _UNREACHABLE_CODES


def _describe_unreachable(path: Path, error: sqlite3.Error) -> str:
    if error.sqlite_errorcode & 0xFF == sqlite3.SQLITE_CANTOPEN:
        return (
            f"{path}: cannot be opened, or SQLite cannot create its -wal and -shm files beside it; copy the study, with"
            " these files, to a folder where you can write."
        )
    return (
        f"{path}: cannot be used as a study ({error}): another program has locked it (such as `verify --repair`),"
        " or its file system does not support locks; wait until that program has ended, or copy the study to another"
        " folder."
    )


@contextmanager
def name_study_in_damage_errors(path: Path) -> Iterator[None]:
    """Put the name of the study into the message of a `DamageError` raised in the block."""
    try:
        yield
    except DamageError as error:
        raise DamageError.from_problem(path, str(error)) if str(path) not in str(error) else error from error


def require_nonempty_file(path: Path) -> None:
    """Raise `InputError` unless the path leads to a regular file that is not empty."""
    try:
        status = path.stat()
    except OSError as error:
        if not isinstance(error, FileNotFoundError | NotADirectoryError):
            raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
        raise InputError(f"{path}: there is no such study; make one with `Study.create`.") from error
    except ValueError as error:
        raise InputError(f"{path}: is not a valid file name ({error}).") from error
    if not stat.S_ISREG(status.st_mode):
        raise InputError(f"{path}: is not a file; name the file of a study.")
    if not status.st_size:
        raise InputError(
            f"{path}: is empty, and not a study; copy the study here again, or remove the file and make one with"
            " `Study.create`."
        )


def read_schema_version(connection: sqlite3.Connection) -> int:
    """Read the schema version of a study."""
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    return int(version)


def require_current_schema(path: Path, connection: sqlite3.Connection) -> None:
    """Raise `InputError` unless the file is a study of the current schema version."""
    (application,) = connection.execute("PRAGMA application_id").fetchone()
    if application != APPLICATION_ID:
        raise InputError(f"{path}: is a database, but not a cornercase study.")
    version = read_schema_version(connection)
    if version != SCHEMA_VERSION:
        raise InputError(
            f"{path}: has schema version {version}, but this cornercase reads version {SCHEMA_VERSION} only; use the"
            " version that wrote it, or run `explore` again, into another study."
        )


def require_known_tables(path: Path, connection: sqlite3.Connection) -> None:
    """Raise `InputError` unless the file holds exactly the tables that cornercase creates.

    Views, triggers, virtual tables and computed columns could run code when they are read or written.
    """
    entries = connection.execute("SELECT type, name, sql FROM sqlite_master").fetchall()
    for kind, name, statement in entries:
        # The automatic index of a key has no statement.
        is_known = kind == "index" and statement is None
        if kind == "table":
            is_known = statement == CREATE_STATEMENTS.get(name)
        if not is_known:
            table = f"the {kind} '{name}'"
            if kind == "table" and name in CREATE_STATEMENTS:
                table += (
                    " with other columns: use the version that wrote it, or run `explore` again, into another study"
                )
            raise InputError(f"{path}: is not a study that cornercase wrote; it holds {table}.")
    if missing := set(REQUIRED_TABLES) - {name for _, name, _ in entries}:
        raise DamageError.from_problem(path, f"its table {min(missing)} is missing")


def require_sqlite_integrity(path: Path, connection: sqlite3.Connection) -> None:
    """Raise `DamageError` if SQLite's integrity check, which reads all pages, finds a problem."""
    for line in iter_sqlite_problems(connection, 1):
        raise DamageError.from_problem(path, f"SQLite says: {line}")


def iter_sqlite_problems(connection: sqlite3.Connection, limit: int) -> Iterator[str]:
    """Yield the first `limit` problems that SQLite's integrity check finds."""
    text_factory = connection.text_factory
    # SQLite quotes damaged content, which may not be valid text.
    connection.text_factory = _decode_leniently
    try:
        for (line,) in connection.execute(f"PRAGMA integrity_check({limit})"):
            if line != "ok":
                yield line
    finally:
        connection.text_factory = text_factory


def _decode_leniently(raw: bytes) -> str:
    return raw.decode(errors="replace")


def open_connection(path: Path, timeout: float = 30.0) -> sqlite3.Connection:
    """Open a connection to an existing study file; SQL statements wait up to `timeout` s for other writers."""
    # In WAL mode a reader creates shared memory beside the file. If it cannot, nobody can write either.
    location = f"{path.resolve().as_uri()}?{'immutable=1' if is_read_only_file(path) else 'mode=rw'}"
    return sqlite3.connect(location, uri=True, timeout=timeout)


def file_identity(path: Path) -> tuple[int, int] | None:
    """Return the device and inode of the file at a path; None if there is no file."""
    with suppress(OSError):
        status = path.stat()
        return status.st_dev, status.st_ino
    return None


def require_same_file(path: Path, identity: tuple[int, int] | None) -> None:
    """Raise `InputError` if the path no longer leads to the file with this `file_identity`.

    A process that waits for a lock may get the lock of a file that was replaced meanwhile.
    """
    if file_identity(path) != identity:
        raise InputError(f"{path}: was replaced by another file just now; run the same command again.")


def is_read_only_file(path: Path) -> bool:
    """Return whether this process cannot write the file, and no other process writes to it (no SQLite log exists)."""
    # SQLite would leave its log beside a read-only file, and keep the owner from writing.
    writable = os.access(path, os.W_OK) and os.access(path.parent, os.W_OK)
    return not writable and not path.with_name(path.name + "-wal").exists()


def require_single_hard_link(path: Path) -> None:
    """Raise `InputError` if the file has several hard links.

    SQLite keeps a separate log for each name, so two processes could write at once.
    """
    if (names := path.stat().st_nlink) > 1:
        raise InputError(
            f"{path}: has {names} hard links, through which two processes could write at once; remove the other"
            " links, or"
            " use a copy."
        )


def remove_leftover_journals(path: Path) -> None:
    """Remove the SQLite log and journal that a killed process left at a path, before a new study is created there."""
    # SQLite would apply the old log to the new file.
    try:
        for ending in SQLITE_SUFFIXES:
            path.with_name(path.name + ending).unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}).") from error
