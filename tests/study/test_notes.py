"""Notes on scenarios, written while others read the study and an explorer writes to it."""

from __future__ import annotations

import sqlite3
import threading
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from cornercase._common.errors import InputError
from cornercase.recordings import read_recording
from cornercase.scenario import ParameterSpace
from cornercase.study import StudyFile, write_note
from cornercase.study._database import open_note_transaction
from cornercase.study._notes import MAX_NOTE_LENGTH
from helpers.synthetic_study import about
from helpers.untrusted_files import change

SPACE = ParameterSpace.from_ranges(["a=0:10"])


@pytest.fixture
def explored(tmp_path):
    """A study that an explorer has open, with ten scenarios that were not run yet."""
    points = np.linspace(0.0, 1.0, 10)[:, None]
    with StudyFile.create(tmp_path / "study.db", about(SPACE, "distance")) as study:
        study.writer.add_pending(1, points, SPACE.values(points))
        yield study


def notes(path: Path) -> dict[int, str]:
    with StudyFile.open(path, readonly=True) as study:
        return study.notes()


def test_a_note_is_kept_changed_and_removed(explored):
    assert notes(explored.path) == {}
    assert "note" not in explored.table()
    write_note(explored.path, 3, "  brakes late\nsee the ticket <b>12</b> ")
    write_note(explored.path, 1, "übersehen 行人")
    assert notes(explored.path) == {1: "übersehen 行人", 3: "brakes late\nsee the ticket <b>12</b>"}
    assert explored.table()["note"].dropna().to_dict() == notes(explored.path)
    write_note(explored.path, 3, "brakes")
    write_note(explored.path, 1, " ")
    write_note(explored.path, 2, "")
    assert notes(explored.path) == {3: "brakes"}
    explored.writer.remove_scenarios()
    assert notes(explored.path) == {}


@pytest.mark.parametrize(
    ("scenario", "note", "said"),
    [
        (11, "there is none", "holds no scenario 11"),
        (-1, "x", "`scenario`"),
        (2**63, "x", "`scenario`"),
        (True, "x", "`scenario`"),
        (1, "x" * (MAX_NOTE_LENGTH + 1), "the limit is 2000"),
        (1, "half a character: \ud800", "cannot be encoded"),
        (1, "a\0b", "null character"),
        (1, 7, "not a text"),
    ],
)
def test_what_cannot_be_kept_is_refused_in_a_sentence(explored, scenario, note, said):
    with pytest.raises(InputError, match=said):
        write_note(explored.path, scenario, note)
    assert notes(explored.path) == {}


def test_notes_and_the_scenarios_of_an_explorer_do_not_disturb_each_other(explored, small_recording):
    course = np.ones(len(small_recording.time))
    failures: list[BaseException] = []

    def take_notes() -> None:
        try:
            for k in range(60):
                write_note(explored.path, k % 10 + 1, f"{k}")
        except BaseException as error:
            failures.append(error)

    taking = threading.Thread(target=take_notes)
    taking.start()
    rounds = 0
    while taking.is_alive():
        for scenario in range(1, 11):
            change_of = {"distance": (course * rounds, float(rounds))}
            if rounds == 0:
                explored.writer.record_result(scenario, small_recording, change_of)
            else:
                explored.writer.add_elapsed_time("simulate", 0.0)
        rounds += 1
    taking.join()
    assert not failures
    assert notes(explored.path) == {k + 1: f"{50 + k}" for k in range(10)}
    assert len(explored.finished_rows()) == 10


@pytest.fixture
def small_recording(tmp_path):
    rows = ["time,entity,kind,x,y,heading,speed,acceleration,length,width,center_x"]
    rows += [f"{t},{name},car,{t},{y},0,1,0,4,2,1" for t in (0.0, 0.1) for name, y in (("Ego", 0), ("B", 5))]
    (tmp_path / "r.csv").write_text("\n".join(rows) + "\n")
    return read_recording(tmp_path / "r.csv")


def test_a_writer_that_does_not_end_is_not_waited_for_forever(explored):
    with closing(sqlite3.connect(explored.path, isolation_level=None)) as stuck:
        stuck.execute("BEGIN IMMEDIATE")
        with pytest.raises(InputError, match="locked"), open_note_transaction(explored.path, timeout=0.1):
            pass


@pytest.mark.parametrize("value", ["zeroblob(5)", f"printf('%.{MAX_NOTE_LENGTH + 1}c', 'x')"])
def test_notes_of_a_stranger_that_are_none_are_refused(explored, value):
    change(explored.path, f"INSERT INTO notes VALUES (1, {value}, 0)")
    with pytest.raises(InputError, match="the note on the scenario 1"):
        notes(explored.path)


def test_a_note_sets_off_nothing_that_a_stranger_put_into_the_file(explored):
    explored.close()
    change(explored.path, "CREATE TRIGGER harm AFTER INSERT ON notes BEGIN DELETE FROM scenarios; END")
    with pytest.raises(InputError, match="trigger 'harm'"):
        write_note(explored.path, 1, "x")


def test_what_is_no_study_is_left_alone(tmp_path):
    with closing(sqlite3.connect(tmp_path / "other.db")) as connection, connection:
        connection.execute("CREATE TABLE notes (scenario, note)")
    with pytest.raises(InputError, match="not a cornercase study"):
        write_note(tmp_path / "other.db", 1, "x")
    with pytest.raises(InputError, match="no such study"):
        write_note(tmp_path / "missing.db", 1, "x")
