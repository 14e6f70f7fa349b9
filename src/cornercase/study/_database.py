"""Create and open the SQLite file of a study, and write to it while no other process can."""

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
from cornercase._common.io.files import atomic_write
from cornercase._common.platform import lock_folder
from cornercase.study._checksums import insert_rows, read_rows, require_checksum_totals
from cornercase.study._connection import (
    file_identity,
    is_read_only_file,
    name_study_in_damage_errors,
    open_connection,
    remove_leftover_journals,
    require_current_schema,
    require_known_tables,
    require_nonempty_file,
    require_same_file,
    require_single_hard_link,
    require_sqlite_integrity,
    reraise_sqlite_errors,
)
from cornercase.study._file_guard import StudyFileGuard
from cornercase.study._lease import Lease
from cornercase.study._schema import APPLICATION_ID, CREATE_STATEMENTS, REQUIRED_TABLES, SCHEMA_VERSION

# Minimum time in s between transactions that wait until they are on disk.
_SYNC_INTERVAL: Final = 1.0

# Time in s that a note waits for other transactions, which take milliseconds.
_NOTE_TIMEOUT: Final = 5.0


class Database:
    """An open study file; `lease` is the right to write, or None for a reader."""

    def __init__(self, path: Path, connection: sqlite3.Connection, lease: Lease | None) -> None:
        self.path = path
        self.connection = connection
        self._lease = lease
        self._is_closed = self._is_writing = False
        # Message once the file was moved or overwritten.
        self._lost_reason = ""
        # SQLite does not look again at a file that was opened as immutable.
        self._sees_other_writers = not is_read_only_file(path)
        self._last_sync = -math.inf
        self._verified_versions: dict[str, tuple[int, int]] = {}
        self._file_guard = None if lease is None else StudyFileGuard(path, connection, lease)
        if lease is not None:
            # A database that is never closed must not keep others from writing.
            weakref.finalize(self, lease.release)

    @classmethod
    def create(cls, path: Path, meta: Iterable[tuple[str, str]], *extra_tables: str) -> Database:
        """Create a study file and open it for writing.

        `meta` are the rows of the table ``meta``; `extra_tables` are names of optional tables. `InputError` if the file
        exists already or cannot be written.
        """
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror}).") from error
        # If two processes start at once, only one creates the file.
        with lock_folder(path.parent):
            if path.exists():
                raise InputError(f"{path}: exists already; choose another name or remove it.")
            remove_leftover_journals(path)
            # The file gets its name only when it is complete.
            with (
                atomic_write(path) as temporary,
                reraise_sqlite_errors(path),
                closing(sqlite3.connect(temporary)) as connection,
            ):
                create_tables(connection, *extra_tables)
                insert_rows(connection, "meta", meta)
                connection.commit()
        return cls._open(path, for_writing=True)

    @classmethod
    def open(cls, path: Path, readonly: bool) -> Database:
        """Open a study file, for reading or for writing.

        Raises `InputError` if the file is not a study of this schema version. To open a study for writing also fails
        with `InputError` if another process is writing to the study.
        """
        require_nonempty_file(path)
        # Open it for reading first: a file that is not a study must not be written.
        reader = cls._open(path, for_writing=False)
        if readonly:
            return reader
        reader.close()
        return cls._open(path, for_writing=True)

    @classmethod
    def _open(cls, path: Path, for_writing: bool) -> Database:
        """Open a file for reading, or acquire the lease and open it for writing."""
        lease = None
        identity = file_identity(path)
        with reraise_sqlite_errors(path):
            connection = open_connection(path)
            try:
                # Do not trust the file: its views and triggers may not call functions, ...
                connection.execute("PRAGMA trusted_schema = OFF")
                connection.execute("PRAGMA cell_size_check = ON")
                require_current_schema(path, connection)
                # ... and it may not have any.
                require_known_tables(path, connection)
                if for_writing:
                    require_single_hard_link(path)
                    # Damage in unread pages could misdirect writes.
                    require_sqlite_integrity(path, connection)
                    connection.execute("PRAGMA journal_mode = WAL")
                    lease = Lease.acquire(path, connection)
                    require_same_file(path, identity)
                else:
                    connection.execute("PRAGMA query_only = ON")
                return cls(path, connection, lease)
            except BaseException:
                if lease is not None:
                    lease.release(connection)
                connection.close()
                raise

    @property
    def readonly(self) -> bool:
        """True if the file is open for reading only."""
        return self._lease is None

    def close(self) -> None:
        """Close the file; `StudyLostError` if it was open for writing and another program removed or replaced it."""
        self._require_own_file(force=True)
        if not self._is_closed and self._lease is not None:
            self._lease.release(self.connection)
        self._is_closed = True
        self.connection.close()

    def query(self, sql: str, *values: Any) -> list[Any]:
        """Return all rows of an SQL query."""
        self._require_open()
        with reraise_sqlite_errors(self.path):
            return self.connection.execute(sql, values).fetchall()

    def read_rows(self, table: str, condition: str = "1", *values: Any, with_blob: bool = False) -> list[Any]:
        """Return rows of a table without checksums, sorted by key; each checksum is checked.

        `condition` is SQL with `values` for its placeholders. Without a condition, all rows are read, and missing rows
        raise `DamageError`. Blob columns are only read with `with_blob`.
        """
        if condition == "1":
            self.require_all_rows(table)
        with closing(self.iter_rows(table, condition, *values, with_blob=with_blob)) as rows:
            return list(rows)

    def iter_rows(
        self, table: str, condition: str = "1", *values: Any, with_blob: bool = False
    ) -> Generator[Any, None, None]:
        """Yield the rows that `read_rows` returns, one by one to save memory; close the generator before the file."""
        self._require_open()
        with reraise_sqlite_errors(self.path), name_study_in_damage_errors(self.path):
            yield from read_rows(self.connection, table, condition, *values, with_blob=with_blob)

    def require_all_rows(self, table: str) -> None:
        """Raise `DamageError` if rows of a table are missing, or were added by another program."""
        version = self.count_writes()
        if self._verified_versions.get(table) != version:
            with self.snapshot(), reraise_sqlite_errors(self.path), name_study_in_damage_errors(self.path):
                require_checksum_totals(self.connection, table)
            self._verified_versions[table] = version

    def data_version(self) -> int | None:
        """Return a counter of writes by other connections; see `StudyFile.data_version`."""
        return int(self.query("PRAGMA data_version")[0][0]) if self._sees_other_writers else None

    def iter_query(self, sql: str) -> Generator[Any, None, None]:
        """Yield the rows of an SQL query one at a time to save memory; close the generator before the file."""
        self._require_open()
        with reraise_sqlite_errors(self.path):
            yield from self.connection.execute(sql)

    def count_writes(self) -> tuple[int, int]:
        """Return two counters: writes by other connections, and writes by this connection.

        If both are unchanged, the content is unchanged, too.
        """
        return int(self.query("PRAGMA data_version")[0][0]), self.connection.total_changes

    @contextmanager
    def snapshot(self) -> Iterator[None]:
        """Within the block, all queries see the file as it was at one moment."""
        self._require_open()
        if self.connection.in_transaction:
            yield
            return
        try:
            with reraise_sqlite_errors(self.path):
                self.connection.execute("BEGIN")
            yield
        finally:
            if self.connection.in_transaction:
                self.connection.execute("ROLLBACK")

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """Open a transaction: what the block writes is stored completely or not at all.

        After a commit, killing the process loses nothing. A power cut may lose the last second: commits are synced to
        disk at most once per second, since syncing takes longer than many scenarios.
        """
        self._require_open()
        if self._is_writing:
            # A nested call joins the open transaction.
            yield self.connection
            return
        syncs = time.monotonic() - self._last_sync >= _SYNC_INTERVAL
        # A moved file is reported after the transaction, so that it holds everything.
        self._require_own_file(force=syncs, check_name=False)
        with reraise_sqlite_errors(self.path), name_study_in_damage_errors(self.path):
            if self.connection.in_transaction:
                # An interrupt after BEGIN left an empty transaction open.
                self.connection.rollback()
            self.connection.execute(f"PRAGMA synchronous = {'FULL' if syncs else 'NORMAL'}")
            self.connection.execute("BEGIN IMMEDIATE")
            with self.connection, self._mark_writing():
                if self._lease is not None:
                    self._lease.require_held(self.connection)
                yield self.connection
        self.require_unchanged_file()
        if syncs:
            self._last_sync = time.monotonic()

    @contextmanager
    def _mark_writing(self) -> Iterator[None]:
        self._is_writing = True
        try:
            yield
        finally:
            self._is_writing = False

    def require_unchanged_file(self) -> None:
        """Raise `StudyLostError` if the file was moved, removed or overwritten since it was opened for writing."""
        self._require_own_file(force=False)

    def _require_own_file(self, force: bool, check_name: bool = True) -> None:
        if self._is_closed or self._file_guard is None:
            return
        try:
            self._file_guard.require_not_overwritten(force)
            if check_name:
                self._file_guard.require_not_moved()
        except StudyLostError as error:
            self._is_closed, self._lost_reason = True, str(error)
            raise

    def _require_open(self) -> None:
        # Later calls get the same error.
        if self._lost_reason:
            raise StudyLostError(self._lost_reason)
        if self._is_closed:
            raise InputError(f"{self.path}: is closed; open it again with `StudyFile.open`.")


def create_tables(connection: sqlite3.Connection, *extra_tables: str) -> None:
    """Create the tables of an empty study, and the optional tables in `extra_tables`."""
    for name in (*REQUIRED_TABLES, *extra_tables):
        connection.execute(CREATE_STATEMENTS[name])
    connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
    connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")


@contextmanager
def open_note_transaction(path: Path, timeout: float = _NOTE_TIMEOUT) -> Iterator[sqlite3.Connection]:
    """Open a short transaction that needs no lease (exclusive right), so that notes can be written during a search.

    SQLite lets only one transaction write at a time; this one waits up to `timeout` s for another.
    """
    reader = Database.open(path, readonly=True)
    can_write = reader.data_version() is not None
    reader.close()
    if not can_write:
        # Opening it for writing raises the error that says why it cannot be written.
        Database.open(path, readonly=False).close()
    identity = file_identity(path)
    with (
        reraise_sqlite_errors(path),
        name_study_in_damage_errors(path),
        closing(open_connection(path, timeout)) as connection,
    ):
        connection.execute("PRAGMA trusted_schema = OFF")
        require_known_tables(path, connection)
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("BEGIN IMMEDIATE")
        with connection:
            require_same_file(path, identity)
            yield connection
