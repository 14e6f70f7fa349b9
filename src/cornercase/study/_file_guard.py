"""Detect that the file of an open study was moved, removed or overwritten by another program.

SQLite does not notice if another file is copied over the study, and goes on with the pages in its cache. So the file
itself is searched for the lease (the row that names this process as the writer). This is done once a second, and
whenever the file has changed.
"""

from __future__ import annotations

import os
import sqlite3
import time
from contextlib import closing, suppress
from pathlib import Path
from typing import Final

from cornercase._common.errors import StudyLostError
from cornercase.study._connection import file_identity
from cornercase.study._lease import Lease

# Attempts to find the lease, as another process may be writing a page, and time in s between them.
_ATTEMPTS: Final = 3
_RETRY_DELAY: Final = 0.02


class StudyFileGuard:
    """Guard of a study that is open for writing: detects that the file was moved, removed or overwritten."""

    def __init__(self, path: Path, connection: sqlite3.Connection, lease: Lease) -> None:
        self._path, self._connection, self._lease = path, connection, lease
        # Files may be renamed while they are open.
        self._file_identities = {name: file_identity(name) for name in _study_and_sqlite_files(path)}
        self._last_state: tuple[int, int] | None = None
        # Move the lease from the log into the file.
        with suppress(sqlite3.Error):
            connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchall()
        # If a reader prevented that, a missing lease means nothing yet.
        self._lease_was_in_file = self._is_lease_in_file() is True

    def require_not_moved(self) -> None:
        """If the path no longer leads to the opened file, close the connection and raise `StudyLostError`."""
        if self._is_in_place():
            return
        change = "it was replaced by another file" if self._path.exists() else "it was removed"
        self._close_moved_file()
        raise StudyLostError(
            f"{self._path}: {change} while this command was writing to it, so the results of the command are no longer"
            " in a file of this name. If you moved the study, move it back; then run the same command again."
        )

    def require_not_overwritten(self, force: bool) -> None:
        """If another file was copied over the study, close the connection and raise `StudyLostError`.

        With `force`, the check is made even if size and modification time are unchanged.
        """
        if not self._is_in_place() or not self._is_overwritten(force):
            return
        self._close_overwritten_file()
        raise StudyLostError(
            f"{self._path}: it was overwritten or truncated while this command was writing to it; what the"
            " command stored is lost. Check the file with `verify`, and run the same command again, into another"
            " study."
        )

    def _is_in_place(self) -> bool:
        return file_identity(self._path) == self._file_identities[self._path]

    def _is_overwritten(self, force: bool) -> bool:
        state = _size_and_mtime(self._path)
        if state == self._last_state and not force:
            return False
        self._last_state = state
        is_in_file = self._is_lease_in_file()
        if is_in_file is not False or not self._lease_was_in_file:
            self._lease_was_in_file |= is_in_file is True
            return False
        try:
            # If another process took over, the next transaction reports it.
            return self._lease.is_held(self._connection)
        except sqlite3.Error:
            return True

    def _is_lease_in_file(self) -> bool | None:
        """Return whether the file itself, read without SQLite's cache, holds the lease; None if it cannot be opened."""
        # Use SQLite, since closing a handle of another kind would release its locks.
        location = f"{self._path.resolve().as_uri()}?immutable=1"
        for attempt in range(_ATTEMPTS):
            time.sleep(_RETRY_DELAY if attempt else 0.0)
            try:
                with closing(sqlite3.connect(location, uri=True)) as connection:
                    if self._lease.is_held(connection):
                        return True
            except (sqlite3.Error, UnicodeDecodeError) as error:
                if "unable to open" in str(error):
                    return None
        return False

    def _close_moved_file(self) -> None:
        # The moved file must get the content of the log, which SQLite does not ensure.
        with suppress(sqlite3.Error):
            self._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        self._lease.release(self._connection)
        self._connection.close()
        self._remove_orphaned_side_files()

    def _close_overwritten_file(self) -> None:
        self._lease.abandon()
        # Closing the connection would write the log into the new file.
        log = _study_and_sqlite_files(self._path)[1]
        if file_identity(log) == self._file_identities[log]:
            with suppress(OSError):
                os.truncate(log, 0)
        self._connection.close()
        self._remove_orphaned_side_files()

    def _remove_orphaned_side_files(self) -> None:
        # These files would be taken for the log of the new file.
        for file, identity in self._file_identities.items():
            if file != self._path and identity is not None and file_identity(file) == identity:
                with suppress(OSError):
                    file.unlink()


def _study_and_sqlite_files(path: Path) -> tuple[Path, ...]:
    """Return the paths of a study and of SQLite's files beside it."""
    resolved = path.resolve()
    return (path, *(resolved.with_name(resolved.name + ending) for ending in ("-wal", "-shm")))


def _size_and_mtime(path: Path) -> tuple[int, int] | None:
    try:
        status = os.stat(path)
    except OSError:
        return None
    return status.st_size, status.st_mtime_ns
