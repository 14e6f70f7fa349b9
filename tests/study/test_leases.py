"""Who may write to a study, by whatever name, and what becomes of one that loses it."""

from __future__ import annotations

import os
import shutil
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from functools import partial

import numpy as np
import pytest

from cornercase import SimulationError
from cornercase._common.errors import InputError, StudyLostError
from cornercase.study import StudyFile, write_note
from cornercase.study._study_file import open_or_create_study
from helpers.synthetic_study import SPACE, about

POINTS = np.array([[0.25, 0.5], [0.5, 0.25]])


@pytest.fixture
def path(tmp_path):
    with StudyFile.create(tmp_path / "s.db", about(SPACE, "distance")) as study:
        study.writer.add_pending(1, POINTS, SPACE.values(POINTS))
    return tmp_path / "s.db"


def holders(path):
    with closing(sqlite3.connect(path)) as connection:
        return connection.execute("SELECT * FROM lease").fetchall()


def set_holder(path, **values):
    with closing(sqlite3.connect(path)) as connection, connection:
        for name, value in values.items():
            connection.execute(f"UPDATE lease SET {name} = ?", (value,))


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights there")
def test_one_writes_by_whatever_name(path):
    os.symlink(path, path.with_name("another.db"))
    with StudyFile.open(path, readonly=False), pytest.raises(InputError, match="another cornercase is writing to it"):
        StudyFile.open(path.with_name("another.db"), readonly=False)
    StudyFile.open(path.with_name("another.db"), readonly=False).close()
    assert holders(path) == []


def test_a_file_of_several_names_is_not_written(path):
    # SQLite keeps a log beside each name, and would not see what was written by another one.
    with StudyFile.open(path, readonly=False) as study:
        os.link(path, path.with_name("another.db"))
        with pytest.raises(InputError, match=r"another\.db: has 2 hard links"):
            StudyFile.open(path.with_name("another.db"), readonly=False)
        study.writer.record_failure(1, SimulationError("as before"))
    with pytest.raises(InputError, match="has 2 hard links"):
        StudyFile.open(path, readonly=False)
    path.with_name("another.db").unlink()
    StudyFile.open(path, readonly=False).close()


def test_nothing_beside_the_study_is_its_lock(path):
    with StudyFile.open(path, readonly=False):
        assert sorted(one.name for one in path.parent.iterdir()) == ["s.db", "s.db-shm", "s.db-wal"]
        # Reading is the default, and does not block writers.
        with StudyFile.open(path) as reader:
            assert reader.readonly
    with StudyFile.open(path), StudyFile.open(path, readonly=False):
        pass
    assert [one.name for one in path.parent.iterdir()] == ["s.db"]


def test_a_killed_process_leaves_its_study_to_the_next_one(path):
    code = f"import os; from cornercase.study import StudyFile; s = StudyFile.open({str(path)!r}, readonly=False); print('open', flush=True); os._exit(9)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "open\n"
    assert len(holders(path)) == 1
    StudyFile.open(path, readonly=False).close()
    assert holders(path) == []


def test_a_study_that_was_never_closed_is_not_locked_for_ever(path):
    study = StudyFile.open(path, readonly=False)
    del study
    StudyFile.open(path, readonly=False).close()


def test_one_on_another_machine_counts_as_dead_when_it_has_not_been_heard_of(path):
    study = StudyFile.open(path, readonly=False)
    set_holder(path, machine="elsewhere", host="far away", beat=time.time() - 60.0)
    with pytest.raises(InputError, match="on far away"):
        StudyFile.open(path, readonly=False)
    set_holder(path, beat=time.time() - 600.0)
    with StudyFile.open(path, readonly=False) as taken:
        taken.writer.record_failure(1, SimulationError("of the new one"))
        # The first one had only been asleep: it notices before it writes.
        with pytest.raises(StudyLostError, match="took over this study"):
            study.writer.record_failure(2, SimulationError("of the old one"))
        assert [row.state for row in taken.rows()] == ["failed", "pending"]
    study.close()


@pytest.mark.parametrize("beat", ["text", 1e300, None])
def test_a_lease_that_is_none_keeps_nobody_out(path, beat):
    with StudyFile.open(path, readonly=False):
        pass
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("INSERT INTO lease VALUES ('a', 'b', 'c', 1, 2.0, ?)", (beat if beat else "",))
    StudyFile.open(path, readonly=False).close()
    assert holders(path) == []


@pytest.mark.skipif(sys.platform == "win32", reason="files that are open stay there")
def test_a_study_that_is_gone_or_another_one_ends_what_writes_to_it(path):
    other = path.with_name("other.db")
    shutil.copy(path, other)
    before = other.read_bytes()
    study = StudyFile.open(path, readonly=False)
    path.unlink()
    with pytest.raises(StudyLostError, match="was removed while this command was writing to it"):
        study.writer.record_failure(1, SimulationError("nowhere"))
    assert [one.name for one in path.parent.iterdir()] == ["other.db"]
    shutil.copy(other, path)
    study = StudyFile.open(path, readonly=False)
    study.writer.record_failure(1, SimulationError("here"))
    os.replace(shutil.copy(other, path.with_name("third.db")), path)
    with pytest.raises(StudyLostError, match="was replaced by another file"):
        study.writer.record_failure(2, SimulationError("elsewhere"))
    # What was written to the one that is gone is not taken for the log of the one that is there.
    assert path.read_bytes() == other.read_bytes() == before
    with StudyFile.open(path) as there:
        assert [row.state for row in there.rows()] == ["pending", "pending"]


@pytest.mark.skipif(sys.platform == "win32", reason="files that are open stay there")
def test_a_study_that_is_moved_takes_all_with_it_that_was_stored(path):
    study = StudyFile.open(path, readonly=False)
    study.writer.record_failure(1, SimulationError("here"))
    moved = path.rename(path.with_name("moved.db"))
    with pytest.raises(StudyLostError, match="was removed while this command was writing to it"):
        study.writer.record_failure(2, SimulationError("there"))
    # Later calls get the same error.
    with pytest.raises(StudyLostError, match="was removed while this command was writing to it"):
        study.rows()
    with StudyFile.open(moved) as opened:
        assert [row.state for row in opened.rows()] == ["failed", "failed"]
    assert [one.name for one in path.parent.iterdir()] == ["moved.db"]


@pytest.mark.skipif(sys.platform == "win32", reason="files that are open cannot be written by others there")
@pytest.mark.parametrize("closes", [True, False])
def test_a_study_that_is_copied_over_ends_what_writes_to_it_and_stays_as_it_is(path, closes):
    other = path.with_name("other.db")
    with StudyFile.create(other, about(SPACE, "distance")) as made:
        made.writer.add_pending(1, POINTS[:1], SPACE.values(POINTS[:1]))
    study = StudyFile.open(path, readonly=False)
    study.writer.record_failure(1, SimulationError("stays in the log"))
    # The same file under the same name, as `cp` leaves it.
    path.write_bytes(other.read_bytes())
    end = study.close if closes else partial(study.writer.record_failure, 2, SimulationError("nowhere"))
    with pytest.raises(StudyLostError, match="it was overwritten or truncated"):
        end()
    assert path.read_bytes() == other.read_bytes()
    assert sorted(one.name for one in path.parent.iterdir()) == ["other.db", "s.db"]
    with pytest.raises(StudyLostError, match="it was overwritten or truncated"):
        study.rows()


@pytest.mark.skipif(sys.platform == "win32", reason="files that are open cannot be written by others there")
def test_a_study_that_is_cut_ends_what_writes_to_it(path):
    study = StudyFile.open(path, readonly=False)
    os.truncate(path, 0)
    with pytest.raises(StudyLostError, match="overwritten or truncated"):
        study.writer.record_failure(1, SimulationError("nowhere"))
    assert path.read_bytes() == b""
    with pytest.raises(InputError, match="is empty, and not a study"):
        StudyFile.open(path)


def test_others_may_write_their_notes_and_read_while_one_writes(path):
    with StudyFile.open(path, readonly=False) as study:
        for number in (1, 2):
            write_note(path, number, "seen")
            with closing(sqlite3.connect(path)) as connection:
                connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
            study.writer.record_failure(number, SimulationError("told"))
    with StudyFile.open(path) as study:
        assert [row.state for row in study.rows()] == ["failed", "failed"]
        assert study.notes() == {1: "seen", 2: "seen"}


@pytest.mark.parametrize("noted", [True, False])
def test_42_s3_a_new_study_is_not_removed_with_a_note_that_somebody_wrote(tmp_path, noted):
    path = tmp_path / "new.db"

    def begin():
        with open_or_create_study(path, about(SPACE, "distance")) as study:
            study.writer.add_pending(1, POINTS, SPACE.values(POINTS))
            if noted:
                write_note(path, 1, "looked at")
            raise InputError("as before")

    with pytest.raises(InputError, match="as before"):
        begin()
    assert path.exists() == noted
