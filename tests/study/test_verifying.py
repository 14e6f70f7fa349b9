"""What `verify` takes for a study, damaged or not, and what it refuses."""

from __future__ import annotations

import sqlite3
from contextlib import closing

import numpy as np
import pytest

from cornercase import SimulationError
from cornercase.study import StudyFile
from cornercase.study._checksums import insert_rows
from cornercase.study._codec import pack_arrays
from cornercase.study._recovery.rebuild import rebuild_study
from helpers.command_line import cornercase
from helpers.synthetic_study import SPACE, about

POINTS = np.array([[0.25, 0.5], [0.5, 0.25]])


@pytest.fixture
def path(tmp_path):
    with StudyFile.create(tmp_path / "s.db", about(SPACE, "distance")) as study:
        study.writer.add_pending(1, POINTS, SPACE.values(POINTS))
        study.writer.record_failure(1, SimulationError("told"))
    return tmp_path / "s.db"


def run(path, *statements):
    with closing(sqlite3.connect(path)) as connection, connection:
        for one in statements:
            connection.execute(one)


@pytest.mark.parametrize("repair", [(), ("--repair",)])
@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "is empty, and not a study; copy the study here again, or remove the file"),
        (b"time,entity\n0.0,Ego\n" * 1000, "is not a cornercase study, or nothing is left of one"),
        (bytes(100_000), "is not a cornercase study, or nothing is left of one"),
    ],
)
def test_what_is_no_study_is_bad_input(tmp_path, content, told, repair):
    (tmp_path / "a.db").write_bytes(content)
    result = cornercase("verify", tmp_path / "a.db", *repair)
    assert result.returncode == 2
    assert told in result.stderr
    assert result.stdout == ""
    assert [one.name for one in tmp_path.iterdir()] == ["a.db"]


@pytest.mark.parametrize("repair", [(), ("--repair",)])
@pytest.mark.parametrize(
    ("statement", "told"),
    [
        ("PRAGMA user_version = 6", "has schema version 6, but this cornercase reads version 1 only"),
        ("PRAGMA application_id = 1196444487", "is a database, but not a cornercase study"),
    ],
)
def test_a_study_of_another_version_or_of_another_program_is_left_as_it_is(path, statement, told, repair):
    run(path, statement)
    before = path.read_bytes()
    result = cornercase("verify", path, *repair)
    assert result.returncode == 2
    assert told in result.stderr
    assert path.read_bytes() == before
    assert [one.name for one in path.parent.iterdir()] == ["s.db"]


def test_a_database_of_another_program_is_bad_input(tmp_path):
    run(tmp_path / "a.db", "CREATE TABLE songs (name TEXT)", "INSERT INTO songs VALUES ('one')")
    result = cornercase("verify", tmp_path / "a.db", "--repair")
    assert result.returncode == 2
    assert "is not a cornercase study" in result.stderr


def test_results_of_scenarios_that_are_not_there_are_damage_that_a_repair_removes(path):
    with closing(sqlite3.connect(path)) as connection, connection:
        insert_rows(connection, "notes", [(999, "of nobody")])
        insert_rows(connection, "courses", [(999, "distance", 1.0, pack_arrays({"course": np.ones(3)}))])
    result = cornercase("verify", path)
    assert result.returncode == 1
    for table in ("notes", "courses"):
        assert f"its table {table} has rows that belong to no row of its table scenarios: 1" in result.stdout
    with StudyFile.open(path) as study:
        recovered = rebuild_study(path, path.with_name("rebuilt.db"))
        assert [*recovered.rounds] == [row.id for row in study.rows()]
    assert cornercase("verify", path.with_name("rebuilt.db")).returncode == 0


def test_a_study_whose_head_is_zeroed_is_a_damaged_one(path):
    path.write_bytes(bytes(100) + path.read_bytes()[100:])
    result = cornercase("verify", path)
    assert result.returncode == 1
    assert "SQLite says" in result.stdout


def test_nobody_writes_where_sqlite_finds_something_wrong_in_what_is_not_read(path):
    # A page that no table has is a damage that no reader meets.
    data = path.read_bytes()
    pages = int.from_bytes(data[28:32], "big") + 1
    path.write_bytes(data[:28] + pages.to_bytes(4, "big") + data[32:] + b"\xff" * 4096)
    assert cornercase("show", path).returncode == 0
    result = cornercase("analyze", path)
    assert result.returncode == 2
    assert "is damaged: SQLite says" in result.stderr
    assert cornercase("verify", path).returncode == 1


@pytest.mark.parametrize("repair", [(), ("--repair",)])
def test_a_study_that_another_program_keeps_to_itself_is_not_damaged(path, repair, monkeypatch):
    # Do not wait half a minute.
    monkeypatch.setattr("cornercase.study._connection.open_connection.__defaults__", (0.1,))
    with closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("PRAGMA locking_mode = EXCLUSIVE")
        other.execute("PRAGMA user_version = 1")
        result = cornercase("verify", path, *repair)
    assert result.returncode == 2
    assert "another program has locked it" in result.stderr
    assert result.stdout == ""
    assert cornercase("verify", path).returncode == 0
    assert [one.name for one in path.parent.iterdir()] == ["s.db"]
