"""A damaged study that is to be replaced: nobody else writes to it meanwhile, and it is still the one that was read.

Nothing is written into a damaged file, also no lease: where its pages are mixed up, that could destroy what is left.
What takes a lease and what writes a note needs SQLite's lock for writing, so that lock is held instead; it ends with
the process. Who copies or renames a file over the study needs no lock: so its files are compared with what was read.
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

# s to wait for a note that is being written.
_PATIENCE: Final = 5.0


@dataclass(frozen=True)
class _State:
    """What is known of a file without reading it."""

    identity: tuple[int, int]
    size: int
    written: int

    @classmethod
    def of(cls, path: Path) -> _State | None:
        try:
            found = path.stat()
        except FileNotFoundError:
            return None
        return cls((found.st_dev, found.st_ino), found.st_size, found.st_mtime_ns)


class HeldFile:
    """The file of a damaged study, from before it is read until it has been replaced.

    Parameters
    ----------
    path : Path
        The study; no link.

    Raises
    ------
    InputError
        Another one writes to it.
    OSError
        It cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._log = path, path.with_name(path.name + "-wal")
        # What stands in the log gets into the file, so that no reader does that later.
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
        """Keep out all who write; SQLite is the only one who lets them in.

        Raises
        ------
        InputError
            Another one writes to it, or it has changed since it was read.
        """
        try:
            # Whoever closes a file last removes the log of that name, which may be that of another file by then. One
            # who may only read cannot, and is closed last.
            reader = sqlite3.connect(f"{self._path.as_uri()}?mode=ro", uri=True, timeout=_PATIENCE)
            self._held.callback(reader.close)
            reader.execute("SELECT count(*) FROM sqlite_master").fetchall()
            connection = connected(self._path, _PATIENCE)
            self._held.callback(connection.close)
            connection.execute("BEGIN IMMEDIATE")
            self._locked = True
            require_no_writer(self._path, connection)
        except (sqlite3.Error, UnicodeDecodeError) as error:
            # Who cannot read it cannot write to it either.
            if is_unreachable(error):
                with sentences(self._path):
                    raise
        self._require(self._states() == self._known)

    def require_same(self) -> None:
        """Refuse to replace what was not read.

        Raises
        ------
        InputError
            It has changed since it was read.
        """
        # To close a handle would let go SQLite's lock.
        self._require(self._states() == self._known and self._read(self._held) == self._digests)
        self._require(self._states() == self._known)

    def moved(self, kept: Path) -> None:
        """Say that the file, and what SQLite keeps beside it, has another name now.

        Parameters
        ----------
        kept : Path
        """
        self._path = kept

    def release_to_rename(self) -> None:
        """Let go of the file where the platform renames none that is open."""
        if not renames_open_files():
            self.release()

    def release(self) -> None:
        """Let others write."""
        if not self._locked:
            self._held.close()
            return
        self._locked = False
        now, log = self._states()
        if now is not None and now != self._known[0] and log is not None and log == self._known[1]:
            # What was put in place shall not be taken together with the log of the damaged file.
            with suppress(OSError):
                os.truncate(self._log, 0)
        self._held.close()
        # Nothing was removed: now SQLite does it, if nobody else has it open.
        with suppress(sqlite3.Error, UnicodeDecodeError), closing(connected(self._path, _PATIENCE)) as connection:
            connection.execute("SELECT count(*) FROM sqlite_master").fetchall()

    def _states(self) -> tuple[_State | None, _State | None]:
        """States of the file and of its log; a log without content, and the memory that goes with it, come and go."""
        log = _State.of(self._log)
        return _State.of(self._path), log if log is not None and log.size else None

    def _read(self, handles: ExitStack) -> list[bytes]:
        """Digest of the file and of its log."""
        digests = []
        for path, state in zip((self._path, self._log), self._known, strict=True):
            if state is not None:
                digests.append(hashlib.file_digest(handles.enter_context(path.open("rb")), "sha256").digest())
        return digests

    def _require(self, same: bool) -> None:
        if same:
            return
        now, before = _State.of(self._path), self._known[0]
        if now is None:
            what = "was removed"
        elif before is None or now.identity != before.identity:
            what = "another file has taken its place"
        else:
            what = "was written to"
        raise InputError(
            f"{self._path}: {what} while it was repaired, so nothing was replaced; look at what is there now with"
            " `verify`, and repair it again if that is damaged."
        )
