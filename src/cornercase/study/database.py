"""The SQLite file of a study: making it, opening it, and writing to it as the only one."""

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
    lease : Lease or None
        Held while the file is open for writing; None for a reader.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection, lease: Lease | None) -> None:
        self.path = path
        self.connection = connection
        self._lease = lease
        self._closed = self._writing = False
        # Why it is not ours any more.
        self._lost = ""
        # SQLite does not look again at a file that was opened as immutable.
        self._sees_others = not is_out_of_reach(path)
        self._forced = -math.inf
        self._tallied: dict[str, tuple[int, int]] = {}
        self._own = None if lease is None else OwnFile(path, connection, lease)
        if lease is not None:
            # One that was never closed does not keep others from writing.
            weakref.finalize(self, lease.give_back)

    @classmethod
    def create(cls, path: Path, meta: Iterable[tuple[str, str]], *more: str) -> Database:
        """Make a file, and open it for writing.

        Parameters
        ----------
        path : Path
        meta : iterable of (str, str)
            Keys and values of the table ``meta``.
        *more : str
            Names of further tables.

        Returns
        -------
        Database

        Raises
        ------
        InputError
            The file exists already, or cannot be written.
        """
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror}).") from error
        # Of two explorers that begin at once, one makes the file.
        with alone_in(path.parent):
            if path.exists():
                raise InputError(f"{path}: exists already; choose another name or remove it.")
            remove_log(path)
            # The file appears under its name only when it is whole.
            with written_whole(path) as temporary, sentences(path), closing(sqlite3.connect(temporary)) as connection:
                make_tables(connection, *more)
                put(connection, "meta", meta)
                connection.commit()
        return cls._opened(path, writes=True)

    @classmethod
    def open(cls, path: Path, readonly: bool) -> Database:
        """Open a file.

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
            There is none, it is none, another program writes to it, or it is of another schema version.
        """
        require_file(path)
        # What is no study is not written to.
        reader = cls._opened(path, writes=False)
        if readonly:
            return reader
        reader.close()
        return cls._opened(path, writes=True)

    @classmethod
    def _opened(cls, path: Path, writes: bool) -> Database:
        """Open for reading, or for writing with a lease."""
        lease = None
        file = file_at(path)
        with sentences(path):
            connection = connected(path)
            try:
                # What a file says of itself is not trusted: its views and triggers may not call functions, ...
                connection.execute("PRAGMA trusted_schema = OFF")
                connection.execute("PRAGMA cell_size_check = ON")
                require_study(path, connection)
                # ... and it may have none.
                require_plain(path, connection)
                if writes:
                    require_one_name(path)
                    # What is not read could lead what is written astray.
                    require_intact(path, connection)
                    connection.execute("PRAGMA journal_mode = WAL")
                    lease = Lease.take(path, connection)
                    require_still(path, file)
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
        """Close the file.

        Raises
        ------
        StudyLostError
            It was open for writing, and was removed or replaced since.
        """
        self._require_own(thorough=True)
        if not self._closed and self._lease is not None:
            self._lease.give_back(self.connection)
        self._closed = True
        self.connection.close()

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
        with sentences(self.path):
            return self.connection.execute(question, values).fetchall()

    def rows(self, table: str, where: str = "1", *values: Any, blob: bool = False) -> list[Any]:
        """Read rows, each of which is as it was written.

        Parameters
        ----------
        table : str
        where : str, optional
            Condition in SQL; by default all rows are read, none of which may be missing.
        *values : object
            For its question marks.
        blob : bool, default False
            Whether the blob of each is read too.

        Returns
        -------
        list of tuple
            Their columns, without checksums, in the order of their keys.

        Raises
        ------
        DamageError
            Something is not as it was written.
        InputError
            The file is closed, or cannot be read.
        """
        if where == "1":
            self.require_all(table)
        with closing(self.each_row(table, where, *values, blob=blob)) as found:
            return list(found)

    def each_row(self, table: str, where: str = "1", *values: Any, blob: bool = False) -> Generator[Any, None, None]:
        """Give rows one after the other, where all at once would take much memory; as `rows`.

        To be closed before the file is.

        Parameters
        ----------
        table : str
        where : str, optional
            Condition in SQL.
        *values : object
            For its question marks.
        blob : bool, default False
            Whether the blob of each is read too.

        Yields
        ------
        tuple

        Raises
        ------
        DamageError
            A row is not as it was written.
        InputError
            The file is closed, or cannot be read.
        """
        self._require_open()
        with sentences(self.path), damage_of(self.path):
            yield from read_rows(self.connection, table, where, *values, blob=blob)

    def require_all(self, table: str) -> None:
        """Refuse a table of which rows are missing.

        Parameters
        ----------
        table : str

        Raises
        ------
        DamageError
            It has other rows than were written.
        InputError
            The file is closed, or cannot be read.
        """
        written = self.written()
        if self._tallied.get(table) != written:
            with self.snapshot(), sentences(self.path), damage_of(self.path):
                require_tally(self.connection, table)
            self._tallied[table] = written

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
        with sentences(self.path):
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
        try:
            with sentences(self.path):
                self.connection.execute("BEGIN")
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
        if self._writing:
            # What is written within a transaction belongs to it.
            yield self.connection
            return
        forces = time.monotonic() - self._forced >= _SECONDS_BETWEEN_FORCED
        # What was moved is told of afterwards, so that it takes all with it.
        self._require_own(thorough=forces, name=False)
        with sentences(self.path), damage_of(self.path):
            if self.connection.in_transaction:
                # An interrupt between the begin of a transaction and its block left it open; nothing is written in it.
                self.connection.rollback()
            self.connection.execute(f"PRAGMA synchronous = {'FULL' if forces else 'NORMAL'}")
            self.connection.execute("BEGIN IMMEDIATE")
            with self.connection, self._noted():
                if self._lease is not None:
                    self._lease.require(self.connection)
                yield self.connection
        self.require_there()
        if forces:
            self._forced = time.monotonic()

    @contextmanager
    def _noted(self) -> Iterator[None]:
        self._writing = True
        try:
            yield
        finally:
            self._writing = False

    def require_there(self) -> None:
        """Refuse to go on with a file that is open for writing and has another name by now, or none, or other content.

        Raises
        ------
        StudyLostError
            It was removed or replaced.
        """
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
        # Whoever cleans up afterwards says the same.
        if self._lost:
            raise StudyLostError(self._lost)
        if self._closed:
            raise InputError(f"{self.path}: is closed; open it again with `Study.open`.")


def make_tables(connection: sqlite3.Connection, *more: str) -> None:
    """Make an empty study of an empty database.

    Parameters
    ----------
    connection : sqlite3.Connection
    *more : str
        Names of tables that not every study has.
    """
    for name in (*ALWAYS, *more):
        connection.execute(STATEMENTS[name])
    connection.execute(f"PRAGMA application_id = {APPLICATION}")
    connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")


@contextmanager
def written_beside(path: Path) -> Iterator[sqlite3.Connection]:
    """Give a connection for one short transaction beside those of an explorer, whose lock is not needed for it.

    SQLite lets one of them write at a time, and each waits for the other.

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
        # Opening it for writing raises the error that says why it cannot be written.
        Database.open(path, readonly=False).close()
    file = file_at(path)
    with sentences(path), damage_of(path), closing(connected(path, _PATIENCE_BESIDE)) as connection:
        connection.execute("PRAGMA trusted_schema = OFF")
        require_plain(path, connection)
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("BEGIN IMMEDIATE")
        with connection:
            require_still(path, file)
            yield connection
