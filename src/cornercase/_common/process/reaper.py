"""Small child process, the reaper, that ends other child processes and removes folders when its parent has died.

A process that is killed cannot clean up, and its children may be in compiled code that never checks their parent. The
reaper process waits until its standard input closes, which happens however the parent died. Then it cleans up.
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
from cornercase._common.platform import detached_process_options, list_process_tree, termination_signals

if TYPE_CHECKING:
    from psutil import Process

# Seconds that processes have to end by themselves after their parent; seconds between checks; seconds in which removing
# a folder is tried again, as a process may still write into the folder.
_GRACE, _POLL_INTERVAL, _REMOVE_TIMEOUT = 2.5, 0.1, 1.0
# Environment variable of processes that are started within `Reaper.watch_new_processes`.
_MARK_VARIABLE: Final = "CORNERCASE_GUARDIAN"
_ENVIRONMENT_LOCK: Final = threading.Lock()
# Finds the package where this process found it.
_REAPER_CODE: Final = (
    "import sys; sys.path.insert(0, sys.argv[1]); from cornercase._common.process.reaper import"
    " run_reaper; run_reaper()"
)


class Reaper:
    """Handle of the reaper, a child process that cleans up after this process has ended or was killed.

    The reaper ends the processes and removes the folders that were registered with it. It is started with the first
    registration.

    >>> with Reaper() as reaper:
    ...     folder = reaper.make_temporary_folder()
    ...     folder.is_dir()
    True
    >>> folder.exists()
    False
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._resources: set[tuple[str, str]] = set()
        self._mark, self._n_watch_blocks = secrets.token_hex(12), 0
        # Asynchronous exploration starts workers from several threads.
        self._lock = threading.Lock()

    def watch_process(self, process_id: int) -> None:
        """Make the reaper end the process `process_id` and its children when the calling process ends or is killed."""
        self._set_guarded("process", str(process_id), is_guarded=True)

    def release_process(self, process_id: int) -> None:
        """Stop watching a process that has ended."""
        self._set_guarded("process", str(process_id), is_guarded=False)

    @contextmanager
    def watch_new_processes(self) -> Iterator[None]:
        """Watch all processes that any thread starts within the block, and their children.

        The reaper ends them when the calling process ends or is killed. Blocks may overlap.
        """
        self._set_guarded("mark", self._mark, is_guarded=True)
        # Processes inherit the mark, even if their parent dies.
        self._update_environment_mark(1)
        try:
            yield
        finally:
            self._update_environment_mark(-1)

    def _update_environment_mark(self, change: int) -> None:
        with _ENVIRONMENT_LOCK:
            self._n_watch_blocks += change
            other_marks = [mark for mark in os.environ.get(_MARK_VARIABLE, "").split() if mark != self._mark]
            if marks := other_marks + [self._mark] * bool(self._n_watch_blocks):
                os.environ[_MARK_VARIABLE] = " ".join(marks)
            else:
                del os.environ[_MARK_VARIABLE]

    def make_temporary_folder(self) -> Path:
        """Make a temporary folder that is removed when this process ends; `InputError` if it cannot be made."""
        try:
            path = Path(tempfile.gettempdir(), f"cornercase-{secrets.token_hex(6)}").absolute()
            # Announced first, so that it never exists without being guarded.
            self._set_guarded("folder", str(path), is_guarded=True)
            path.mkdir(mode=0o700)
        except OSError as error:
            raise InputError(
                f"No temporary folder can be created ({error.strerror or error}); free some space, or set"
                " the environment variable TMPDIR to another folder."
            ) from error
        return path

    def remove_folder(self, folder: Path) -> None:
        """Remove a folder that `make_temporary_folder` made."""
        shutil.rmtree(folder, ignore_errors=True)
        # If it cannot be removed now, the reaper may succeed when all processes have ended.
        if not folder.exists():
            self._set_guarded("folder", str(folder), is_guarded=False)

    def close(self) -> None:
        """Remove all remaining temporary folders, and end the reaper process."""
        for kind, name in sorted(self._resources):
            if kind == "folder":
                self.remove_folder(Path(name))
        with self._lock:
            if self._process is not None:
                _close_reaper_process(self._process)
                self._process = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _set_guarded(self, category: str, name: str, *, is_guarded: bool) -> None:
        with self._lock:
            if not is_guarded and (category, name) not in self._resources:
                return
            (self._resources.add if is_guarded else self._resources.discard)((category, name))
            if self._process is not None:
                try:
                    _send_message(self._process, category, name, is_guarded=is_guarded)
                    return
                except OSError:
                    # The reaper was killed; start another one.
                    _close_reaper_process(self._process)
            self._start_reaper_process()

    def _start_reaper_process(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", _REAPER_CODE, str(Path(__file__).parents[3])],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            # A working directory that nobody wants to remove.
            cwd=Path(sys.executable).anchor or None,
            **detached_process_options(),
        )
        # If it is killed at once, the next message fails, and starts another one.
        with suppress(OSError):
            for kind, name in self._resources:
                _send_message(self._process, kind, name, is_guarded=True)


def _close_reaper_process(process: subprocess.Popen[bytes]) -> None:
    assert process.stdin is not None
    with suppress(OSError):
        process.stdin.close()
    process.wait()


def _send_message(process: subprocess.Popen[bytes], category: str, name: str, *, is_guarded: bool) -> None:
    assert process.stdin is not None
    process.stdin.write(json.dumps([category, name, is_guarded]).encode() + b"\n")
    process.stdin.flush()


def run_reaper() -> None:
    """Run the reaper process: read messages on what to clean up until standard input closes, then clean up."""
    for number in (signal.SIGINT, *termination_signals()):
        signal.signal(number, signal.SIG_IGN)
    guarded = _read_messages(sys.stdin.buffer)
    process_ids = [int(name) for kind, name in guarded if kind == "process"]
    process_ids += _find_marked_processes({name for kind, name in guarded if kind == "mark"})
    if process_ids:
        _end_processes(process_ids)
    deadline = time.monotonic() + _REMOVE_TIMEOUT
    for folder in [name for kind, name in guarded if kind == "folder"]:
        while os.path.lexists(folder):
            shutil.rmtree(folder, ignore_errors=True)
            if time.monotonic() > deadline:
                break
            time.sleep(_POLL_INTERVAL / 10)


def _read_messages(source: IO[bytes]) -> set[tuple[str, str]]:
    """Read messages until the input ends, and return category and name of processes and folders to clean up."""
    guarded: set[tuple[str, str]] = set()
    for line in source:
        # The last line may be truncated.
        with suppress(ValueError):
            category, name, is_guarded = json.loads(line)
            (guarded.add if is_guarded else guarded.discard)((category, name))
    return guarded


def _find_marked_processes(marks: set[str]) -> list[int]:
    """Return ids of processes whose environment contains one of these marks."""
    import psutil

    process_ids = []
    for process in psutil.process_iter() if marks else ():
        # Environments of other users' processes are not readable.
        with suppress(psutil.Error, OSError):
            if process.pid != os.getpid() and marks.intersection(process.environ().get(_MARK_VARIABLE, "").split()):
                process_ids.append(process.pid)
    return process_ids


def _end_processes(process_ids: list[int]) -> None:
    """End processes and their children; kill processes that do not end in time."""
    import psutil

    processes = {process for number in process_ids for process in list_process_tree(number)}
    deadline = time.monotonic() + _GRACE
    while True:
        for process in list(processes):
            with suppress(psutil.Error):
                processes.update(process.children(recursive=True))
        running = [process for process in processes if _is_running(process)]
        if not running:
            return
        if time.monotonic() > deadline:
            break
        time.sleep(_POLL_INTERVAL)
    for process in running:
        with suppress(psutil.Error):
            process.kill()
    psutil.wait_procs(running, _REMOVE_TIMEOUT)


def _is_running(process: Process) -> bool:
    import psutil

    try:
        # The process id may have been reused.
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.Error:
        return False
