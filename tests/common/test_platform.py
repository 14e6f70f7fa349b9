"""Platform differences, as far as they can be tested on one platform."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cornercase._common import platform
from cornercase._common.errors import InputError
from cornercase._common.io.atomic import atomic_write_group
from cornercase._common.io.files import atomic_write, make_portable_file_name
from helpers.waiting import lives, until


def test_a_tree_of_processes_ends_as_a_whole():
    inner = "import time; time.sleep(600)"
    outer = f"""
import subprocess, sys, time
child = subprocess.Popen([sys.executable, "-c", {inner!r}])
print(child.pid, flush=True)
time.sleep(600)
"""
    process = subprocess.Popen([sys.executable, "-c", outer], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    child = int(process.stdout.readline())
    platform.kill_process_tree(process.pid)
    process.communicate(timeout=120)
    until(lambda: not lives(child))
    platform.kill_process_tree(process.pid)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (None, "ended"),
        (0, "ended"),
        (3, "ended with exit code 3"),
        (-11, "was ended by SIGSEGV"),
        (-99, "was ended by signal 99"),
        (0xC0000005, "ended with exit code 0xc0000005"),
    ],
)
def test_exit_codes_of_all_platforms_have_words(code, words):
    assert platform.describe_exit_code(code) == words


def test_a_parent_that_is_gone_is_noticed(monkeypatch):
    watch, parent = platform.make_parent_check(), os.getppid()
    assert watch()
    # Any new parent; in a container or in the background, the parent of the tests may be 1 already.
    monkeypatch.setattr(os, "getppid", lambda: parent + 1)
    assert not watch()


def test_a_parent_that_is_gone_is_noticed_where_its_number_stays(monkeypatch):
    """As on Windows."""
    process = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    monkeypatch.setattr(os, "getppid", lambda: process.pid)
    watch = platform.make_parent_check()
    assert watch()
    process.communicate(b"\n", timeout=60)
    assert not watch()


def test_windows_keeps_its_cache_where_its_programs_do(monkeypatch, tmp_path):
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path))
    monkeypatch.setattr(platform, "_WINDOWS", True)
    assert platform.user_cache_folder() == tmp_path
    monkeypatch.setattr(platform, "_WINDOWS", False)
    assert platform.user_cache_folder().parent == Path.home()


def test_a_file_that_is_looked_at_for_a_moment_is_replaced_all_the_same(monkeypatch, tmp_path):
    tries = []

    def held(source, target, replace=os.replace):
        tries.append(source)
        if len(tries) < 3:
            raise PermissionError("held by another program")
        replace(source, target)

    monkeypatch.setattr(platform, "_WINDOWS", True)
    monkeypatch.setattr(os, "replace", held)
    with atomic_write(tmp_path / "file.txt") as temporary:
        temporary.write_text("new")
    assert (tmp_path / "file.txt").read_text() == "new"
    assert len(tries) == 3


def test_the_content_is_on_the_disk_before_it_gets_its_name_and_the_name_after_it(monkeypatch, tmp_path):
    told = []
    for name in ("fsync", "replace"):
        real = getattr(os, name)

        def order(*values, name=name, real=real):
            kind = "folder" if name == "fsync" and os.path.isdir(f"/proc/self/fd/{values[0]}") else "file"
            told.append((name, kind))
            return real(*values)

        monkeypatch.setattr(os, name, order)
    with atomic_write(tmp_path / "new" / "file.txt") as temporary:
        temporary.write_text("new")
    if sys.platform == "linux":
        assert told[:3] == [("fsync", "file"), ("replace", "file"), ("fsync", "folder")]
        # The new folder's, too.
        assert told[3:] == [("fsync", "folder")]


def test_files_that_are_written_together_appear_together_or_not_at_all(tmp_path):
    (tmp_path / "a.txt").write_text("earlier")

    def write(failing: str) -> None:
        with atomic_write_group():
            for name in ("a.txt", "new/b.txt"):
                with atomic_write(tmp_path / name) as temporary:
                    temporary.write_text("new")
                    assert (tmp_path / "a.txt").read_text() == "earlier"
                    if name == failing:
                        raise OSError(28, "No space left on device")

    with pytest.raises(InputError, match=r"b\.txt: cannot be written"):
        write("new/b.txt")
    assert [one.name for one in tmp_path.iterdir()] == ["a.txt"]
    assert (tmp_path / "a.txt").read_text() == "earlier"
    write("none")
    assert {one.name for one in tmp_path.rglob("*.*")} == {"a.txt", "b.txt"}


KILLED_WRITER = """
import os, sys
from cornercase._common.io.files import atomic_write
with atomic_write(sys.argv[1]) as temporary:
    temporary.with_name(temporary.name + "-journal").write_text("of SQLite")
    os.kill(os.getpid(), 9)
"""


def test_what_a_writer_in_another_container_of_this_name_writes_is_not_removed(tmp_path, monkeypatch):
    target = tmp_path / "file.txt"
    subprocess.run([sys.executable, "-c", KILLED_WRITER, str(target)], check=False)
    theirs = {one.name for one in tmp_path.iterdir()}
    assert len(theirs) == 2
    # Its processes are invisible here, so it is unknown whether the writer is alive.
    monkeypatch.setattr("cornercase._common.io.atomic._process_namespace", lambda: "pid:[1]")
    with atomic_write(target) as temporary:
        temporary.write_text("of this one")
    assert {one.name for one in tmp_path.iterdir()} == theirs | {"file.txt"}


def test_what_a_killed_writer_left_is_removed_and_what_a_living_one_writes_is_not(tmp_path):
    target = tmp_path / "file.txt"
    killed = subprocess.run([sys.executable, "-c", KILLED_WRITER, str(target)], check=False)
    assert killed.returncode != 0
    assert len(list(tmp_path.iterdir())) == 2
    (tmp_path / ".file.txt.other").write_text("of another program")
    with atomic_write(target) as first, atomic_write(target) as second:
        assert first != second
        first.write_text("one")
        second.write_text("two")
    assert {one.name for one in tmp_path.iterdir()} == {"file.txt", ".file.txt.other"}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="permissions are those of POSIX")
def test_a_new_file_has_the_permissions_of_the_users_choice(tmp_path):
    mask = os.umask(0o027)
    try:
        with atomic_write(tmp_path / "file.txt") as temporary:
            temporary.write_text("new")
        assert os.umask(0o027) == 0o027
    finally:
        os.umask(mask)
    assert (tmp_path / "file.txt").stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("clusters-ttc:accelerating=true.png", "clusters-ttc-accelerating=true.png"),
        ("a/b\\c?.csv", "a-b-c-.csv"),
        ("con.csv", "-con.csv"),
        ("COM1", "-COM1"),
        ("console.csv", "console.csv"),
        ("dots. .", "dots"),
        ("", "-"),
        ("a" * 200, "a" * 150),
        ("." + "ä" * 100, "-." + "ä" * 74),
        ("con." + "a" * 200, "-con." + "a" * 145),
        ("nul" + " " * 200 + "x", "-nul"),
    ],
)
def test_names_of_files_are_such_as_every_platform_takes(text, name):
    assert make_portable_file_name(text) == name


def test_output_in_a_narrow_encoding_loses_a_character_rather_than_the_program():
    program = """
from cornercase._common.platform import replace_unencodable_output
replace_unencodable_output()
print("m/s² ≥ π")
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, env={**os.environ, "PYTHONIOENCODING": "cp1252"}
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.decode("cp1252").strip() == "m/s² ? ?"


def test_a_worker_is_not_ended_by_the_ctrl_c_of_the_terminal():
    program = """
import os, signal
from cornercase._common.platform import detach_from_terminal
detach_from_terminal()
signal.raise_signal(signal.SIGINT)
print("still here", os.getsid(0) == os.getpid() if hasattr(os, "setsid") else True)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.strip() == "still here True", done.stderr
