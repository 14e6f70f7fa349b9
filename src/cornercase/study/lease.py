"""Who may write to a study: a lease in the file itself, which holds by whatever name the file is opened.

A lock file beside the study would belong to a name: a link, another name of the same file, or a removed lock let two
write at once. A lock of the operating system on the study would be the same lock as SQLite's own on some platforms, and
disturb it; closing any other handle of the file lets go SQLite's. So the one who writes stands in the table ``lease``,
which SQLite itself protects, on network file systems as far as it protects the study.

Each transaction looks first whether the lease is still there. So two never write, whatever the clocks say: one that was
taken for dead ends at its next transaction. Whether another one is alive is known at once on the same machine. One
elsewhere renews its lease, and counts as dead when it has not done so for two minutes.
"""

from __future__ import annotations

import math
import os
import platform
import secrets
import sqlite3
import threading
import time
import uuid
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError, StudyLostError

# s between renewals, and s after which one that was not renewed counts no more.
_BEAT: Final = 30.0
_LONGEST: Final = 120.0
# s by which the beginning of a process may be told otherwise the next time, where it is told by the clock.
_ALIKE: Final = 5.0
_PATIENCE: Final = 5.0

# Tokens of the leases that this process holds.
_held: set[tuple[int, str]] = set()


@dataclass(frozen=True)
class Lease:
    """The right to write to a study.

    Attributes
    ----------
    path : Path
        The study.
    token : str
        Tells this lease from all others.
    ended : threading.Event
        Set when it is given back.
    """

    path: Path
    token: str
    ended: threading.Event

    @classmethod
    def take(cls, path: Path, connection: sqlite3.Connection) -> Lease:
        """Take the lease of a study.

        Parameters
        ----------
        path : Path
        connection : sqlite3.Connection

        Returns
        -------
        Lease

        Raises
        ------
        InputError
            Another one holds it.
        sqlite3.Error
            The study cannot be written.
        """
        token = secrets.token_hex(16)
        connection.execute("BEGIN IMMEDIATE")
        try:
            require_no_writer(path, connection)
            connection.execute("DELETE FROM lease")
            mine = (token, platform.node(), _machine(), os.getpid(), _began(os.getpid()), time.time())
            connection.execute("INSERT INTO lease VALUES (?, ?, ?, ?, ?, ?)", mine)
            connection.execute("COMMIT")
        except BaseException:
            if connection.in_transaction:
                connection.execute("ROLLBACK")
            raise
        _held.add((os.getpid(), token))
        lease = cls(path, token, threading.Event())
        threading.Thread(target=lease._renew, name="cornercase-lease", daemon=True).start()
        return lease

    def require(self, connection: sqlite3.Connection) -> None:
        """Look, within a transaction, whether the study is still this lease's.

        Parameters
        ----------
        connection : sqlite3.Connection

        Raises
        ------
        StudyLostError
            Another one has taken it.
        """
        if not self.stands(connection):
            raise StudyLostError(
                f"{self.path}: another cornercase took this study over, as this one seemed to have ended; what was"
                " stored until then is in it. Run the same command again once the other one has ended."
            )

    def stands(self, connection: sqlite3.Connection) -> bool:
        """Tell whether the lease stands in a file.

        Parameters
        ----------
        connection : sqlite3.Connection
            With the file.

        Returns
        -------
        bool
        """
        return connection.execute("SELECT 1 FROM lease WHERE token = ?", (self.token,)).fetchone() is not None

    def forget(self) -> None:
        """Let it go without writing to the file, which is another one by now."""
        self.ended.set()
        _held.discard((os.getpid(), self.token))

    def give_back(self, connection: sqlite3.Connection | None = None) -> None:
        """Let another one write.

        Parameters
        ----------
        connection : sqlite3.Connection, optional
            By default one of its own, which any thread may use.
        """
        self.ended.set()
        if (os.getpid(), self.token) not in _held:
            return
        _held.discard((os.getpid(), self.token))
        # Where it cannot be taken out, the end of this process does it.
        with suppress(sqlite3.Error):
            if connection is not None:
                _remove(connection, self.token)
            elif self.path.is_file():
                with closing(sqlite3.connect(self.path, timeout=_PATIENCE)) as own:
                    _remove(own, self.token)

    def _renew(self) -> None:
        """Say from time to time that this process is alive, to those on other machines."""
        while not self.ended.wait(_BEAT):
            # What was removed is not made again.
            with suppress(sqlite3.Error, OSError):
                location = f"{self.path.resolve().as_uri()}?mode=rw"
                with closing(sqlite3.connect(location, uri=True, timeout=_PATIENCE)) as own, own:
                    own.execute("UPDATE lease SET beat = ? WHERE token = ?", (time.time(), self.token))


def require_no_writer(path: Path, connection: sqlite3.Connection) -> None:
    """Refuse a study that another one writes to.

    Parameters
    ----------
    path : Path
    connection : sqlite3.Connection

    Raises
    ------
    InputError
        Another one holds its lease.
    sqlite3.Error
        The lease cannot be read.
    """
    for row in connection.execute("SELECT token, host, machine, pid, began, beat FROM lease").fetchall():
        if _is_alive(row):
            here = row[2] == _machine()
            where = "" if here else f" on {str(row[1])[:80]}"
            # Whether it was killed is not seen from here.
            until = "it has ended" if here else "it has ended, or two minutes if it was killed"
            raise InputError(
                f"{path}: another cornercase is writing to it (process {row[3]}{where}); wait until {until}."
            )


def _remove(connection: sqlite3.Connection, token: str) -> None:
    with connection:
        connection.execute("DELETE FROM lease WHERE token = ?", (token,))


def _is_alive(row: tuple[Any, ...]) -> bool:
    """Tell whether the holder of a lease is alive."""
    token, host, machine, pid, began, beat = row
    known = all(isinstance(one, str) for one in (token, host, machine)) and isinstance(pid, int)
    if not known or not all(isinstance(one, float) for one in (began, beat)):
        return False
    if machine != _machine():
        return abs(time.time() - float(beat)) < _LONGEST
    if pid == os.getpid():
        return (pid, token) in _held
    since = _began(pid)
    return since is not None and not abs(since - float(began)) >= _ALIKE


@cache
def _machine() -> str:
    """Name the machine as long as it runs, and what sees the same processes on it."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        return f"{boot} {os.readlink('/proc/self/ns/pid')}"
    except OSError:
        return f"{platform.node()} {uuid.getnode():x}"


def _began(pid: int) -> float | None:
    """When a process began, by whatever clock; None where there is none, NaN where that is not told."""
    try:
        # After the name, which may hold anything. The clock may be set, the ticks since the start of the machine not.
        state, *more = (
            Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
        )
        return None if state in "ZX" else float(more[18])
    except FileNotFoundError:
        if Path("/proc/self/stat").exists():
            return None
    except (OSError, IndexError, ValueError):
        pass
    # Loaded here, as it is not needed on Linux.
    import psutil

    try:
        process = psutil.Process(pid)
        return None if process.status() == psutil.STATUS_ZOMBIE else float(process.create_time())
    except psutil.NoSuchProcess:
        return None
    except psutil.Error:
        # It is somebody else's, and alive.
        return math.nan
