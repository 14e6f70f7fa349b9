"""The benchmark that kills workers at random, with a few kills."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("distributed")

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "worker_kills.py"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="it kills as Unix does")
def test_killed_workers_leave_no_trace_in_the_study(tmp_path):
    command = [sys.executable, str(BENCHMARK), "--kills", "2", "--seed", "1", "--json", str(tmp_path / "found.json")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    found = json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))
    assert done.returncode == 0, done.stdout
    assert found["differs"] == "nothing"
    assert (found["workers killed"], found["done"], found["last exit code"]) == (2, 36, 0)
