"""Keep a CARLA server for one worker of this user on this machine."""

from __future__ import annotations

import os
import time
from typing import Final
from weakref import finalize

from cornercase._common.errors import InputError
from cornercase._common.platform import try_lock_file, user_cache_folder

_LOCAL_HOSTS: Final = ("127.0.0.1", "::1")
# s: a worker that was killed may not have ended yet.
_TIMEOUT, _POLL_INTERVAL = 10.0, 0.1


class ServerLock:
    """A locked file for a server's address, so that a worker that dies gives it back.

    Each run removes all actors from its server, so two at a time would disturb each other and not notice it.
    """

    def __init__(self, host: str, port: int) -> None:
        self._host, self._port = "localhost" if host in _LOCAL_HOSTS else host, port
        self._finalizer: finalize[[int], ServerLock] | None = None

    def acquire(self) -> None:
        """Take the server unless it is taken already; `InputError` if another worker has it."""
        if self._finalizer is not None:
            return
        folder = user_cache_folder() / "carla-servers"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            handle = os.open(folder / f"{self._host} {self._port}", os.O_RDWR | os.O_CREAT, 0o600)
        except OSError:
            # Without a folder of one's own there is no protection.
            return
        deadline = time.monotonic() + _TIMEOUT
        while not try_lock_file(handle):
            if time.monotonic() > deadline:
                os.close(handle)
                raise InputError(
                    f"Another cornercase runs scenarios on CARLA on {self._host}:{self._port}; wait for its end, or"
                    " choose another server by `simulator` carla:port= or hosts=."
                )
            time.sleep(_POLL_INTERVAL)
        # Also given back if nobody calls `release`.
        self._finalizer = finalize(self, os.close, handle)

    def release(self) -> None:
        """Give the server back."""
        if self._finalizer is not None:
            self._finalizer()
        self._finalizer = None
