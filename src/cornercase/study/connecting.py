"""Connections with the files of studies, and what of a file is refused before it is read."""

from __future__ import annotations

import os
import sqlite3
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError
from cornercase._common.pending_files import OF_SQLITE
from cornercase.study.damage import DamageError
from cornercase.study.schema import ALWAYS, APPLICATION, SCHEMA_VERSION, STATEMENTS

# What SQLite says where a file cannot be opened, or others keep it to themselves.
_UNREACHABLE: Final = {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_PROTOCOL, sqlite3.SQLITE_CANTOPEN}


@contextmanager
def sentences(path: Path) -> Iterator[None]:
    """Say an error of the database in a sentence.

    Parameters
    ----------
    path : Path
        Of the study.

    Yields
    ------
    None

    Raises
    ------
    InputError
        It happened within the block.
    """
    try:
        yield
    except UnicodeDecodeError as error:
        # SQLite quotes what is damaged in its message.
        raise InputError(f"{path}: cannot be used as a study (damaged text). `verify` says what is damaged.") from error
    except sqlite3.Error as error:
        if is_unreachable(error):
            raise InputError(_unreachable(path, error)) from error
        if "readonly" in str(error):
            raise InputError(
                f"{path}: cannot be written: it was opened for reading, or its file or folder may only be read; name a"
                " copy where you may write."
            ) from error
        # What SQLite says of pages that it cannot read.
        advice = " `verify` says what is damaged." if "malformed" in str(error) else ""
        raise InputError(f"{path}: cannot be used as a study ({error}).{advice}") from error


def is_unreachable(error: BaseException) -> bool:
    """Tell whether SQLite could not get at a file, which says nothing of what the file holds.

    Parameters
    ----------
    error : BaseException

    Returns
    -------
    bool
    """
    # What Python's module itself refuses has no code. The lower byte is the kind, the others say more of it.
    return isinstance(error, sqlite3.Error) and vars(error).get("sqlite_errorcode", 0) & 0xFF in _UNREACHABLE


def _unreachable(path: Path, error: sqlite3.Error) -> str:
    if error.sqlite_errorcode & 0xFF == sqlite3.SQLITE_CANTOPEN:
        return (
            f"{path}: cannot be opened, or SQLite cannot make its files beside it (-wal and -shm); copy it, with those"
            " beside it, where you may write."
        )
    return (
        f"{path}: cannot be used as a study ({error}): another program keeps it to itself, as `verify --repair` does,"
        " or its file system knows no locks; wait until that program has ended, or copy the study elsewhere."
    )


@contextmanager
def damage_of(path: Path) -> Iterator[None]:
    """Say what is damaged with the name of the study.

    Parameters
    ----------
    path : Path
        Of the study.

    Yields
    ------
    None

    Raises
    ------
    DamageError
        Something was found damaged within the block.
    """
    try:
        yield
    except DamageError as error:
        raise DamageError.of(path, str(error)) if str(path) not in str(error) else error from error


def require_file(path: Path) -> None:
    """Refuse what is no file, or has nothing in it.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError
        There is no file of this name, or it is empty.
    """
    try:
        found = path.stat()
    except OSError as error:
        if not isinstance(error, FileNotFoundError | NotADirectoryError):
            raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
        raise InputError(f"{path}: there is no such study; make one with `explore`.") from error
    except ValueError as error:
        raise InputError(f"{path}: is not a valid file name ({error}).") from error
    if not stat.S_ISREG(found.st_mode):
        raise InputError(f"{path}: is not a file; name the file of a study.")
    if not found.st_size:
        raise InputError(
            f"{path}: is empty, and not a study; copy the study here again, or remove the file and make one with"
            " `explore`."
        )


def schema_version(connection: sqlite3.Connection) -> int:
    """Read the schema version of a study."""
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    return int(version)


def require_study(path: Path, connection: sqlite3.Connection) -> None:
    """Refuse what is no study of a version that is known.

    Parameters
    ----------
    path : Path
    connection : sqlite3.Connection

    Raises
    ------
    InputError
        It is of another program, or of a later schema version.
    """
    (application,) = connection.execute("PRAGMA application_id").fetchone()
    if application != APPLICATION:
        raise InputError(f"{path}: is a database, but not a cornercase study.")
    version = schema_version(connection)
    if version != SCHEMA_VERSION:
        raise InputError(
            f"{path}: has schema version {version}, but this cornercase reads version {SCHEMA_VERSION} only; use the"
            " version that wrote it, or run `explore` again, into another study."
        )


def require_plain(path: Path, connection: sqlite3.Connection) -> None:
    """Refuse what would do something when it is read or written: views, triggers, virtual tables and columns.

    Parameters
    ----------
    path : Path
    connection : sqlite3.Connection

    Raises
    ------
    InputError
        Something in the file is not as cornercase makes it.
    """
    found = connection.execute("SELECT type, name, sql FROM sqlite_master").fetchall()
    for kind, name, statement in found:
        # SQLite's own index of a key has no statement.
        plain = kind == "index" and statement is None
        if kind == "table":
            plain = statement == STATEMENTS.get(name)
        if not plain:
            what = f"the {kind} '{name}'"
            if kind == "table" and name in STATEMENTS:
                what += " with other columns: use the version that wrote it, or run `explore` again, into another study"
            raise InputError(f"{path}: is not a study that cornercase wrote; it holds {what}.")
    if missing := set(ALWAYS) - {name for _, name, _ in found}:
        raise DamageError.of(path, f"its table {min(missing)} is missing")


def require_intact(path: Path, connection: sqlite3.Connection) -> None:
    """Refuse a file in whose pages SQLite finds something wrong, also in those that are not read.

    Parameters
    ----------
    path : Path
    connection : sqlite3.Connection

    Raises
    ------
    DamageError
        It does.
    """
    for line in told_by_sqlite(connection, 1):
        raise DamageError.of(path, f"SQLite says: {line}")


def told_by_sqlite(connection: sqlite3.Connection, most: int) -> Iterator[str]:
    """Tell what SQLite finds wrong in a file.

    Parameters
    ----------
    connection : sqlite3.Connection
    most : int
        Lines that are told.

    Yields
    ------
    str
    """
    plain = connection.text_factory
    # It names what it finds, which may be no text any more.
    connection.text_factory = _any_text
    try:
        for (line,) in connection.execute(f"PRAGMA integrity_check({most})"):
            if line != "ok":
                yield line
    finally:
        connection.text_factory = plain


def _any_text(raw: bytes) -> str:
    return raw.decode(errors="replace")


def connected(path: Path, patience: float = 30.0) -> sqlite3.Connection:
    """Open a file that is there.

    Parameters
    ----------
    path : Path
    patience : float, default 30.0
        s to wait for what others write.

    Returns
    -------
    sqlite3.Connection
    """
    # A reader of a file in WAL mode has to make its shared memory beside it. Where it cannot, nobody writes either.
    location = f"{path.resolve().as_uri()}?{'immutable=1' if is_out_of_reach(path) else 'mode=rw'}"
    return sqlite3.connect(location, uri=True, timeout=patience)


def file_at(path: Path) -> tuple[int, int] | None:
    """Tell which file a name leads to.

    Parameters
    ----------
    path : Path

    Returns
    -------
    tuple of (int, int) or None
        None where there is none.
    """
    with suppress(OSError):
        found = path.stat()
        return found.st_dev, found.st_ino
    return None


def require_still(path: Path, file: tuple[int, int] | None) -> None:
    """Refuse to write where a name leads to another file by now: who waits for a lock may get that of the earlier file.

    Parameters
    ----------
    path : Path
    file : tuple of (int, int) or None
        What `file_at` said before the file was opened.

    Raises
    ------
    InputError
        It does.
    """
    if file_at(path) != file:
        raise InputError(f"{path}: another file has taken its place just now; run the same command again.")


def is_out_of_reach(path: Path) -> bool:
    """Tell whether a file is only for reading here, and nobody writes to it.

    Parameters
    ----------
    path : Path

    Returns
    -------
    bool
    """
    # SQLite would leave its log of a file that may only be read beside it, and keep its owner from writing.
    writable = os.access(path, os.W_OK) and os.access(path.parent, os.W_OK)
    return not writable and not path.with_name(path.name + "-wal").exists()


def require_one_name(path: Path) -> None:
    """Refuse to write to a file that has several names: SQLite keeps a log beside each, and sees that of one alone.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError
        It has.
    """
    if (names := path.stat().st_nlink) > 1:
        raise InputError(
            f"{path}: has {names} names (hard links), by which two could write to it at once; remove the others, or"
            " write to a copy."
        )


def remove_log(path: Path) -> None:
    """Remove what a killed explorer wrote beside a file that is gone.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError
        It cannot be removed.
    """
    # SQLite would take it into the new one.
    try:
        for ending in OF_SQLITE:
            path.with_name(path.name + ending).unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}).") from error
