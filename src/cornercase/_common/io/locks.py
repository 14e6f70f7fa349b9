"""File locks between processes of a machine; the operating system frees them when a process ends."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Final

from filelock import BaseFileLock, FileLock, Timeout

# Seconds between attempts to lock (locks are held for milliseconds), and seconds after which attempts end.
_POLL_INTERVAL, _TIMEOUT = 0.005, 60.0
# Locks that timed out; they are not waited for again until somebody frees them.
_TIMED_OUT: Final[set[Path]] = set()


def try_lock(path: Path) -> BaseFileLock | None:
    """Acquire a lock, or return None if somebody else holds it; OSError if the lock file cannot be written."""
    # Any thread may release it.
    lock = FileLock(path, thread_local=False)
    try:
        lock.acquire(blocking=False)
    except Timeout:
        # filelock raises the same if the file cannot be created.
        if not path.exists():
            path.touch()
        return None
    except NotImplementedError as error:
        raise OSError(None, "its file system has no locks") from error
    return lock


@contextmanager
def lock(path: Path, timeout: float = _TIMEOUT) -> Iterator[None]:
    """Hold a lock on the file `path` during the block; a thread that holds the lock may enter again.

    If the lock file cannot be written, or the lock is not free within `timeout` s, the block runs without a lock. A
    process that holds a lock for so long has probably been suspended, so later calls do not wait for this lock.
    """
    with ExitStack() as stack:
        # filelock's Timeout is an OSError, too.
        with suppress(OSError, NotImplementedError):
            path.parent.mkdir(parents=True, exist_ok=True)
            try:
                stack.enter_context(
                    FileLock(path, is_singleton=True).acquire(
                        timeout=0.0 if path in _TIMED_OUT else timeout, poll_interval=_POLL_INTERVAL
                    )
                )
            except Timeout:
                _TIMED_OUT.add(path)
            else:
                _TIMED_OUT.discard(path)
        yield
