"""What `verify --repair` does beside bringing rows back: it is alone, keeps what was there, and fits into memory."""

from __future__ import annotations

import os
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

import cornercase as cc
from command_line import X, cornercase
from cornercase.study import Study, write_note


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
    with Study.open(damaged, readonly=False):
        result = cornercase("verify", damaged, "--repair", "--scenario", X)
    assert result.returncode == 2
    assert f"another cornercase is writing to it (process {os.getpid()})" in result.stderr
    assert sorted(one.name for one in damaged.parent.iterdir()) == ["s.db"]


def test_there_is_a_study_of_its_name_whatever_stops_the_repair(whole, damaged, monkeypatch):
    before = damaged.read_bytes()

    def killed(*given):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("cornercase._common.pending_files.replace_file", killed)
        assert cornercase("verify", damaged, "--repair", "--scenario", X).returncode == 130
    assert damaged.read_bytes() == before
    # It has two names now, which is one too many to write to it.
    assert cornercase("verify", damaged, "--repair", "--scenario", X).returncode == 0
    assert contents(damaged) == contents(whole)
    assert sorted(one.name for one in damaged.parent.iterdir()) == ["s.db", "s.db.damaged"]


def test_rows_that_still_stood_in_the_log_are_brought_back(whole, tmp_path):
    original = tmp_path / "original.db"
    shutil.copy(whole, original)
    damaged = tmp_path / "s.db"
    with Study.open(original):
        # A reader keeps the log from being taken into the file.
        write_note(original, 2, "looked at")
        for ending in ("", "-wal"):
            shutil.copy(f"{original}{ending}", f"{damaged}{ending}")
    damaged.write_bytes(bytes(100) + damaged.read_bytes()[100:])
    result = cornercase("verify", damaged, "--repair", "--scenario", X)
    with Study.open(damaged) as study:
        assert list(study.notes().values()) == ["looked at"], result.stdout
    assert contents(damaged) == contents(whole)


def test_what_does_not_fit_into_memory_is_said_before(damaged, monkeypatch):
    monkeypatch.setattr("cornercase.exploration.repairing._COPIES", 1e6)
    result = cornercase("verify", damaged, "--repair", "--scenario", X, "--memory", "2GB")
    assert result.returncode == 2
    assert "which is more than --memory 2 GB; give more." in result.stderr
    assert sorted(one.name for one in damaged.parent.iterdir()) == ["s.db"]
