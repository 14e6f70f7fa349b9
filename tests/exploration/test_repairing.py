"""`verify --repair`: locking, the copy of the damaged file, and the memory limit."""

from __future__ import annotations

import os
import shutil
import sqlite3
import sys
from contextlib import closing
from pathlib import Path

import pytest

import cornercase as cc
from cornercase._common.errors import InputError
from cornercase.exploration import _repair as repair
from cornercase.study import StudyFile, write_note
from cornercase.study._database import open_note_transaction
from cornercase.study._lease import Lease
from helpers.command_line import X, cornercase


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    path: Path = tmp_path_factory.mktemp("whole") / "s.db"
    cc.explore(
        X, path, ego="Ego", other="Pedestrian", metrics=["wttc"], ranges=["ego_start=20:60"],
        optimizer="sobol", budget=4, duration=4.0, time_step=0.2,
    )  # fmt: skip
    return path


@pytest.fixture
def damaged(whole, tmp_path) -> Path:
    path: Path = tmp_path / "s.db"
    shutil.copy(whole, path)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE courses SET score = score + 1 WHERE scenario = 2")
    return path


def contents(path: Path) -> dict[str, list[object]]:
    with closing(sqlite3.connect(path)) as connection:
        return {name: connection.execute(f"SELECT * FROM {name}").fetchall() for name in ("scenarios", "courses")}


def test_the_damaged_study_is_kept_under_another_name(whole, damaged):
    before = damaged.read_bytes()
    for kept in ("s.db.damaged", "s.db.damaged-2"):
        assert cornercase("verify", damaged, "--repair", "--scenario", X).returncode == 0
        assert contents(damaged) == contents(whole)
        assert (damaged.parent / kept).read_bytes() == before
        assert damaged.stat().st_nlink == 1
        damaged.write_bytes(before)


def test_a_study_that_another_one_writes_to_is_not_repaired(damaged):
    with StudyFile.open(damaged, readonly=False):
        result = cornercase("verify", damaged, "--repair", "--scenario", X)
    assert result.returncode == 2
    assert f"another cornercase is writing to it (process {os.getpid()})" in result.stderr
    assert sorted(one.name for one in damaged.parent.iterdir()) == ["s.db"]


def test_there_is_a_study_of_its_name_whatever_stops_the_repair(whole, damaged, monkeypatch):
    before = damaged.read_bytes()

    def killed(*given):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("cornercase._common.io.atomic.replace_file", killed)
        assert cornercase("verify", damaged, "--repair", "--scenario", X).returncode == 130
    assert damaged.read_bytes() == before
    # It has two names now, so nobody may write to it.
    assert cornercase("verify", damaged, "--repair", "--scenario", X).returncode == 0
    assert contents(damaged) == contents(whole)
    assert sorted(one.name for one in damaged.parent.iterdir()) == ["s.db", "s.db.damaged"]


def test_rows_that_still_stood_in_the_log_are_brought_back(whole, tmp_path):
    original = tmp_path / "original.db"
    shutil.copy(whole, original)
    damaged = tmp_path / "s.db"
    with StudyFile.open(original):
        # A reader prevents the log from being checkpointed into the file.
        write_note(original, 2, "looked at")
        for ending in ("", "-wal"):
            shutil.copy(f"{original}{ending}", f"{damaged}{ending}")
    damaged.write_bytes(bytes(100) + damaged.read_bytes()[100:])
    result = cornercase("verify", damaged, "--repair", "--scenario", X)
    with StudyFile.open(damaged) as study:
        assert list(study.notes().values()) == ["looked at"], result.stdout
    assert contents(damaged) == contents(whole)


def test_what_does_not_fit_into_memory_is_said_before(damaged):
    # A gap in the file, which takes no space.
    os.truncate(damaged, 100_000_000)
    result = cornercase("verify", damaged, "--repair", "--scenario", X, "--memory", "500MB")
    assert result.returncode == 2
    assert "which is more than --memory 500 MB; give more." in result.stderr
    assert sorted(one.name for one in damaged.parent.iterdir()) == ["s.db"]


@pytest.fixture
def meanwhile(monkeypatch):
    """Run an action while scenarios are run again, or before another step of the repair."""

    def let(action, step="simulator_from_config"):
        plain = getattr(repair, step)

        def after_action(*given):
            action()
            return plain(*given)

        monkeypatch.setattr(repair, step, after_action)

    return let


def repaired(path: Path):
    return cornercase("verify", path, "--repair", "--scenario", X)


def test_42_s3_nobody_writes_to_a_study_while_it_is_repaired(whole, damaged, meanwhile):
    said = []

    def write():
        # As `write_note` does, without the usual wait for the lock.
        with pytest.raises(InputError) as error, open_note_transaction(damaged, timeout=0.1):
            pass
        said.append(str(error.value))
        # The first step of every explorer, without that wait, too.
        with closing(sqlite3.connect(damaged, timeout=0.1)) as explorer, pytest.raises(sqlite3.Error, match="locked"):
            Lease.acquire(damaged, explorer)
        # Reading is allowed.
        with StudyFile.open(damaged) as reader:
            assert len(reader.rows()) == 4
        # Waits 5 s for the lock.
        assert repaired(damaged).returncode == 2

    meanwhile(write)
    assert repaired(damaged).returncode == 0
    assert "another program has locked it (such as `verify --repair`)" in said[0]
    assert contents(damaged) == contents(whole)
    write_note(damaged, 1, "brakes late")
    assert sorted(one.name for one in damaged.parent.iterdir()) == ["s.db", "s.db.damaged"]


@pytest.mark.parametrize("step", ["rebuild_study", "_require_repeatable_search"])
def test_42_s3_a_note_that_is_written_while_a_damaged_study_is_read_stays(damaged, meanwhile, step):
    written = []

    def write():
        if step == "rebuild_study":
            write_note(damaged, 1, "brakes late")
        else:
            with pytest.raises(InputError), open_note_transaction(damaged, timeout=0.1):
                pass
        written.append(step)

    meanwhile(write, step)
    result = repaired(damaged)
    assert written
    if step == "rebuild_study":
        assert result.returncode == 2
        assert f"{damaged}: was written to during the repair, so nothing was replaced" in result.stderr
        with StudyFile.open(damaged) as study:
            assert study.notes() == {1: "brakes late"}
        assert [one.name for one in damaged.parent.iterdir()] == ["s.db"]
    else:
        assert result.returncode == 0


def explored_further(whole: Path, damaged: Path) -> None:
    """Thirty scenarios in an intact copy that replaced the study."""
    other = damaged.with_name("other.db")
    shutil.copy(whole, other)
    os.replace(other, damaged)
    cc.explore(
        X, damaged, ego="Ego", other="Pedestrian", metrics=["wttc"], ranges=["ego_start=20:60"],
        optimizer="sobol", budget=34, duration=4.0, time_step=0.2,
    )  # fmt: skip


@pytest.mark.skipif(sys.platform == "win32", reason="files that are open cannot be written by others there")
@pytest.mark.parametrize("readable", [True, False])
@pytest.mark.parametrize("how", ["copied over", "renamed", "removed", "explored"])
def test_42_s3_what_is_put_in_place_of_a_study_while_it_is_repaired_stays(whole, damaged, meanwhile, how, readable):
    before = damaged.read_bytes()
    if not readable:
        damaged.write_bytes(bytes(100) + before[100:])
    backup = whole.read_bytes()

    def put():
        if how == "copied over":
            damaged.write_bytes(backup)
        elif how == "explored":
            explored_further(whole, damaged)
        elif how == "removed":
            damaged.unlink()
        else:
            other = damaged.with_name("backup.db")
            other.write_bytes(backup)
            os.replace(other, damaged)

    meanwhile(put)
    result = repaired(damaged)
    assert result.returncode == 2
    told = {"copied over": "was written to", "removed": "was removed"}.get(how, "was replaced by another file")
    assert f"s.db: {told} during the repair, so nothing was replaced" in result.stderr
    assert not damaged.with_name("s.db.damaged").exists()
    if how == "removed":
        assert not damaged.exists()
    elif how == "explored":
        with StudyFile.open(damaged) as study:
            assert len(study.finished_rows()) == 34
    else:
        with closing(sqlite3.connect(damaged)) as connection:
            assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        assert contents(damaged) == contents(whole)


@pytest.mark.parametrize("step", ["simulator_from_config", "_describe_changed_tables", "_keep_damaged_file"])
def test_42_s3_an_interrupted_repair_leaves_the_study_as_it_was(damaged, meanwhile, step):
    before = damaged.read_bytes()

    def interrupt():
        raise KeyboardInterrupt

    meanwhile(interrupt, step)
    assert repaired(damaged).returncode == 130
    assert damaged.read_bytes() == before
    assert [one.name for one in damaged.parent.iterdir()] == ["s.db"]
    write_note(damaged, 1, "nobody keeps it any more")


@pytest.mark.skipif(sys.platform == "win32", reason="files that are open stay there")
def test_42_s3_who_waited_for_a_study_that_was_replaced_does_not_write_to_the_earlier_file(whole, damaged, monkeypatch):
    plain = Lease.acquire

    def replaced_before(path, connection):
        other = damaged.with_name("other.db")
        shutil.copy(whole, other)
        os.replace(damaged, damaged.with_name("s.db.damaged"))
        os.replace(other, damaged)
        return plain(path, connection)

    monkeypatch.setattr(Lease, "acquire", replaced_before)
    with pytest.raises(InputError, match="was replaced by another file just now"):
        StudyFile.open(damaged, readonly=False)
    with closing(sqlite3.connect(damaged.with_name("s.db.damaged"))) as connection:
        assert connection.execute("SELECT count(*) FROM lease").fetchone() == (0,)


@pytest.mark.usefixtures("no_cache")
def test_42_10_a_repair_names_the_study_where_its_scenario_is_not_found(damaged, tmp_path, monkeypatch):
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    result = cornercase("verify", damaged, "--repair")
    assert result.returncode == 2
    assert (
        f"{damaged}: the scenario file '{X.name}' was not found beside the study, in the current folder"
        in result.stderr
    )


def test_a_repair_runs_no_driver_that_only_the_condition_of_a_study_names(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "named_only.py").write_text(
        "from pathlib import Path\n\nimport cornercase as cc\n\nPath('was-run').write_text('')\n\n\n"
        "class Reference(cc.SystemUnderTest):\n    def step(self, view, dt):\n        return -1.0\n"
    )
    study = tmp_path / "s.db"
    explored = cornercase(
        "explore", X, "--range", "ego_start=20:60", "--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc",
        "--critical-if", "collision and not reference:named_only:Reference", "--driver", "Ego=cautious",
        "--optimizer", "sobol", "--budget", 4, "-o", study,
    )  # fmt: skip
    assert explored.returncode == 0, explored.stderr
    assert (tmp_path / "was-run").exists()
    (tmp_path / "was-run").unlink()
    sys.modules.pop("named_only", None)
    with closing(sqlite3.connect(study)) as connection, connection:
        connection.execute("UPDATE courses SET score = score + 1 WHERE scenario = 2")
    before = study.read_bytes()
    result = cornercase("verify", study, "--repair", "--scenario", X)
    assert result.returncode == 2
    assert "its critical condition uses the driver 'named_only:Reference'" in result.stderr
    assert not (tmp_path / "was-run").exists()
    assert "named_only" not in sys.modules
    assert study.read_bytes() == before


@pytest.mark.usefixtures("no_cache")
def test_a_repair_decides_again_with_the_road_who_is_at_fault_or_says_that_it_could_not(tmp_path, monkeypatch):
    for file in (X.parents[1] / "t_intersection").iterdir():
        shutil.copy(file, tmp_path)
    scenario, study = tmp_path / "t_intersection.xosc", tmp_path / "s.db"
    cc.explore(
        scenario, study, ego="Ego", other="C", metrics=["wttc"], drivers={"Ego": "normal"}, optimizer="sobol",
        budget=1, duration=15.0,
        ranges=["ego_sync_s=10.3:10.31", "c_start_time=4.58:4.581", "c_routing_distance=36.6:36.61"],
    )  # fmt: skip

    def culprits() -> list[str]:
        with StudyFile.open(study) as opened:
            return [hit.fault.who for hits in opened.impacts().values() for hit in hits if hit.fault]

    def lose_digests() -> None:
        with closing(sqlite3.connect(study)) as connection, connection:
            connection.execute("DELETE FROM digests")

    before = culprits()
    assert before == ["ego"]
    lose_digests()
    assert repair.repair(study).lost_content == ()
    assert culprits() == before
    lose_digests()
    scenario.unlink()
    monkeypatch.chdir(tmp_path)
    lost = " ".join(repair.repair(study).lost_content)
    assert "who is at fault in scenario 1, as far as the road says so" in lost
    assert "the scenario file 't_intersection.xosc' was not found beside the study" in lost
