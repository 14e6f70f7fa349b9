"""Lock a damaged study while it is replaced, and make sure that it is still the file that was read.

Nothing is written into a damaged file, not even a lease: if its pages are mixed up, that could destroy what is left.
Taking a lease and writing a note need SQLite's write lock, so that lock is held instead; it ends with the process.
Copying or renaming a file over the study needs no lock, so its files are compared with what was read.
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
from cornercase._common.platform import renames_open_files
from cornercase.study.connecting import connected, is_unreachable, sentences
from cornercase.study.lease import require_no_writer

# Time in s to wait for a note that is being written.
_PATIENCE: Final = 5.0


@dataclass(frozen=True)
class _State:
    """Identity, size in bytes and modification time in ns of a file, which are known without reading it."""

    identity: tuple[int, int]
    size: int
    written: int

    @classmethod
    def of(cls, path: Path) -> _State | None:
        try:
            status = path.stat()
        except FileNotFoundError:
            return None
        return cls((status.st_dev, status.st_ino), status.st_size, status.st_mtime_ns)


class HeldFile:
    """The file of a damaged study, from before it is read until it has been replaced; `path` is no link."""

    def __init__(self, path: Path) -> None:
        self._path, self._log = path, path.with_name(path.name + "-wal")
        # Move the log into the file now, so that no reader does it later.
        with suppress(sqlite3.Error, UnicodeDecodeError), closing(connected(path, _PATIENCE)) as connection:
            require_no_writer(path, connection)
            connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchall()
        self._known = self._states()
        with ExitStack() as handles:
            self._digests = self._read(handles)
        self._held = ExitStack()
        self._locked = False

    def __enter__(self) -> HeldFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    def lock(self) -> None:
        """Keep out all writers through SQLite's write lock."""
        try:
            # The last connection that closes a file removes the log of that name, which may belong to another file
            # by then. A read-only connection cannot, so it is closed last.
            reader = sqlite3.connect(f"{self._path.as_uri()}?mode=ro", uri=True, timeout=_PATIENCE)
            self._held.callback(reader.close)
            reader.execute("SELECT count(*) FROM sqlite_master").fetchall()
            connection = connected(self._path, _PATIENCE)
            self._held.callback(connection.close)
            connection.execute("BEGIN IMMEDIATE")
            self._locked = True
            require_no_writer(self._path, connection)
        except (sqlite3.Error, UnicodeDecodeError) as error:
            # A process that cannot read the file cannot write to it either.
            if is_unreachable(error):
                with sentences(self._path):
                    raise
        self._require(self._states() == self._known)

    def require_same(self) -> None:
        """Raise `InputError` if the file has changed since it was read, so that nothing unread is replaced."""
        # Closing a handle would release SQLite's lock.
        self._require(self._states() == self._known and self._read(self._held) == self._digests)
        self._require(self._states() == self._known)

    def moved(self, kept: Path) -> None:
        """Set the new name of the file, and of the files that SQLite keeps beside it."""
        self._path = kept

    def release_to_rename(self) -> None:
        """Release the file if the platform cannot rename open files."""
        if not renames_open_files():
            self.release()

    def release(self) -> None:
        """Let others write."""
        if not self._locked:
            self._held.close()
            return
        self._locked = False
        state, log = self._states()
        if state is not None and state != self._known[0] and log is not None and log == self._known[1]:
            # The log of the damaged file must not be applied to the new one.
            with suppress(OSError):
                os.truncate(self._log, 0)
        self._held.close()
        # Let SQLite remove its files, if nobody else has the study open.
        with suppress(sqlite3.Error, UnicodeDecodeError), closing(connected(self._path, _PATIENCE)) as connection:
            connection.execute("SELECT count(*) FROM sqlite_master").fetchall()

    def _states(self) -> tuple[_State | None, _State | None]:
        """States of the file and its log; an empty log counts as none, since SQLite adds and removes it freely."""
        log = _State.of(self._log)
        return _State.of(self._path), log if log is not None and log.size else None

    def _read(self, handles: ExitStack) -> list[bytes]:
        """SHA-256 of the file and its log."""
        digests = []
        for path, state in zip((self._path, self._log), self._known, strict=True):
            if state is not None:
                digests.append(hashlib.file_digest(handles.enter_context(path.open("rb")), "sha256").digest())
        return digests

    def _require(self, same: bool) -> None:
        if same:
            return
        state, initial = _State.of(self._path), self._known[0]
        if state is None:
            change = "was removed"
        elif initial is None or state.identity != initial.identity:
            change = "was replaced by another file"
        else:
            change = "was written to"
        raise InputError(
            f"{self._path}: {change} during the repair, so nothing was replaced; check the current file with"
            " `verify`, and repair it again if that is damaged."
        )
