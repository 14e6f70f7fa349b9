"""Clean-up of child processes and folders when a process is killed, even inside compiled code."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from cornercase._common.errors import InputError
from cornercase._common.process.reaper import Reaper
from helpers.waiting import lives, until

# Makes a folder, starts a child and a grandchild, and waits.
PROGRAM = """
import os, subprocess, sys, time
from cornercase._common.process.reaper import Reaper

guardian = Reaper()
folder = guardian.make_temporary_folder()
(folder / "file").write_text("x")
wait = [sys.executable, "-c", "import time; time.sleep(600)"]
one = subprocess.Popen([sys.executable, "-c", f"import subprocess; subprocess.run({wait})"])
guardian.watch_process(one.pid)
with guardian.watch_new_processes():
    other = subprocess.Popen(wait, start_new_session=True)
print(folder, one.pid, other.pid, flush=True)
time.sleep(600)
"""


def test_what_a_killed_process_leaves_is_ended_and_removed():
    process = subprocess.Popen([sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    folder, first, second = process.stdout.readline().split()
    (child,) = until(psutil.Process(int(first)).children)
    every = [int(first), int(second), child.pid]
    assert all(map(lives, every))
    assert (Path(folder) / "file").exists()
    process.kill()
    process.communicate()
    until(lambda: not any(map(lives, every)) and not Path(folder).exists())


def test_a_process_ends_with_the_one_at_the_other_end_of_its_input():
    lasting = "from cornercase._common.process.parent_death import end_with_input; import time; end_with_input(); time.sleep(600)"
    starter = (
        "import subprocess, sys, time; one = subprocess.Popen([sys.executable, '-c', sys.argv[1]], stdin=subprocess.PIPE);"
        "print(one.pid, flush=True); time.sleep(600)"
    )
    process = subprocess.Popen([sys.executable, "-c", starter, lasting], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    number = int(process.stdout.readline())
    assert lives(number)
    process.kill()
    process.communicate()
    until(lambda: not lives(number))


def test_a_guardian_that_is_killed_is_replaced_and_one_with_nothing_to_guard_ends(tmp_path):
    with Reaper() as guardian:
        folder = guardian.make_temporary_folder()
        assert guardian._process is not None
        first = guardian._process.pid
        guardian._process.kill()
        guardian._process.wait()
        second = guardian.make_temporary_folder()
        assert guardian._process.pid != first
        number = guardian._process.pid
        guardian.remove_folder(folder)
        assert second.is_dir()
    assert not folder.exists()
    assert not second.exists()
    assert not psutil.pid_exists(number)


def test_a_place_for_temporary_files_that_is_missing_or_full_is_told(monkeypatch, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "missing"))
    with Reaper() as guardian, pytest.raises(InputError, match=r"No temporary folder.*TMPDIR"):
        guardian.make_temporary_folder()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is nothing that is always full")
def test_workers_say_where_the_disk_is_full_and_the_scenario_may_be_run_again(tmp_path):
    from cornercase._common.errors import RunLostError
    from cornercase.scenario import ConcreteScenario
    from cornercase.simulators.pool._simulator import WorkerSimulator
    from helpers.fake_simulators import Plan

    plan = Plan(tmp_path, {1: ["full", "well"], 2: ["full"]})
    concretes = [ConcreteScenario(Path("none.xosc"), {"k": float(k)}) for k in range(4)]
    with WorkerSimulator("failing", {"plan": plan}, retries=0) as simulator:
        found = list(simulator.run(concretes))
    assert [int(one.x[0, 0]) for one in found if not isinstance(one, Exception)] == [0, 1, 3]
    assert isinstance(found[2], RunLostError)
    assert "No space left on device" in str(found[2])
    assert str(found[2]).endswith("tried 2 times")
    assert os.listdir(tmp_path)
