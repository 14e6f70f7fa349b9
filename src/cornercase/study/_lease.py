"""The lease of a study: a row in the study file that says which process may write to the file.

A lock file beside the study would protect only one name of the study: through a link, or after the lock file was
removed, two processes could write. A lock of the operating system on the study would disturb SQLite's own lock on some
platforms. So the table ``lease`` names the writer, and SQLite protects that table, on network file systems as well.

Each transaction first checks that its lease is still stored. So two processes never write, even if clocks differ: a
process that was wrongly taken for dead stops at its next transaction. On the same machine, it is known at once whether
the holder is alive. A holder on another machine renews its lease, and counts as dead if the lease was not renewed for
two minutes.
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

# Time in s between renewals, and after which a lease expires that was not renewed.
_RENEWAL_INTERVAL: Final = 30.0
_EXPIRY_TIME: Final = 120.0
# Tolerance for the start time of a process, which depends on the clock on some systems; unit of `_process_start_time`.
_START_TIME_TOLERANCE: Final = 5.0
_LOCK_TIMEOUT: Final = 5.0

# Tokens of the leases that this process holds.
_held_tokens: set[tuple[int, str]] = set()


@dataclass(frozen=True)
class Lease:
    """The right to write to a study; `token` identifies the lease, and `released` is set when the lease ends."""

    path: Path
    token: str
    released: threading.Event

    @classmethod
    def acquire(cls, path: Path, connection: sqlite3.Connection) -> Lease:
        """Acquire the right to write to a study; `InputError` if another process holds it."""
        token = secrets.token_hex(16)
        connection.execute("BEGIN IMMEDIATE")
        try:
            require_no_writer(path, connection)
            connection.execute("DELETE FROM lease")
            row = (token, platform.node(), _machine_id(), os.getpid(), _process_start_time(os.getpid()), time.time())
            connection.execute("INSERT INTO lease VALUES (?, ?, ?, ?, ?, ?)", row)
            connection.execute("COMMIT")
        except BaseException:
            if connection.in_transaction:
                connection.execute("ROLLBACK")
            raise
        _held_tokens.add((os.getpid(), token))
        lease = cls(path, token, threading.Event())
        threading.Thread(target=lease._renew_periodically, name="cornercase-lease", daemon=True).start()
        return lease

    def require_held(self, connection: sqlite3.Connection) -> None:
        """Raise `StudyLostError` if another process has taken over the study; call it within a transaction."""
        if not self.is_held(connection):
            raise StudyLostError(
                f"{self.path}: another cornercase process took over this study, because this process seemed to have"
                " ended. Everything stored until then is in the study. Run the same command again when the other"
                " process has ended."
            )

    def is_held(self, connection: sqlite3.Connection) -> bool:
        """Return whether the file of a connection still stores this lease."""
        return connection.execute("SELECT 1 FROM lease WHERE token = ?", (self.token,)).fetchone() is not None

    def abandon(self) -> None:
        """End the lease without writing to the file, because another file has taken its place."""
        self.released.set()
        _held_tokens.discard((os.getpid(), self.token))

    def release(self, connection: sqlite3.Connection | None = None) -> None:
        """End the lease, so that another process can write.

        Without `connection`, a new connection is used, so that any thread can call this.
        """
        self.released.set()
        if (os.getpid(), self.token) not in _held_tokens:
            return
        _held_tokens.discard((os.getpid(), self.token))
        # A row that cannot be deleted expires with this process.
        with suppress(sqlite3.Error):
            if connection is not None:
                _delete_lease_row(connection, self.token)
            elif self.path.is_file():
                with closing(sqlite3.connect(self.path, timeout=_LOCK_TIMEOUT)) as own_connection:
                    _delete_lease_row(own_connection, self.token)

    def _renew_periodically(self) -> None:
        """Renew the lease at intervals, so that other machines see that this process is alive."""
        while not self.released.wait(_RENEWAL_INTERVAL):
            # mode=rw does not create a file that was removed.
            with suppress(sqlite3.Error, OSError):
                location = f"{self.path.resolve().as_uri()}?mode=rw"
                with closing(sqlite3.connect(location, uri=True, timeout=_LOCK_TIMEOUT)) as connection, connection:
                    connection.execute("UPDATE lease SET beat = ? WHERE token = ?", (time.time(), self.token))


def require_no_writer(path: Path, connection: sqlite3.Connection) -> None:
    """Raise `InputError` if another process holds the lease of the study, which is the right to write to it."""
    for row in connection.execute("SELECT token, host, machine, pid, began, beat FROM lease").fetchall():
        if _is_holder_alive(row):
            is_local = row[2] == _machine_id()
            host_text = "" if is_local else f" on {str(row[1])[:80]}"
            # From another machine it is unknown whether the process was killed.
            advice = "it has ended" if is_local else "it has ended, or two minutes if it was killed"
            raise InputError(
                f"{path}: another cornercase is writing to it (process {row[3]}{host_text}); wait until {advice}."
            )


def _delete_lease_row(connection: sqlite3.Connection, token: str) -> None:
    with connection:
        connection.execute("DELETE FROM lease WHERE token = ?", (token,))


def _is_holder_alive(row: tuple[Any, ...]) -> bool:
    """Return whether the process that a row of the table ``lease`` names is alive."""
    token, host, machine, pid, began, beat = row
    is_valid = all(isinstance(value, str) for value in (token, host, machine)) and isinstance(pid, int)
    if not is_valid or not all(isinstance(value, float) for value in (began, beat)):
        return False
    if machine != _machine_id():
        return abs(time.time() - float(beat)) < _EXPIRY_TIME
    if pid == os.getpid():
        return (pid, token) in _held_tokens
    start = _process_start_time(pid)
    return start is not None and not abs(start - float(began)) >= _START_TIME_TOLERANCE


@cache
def _machine_id() -> str:
    """Return a text that identifies the machine since its last boot, and the namespace of process ids."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        return f"{boot} {os.readlink('/proc/self/ns/pid')}"
    except OSError:
        return f"{platform.node()} {uuid.getnode():x}"


def _process_start_time(pid: int) -> float | None:
    """Return the start time of a process by a clock with an arbitrary zero; in clock ticks on Linux, else in s.

    Return None if there is no such process, and NaN if the time is unknown.
    """
    try:
        # The fields follow the name, which may contain anything. Ticks since boot do not change with the clock.
        state, *fields = (
            Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
        )
        return None if state in "ZX" else float(fields[18])
    except FileNotFoundError:
        if Path("/proc/self/stat").exists():
            return None
    except (OSError, IndexError, ValueError):
        pass
    # Imported here, since Linux does not need it.
    import psutil

    try:
        process = psutil.Process(pid)
        return None if process.status() == psutil.STATUS_ZOMBIE else float(process.create_time())
    except psutil.NoSuchProcess:
        return None
    except psutil.Error:
        # Access was denied, so the process is alive.
        return math.nan
