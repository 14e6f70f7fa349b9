"""A process that ends when the one that has started it does."""

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

from cornercase._common.platform import process_tree, signal_main_thread

# s that this process has to end what it has started and to clear up.
_GRACE: Final = 2.0


def end_with_parent() -> None:
    """End this process, which `multiprocessing` has started, soon after its parent has ended.

    What it does ends by `SystemExit` where Python can raise it. Else, and where that does not end it, it is ended two
    seconds later with all that it has started. Inside compiled code that lets no other thread run, that is left to the
    parent's `Guardian`.

    To be called in the main thread.
    """
    parent = parent_process()
    assert parent is not None
    lost = threading.Event()

    def end(number: int, frame: FrameType | None) -> None:
        if lost.is_set():
            raise SystemExit(128 + number)
        # Of anybody else it ends this process as it always does.
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(number)

    signal.signal(signal.SIGTERM, end)

    def watch() -> None:
        wait([parent.sentinel])
        lost.set()
        signal_main_thread(signal.SIGTERM)
        time.sleep(_GRACE)
        _end_all()

    threading.Thread(target=watch, daemon=True, name="lifeline").start()


def end_with_input() -> None:
    """End this process at once when its standard input does, as it does with the process at its other end."""

    def watch() -> None:
        with suppress(OSError):
            while os.read(0, 4096):
                pass
        os._exit(1)

    threading.Thread(target=watch, daemon=True, name="lifeline").start()


def _end_all() -> None:
    import psutil

    for one in process_tree(os.getpid()):
        with suppress(psutil.Error):
            if one.pid != os.getpid():
                one.kill()
    os._exit(1)


def keep_temporary_files_in(folder: Path) -> None:
    """Have this process, and all that it starts, put their temporary files into a folder.

    Parameters
    ----------
    folder : Path
    """
    tempfile.tempdir = str(folder)
    for name in ("TMPDIR", "TEMP", "TMP"):
        os.environ[name] = str(folder)
