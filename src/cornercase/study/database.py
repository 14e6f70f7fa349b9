"""The SQLite file of a study: making it, opening it, and locking it for one that writes."""

from __future__ import annotations

import math
import os
import sqlite3
import time
from collections.abc import Generator, Iterable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Final

from filelock import BaseFileLock

from cornercase._common.errors import InputError
from cornercase._common.files import written_whole
from cornercase._common.locks import taken_lock
from cornercase.study.damage import damage_told
from cornercase.study.migrations import SCHEMA, SCHEMA_VERSION, TABLES, migrate, schema_version

_APPLICATION: Final = 0x434F524E  # "CORN"

# s between transactions of which it is waited for that they are on the disk.
_SECONDS_BETWEEN_FORCED: Final = 1.0

# s that a note waits for the transactions of an explorer, which take milliseconds.
_PATIENCE_BESIDE: Final = 5.0


class Database:
    """A study's file that is open.

    Parameters
    ----------
    path : Path
        Name of the file, for messages.
    connection : sqlite3.Connection
    lock : BaseFileLock or None
        Held while the file is open for writing; None for a reader.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection, lock: BaseFileLock | None) -> None:
        self.path = path
        self.connection = connection
        self._lock = lock
        self._closed = False
        (_, _, file), *_ = connection.execute("PRAGMA database_list").fetchall()
        # A migrated copy has no name; what is immutable is not looked at again.
        self._sees_others = bool(file) and not _is_out_of_reach(path)
        self._forced = -math.inf

    @classmethod
    def create(cls, path: Path, meta: Iterable[tuple[str, str]], *more: str) -> Database:
        """Make a file, and open it for writing.

        Parameters
        ----------
        path : Path
        meta : iterable of (str, str)
            Keys and values of the table ``meta``.
        *more : str
            Statements that make further tables.

        Returns
        -------
        Database

        Raises
        ------
        InputError
            The file exists already, or cannot be written.
        """
        lock = _locked(path)
        try:
            # Looked for under the lock: of two explorers that begin at once, one makes the file.
            if path.exists():
                raise InputError(f"{path}: exists already; choose another name or remove it.")
            _remove_log(path)
            # The file appears under its name only when it is whole.
            with written_whole(path) as temporary, _sentences(path), closing(sqlite3.connect(temporary)) as connection:
                connection.executescript(SCHEMA)
                for statement in more:
                    connection.execute(statement)
                connection.execute(f"PRAGMA application_id = {_APPLICATION}")
                connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
                connection.executemany("INSERT INTO meta VALUES (?, ?)", meta)
                connection.commit()
            return cls._opened(path, lock)
        except BaseException:
            lock.release()
            raise

    @classmethod
    def open(cls, path: Path, readonly: bool) -> Database:
        """Open a file.

        One of an earlier schema version is migrated; a reader migrates a copy of its own and leaves the file as it is.

        Parameters
        ----------
        path : Path
        readonly : bool

        Returns
        -------
        Database

        Raises
        ------
        InputError
            There is none, it is none, another program writes to it, or it is of a later schema version.
        """
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is not a file; name the file of a study.")
        if not path.is_file():
            raise InputError(f"{path}: there is no such study; make one with `explore`.")
        # What is no study gets no lock beside it.
        reader = cls._opened(path, None)
        if readonly:
            return reader
        reader.close()
        lock = _locked(path)
        try:
            return cls._opened(path, lock)
        except BaseException:
            lock.release()
            raise

    @classmethod
    def _opened(cls, path: Path, lock: BaseFileLock | None) -> Database:
        """Open for writing under a lock, for reading without."""
        with _sentences(path):
            connection = _connected(path)
            try:
                # What a file says of itself is not trusted: its views and triggers may not call functions, ...
                connection.execute("PRAGMA trusted_schema = OFF")
                connection.execute("PRAGMA cell_size_check = ON")
                _require_study(path, connection)
                # ... and it may have none.
                _require_plain(path, connection)
                if lock is not None:
                    connection.execute("PRAGMA journal_mode = WAL")
                    with damage_told(path):
                        migrate(connection)
                else:
                    with damage_told(path):
                        connection = _of_today(connection)
                    connection.execute("PRAGMA query_only = ON")
                return cls(path, connection, lock)
            except BaseException:
                connection.close()
                raise

    @property
    def readonly(self) -> bool:
        """Whether the file is open for reading only."""
        return self._lock is None

    def close(self) -> None:
        """Close the file."""
        self._closed = True
        self.connection.close()
        if self._lock is not None:
            self._lock.release()

    def found(self, question: str, *values: Any) -> list[Any]:
        """Return the rows that a query finds.

        Parameters
        ----------
        question : str
            SQL.
        *values
            For its question marks.

        Returns
        -------
        list of tuple

        Raises
        ------
        InputError
            The file is closed, or cannot be read.
        """
        self._require_open()
        with _sentences(self.path):
            return self.connection.execute(question, values).fetchall()

    def changes(self) -> int | None:
        """Count what others wrote; as `StudyContents.changes`.

        Returns
        -------
        int or None
        """
        return int(self.found("PRAGMA data_version")[0][0]) if self._sees_others else None

    def each(self, question: str) -> Generator[Any, None, None]:
        """Give the rows that a query finds one after the other, where all at once would take much memory.

        To be closed before the file is.

        Parameters
        ----------
        question : str
            SQL.

        Yields
        ------
        tuple

        Raises
        ------
        InputError
            The file is closed, or cannot be read.
        """
        self._require_open()
        with _sentences(self.path):
            yield from self.connection.execute(question)

    def written(self) -> tuple[int, int]:
        """Count what others wrote, and what was written here: the same again where all queries find the same.

        Returns
        -------
        tuple of (int, int)
        """
        return int(self.found("PRAGMA data_version")[0][0]), self.connection.total_changes

    @contextmanager
    def snapshot(self) -> Iterator[None]:
        """Let all queries within the block see the file as it is at one moment.

        Yields
        ------
        None

        Raises
        ------
        InputError
            The file is closed, or cannot be read.
        """
        self._require_open()
        if self.connection.in_transaction:
            yield
            return
        with _sentences(self.path):
            self.connection.execute("BEGIN")
        try:
            yield
        finally:
            if self.connection.in_transaction:
                self.connection.execute("ROLLBACK")

    @contextmanager
    def writing(self) -> Iterator[sqlite3.Connection]:
        """Give the connection for a transaction: what is written in it is stored wholly or not at all.

        A killed process loses none of it. That it is on the disk, where a power cut cannot reach it, is waited for
        once a second at most: many scenarios end within that time.

        Yields
        ------
        sqlite3.Connection

        Raises
        ------
        InputError
            The file is closed, or cannot be written.
        """
        self._require_open()
        forces = time.monotonic() - self._forced >= _SECONDS_BETWEEN_FORCED
        with _sentences(self.path):
            if not self.connection.in_transaction:
                self.connection.execute(f"PRAGMA synchronous = {'FULL' if forces else 'NORMAL'}")
            with self.connection:
                yield self.connection
        if forces:
            self._forced = time.monotonic()

    def _require_open(self) -> None:
        if self._closed:
            raise InputError(f"{self.path}: is closed; open it again with `Study.open`.")


def _remove_log(path: Path) -> None:
    """Remove what a killed explorer wrote beside a file that is gone."""
    # SQLite would take it into the new one.
    try:
        for ending in ("-wal", "-shm"):
            path.with_name(path.name + ending).unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}).") from error


@contextmanager
def _sentences(path: Path) -> Iterator[None]:
    """Say an error of the database in a sentence."""
    try:
        yield
    except sqlite3.Error as error:
        raise InputError(f"{path}: cannot be used as a study ({error}).") from error


@contextmanager
def written_beside(path: Path) -> Iterator[sqlite3.Connection]:
    """Give a connection for one short transaction beside those of an explorer, whose lock is not needed for it.

    SQLite lets one of them write at a time, and each waits for the other. Only to migrate a file of an earlier schema
    version the lock is taken.

    Parameters
    ----------
    path : Path

    Yields
    ------
    sqlite3.Connection

    Raises
    ------
    InputError
        There is no study, or it cannot be written.
    """
    reader = Database.open(path, readonly=True)
    reads_itself = reader.changes() is not None
    reader.close()
    if not reads_itself:
        # Of an earlier version, or one that cannot be written, which is said.
        Database.open(path, readonly=False).close()
    with _sentences(path), closing(_connected(path, _PATIENCE_BESIDE)) as connection:
        connection.execute("PRAGMA trusted_schema = OFF")
        _require_plain(path, connection)
        connection.execute("PRAGMA synchronous = FULL")
        with connection:
            yield connection


def _require_study(path: Path, connection: sqlite3.Connection) -> None:
    (application,) = connection.execute("PRAGMA application_id").fetchone()
    if application != _APPLICATION:
        raise InputError(f"{path}: is a database, but no cornercase study.")
    version = schema_version(connection)
    if not 1 <= version <= SCHEMA_VERSION:
        raise InputError(
            f"{path}: has schema version {version}, this cornercase reads up to {SCHEMA_VERSION}; use the version that"
            " wrote it."
        )


def _require_plain(path: Path, connection: sqlite3.Connection) -> None:
    """Refuse what would do something when it is read or written: views, triggers, virtual tables and columns."""
    for kind, name, statement in connection.execute("SELECT type, name, sql FROM sqlite_master").fetchall():
        # SQLite's own index of a key has no statement.
        plain = kind == "index" and statement is None
        if kind == "table" and name in TABLES:
            # Virtual tables have no columns of their own, computed columns are hidden ones.
            columns = connection.execute(f"PRAGMA table_xinfo({name})").fetchall()
            plain = not str(statement).upper().startswith("CREATE VIRTUAL") and not any(one[6] for one in columns)
        if not plain:
            raise InputError(f"{path}: is no study as cornercase writes it; it holds the {kind} '{name}'.")


def _of_today(connection: sqlite3.Connection) -> sqlite3.Connection:
    """Give the connection, or one to a migrated copy in its place."""
    if schema_version(connection) == SCHEMA_VERSION:
        return connection
    with closing(connection):
        # A database without a name is a temporary file that SQLite removes.
        copy = sqlite3.connect("")
        connection.backup(copy)
    migrate(copy)
    return copy


def _connected(path: Path, patience: float = 30.0) -> sqlite3.Connection:
    # A reader of a file in WAL mode has to make its shared memory beside it. Where it cannot, nobody writes either.
    location = f"{path.resolve().as_uri()}?{'immutable=1' if _is_out_of_reach(path) else 'mode=rw'}"
    return sqlite3.connect(location, uri=True, timeout=patience)


def _is_out_of_reach(path: Path) -> bool:
    return not os.access(path.parent, os.W_OK) and not path.with_name(path.name + "-wal").exists()


def _locked(path: Path) -> BaseFileLock:
    beside = path.with_name(path.name + ".lock")
    # Whoever sent the study may have put a link there, and to take a lock empties its file.
    if beside.is_symlink() or (beside.exists() and not beside.is_file()):
        raise InputError(f"{beside}: is a link or no file, which is not used as the study's lock; remove it.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = taken_lock(beside)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}).") from error
    if lock is None:
        raise InputError(f"{path}: another cornercase is writing to it; wait until it has ended.")
    return lock
