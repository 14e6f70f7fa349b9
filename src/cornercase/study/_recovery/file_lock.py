"""Lock a damaged study until it has been replaced, and check that the file is still the one that was read.

First SQLite's log is moved into the damaged file, if SQLite can read both. Nothing else is written into the file, not
even a lease (the row that names the writing process): if the pages of the file are mixed up, writing could destroy the
rest. Instead, SQLite's write lock is held: other processes need this lock to take a lease or to write a note. The lock
ends with this process at the latest. Programs that copy or rename a file over the study need no lock, so the file is
compared with its state when it was read.
"""

from __future__ import annotations

import hashlib
import os
import sqlite3
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Final

from cornercase._common.errors import InputError
from cornercase._common.platform import can_rename_open_files
from cornercase.study._connection import is_unreachable_error, open_connection, reraise_sqlite_errors
from cornercase.study._lease import require_no_writer

# Time in s to wait for a note that is being written.
_LOCK_TIMEOUT: Final = 5.0


@dataclass(frozen=True)
class _FileState:
    """Identity, size in bytes and modification time in ns of a file."""

    identity: tuple[int, int]
    size: int
    modified: int

    @classmethod
    def from_path(cls, path: Path) -> _FileState | None:
        try:
            status = path.stat()
        except FileNotFoundError:
            return None
        return cls((status.st_dev, status.st_ino), status.st_size, status.st_mtime_ns)


class DamagedFileLock:
    """Lock of a damaged study, with a check that the file has not changed since it was read.

    Create the object before the file is read: the object notes the state and the SHA-256 of the file. `lock` acquires
    SQLite's write lock; `release` or the end of the ``with`` block releases the lock. `path` must not be a symbolic
    link.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._log_path = path, path.with_name(path.name + "-wal")
        # Move the log into the file now, so that no reader does it later.
        with suppress(sqlite3.Error, UnicodeDecodeError), closing(open_connection(path, _LOCK_TIMEOUT)) as connection:
            require_no_writer(path, connection)
            connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchall()
        self._initial_states = self._read_file_states()
        with ExitStack() as handles:
            self._initial_hashes = self._hash_files(handles)
        self._open_handles = ExitStack()
        self._is_locked = False

    def __enter__(self) -> DamagedFileLock:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    def lock(self) -> None:
        """Acquire SQLite's write lock, so that no other process can write.

        If SQLite cannot even read the damaged file, there is no lock, but other processes cannot write to the file
        either.
        """
        try:
            # The last connection that closes a file removes the log of that name, which may belong to another file
            # by then. A read-only connection cannot, so it is closed last.
            reader = sqlite3.connect(f"{self._path.as_uri()}?mode=ro", uri=True, timeout=_LOCK_TIMEOUT)
            self._open_handles.callback(reader.close)
            reader.execute("SELECT count(*) FROM sqlite_master").fetchall()
            connection = open_connection(self._path, _LOCK_TIMEOUT)
            self._open_handles.callback(connection.close)
            connection.execute("BEGIN IMMEDIATE")
            self._is_locked = True
            require_no_writer(self._path, connection)
        except (sqlite3.Error, UnicodeDecodeError) as error:
            # A process that cannot read the file cannot write to it either.
            if is_unreachable_error(error):
                with reraise_sqlite_errors(self._path):
                    raise
        self._raise_if_changed(self._read_file_states() == self._initial_states)

    def require_unchanged(self) -> None:
        """Raise `InputError` if the file has changed since it was read: replacing the file would lose these changes."""
        # Closing a handle would release SQLite's lock.
        self._raise_if_changed(
            self._read_file_states() == self._initial_states
            and self._hash_files(self._open_handles) == self._initial_hashes
        )
        self._raise_if_changed(self._read_file_states() == self._initial_states)

    def set_path(self, path: Path) -> None:
        """Set the new path of the damaged file after it was renamed."""
        self._path = path

    def release_before_rename(self) -> None:
        """Release the lock if the platform cannot rename files that are open."""
        if not can_rename_open_files():
            self.release()

    def release(self) -> None:
        """Release the lock, so that other processes can write."""
        if not self._is_locked:
            self._open_handles.close()
            return
        self._is_locked = False
        state, log = self._read_file_states()
        if (
            state is not None
            and state != self._initial_states[0]
            and log is not None
            and log == self._initial_states[1]
        ):
            # The log of the damaged file must not be applied to the new one.
            with suppress(OSError):
                os.truncate(self._log_path, 0)
        self._open_handles.close()
        # Let SQLite remove its files, if nobody else has the study open.
        with (
            suppress(sqlite3.Error, UnicodeDecodeError),
            closing(open_connection(self._path, _LOCK_TIMEOUT)) as connection,
        ):
            connection.execute("SELECT count(*) FROM sqlite_master").fetchall()

    def _read_file_states(self) -> tuple[_FileState | None, _FileState | None]:
        """Return the state of the damaged file, and the state of SQLite's log beside the file; None for a missing file.

        An empty log counts as missing, since SQLite may add or remove an empty log at any time.
        """
        log = _FileState.from_path(self._log_path)
        return _FileState.from_path(self._path), log if log is not None and log.size else None

    def _hash_files(self, handles: ExitStack) -> list[bytes]:
        """Return the SHA-256 of the damaged file and, if it existed, of SQLite's log; `handles` keeps both open."""
        digests = []
        for path, state in zip((self._path, self._log_path), self._initial_states, strict=True):
            if state is not None:
                digests.append(hashlib.file_digest(handles.enter_context(path.open("rb")), "sha256").digest())
        return digests

    def _raise_if_changed(self, is_unchanged: bool) -> None:
        if is_unchanged:
            return
        state, initial = _FileState.from_path(self._path), self._initial_states[0]
        if state is None:
            change = "was removed"
        elif initial is None or state.identity != initial.identity:
            change = "was replaced by another file"
        else:
            change = "was written to"
        raise InputError(
            f"{self._path}: {change} during the repair, so nothing was replaced; check the current file with"
            " `verify`, and if the file is damaged, repair it again."
        )
