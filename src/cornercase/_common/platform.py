"""Differences between Linux, macOS and Windows; no other module checks the platform."""

from __future__ import annotations

import ctypes
import errno
import os
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing import resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from cornercase._common.current_folder import isolate_children

if TYPE_CHECKING:
    from psutil import Process

_WINDOWS: Final = sys.platform == "win32"
# A virus scanner or an indexer may hold a new file for a moment.
_MAX_ATTEMPTS, _RETRY_DELAY = 20, 0.05
# errno values of file systems that do not support an operation.
_NOT_SUPPORTED_ERRNOS: Final = (errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)
# Higher exit codes are Windows exceptions, which are known by hexadecimal numbers.
_FIRST_WINDOWS_EXCEPTION_CODE: Final = 0xC0000000


def count_available_cpus() -> int:
    """Return the number of CPUs that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def user_cache_folder() -> Path:
    """Return the folder for caches of the user's programs: ``XDG_CACHE_HOME``, or by default the platform's folder."""
    configured = os.environ.get("XDG_CACHE_HOME") or (os.environ.get("LOCALAPPDATA") if _WINDOWS else None)
    if configured:
        return Path(configured)
    return Path.home() / ("Library/Caches" if sys.platform == "darwin" else ".cache")


def new_file_mode() -> int:
    """Return the permissions of a new file according to the umask."""
    # The umask can only be read by setting it.
    mask = os.umask(0o077)
    os.umask(mask)
    return 0o666 & ~mask


def replace_file(source: Path, target: Path) -> None:
    """Rename `source` to `target`, replacing the file there.

    Windows refuses while a program has one of both files open, as virus scanners do for a moment. So renaming is
    retried for a second.
    """
    for _ in range(_MAX_ATTEMPTS if _WINDOWS else 0):
        with suppress(PermissionError):
            os.replace(source, target)
            return
        time.sleep(_RETRY_DELAY)
    os.replace(source, target)


def can_rename_open_files() -> bool:
    """Return whether the platform can rename and replace a file that is open; False on Windows."""
    return not _WINDOWS


def fsync_file(path: Path) -> None:
    """Sync the content of a file to disk, if the file system supports that; OSError if the disk is full or broken."""
    # The user's umask may forbid writing to new files.
    _fsync(path, os.O_RDWR | getattr(os, "O_BINARY", 0) if _WINDOWS else os.O_RDONLY)


def fsync_folder(path: Path) -> None:
    """Sync the list of names in a folder to disk; does nothing on Windows."""
    if not _WINDOWS:
        # A folder may be writable but not readable.
        with suppress(PermissionError):
            _fsync(path, os.O_RDONLY)


def _fsync(path: Path, flags: int) -> None:
    handle = os.open(path, flags)
    try:
        if sys.platform == "darwin":
            import fcntl

            # On macOS, fsync does not flush the disk's own cache.
            with suppress(OSError):
                fcntl.fcntl(handle, fcntl.F_FULLFSYNC)
                return
        os.fsync(handle)
    except OSError as error:
        if error.errno not in _NOT_SUPPORTED_ERRNOS:
            raise
    finally:
        os.close(handle)


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Lock a folder during the block without making a file; without effect if the platform cannot lock folders."""
    with ExitStack() as stack:
        # Windows and some file systems cannot lock folders.
        with suppress(OSError, ImportError):
            import fcntl

            handle = os.open(folder, os.O_RDONLY)
            stack.callback(os.close, handle)
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def try_lock_file(handle: int) -> bool:
    """Try to lock an open file; return False if another process has locked it. The lock ends with this process."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def encode_path(path: Path) -> bytes:
    """Encode a path for the C library.

    On Windows, the system's code page is used, which may lack a character of the path.
    """
    return str(path).encode("mbcs", "strict") if _WINDOWS else os.fsencode(path)


def detach_from_terminal() -> None:
    """Ignore Ctrl-C in this process, and give it a process group of its own if the platform has groups.

    Children of the process belong to the same group.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        # Blocked by `block_interrupts`.
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, *termination_signals()})
    if hasattr(os, "setsid"):
        os.setsid()


@contextmanager
def block_interrupts(*other_signals: signal.Signals) -> Iterator[None]:
    """Block Ctrl-C and `other_signals` in this thread, and in processes and threads that it starts within the block.

    In a child process, the signals stay blocked until the child calls `detach_from_terminal`, so they do not interrupt
    its imports. On platforms without signal masks, such as Windows, this does nothing.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})
    try:
        # Started now, as it would otherwise start with the first process and unblock Ctrl-C. SIGHUP is blocked so that
        # closing the terminal does not end it unnoticed.
        with isolate_children():
            resource_tracker.ensure_running()
        signal.pthread_sigmask(signal.SIG_SETMASK, {*before, signal.SIGINT, *other_signals})
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def add_library_folder(folder: Path) -> None:
    """On Windows, add a folder in which shared libraries find other libraries that they need; else do nothing."""
    if sys.platform == "win32":
        os.add_dll_directory(str(folder))


def load_c_library() -> ctypes.CDLL:
    """Return a C library, which has functions such as ``calloc`` and ``free``.

    This is the C library of this process; on Windows it is ``msvcrt``, while Python itself uses another one.
    """
    return ctypes.CDLL("msvcrt" if _WINDOWS else None)


def split_command(command: str) -> list[str]:
    """Split a command into words as a shell does; backslashes separate folders on Windows."""
    if not _WINDOWS:
        return shlex.split(command)
    return [word.strip('"') for word in shlex.split(command, posix=False)]


def find_program(name: str, folders: Sequence[str] | None = None) -> str | None:
    """Return the path of a program in `folders` (default: PATH), or None.

    The current folder, where Windows would look first, is skipped because programs there are not trusted.
    """
    folders_to_search = [path for path in (os.get_exec_path() if folders is None else folders) if path]
    if not _WINDOWS:
        return shutil.which(name, path=os.pathsep.join(folders_to_search))
    endings = os.environ.get("PATHEXT", ".EXE").split(os.pathsep)
    files = (Path(folder, name + ending) for folder in folders_to_search for ending in endings)
    return next((str(path) for path in files if path.is_file()), None)


def detached_process_options() -> dict[str, Any]:
    """Return options of `subprocess.Popen` for a process that outlives this one and has no terminal or window."""
    # Written so that type checkers understand it.
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NO_WINDOW | subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}


def list_process_tree(process_id: int, *, include_group: bool = True) -> list[Process]:
    """Return a process and its descendants that are running.

    With `include_group`, orphaned members of its process group are included, too.
    """
    # Imported late: only needed to start processes.
    import psutil

    processes: list[Process] = []
    with suppress(psutil.Error):
        process = psutil.Process(process_id)
        processes += [process, *process.children(recursive=True)]
    if include_group and hasattr(os, "getpgid"):
        for process_of_group in psutil.process_iter():
            with suppress(OSError):
                if os.getpgid(process_of_group.pid) == process_id and process_of_group not in processes:
                    processes.append(process_of_group)
    return processes


def kill_process_tree(process_id: int) -> None:
    """Kill a process, its descendants and its process group."""
    import psutil

    processes = list_process_tree(process_id, include_group=False)
    if hasattr(os, "killpg"):
        with suppress(OSError):
            os.killpg(process_id, signal.SIGKILL)
    for process in processes:
        with suppress(psutil.Error):
            process.kill()


def is_process_running(process_id: int) -> bool:
    """Return whether a process with this id is running."""
    import psutil

    return psutil.pid_exists(process_id)


def termination_signals() -> tuple[signal.Signals, ...]:
    """Return termination signals other than Ctrl-C: SIGTERM, SIGHUP (terminal closed), SIGBREAK (Windows)."""
    names = ("SIGTERM", "SIGHUP", "SIGBREAK")
    return tuple(getattr(signal, name) for name in names if hasattr(signal, name))


def signal_main_thread(signal_number: int) -> None:
    """Send a signal to the main thread. On platforms that can signal threads, this interrupts a wait of that thread."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, signal_number)
    else:
        signal.raise_signal(signal_number)


def is_killed_externally(exit_code: int | None) -> bool:
    """Return whether the exit code of a `multiprocessing` process means that it was killed or ended from outside.

    Exit codes of crashes, such as that after SIGSEGV, do not count.
    """
    return (
        exit_code is not None
        and exit_code < 0
        and -exit_code in [getattr(signal, "SIGKILL", 0), *termination_signals()]
    )


def describe_exit_code(exit_code: int | None) -> str:
    """Describe the exit code of a `multiprocessing` process.

    Examples: ``"ended with exit code 3"``, ``"was ended by SIGSEGV"``.
    """
    if not exit_code:
        return "ended"
    if exit_code < 0:
        names = {number.value: number.name for number in signal.Signals}
        return f"was ended by {names.get(-exit_code, f'signal {-exit_code}')}"
    return (
        f"ended with exit code {exit_code:#010x}"
        if exit_code >= _FIRST_WINDOWS_EXCEPTION_CODE
        else f"ended with exit code {exit_code}"
    )


def make_parent_check() -> Callable[[], bool]:
    """Return a function that tells whether the parent of this process is still running."""
    import psutil

    number = os.getppid()
    try:
        parent = psutil.Process(number)
    except psutil.Error:
        # The parent is invisible, as from inside a container.
        return lambda: os.getppid() == number
    # On Windows, `getppid` does not change when the parent ends.
    return lambda: os.getppid() == number and parent.is_running()


def replace_unencodable_output() -> None:
    """Make stdout and stderr replace characters that their encoding lacks, instead of failing.

    On Windows, the default encoding of redirected output has only 256 different characters.
    """
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="replace")


def count_unallocated_bytes(path: Path) -> int:
    """Return how many bytes of a sparse file take no disk space yet; 0 if the platform has no sparse files."""
    if sys.platform == "win32":
        return 0
    status = path.stat()
    return max(status.st_size - 512 * status.st_blocks, 0)


def allocate_file(path: Path) -> None:
    """Allocate the disk space of a sparse file on Linux; OSError if there is not enough space."""
    if sys.platform == "linux":
        with path.open("r+b") as file:
            os.posix_fallocate(file.fileno(), 0, path.stat().st_size)
