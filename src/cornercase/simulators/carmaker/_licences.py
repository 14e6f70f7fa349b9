"""Licences that limit how many CarMakers run on a host at a time."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError
from cornercase._common.platform import try_lock_file, user_cache_folder

_POLL_INTERVAL: Final = 0.1
# Maximum number of workers that wait on one host at a time.
_MAX_WAITING: Final = 256


class Licence:
    """One of `count` licences that all workers of this user on this host share; 0 licences mean no limit.

    A licence is a locked file. If a worker dies, the operating system releases its lock.
    """

    def __init__(self, count: int, folder: Path | None = None) -> None:
        self._count, self._folder = count, folder or user_cache_folder() / "carmaker-licences"
        self._handle: int | None = None

    def acquire(self) -> None:
        """Wait until a licence is free, and take it; does nothing if this object has a licence already."""
        if not self._count or self._handle is not None:
            return
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._handle = self._lock_any("licence", self._count)
        except OSError as error:
            raise InputError(
                f"licences={self._count}: the folder {self._folder}, in which licences are counted, cannot be written"
                f" ({error.strerror or error}); make the folder writable, or set XDG_CACHE_HOME to another folder."
            ) from error
        if self._handle is not None:
            return
        waiting = self._lock_any("waiting", _MAX_WAITING)
        try:
            while self._handle is None:
                time.sleep(_POLL_INTERVAL)
                self._handle = self._lock_any("licence", self._count)
        finally:
            if waiting is not None:
                os.close(waiting)

    def release(self) -> None:
        """Give the licence back, if this object has one."""
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None

    def is_awaited(self) -> bool:
        """Return whether another worker waits for a licence; False if this object has no licence to give back."""
        if self._handle is None:
            return False
        for path in self._folder.glob("waiting *"):
            handle = os.open(path, os.O_RDWR)
            try:
                if not try_lock_file(handle):
                    return True
            finally:
                os.close(handle)
        return False

    def _lock_any(self, name: str, count: int) -> int | None:
        """Lock one of `count` files whose names begin with `name`; return its handle, or None if all are locked."""
        for number in range(count):
            handle = os.open(self._folder / f"{name} {number}", os.O_RDWR | os.O_CREAT, 0o600)
            if try_lock_file(handle):
                return handle
            os.close(handle)
        return None
