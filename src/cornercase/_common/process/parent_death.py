"""Let a child process die with its parent."""

from __future__ import annotations

import os
import signal
import tempfile
import threading
import time
from contextlib import suppress
from multiprocessing import parent_process
from multiprocessing.connection import wait
from pathlib import Path
from types import FrameType
from typing import Final

from cornercase._common.platform import list_process_tree, signal_main_thread

# Seconds for this process to end its children and clean up.
_GRACE_PERIOD: Final = 2.0


def exit_with_parent() -> None:
    """Watch the parent of this `multiprocessing` process, and exit soon after the parent has died.

    Call this function in the main thread. When the parent has died, `SystemExit` is raised in the main thread as soon
    as Python code runs. If the process is still running two seconds later, it is killed with its children. Compiled
    code that blocks all other threads also blocks this exit; then the parent's `Reaper` ends the process.
    """
    parent = parent_process()
    assert parent is not None
    parent_died = threading.Event()

    def handle_sigterm(number: int, frame: FrameType | None) -> None:
        if parent_died.is_set():
            raise SystemExit(128 + number)
        # A SIGTERM from anybody else ends this process as usual.
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(number)

    signal.signal(signal.SIGTERM, handle_sigterm)

    def wait_for_parent() -> None:
        wait([parent.sentinel])
        parent_died.set()
        signal_main_thread(signal.SIGTERM)
        time.sleep(_GRACE_PERIOD)
        _kill_process_tree_and_exit()

    threading.Thread(target=wait_for_parent, daemon=True, name="lifeline").start()


def exit_when_stdin_closes() -> None:
    """Exit this process as soon as its standard input closes, which happens when the process at the other end dies."""

    def wait_for_end_of_input() -> None:
        with suppress(OSError):
            while os.read(0, 4096):
                pass
        os._exit(1)

    threading.Thread(target=wait_for_end_of_input, daemon=True, name="lifeline").start()


def _kill_process_tree_and_exit() -> None:
    import psutil

    for process in list_process_tree(os.getpid()):
        with suppress(psutil.Error):
            if process.pid != os.getpid():
                process.kill()
    os._exit(1)


def set_temporary_folder(folder: Path) -> None:
    """Make this process and its children use `folder` for temporary files."""
    tempfile.tempdir = str(folder)
    for name in ("TMPDIR", "TEMP", "TMP"):
        os.environ[name] = str(folder)
