"""Locks that processes on one machine share; the end of a process frees those that it holds, however it ends."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Final

from filelock import BaseFileLock, FileLock, Timeout

# s between two tries to take a lock that is held for milliseconds, and s after which it is given up.
_SOON, _LONGEST = 0.005, 60.0
# Locks that were given up, which are not waited for again as long as nobody frees them.
_GIVEN_UP: Final[set[Path]] = set()


def taken_lock(path: Path) -> BaseFileLock | None:
    """Take a lock that nobody else holds.

    Parameters
    ----------
    path : Path
        File of the lock; it is made where it is missing.

    Returns
    -------
    FileLock or None
        To be released; None where another one holds it, in this process or in another.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    # Any thread may release it.
    lock = FileLock(path, thread_local=False)
    try:
        lock.acquire(blocking=False)
    except Timeout:
        # Where the file cannot be made, filelock says the same as where another one holds it.
        if not path.exists():
            path.touch()
        return None
    except NotImplementedError as error:
        raise OSError(None, "its file system has no locks") from error
    return lock


@contextmanager
def held_lock(path: Path) -> Iterator[None]:
    """Wait for a lock and hold it within the block; a thread that holds it already goes on at once.

    Where its file cannot be written there is nothing to protect, and nothing is held. A holder that has not come back
    after a minute has been stopped, and is waited for no longer, nor again.

    Parameters
    ----------
    path : Path
        File of the lock; it is made where it is missing, with its folder.

    Yields
    ------
    None
    """
    with ExitStack() as held:
        longest = 0.0 if path in _GIVEN_UP else _LONGEST
        # filelock's Timeout is an OSError, too.
        with suppress(OSError, NotImplementedError):
            path.parent.mkdir(parents=True, exist_ok=True)
            try:
                held.enter_context(FileLock(path, is_singleton=True).acquire(timeout=longest, poll_interval=_SOON))
            except Timeout:
                _GIVEN_UP.add(path)
            else:
                _GIVEN_UP.discard(path)
        yield
