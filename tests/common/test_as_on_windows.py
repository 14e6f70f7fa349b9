"""cornercase without POSIX features; tests/as_on_windows runs the whole suite like this."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from helpers.command_line import SPACE, X

FOLDER = Path(__file__).parents[1] / "as_on_windows"
PROGRAM = """
import os, signal, sys
from pathlib import Path

assert not any(hasattr(os, name) for name in ("setsid", "killpg", "fork", "sched_getaffinity"))
assert not hasattr(signal, "SIGKILL")
try:
    import fcntl
except ImportError:
    pass
else:
    raise AssertionError("fcntl is there")

from cornercase.simulators._create import create_simulator
from helpers import fake_simulators as fake_simulators
from helpers.fake_simulators import Plan
from cornercase.scenario import ConcreteScenario


def run(folder):
    plan = Plan(folder, {1: ["child"], 2: ["crash", "well"]})
    concretes = [ConcreteScenario(Path("none.xosc"), {"k": float(k)}) for k in range(4)]
    with create_simulator("failing", {"plan": plan}, workers=2, timeout=2.0, retries=1) as simulator:
        return [str(one) if isinstance(one, Exception) else int(one.x[0, 0]) for one in simulator.run(concretes)]


# Workers import this file, too.
if __name__ == "__main__":
    print(run(Path(sys.argv[1])))
"""


def without_posix(*command, cwd=None):
    path = os.pathsep.join([str(FOLDER), str(FOLDER.parent), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, *map(str, command)], capture_output=True, text=True, cwd=cwd, timeout=300,
        env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip


def test_workers_crash_and_hang_and_their_children_end(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    done = without_posix(program, tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[0, 'the simulator did not end within 2 s, tried 2 times', 2, 3]"


@pytest.mark.slow
def test_an_exploration_goes_on_and_is_written_by_one_only(tmp_path):
    explore = [
        "-c", "from cornercase.cli import main; main()", "explore", X, "--space", SPACE, "--ego", "Ego", "--other",
        "Pedestrian", "--metric", "wttc", "--optimizer", "sobol", "--workers", "2", "-o", tmp_path / "study.db",
    ]  # fmt: skip
    for budget in (2, 4):
        done = without_posix(*explore, "--budget", budget)
        assert done.returncode == 0, done.stderr
        assert f"{budget} scenarios" in done.stdout
    holding = f"""
from cornercase.study import StudyFile
import subprocess, sys
with StudyFile.open({str(tmp_path / "study.db")!r}, readonly=False):
    done = subprocess.run({[sys.executable, *map(str, explore)]!r}, capture_output=True, text=True)
print(done.returncode, done.stderr)
"""
    done = without_posix("-c", holding)
    assert done.stdout.startswith("2 "), done.stderr
    assert "another cornercase is writing to it" in done.stdout
