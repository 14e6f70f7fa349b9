"""Locks between threads and between processes."""

from __future__ import annotations

import subprocess
import sys
import threading
import time

import pytest

from cornercase._common.io.locks import lock, try_lock

HOLDER = """
import sys, time
from pathlib import Path
from cornercase._common.io.locks import try_lock
lock = try_lock(Path(sys.argv[1]))
print(lock is not None, flush=True)
time.sleep(600)
"""


def test_one_process_at_a_time_holds_a_lock_and_its_end_frees_it(tmp_path):
    path = tmp_path / "study.db.lock"
    with subprocess.Popen([sys.executable, "-c", HOLDER, str(path)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().strip() == "True"
        assert try_lock(path) is None
        process.kill()
    lock = try_lock(path)
    assert lock is not None
    lock.release()


def test_one_process_holds_a_lock_once_and_any_thread_may_release_it(tmp_path):
    path = tmp_path / "study.db.lock"
    lock = try_lock(path)
    assert lock is not None
    assert try_lock(path) is None
    releasing = threading.Thread(target=lock.release)
    releasing.start()
    releasing.join()
    again = try_lock(path)
    assert again is not None
    again.release()


def test_a_lock_that_cannot_be_made_is_an_error(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="file"):
        try_lock(tmp_path / "file" / "study.db.lock")


def test_a_thread_that_holds_a_lock_goes_on_and_others_wait(tmp_path):
    path, order = tmp_path / "cache" / "cornercase.lock", []
    inside, go_on = threading.Event(), threading.Event()

    def other():
        inside.wait()
        go_on.set()
        with lock(path):
            order.append("other")

    waiting = threading.Thread(target=other)
    waiting.start()
    with lock(path), lock(path):
        inside.set()
        go_on.wait()
        order.append("first")
    waiting.join()
    assert order == ["first", "other"]


def test_a_holder_that_does_not_come_back_is_waited_for_once(tmp_path):
    path, waited = tmp_path / "cornercase.lock", []
    stopped = try_lock(path)
    assert stopped is not None
    for _ in range(3):
        begun = time.monotonic()
        with lock(path, timeout=0.4):
            waited.append(time.monotonic() - begun)
    assert waited[0] >= 0.4
    assert max(waited[1:]) < 0.4
    stopped.release()
    # A holder that continues releases it for everybody.
    with lock(path):
        assert try_lock(path) is None


def test_where_nothing_can_be_written_nothing_is_locked(tmp_path):
    (tmp_path / "file").touch()
    with lock(tmp_path / "file" / "cornercase.lock"):
        pass
