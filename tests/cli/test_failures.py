"""What is left over of any failure is one sentence; the traceback is for who asks for it."""

from __future__ import annotations

import errno
import json
import subprocess
import sys

import pytest

from conftest import moving, scenario_file
from cornercase import simulators
from cornercase._common.text.sanitize import format_json
from helpers.command_line import X, cornercase


def failing(error):
    def check(*arguments, **options):
        if isinstance(error, RecursionError):
            return check(*arguments, **options)
        raise error

    return check


FAULTS = {
    "a fault": (ZeroDivisionError("division\nby zero"), ("fault of cornercase itself", "ZeroDivisionError", "please report")),
    "a key": (KeyError("x"), ("KeyError: 'x'", "please report")),
    "a fault that says little": (AssertionError(), ("AssertionError", "please report")),
    "memory": (MemoryError(), ("needs more memory than available",)),
    "recursion": (RecursionError(), ("nested too deep", "please report")),
    "a full disk": (OSError(errno.ENOSPC, "No space left on device"), ("No space left on device", "make room")),
    "a named file": (PermissionError(errno.EACCES, "Permission denied", "/a/b.csv"), ("/a/b.csv: ", "Permission denied")),
    "a long message": (ValueError("\x1b[2J" + "x" * 100_000), ("\\x1b[2J", "please report")),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_it_is_one_sentence_with_the_file(monkeypatch, name):
    error, words = FAULTS[name]
    monkeypatch.setattr(simulators, "check", failing(error))
    monkeypatch.delenv("CORNERCASE_DEBUG", raising=False)
    result = cornercase("check", X)
    assert (result.returncode, result.stdout) == (2, "")
    (line,) = result.stderr.splitlines()
    assert line.startswith("cornercase: ")
    assert len(line) < 1500
    assert all(word in line for word in words)
    if not isinstance(error, OSError):
        assert str(X) in line


def test_the_traceback_is_for_who_asks_for_it(monkeypatch):
    monkeypatch.setattr(simulators, "check", failing(ZeroDivisionError("no")))
    monkeypatch.delenv("CORNERCASE_DEBUG", raising=False)
    asked = cornercase("--debug", "check", X)
    assert asked.returncode == 2
    assert "Traceback (most recent call last)" in asked.stderr
    assert "please report" in asked.stderr.splitlines()[-1]
    # Asked for once is not asked for ever.
    assert "Traceback" not in cornercase("check", X).stderr
    monkeypatch.setenv("CORNERCASE_DEBUG", "1")
    assert "Traceback" in cornercase("check", X).stderr


def test_an_exception_stays_one_in_python(monkeypatch):
    monkeypatch.setattr(simulators, "check", failing(ZeroDivisionError("no")))
    with pytest.raises(ZeroDivisionError):
        simulators.check(X, None, strict=False)


def test_ctrl_c_is_no_failure(monkeypatch):
    monkeypatch.setattr(simulators, "check", failing(KeyboardInterrupt()))
    result = cornercase("check", X)
    assert (result.returncode, "Traceback" in result.stderr) == (130, False)


def test_orders_to_the_terminal_in_options_are_written_out():
    result = cornercase("show", "--no\x1b[2J")
    assert result.returncode == 2
    assert "--no\\x1b[2J" in result.stderr
    assert "\x1b" not in result.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="pipes end otherwise there")
@pytest.mark.parametrize("more", [(), ("--json",)])
def test_who_reads_only_the_head_gets_no_complaint(more):
    code = "from cornercase.cli import main; main()"
    running = subprocess.Popen(
        [sys.executable, "-c", code, "metrics", *more], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert running.stdout is not None
    assert running.stderr is not None
    # Closed before anything is written.
    running.stdout.close()
    assert running.stderr.read() == b""
    running.stderr.close()
    assert running.wait() == 1


def test_json_is_valid_whatever_is_in_it():
    value = {"a": float("nan"), "b": [float("inf"), 1.5], "c\x1b\x9b": "\ud800é\n"}
    text = format_json(value)
    assert json.loads(text, parse_constant=pytest.fail) == {"a": None, "b": [None, 1.5], "c\x1b\x9b": "\ud800é\n"}
    assert not set(text) & {"\x1b", "\x9b", "\ud800"}
    text.encode()


def test_what_is_told_of_a_file_has_lines_of_bounded_length(tmp_path):
    path = scenario_file(tmp_path, init=moving())
    path.write_text(path.read_text().replace("<CatalogLocations/>", f"<CatalogLocations/><{'N' * 30_000}/>"))
    checked = cornercase("check", path)
    assert "NNN" in checked.stdout
    assert max(map(len, checked.stdout.splitlines())) <= 1400
    simulated = cornercase("simulate", path, "--duration", "1", "-o", tmp_path / "r.csv")
    assert max(map(len, simulated.stderr.splitlines())) <= 1500
