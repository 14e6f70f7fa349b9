"""A small process that outlives this one, to end what it has started and to remove its temporary folders.

A process that is killed can clear up nothing, and those that it has started may be inside compiled code that never
looks whether it is still there. So somebody else has to look: the guardian, which ends when its input does, however
that comes about.
"""

from __future__ import annotations

import json
import os
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final, Self

from cornercase._common.errors import InputError
from cornercase._common.platform import ending_signals, process_tree, started_apart

if TYPE_CHECKING:
    from psutil import Process

# s that processes have to end by themselves once the one that has started them is gone, between two looks at them, and
# for which it is tried to remove a folder in which one of them may still write.
_GRACE, _LOOKS, _REMOVES = 2.5, 0.1, 1.0
# The environment variable of those that are started within `Guardian.watch_all`.
_MARK: Final = "CORNERCASE_GUARDIAN"
_ENVIRONMENT: Final = threading.Lock()
# It finds the package where this process did.
_PROGRAM: Final = "import sys; sys.path.insert(0, sys.argv[1]); from cornercase._common.guardian import guard; guard()"


class Guardian:
    """Ends processes and removes folders once this process has ended, however it does.

    Its own process is started when there is first something to guard.

    Examples
    --------
    >>> with Guardian() as guardian:
    ...     folder = guardian.new_folder()
    ...     folder.is_dir()
    True
    >>> folder.exists()
    False
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._guarded: set[tuple[str, str]] = set()
        self._mark, self._watching = secrets.token_hex(12), 0
        # Threads of their own start the workers of a search without rounds.
        self._lock = threading.Lock()

    def watch(self, number: int) -> None:
        """Have a process, and all that it starts, ended.

        Parameters
        ----------
        number : int
            Of the process.
        """
        self._tell("process", str(number), guarded=True)

    def release(self, number: int) -> None:
        """Say that a process has ended.

        Parameters
        ----------
        number : int
            Of the process.
        """
        self._tell("process", str(number), guarded=False)

    @contextmanager
    def watch_all(self) -> Iterator[None]:
        """Have all processes ended, and all that they start, that are started within the block, in any thread.

        Blocks may overlap.

        Yields
        ------
        None
        """
        self._tell("mark", self._mark, guarded=True)
        # They are known by it whatever becomes of who has started them.
        self._count_watching(1)
        try:
            yield
        finally:
            self._count_watching(-1)

    def _count_watching(self, change: int) -> None:
        with _ENVIRONMENT:
            self._watching += change
            others = [one for one in os.environ.get(_MARK, "").split() if one != self._mark]
            if marks := others + [self._mark] * bool(self._watching):
                os.environ[_MARK] = " ".join(marks)
            else:
                del os.environ[_MARK]

    def new_folder(self) -> Path:
        """Make a temporary folder.

        Returns
        -------
        Path

        Raises
        ------
        InputError
            There is no place for temporary files, or it is full.
        """
        try:
            path = Path(tempfile.gettempdir(), f"cornercase-{secrets.token_hex(6)}").absolute()
            # First, so that it is there at no instant without being guarded.
            self._tell("folder", str(path), guarded=True)
            path.mkdir(mode=0o700)
        except OSError as error:
            raise InputError(
                f"No temporary folder can be made ({error.strerror or error}); free some space, or name another place"
                " by the environment variable TMPDIR."
            ) from error
        return path

    def remove(self, folder: Path) -> None:
        """Remove a folder that `new_folder` has made.

        Parameters
        ----------
        folder : Path
        """
        shutil.rmtree(folder, ignore_errors=True)
        # What could not be removed now may be so when all has ended.
        if not folder.exists():
            self._tell("folder", str(folder), guarded=False)

    def close(self) -> None:
        """Remove what is left, and end the guardian's process."""
        for kind, name in sorted(self._guarded):
            if kind == "folder":
                self.remove(Path(name))
        with self._lock:
            if self._process is not None:
                _dismiss(self._process)
                self._process = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _tell(self, kind: str, name: str, *, guarded: bool) -> None:
        with self._lock:
            if not guarded and (kind, name) not in self._guarded:
                return
            (self._guarded.add if guarded else self._guarded.discard)((kind, name))
            if self._process is not None:
                try:
                    _write(self._process, kind, name, guarded=guarded)
                    return
                except OSError:
                    # It was killed; another one takes over.
                    _dismiss(self._process)
            self._start()

    def _start(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", _PROGRAM, str(Path(__file__).parents[2])],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            # It holds no folder that somebody may want to remove.
            cwd=Path(sys.executable).anchor or None,
            **started_apart(),
        )
        # If it is killed at once, what is told next finds out.
        with suppress(OSError):
            for kind, name in self._guarded:
                _write(self._process, kind, name, guarded=True)


def _dismiss(process: subprocess.Popen[bytes]) -> None:
    """Let a guardian end, which may have been killed."""
    assert process.stdin is not None
    with suppress(OSError):
        process.stdin.close()
    process.wait()


def _write(process: subprocess.Popen[bytes], kind: str, name: str, *, guarded: bool) -> None:
    assert process.stdin is not None
    process.stdin.write(json.dumps([kind, name, guarded]).encode() + b"\n")
    process.stdin.flush()


def guard() -> None:
    """Be the guardian: read what is to be guarded until the input ends, and clear up what is left then."""
    for number in (signal.SIGINT, *ending_signals()):
        signal.signal(number, signal.SIG_IGN)
    guarded = _listen(sys.stdin.buffer)
    numbers = [int(name) for kind, name in guarded if kind == "process"]
    numbers += _marked({name for kind, name in guarded if kind == "mark"})
    if numbers:
        _end(numbers)
    deadline = time.monotonic() + _REMOVES
    for folder in [name for kind, name in guarded if kind == "folder"]:
        while os.path.lexists(folder):
            shutil.rmtree(folder, ignore_errors=True)
            if time.monotonic() > deadline:
                break
            time.sleep(_LOOKS / 10)


def _listen(source: IO[bytes]) -> set[tuple[str, str]]:
    """What is still guarded as the input ends."""
    guarded: set[tuple[str, str]] = set()
    for line in source:
        # The last one may be cut.
        with suppress(ValueError):
            kind, name, wanted = json.loads(line)
            (guarded.add if wanted else guarded.discard)((kind, name))
    return guarded


def _marked(marks: set[str]) -> list[int]:
    """Numbers of the processes with one of these marks."""
    import psutil

    found = []
    for one in psutil.process_iter() if marks else ():
        # Those of other users do not tell.
        with suppress(psutil.Error, OSError):
            if one.pid != os.getpid() and marks.intersection(one.environ().get(_MARK, "").split()):
                found.append(one.pid)
    return found


def _end(numbers: list[int]) -> None:
    """End processes and what they have started, by force those that do not end by themselves."""
    import psutil

    found = {one for number in numbers for one in process_tree(number)}
    deadline = time.monotonic() + _GRACE
    while True:
        for one in list(found):
            with suppress(psutil.Error):
                found.update(one.children(recursive=True))
        running = [one for one in found if _is_running(one)]
        if not running:
            return
        if time.monotonic() > deadline:
            break
        time.sleep(_LOOKS)
    for one in running:
        with suppress(psutil.Error):
            one.kill()
    psutil.wait_procs(running, _REMOVES)


def _is_running(process: Process) -> bool:
    import psutil

    try:
        # A number that was given again is that of another process.
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.Error:
        return False
