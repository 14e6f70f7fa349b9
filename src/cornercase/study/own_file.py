"""Whether a study that is written to is still the file that was opened.

Its name may lead to another file by now, or to none. And another program may have copied a file over it, under the same
name: SQLite does not look, and goes on with the pages that it remembers. So the file itself is looked into, whether the
lease of the one who writes still stands there: whenever it has changed, and once a second.
"""

from __future__ import annotations

import os
import sqlite3
import time
from contextlib import closing, suppress
from pathlib import Path
from typing import Final

from cornercase._common.errors import StudyLostError
from cornercase.study.connecting import file_at
from cornercase.study.lease import Lease

# Looks into the file, which another process may be in the middle of writing a page of, and s between them.
_LOOKS: Final = 3
_PAUSE: Final = 0.02


class OwnFile:
    """The file of a study that is open for writing, and those that SQLite keeps beside it.

    Parameters
    ----------
    path : Path
        The study.
    connection : sqlite3.Connection
        With it.
    lease : Lease
        Held by it.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection, lease: Lease) -> None:
        self._path, self._connection, self._lease = path, connection, lease
        # Names may be changed while the file is open.
        self._files = {one: file_at(one) for one in _files_of(path)}
        self._seen: tuple[int, int] | None = None
        # The lease gets from the log into the file.
        with suppress(sqlite3.Error):
            connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchall()
        # A reader may be in the way of that; then it is not missed there.
        self._there = self._lease_stands_in_file() is True

    def require_name(self) -> None:
        """Refuse to go on where the name leads elsewhere; then the connection is closed.

        Raises
        ------
        StudyLostError
            It was removed, or another one has taken its place.
        """
        if self._has_its_name():
            return
        words = "another file has taken its place" if self._path.exists() else "it was removed"
        self._leave_moved()
        raise StudyLostError(
            f"{self._path}: {words} while this command wrote to it; what it had stored is not under this name any"
            " more. Run the same command again, after putting the study back if you have moved it."
        )

    def require_content(self, thorough: bool) -> None:
        """Refuse to go on where something else was written into the file; then the connection is closed.

        Parameters
        ----------
        thorough : bool
            Whether the file is looked into also where it seems not to have changed.

        Raises
        ------
        StudyLostError
            Another one was copied over it.
        """
        if not self._has_its_name() or not self._is_copied_over(thorough):
            return
        self._leave_overwritten()
        raise StudyLostError(
            f"{self._path}: another file was copied over it, or it was cut, while this command wrote to it; what it had"
            " stored is lost. Look at what is there now with `verify`, and run the same command again, into another"
            " study."
        )

    def _has_its_name(self) -> bool:
        return file_at(self._path) == self._files[self._path]

    def _is_copied_over(self, thorough: bool) -> bool:
        seen = _state(self._path)
        if seen == self._seen and not thorough:
            return False
        self._seen = seen
        found = self._lease_stands_in_file()
        if found is not False or not self._there:
            self._there |= found is True
            return False
        try:
            # Somebody who took it over says so at the next transaction.
            return self._lease.stands(self._connection)
        except sqlite3.Error:
            return True

    def _lease_stands_in_file(self) -> bool | None:
        """Look into the file, past what SQLite remembers of it; None where it cannot be opened."""
        # By SQLite, as closing a handle of one's own would let go its locks.
        location = f"{self._path.resolve().as_uri()}?immutable=1"
        for look in range(_LOOKS):
            time.sleep(_PAUSE if look else 0.0)
            try:
                with closing(sqlite3.connect(location, uri=True)) as beside:
                    if self._lease.stands(beside):
                        return True
            except (sqlite3.Error, UnicodeDecodeError) as error:
                if "unable to open" in str(error):
                    return None
        return False

    def _leave_moved(self) -> None:
        # What was moved shall hold what is still in the log: SQLite does not see to that by itself.
        with suppress(sqlite3.Error):
            self._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        self._lease.give_back(self._connection)
        self._connection.close()
        self._remove_beside()

    def _leave_overwritten(self) -> None:
        self._lease.forget()
        # What closes the file would write the log into what was copied over it.
        log = _files_of(self._path)[1]
        if file_at(log) == self._files[log]:
            with suppress(OSError):
                os.truncate(log, 0)
        self._connection.close()
        self._remove_beside()

    def _remove_beside(self) -> None:
        # What is beside it now would be taken for the log of what has its name now.
        for beside, known in self._files.items():
            if beside != self._path and known is not None and file_at(beside) == known:
                with suppress(OSError):
                    beside.unlink()


def _files_of(path: Path) -> tuple[Path, ...]:
    """The file of a study, and those that SQLite keeps beside it."""
    whole = path.resolve()
    return (path, *(whole.with_name(whole.name + ending) for ending in ("-wal", "-shm")))


def _state(path: Path) -> tuple[int, int] | None:
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_size, found.st_mtime_ns
