"""The SQLite file of a study: create it, open it, and write to it exclusively."""

from __future__ import annotations

import math
import sqlite3
import time
import weakref
from collections.abc import Generator, Iterable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError, StudyLostError
from cornercase._common.files import written_whole
from cornercase._common.platform import alone_in
from cornercase.study.connecting import (
    connected,
    damage_of,
    file_at,
    is_out_of_reach,
    remove_log,
    require_file,
    require_intact,
    require_one_name,
    require_plain,
    require_still,
    require_study,
    sentences,
)
from cornercase.study.lease import Lease
from cornercase.study.own_file import OwnFile
from cornercase.study.schema import ALWAYS, APPLICATION, SCHEMA_VERSION, STATEMENTS
from cornercase.study.seals import put, read_rows, require_tally

# Minimum time in s between transactions that wait until they are on disk.
_SECONDS_BETWEEN_FORCED: Final = 1.0

# Time in s that a note waits for other transactions, which take milliseconds.
_PATIENCE_BESIDE: Final = 5.0


class Database:
    """An open study file; `lease` is held while it is open for writing, and None for a reader."""

    def __init__(self, path: Path, connection: sqlite3.Connection, lease: Lease | None) -> None:
        self.path = path
        self.connection = connection
        self._lease = lease
        self._closed = self._writing = False
        # Message once the file was moved or overwritten.
        self._lost = ""
        # SQLite does not look again at a file that was opened as immutable.
        self._sees_others = not is_out_of_reach(path)
        self._forced = -math.inf
        self._tallied: dict[str, tuple[int, int]] = {}
        self._own = None if lease is None else OwnFile(path, connection, lease)
        if lease is not None:
            # A database that is never closed must not keep others from writing.
            weakref.finalize(self, lease.give_back)

    @classmethod
    def create(cls, path: Path, meta: Iterable[tuple[str, str]], *more: str) -> Database:
        """Create a study file with the rows of its table `meta` and further tables, and open it for writing.

        Raises `InputError` if the file exists already or cannot be written.
        """
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror}).") from error
        # If two processes start at once, only one creates the file.
        with alone_in(path.parent):
            if path.exists():
                raise InputError(f"{path}: exists already; choose another name or remove it.")
            remove_log(path)
            # The file gets its name only when it is complete.
            with written_whole(path) as temporary, sentences(path), closing(sqlite3.connect(temporary)) as connection:
                make_tables(connection, *more)
                put(connection, "meta", meta)
                connection.commit()
        return cls._opened(path, writes=True)

    @classmethod
    def open(cls, path: Path, readonly: bool) -> Database:
        """Open a file; raises `InputError` if it is not a study of this version, or another process writes to it."""
        require_file(path)
        # Open it for reading first: a file that is not a study must not be written.
        reader = cls._opened(path, writes=False)
        if readonly:
            return reader
        reader.close()
        return cls._opened(path, writes=True)

    @classmethod
    def _opened(cls, path: Path, writes: bool) -> Database:
        """Open for reading, or for writing with a lease."""
        lease = None
        identity = file_at(path)
        with sentences(path):
            connection = connected(path)
            try:
                # Do not trust the file: its views and triggers may not call functions, ...
                connection.execute("PRAGMA trusted_schema = OFF")
                connection.execute("PRAGMA cell_size_check = ON")
                require_study(path, connection)
                # ... and it may not have any.
                require_plain(path, connection)
                if writes:
                    require_one_name(path)
                    # Damage in unread pages could misdirect writes.
                    require_intact(path, connection)
                    connection.execute("PRAGMA journal_mode = WAL")
                    lease = Lease.take(path, connection)
                    require_still(path, identity)
                else:
                    connection.execute("PRAGMA query_only = ON")
                return cls(path, connection, lease)
            except BaseException:
                if lease is not None:
                    lease.give_back(connection)
                connection.close()
                raise

    @property
    def readonly(self) -> bool:
        """Whether the file is open for reading only."""
        return self._lease is None

    def close(self) -> None:
        """Close the file; raises `StudyLostError` if it was open for writing and was removed or replaced since."""
        self._require_own(thorough=True)
        if not self._closed and self._lease is not None:
            self._lease.give_back(self.connection)
        self._closed = True
        self.connection.close()

    def found(self, question: str, *values: Any) -> list[Any]:
        """Return all rows of an SQL query."""
        self._require_open()
        with sentences(self.path):
            return self.connection.execute(question, values).fetchall()

    def rows(self, table: str, where: str = "1", *values: Any, blob: bool = False) -> list[Any]:
        """Return rows without checksums in the order of their keys, after checking each against its checksum.

        Without a condition all rows are read, and none may be missing. `blob` reads the blob column too.
        """
        if where == "1":
            self.require_all(table)
        with closing(self.each_row(table, where, *values, blob=blob)) as rows:
            return list(rows)

    def each_row(self, table: str, where: str = "1", *values: Any, blob: bool = False) -> Generator[Any, None, None]:
        """Yield rows like `rows`, one at a time to save memory; close the generator before the file."""
        self._require_open()
        with sentences(self.path), damage_of(self.path):
            yield from read_rows(self.connection, table, where, *values, blob=blob)

    def require_all(self, table: str) -> None:
        """Raise `DamageError` if the table has other rows than were written."""
        version = self.written()
        if self._tallied.get(table) != version:
            with self.snapshot(), sentences(self.path), damage_of(self.path):
                require_tally(self.connection, table)
            self._tallied[table] = version

    def changes(self) -> int | None:
        """Count writes of other connections; see `Study.data_version`."""
        return int(self.found("PRAGMA data_version")[0][0]) if self._sees_others else None

    def each(self, question: str) -> Generator[Any, None, None]:
        """Yield the rows of an SQL query one at a time to save memory; close the generator before the file."""
        self._require_open()
        with sentences(self.path):
            yield from self.connection.execute(question)

    def written(self) -> tuple[int, int]:
        """Count writes of other connections and of this one; unchanged as long as all queries give the same result."""
        return int(self.found("PRAGMA data_version")[0][0]), self.connection.total_changes

    @contextmanager
    def snapshot(self) -> Iterator[None]:
        """Make all queries within the block see the file at one moment."""
        self._require_open()
        if self.connection.in_transaction:
            yield
            return
        try:
            with sentences(self.path):
                self.connection.execute("BEGIN")
            yield
        finally:
            if self.connection.in_transaction:
                self.connection.execute("ROLLBACK")

    @contextmanager
    def writing(self) -> Iterator[sqlite3.Connection]:
        """Open a transaction: what is written in the block is stored completely or not at all.

        A killed process loses nothing that was committed. Waiting until it is on disk, so that a power cut cannot lose
        it, happens once a second at most, since many scenarios may end within that time.
        """
        self._require_open()
        if self._writing:
            # A nested call joins the open transaction.
            yield self.connection
            return
        syncs = time.monotonic() - self._forced >= _SECONDS_BETWEEN_FORCED
        # A moved file is reported after the transaction, so that it holds everything.
        self._require_own(thorough=syncs, name=False)
        with sentences(self.path), damage_of(self.path):
            if self.connection.in_transaction:
                # An interrupt after BEGIN left an empty transaction open.
                self.connection.rollback()
            self.connection.execute(f"PRAGMA synchronous = {'FULL' if syncs else 'NORMAL'}")
            self.connection.execute("BEGIN IMMEDIATE")
            with self.connection, self._noted():
                if self._lease is not None:
                    self._lease.require(self.connection)
                yield self.connection
        self.require_there()
        if syncs:
            self._forced = time.monotonic()

    @contextmanager
    def _noted(self) -> Iterator[None]:
        self._writing = True
        try:
            yield
        finally:
            self._writing = False

    def require_there(self) -> None:
        """Raise `StudyLostError` if the file that is open for writing was moved, removed or overwritten."""
        self._require_own(thorough=False)

    def _require_own(self, thorough: bool, name: bool = True) -> None:
        if self._closed or self._own is None:
            return
        try:
            self._own.require_content(thorough)
            if name:
                self._own.require_name()
        except StudyLostError as error:
            self._closed, self._lost = True, str(error)
            raise

    def _require_open(self) -> None:
        # Later calls get the same error.
        if self._lost:
            raise StudyLostError(self._lost)
        if self._closed:
            raise InputError(f"{self.path}: is closed; open it again with `Study.open`.")


def make_tables(connection: sqlite3.Connection, *more: str) -> None:
    """Create the tables of an empty study, with those named in `extra` that only some studies have."""
    for name in (*ALWAYS, *more):
        connection.execute(STATEMENTS[name])
    connection.execute(f"PRAGMA application_id = {APPLICATION}")
    connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")


@contextmanager
def written_beside(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a short transaction beside those of an exploration, whose lease is not needed for it.

    SQLite lets one of them write at a time, and each waits for the other.
    """
    reader = Database.open(path, readonly=True)
    can_write = reader.changes() is not None
    reader.close()
    if not can_write:
        # Opening it for writing raises the error that says why it cannot be written.
        Database.open(path, readonly=False).close()
    identity = file_at(path)
    with sentences(path), damage_of(path), closing(connected(path, _PATIENCE_BESIDE)) as connection:
        connection.execute("PRAGMA trusted_schema = OFF")
        require_plain(path, connection)
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("BEGIN IMMEDIATE")
        with connection:
            require_still(path, identity)
            yield connection
