"""Lock that reserves a CARLA server for one worker of this user on this machine."""

from __future__ import annotations

import os
import time
from typing import Final
from weakref import finalize

from cornercase._common.errors import InputError
from cornercase._common.platform import try_lock_file, user_cache_folder

_LOCAL_HOSTS: Final = ("127.0.0.1", "::1")
# Time in s to wait for the lock, since a worker that was killed may not have ended yet.
_TIMEOUT, _POLL_INTERVAL = 10.0, 0.1


class ServerLock:
    """A locked file that reserves the CARLA server at an address for one worker.

    Each run removes all actors from its server, so two workers on one server would disturb each other unnoticed. If a
    worker dies, the operating system releases its lock.
    """

    def __init__(self, host: str, port: int) -> None:
        self._host, self._port = "localhost" if host in _LOCAL_HOSTS else host, port
        self._finalizer: finalize[[int], ServerLock] | None = None

    def acquire(self, timeout: float = _TIMEOUT) -> None:
        """Reserve the server; raise `InputError` if another worker still uses it after `timeout` s.

        Does nothing if this object has reserved the server already.
        """
        if self._finalizer is not None:
            return
        folder = user_cache_folder() / "carla-servers"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            handle = os.open(folder / f"{self._host} {self._port}", os.O_RDWR | os.O_CREAT, 0o600)
        except OSError:
            # Without a folder for the lock there is no protection.
            return
        deadline = time.monotonic() + timeout
        while not try_lock_file(handle):
            if time.monotonic() > deadline:
                os.close(handle)
                raise InputError(
                    f"Another cornercase process runs scenarios on CARLA on {self._host}:{self._port}; wait until it"
                    " ends, or choose another server by `simulator` carla:port= or hosts=."
                )
            time.sleep(_POLL_INTERVAL)
        # Releases the server even if `release` is never called.
        self._finalizer = finalize(self, os.close, handle)

    def release(self) -> None:
        """Release the server for other workers."""
        if self._finalizer is not None:
            self._finalizer()
        self._finalizer = None
