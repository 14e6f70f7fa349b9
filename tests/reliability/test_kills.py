"""Explorations that are killed: a few at night, a thousand kills by `make torture`."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("distributed")
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="it looks for processes as only Linux shows them")

PROGRAM = Path(__file__).with_name("kills.py")


def killed(*options, seconds):
    command = [sys.executable, str(PROGRAM), "--seed", os.environ.get("CORNERCASE_TORTURE_SEED", "0"), *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=seconds, check=False)
    print(done.stdout)
    assert done.returncode == 0, done.stdout[-5000:] + done.stderr[-2000:]
    return done.stdout


@pytest.mark.slow
def test_a_killed_exploration_goes_on_as_if_undisturbed_and_leaves_nothing():
    chosen = ("level-set builtin", "sobol waiting --workers 2")
    said = killed("--kills", "12", *(word for one in chosen for word in ("--only", one)), seconds=300)
    assert "SIGKILLs" in said


@pytest.mark.torture
def test_a_thousand_kills_lose_double_and_change_nothing_and_leave_nothing():
    assert "SIGKILLs                                 1000" in killed("--kills", "1000", seconds=7200)
