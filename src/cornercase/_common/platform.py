"""What differs between Linux, macOS and Windows; no other module asks which of them it is."""

from __future__ import annotations

import errno
import os
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

from cornercase._common.current_folder import kept_from_children

if TYPE_CHECKING:
    from psutil import Process

_WINDOWS: Final = sys.platform == "win32"
# A virus scanner or an indexer may hold a new file for a moment.
_TRIES, _PAUSE = 20, 0.05
# How a file system says that it does not know an order.
_UNKNOWN_ORDER: Final = (errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)
# From here on, exit codes are exceptions of Windows, which are known by their hexadecimal numbers.
_EXCEPTIONS: Final = 0xC0000000


def available_cpus() -> int:
    """Count the CPUs that this process may use.

    Returns
    -------
    int
    """
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def user_cache() -> Path:
    """Tell where a user's programs keep what they can make again.

    Returns
    -------
    Path
        ``XDG_CACHE_HOME`` where it is set, else the folder of the platform.
    """
    named = os.environ.get("XDG_CACHE_HOME") or (os.environ.get("LOCALAPPDATA") if _WINDOWS else None)
    if named:
        return Path(named)
    return Path.home() / ("Library/Caches" if sys.platform == "darwin" else ".cache")


def new_file_mode() -> int:
    """Tell which permissions a new file gets by the user's choice.

    Returns
    -------
    int
    """
    # The mask can only be read by setting it.
    mask = os.umask(0o077)
    os.umask(mask)
    return 0o666 & ~mask


def replace_file(source: Path, target: Path) -> None:
    """Give a file the name of another, which it replaces.

    Windows refuses it while a program has one of the two open, and programs that look at each new file do so for a
    moment.

    Parameters
    ----------
    source, target : Path

    Raises
    ------
    OSError
        It cannot be done; on Windows after a second of trying.
    """
    for _ in range(_TRIES if _WINDOWS else 0):
        with suppress(PermissionError):
            os.replace(source, target)
            return
        time.sleep(_PAUSE)
    os.replace(source, target)


def renames_open_files() -> bool:
    """Tell whether a file that a program has open can be renamed and replaced, which Windows refuses.

    Returns
    -------
    bool
    """
    return not _WINDOWS


def force_file(path: Path) -> None:
    """Wait until the content of a file is on the disk, where a power cut cannot reach it.

    Where the file system knows no such order, nothing is waited for.

    Parameters
    ----------
    path : Path

    Raises
    ------
    OSError
        The disk is full or broken.
    """
    # The user's choice of permissions may be that nobody writes to new files.
    _force(path, os.O_RDWR | getattr(os, "O_BINARY", 0) if _WINDOWS else os.O_RDONLY)


def force_folder(path: Path) -> None:
    """Wait until the names in a folder are on the disk; on Windows that is left to the file system.

    Parameters
    ----------
    path : Path

    Raises
    ------
    OSError
        The disk is full or broken.
    """
    if not _WINDOWS:
        # One may be writable and not readable.
        with suppress(PermissionError):
            _force(path, os.O_RDONLY)


def _force(path: Path, flags: int) -> None:
    handle = os.open(path, flags)
    try:
        if sys.platform == "darwin":
            import fcntl

            # There fsync leaves it to the disk when it writes what it has got.
            with suppress(OSError):
                fcntl.fcntl(handle, fcntl.F_FULLFSYNC)
                return
        os.fsync(handle)
    except OSError as error:
        if error.errno not in _UNKNOWN_ORDER:
            raise
    finally:
        os.close(handle)


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Let one process at a time go through the block for a folder, where the platform can; no file is made for it.

    Parameters
    ----------
    folder : Path

    Yields
    ------
    None
    """
    with ExitStack() as held:
        # Windows locks no folders, and some file systems none either.
        with suppress(OSError, ImportError):
            import fcntl

            handle = os.open(folder, os.O_RDONLY)
            held.callback(os.close, handle)
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def bytes_of_path(path: Path) -> bytes:
    """Return a path as the C library of this platform takes it: on Windows in the code page of the system.

    Parameters
    ----------
    path : Path

    Returns
    -------
    bytes

    Raises
    ------
    UnicodeEncodeError
        The code page has no such character.
    """
    return str(path).encode("mbcs", "strict") if _WINDOWS else os.fsencode(path)


def leave_terminal() -> None:
    """Keep Ctrl-C from this process, and make it and all that it will start a group where the platform has groups."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        # Of `interrupts_kept`.
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, *ending_signals()})
    if hasattr(os, "setsid"):
        os.setsid()


@contextmanager
def interrupts_kept(*others: signal.Signals) -> Iterator[None]:
    """Keep Ctrl-C, until the block ends, from this thread and the processes and threads that it starts.

    A process keeps it until `leave_terminal`, so that it is not interrupted while Python loads what it needs. Where
    the platform cannot do that, nothing is kept.

    Parameters
    ----------
    *others : signal.Signals
        To be kept too.

    Yields
    ------
    None
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})
    try:
        # Else it would be started with the first process, and let Ctrl-C through. If a terminal that is closed ended
        # it, who started it would miss it.
        with kept_from_children():
            resource_tracker.ensure_running()
        signal.pthread_sigmask(signal.SIG_SETMASK, {*before, signal.SIGINT, *others})
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def find_program(name: str, folders: Sequence[str] | None = None) -> str | None:
    """Find a program.

    Windows would look in the current folder first, in which a stranger's program may lie; that is left out.

    Parameters
    ----------
    name : str
        Without its ending.
    folders : sequence of str, optional
        Where to look; by default where the environment variable PATH says.

    Returns
    -------
    str or None
        Its path.
    """
    places = [one for one in (os.get_exec_path() if folders is None else folders) if one]
    if not _WINDOWS:
        return shutil.which(name, path=os.pathsep.join(places))
    endings = os.environ.get("PATHEXT", ".EXE").split(os.pathsep)
    files = (Path(place, name + ending) for place in places for ending in endings)
    return next((str(one) for one in files if one.is_file()), None)


def started_apart() -> dict[str, Any]:
    """Return the options of `subprocess.Popen` for a process that goes on when this one and its group are ended.

    Returns
    -------
    dict of str to object
        It has neither a terminal nor a window.
    """
    # What sys.platform says is looked at by checkers of types, too.
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NO_WINDOW | subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}


def process_tree(number: int, *, group: bool = True) -> list[Process]:
    """List a process and all that it has started, as far as they are there.

    Parameters
    ----------
    number : int
        Of the process, or of the group that it has made by `leave_terminal`.
    group : bool, default True
        Also those of that group whose parents have ended.

    Returns
    -------
    list of psutil.Process
    """
    # Only those who start processes need it.
    import psutil

    found: list[Process] = []
    with suppress(psutil.Error):
        process = psutil.Process(number)
        found += [process, *process.children(recursive=True)]
    if group and hasattr(os, "getpgid"):
        for one in psutil.process_iter():
            with suppress(OSError):
                if os.getpgid(one.pid) == number and one not in found:
                    found.append(one)
    return found


def end_process_tree(number: int) -> None:
    """End a process and all that it has started, at once.

    Parameters
    ----------
    number : int
        Of the process; where there is none any more, of the group that it has made by `leave_terminal`.
    """
    import psutil

    found = process_tree(number, group=False)
    if hasattr(os, "killpg"):
        with suppress(OSError):
            os.killpg(number, signal.SIGKILL)
    for one in found:
        with suppress(psutil.Error):
            one.kill()


def is_process(number: int) -> bool:
    """Say whether there is a process of a number.

    Parameters
    ----------
    number : int

    Returns
    -------
    bool
    """
    import psutil

    return psutil.pid_exists(number)


def ending_signals() -> tuple[signal.Signals, ...]:
    """List the signals, beside that of Ctrl-C, by which a user or a system asks a program to end.

    Returns
    -------
    tuple of signal.Signals
        Of schedulers and `timeout`, of a terminal that is closed, of Ctrl-Break.
    """
    names = ("SIGTERM", "SIGHUP", "SIGBREAK")
    return tuple(getattr(signal, name) for name in names if hasattr(signal, name))


def signal_main_thread(number: int) -> None:
    """Send a signal to the main thread of this process, which stops waiting where the platform can do that.

    Parameters
    ----------
    number : int
        Of the signal.
    """
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, number)
    else:
        signal.raise_signal(number)


def ended_from_outside(code: int | None) -> bool:
    """Tell whether a process was ended by somebody else: by a user, or by the system for want of memory.

    Parameters
    ----------
    code : int or None
        As in `multiprocessing.Process.exitcode`.

    Returns
    -------
    bool
        Always False on Windows, where it cannot be told.
    """
    return code is not None and code < 0 and -code in [getattr(signal, "SIGKILL", 0), *ending_signals()]


def words_of_exit_code(code: int | None) -> str:
    """Say how a process ended.

    Parameters
    ----------
    code : int or None
        As in `multiprocessing.Process.exitcode`.

    Returns
    -------
    str
        ``"ended with exit code 3"``, ``"was ended by SIGSEGV"``.
    """
    if not code:
        return "ended"
    if code < 0:
        names = {one.value: one.name for one in signal.Signals}
        return f"was ended by {names.get(-code, f'signal {-code}')}"
    return f"ended with exit code {code:#010x}" if code >= _EXCEPTIONS else f"ended with exit code {code}"


def parent_watch() -> Callable[[], bool]:
    """Remember which process has started this one.

    Returns
    -------
    callable
        Says whether that process is still there.
    """
    import psutil

    number = os.getppid()
    try:
        parent = psutil.Process(number)
    except psutil.Error:
        # It cannot be seen from here, as from inside a container.
        return lambda: os.getppid() == number
    # On Windows `getppid` stays the same after that process has ended.
    return lambda: os.getppid() == number and parent.is_running()


def forgive_narrow_output() -> None:
    """Let output to a file or a pipe replace the characters that its encoding lacks, instead of ending the program.

    On Windows that is a code page of 256 characters, unless the user says otherwise.
    """
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="replace")


def bytes_in_holes(path: Path) -> int:
    """Return how many bytes of a file take no space on the disk yet.

    Parameters
    ----------
    path : Path

    Returns
    -------
    int
        0 where files have no holes.
    """
    if sys.platform == "win32":
        return 0
    status = path.stat()
    return max(status.st_size - 512 * status.st_blocks, 0)


def fill_holes(path: Path) -> None:
    """Let a file take its space on the disk, where the platform can.

    Parameters
    ----------
    path : Path

    Raises
    ------
    OSError
        There is not enough space.
    """
    if sys.platform == "linux":
        with path.open("r+b") as file:
            os.posix_fallocate(file.fileno(), 0, path.stat().st_size)
