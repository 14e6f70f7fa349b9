from __future__ import annotations

import csv
import io
import os
import sqlite3
import sys
from contextlib import closing
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.distance import cdist, squareform

from conftest import same_recording
from cornercase._common.errors import InputError, SimulationError
from cornercase._common.typing import FloatArray
from cornercase.recordings import Collision, Recording, read_recording
from cornercase.recordings._recording import MOTION_ARRAYS
from cornercase.scenario import Constraint, ParameterDeclaration, ParameterSpace
from cornercase.study import StudyFile
from helpers.checksums import reseal
from helpers.synthetic_study import about

SPACE = ParameterSpace.from_ranges(["a=0:10", "b=0:1:0.1"])
META = about(SPACE, "distance", "wttc", seed=3)
POINTS = np.array([[0.25, 0.5], [0.1, 0.05], [1 / 3, 0.95]])


def recording(seed: int = 0) -> Recording:
    random = np.random.default_rng(seed)
    motion = random.normal(size=(5, 2, 40)) * 10.0 ** random.integers(-9, 9, (5, 2, 40))
    motion[:, 1, 30:] = np.nan
    return Recording(
        time=np.arange(40) * 0.05,
        names=("Ego", "Übergang"),
        object_types=("car", "pedestrian"),
        **dict(zip(MOTION_ARRAYS, motion, strict=True)),
        length=np.array([4.5, 0.5]),
        width=np.array([2.0, 0.6]),
        center_x=np.array([1.4, 0.0]),
        collisions=(Collision(0.1, ("Ego", "Übergang")),),
    )


def courses(seed: int = 0) -> dict[str, tuple[FloatArray, float]]:
    course = np.random.default_rng(seed).normal(size=40)
    course[3] = np.nan
    return {"distance": (course, float(np.nanmin(course))), "wttc": (course**2, 0.5 + seed)}


@pytest.fixture
def study(tmp_path):
    with StudyFile.create(tmp_path / "study.db", META) as made:
        made.writer.add_pending(1, POINTS, SPACE.values(POINTS))
        made.writer.record_result(1, recording(), courses())
        made.writer.record_failure(2, SimulationError("the road ends"))
        yield made


def test_what_is_put_in_comes_out(study):
    with StudyFile.open(study.path, readonly=True) as reader:
        assert reader.meta == META
        assert reader.space.parameters == SPACE.parameters
        rows = reader.rows()
        assert [(r.id, r.round, r.state, r.error) for r in rows] == [
            (1, 1, "done", None), (2, 1, "failed", "the road ends"), (3, 1, "pending", None)
        ]  # fmt: skip
        np.testing.assert_array_equal([r.point for r in rows], POINTS)
        assert [r.values for r in rows] == SPACE.values(POINTS)
        assert same_recording(reader.recording(1), recording())
        np.testing.assert_array_equal(reader.course(1, "distance"), courses()["distance"][0])
        assert reader.scores("wttc").tolist() == [0.5]
        for absent in (2, 3):
            with pytest.raises(InputError, match=f"scenario {absent} was not run"):
                reader.recording(absent)
        with pytest.raises(InputError, match=r"has no scenario 99; its scenarios are 1 to 3\.$"):
            reader.recording(99)
        with pytest.raises(
            InputError, match=r"^`scenario` 'first': give the id of a scenario, a whole number from 1 on; its sc"
        ):
            reader.course(cast("Any", "first"), "distance")
        with pytest.raises(InputError, match="no course of the metric 'pet'"):
            reader.scores("pet")


def test_who_collides_is_read_without_the_rest_of_the_recordings(study):
    study.writer.record_result(3, replace(recording(1), collisions=()), courses(1))
    assert study.collisions() == {1: recording().collisions, 3: ()}


def test_a_reader_sees_each_scenario_as_soon_as_it_has_ended(study):
    with StudyFile.open(study.path, readonly=True) as reader:
        assert len(reader.finished_rows()) == 1
        study.writer.record_result(3, recording(1), courses(1))
        assert [row.id for row in reader.finished_rows()] == [1, 3]
        with pytest.raises(InputError, match="opened for reading"):
            reader.writer.record_failure(3, SimulationError("a reader must not write"))


def test_the_disk_is_waited_for_once_a_second(study):
    def level():
        return study._database.connection.execute("PRAGMA synchronous").fetchone()[0]

    full, normal = 2, 1
    study._database._last_sync = -np.inf
    study.writer.add_elapsed_time("simulate", 1.0)
    assert level() == full
    study.writer.add_elapsed_time("simulate", 1.0)
    assert level() == normal
    study._database._last_sync -= 2.0
    study.writer.add_elapsed_time("simulate", 1.0)
    assert level() == full


def test_a_transaction_that_an_interrupt_left_open_does_not_end_the_study(study):
    before = len(study.finished_rows())
    # As where Ctrl-C comes between the begin of a transaction and its block.
    study._database.connection.execute("BEGIN IMMEDIATE")
    study.writer.record_result(3, recording(1), courses(1))
    assert len(study.finished_rows()) == before + 1
    with StudyFile.open(study.path, readonly=True) as reader:
        assert len(reader.finished_rows()) == before + 1


def test_the_same_content_gives_the_same_bytes(tmp_path):
    blobs = []
    for name in "ab":
        with StudyFile.create(tmp_path / name, META) as made:
            made.writer.add_pending(1, POINTS, SPACE.values(POINTS))
            made.writer.record_result(1, recording(), courses())
            made.writer.save_analysis("wttc", {"ids": np.arange(3)}, {"gamma": 1.0})
        with sqlite3.connect(tmp_path / name) as connection:
            blobs.append(
                [
                    connection.execute(f"SELECT * FROM {table}").fetchall()
                    for table in ("scenarios", "courses", "analyses")
                ]
            )
    assert blobs[0] == blobs[1]


def test_analyses_keep_types_and_the_last_one_counts(study):
    apart = 1.0 - np.eye(3, dtype=np.float32)
    for gamma in (1.0, 2.0):
        arrays = {"ids": np.array([1, 2, 3]), "distances": gamma * apart, "labels": np.array([0, -1, 0])}
        study.writer.save_analysis("wttc", arrays, {"gamma": gamma, "candidates": [{"eps": 0.1}]})
    study.writer.save_analysis("ego-trajectory", {}, {})
    loaded, info = study.read_analysis("wttc")
    assert loaded["distances"].dtype == np.float32
    np.testing.assert_array_equal(loaded["distances"], 2.0 * apart)
    assert info == {"gamma": 2.0, "candidates": [{"eps": 0.1}]}
    assert study.analyzed_aspects() == ["ego-trajectory", "wttc"]
    with pytest.raises(InputError, match="no analysis by distance"):
        study.read_analysis("distance")


def test_large_arrays_come_back_whether_or_not_they_are_worth_compressing(study):
    random = np.random.default_rng(0).random((3000, 4))
    arrays = {"ids": np.array([1, 3]), "coordinates": random, "labels": np.zeros(90_000, dtype=np.int64)}
    study.writer.save_analysis("wttc", arrays, {})
    found, _ = study.read_analysis("wttc", *arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(found[name], array)
    with sqlite3.connect(study.path) as connection:
        sizes = dict(connection.execute("SELECT name, length(data) FROM arrays"))
    assert sizes["coordinates"] > random.nbytes
    assert sizes["labels"] < 10_000


def test_no_value_in_the_file_grows_with_the_number_of_pairs(tmp_path):
    rng = np.random.default_rng(0)
    points = rng.random((300, 2))
    distances = cdist(points, points)
    arrays = {"ids": np.arange(1, 301), "distances": distances, "embedding": rng.random((300, 40))}
    with StudyFile.create(tmp_path / "s.db", META) as study:
        study.writer.add_pending(1, points, SPACE.values(points))
        # As SQLite's limit of 1e9 bytes, for 300 scenarios instead of 11,500.
        study._database.connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, 50_000)
        study.writer.save_analysis("wttc", arrays, {})
        again = study.read_analysis("wttc")[0]
        for name, array in arrays.items():
            np.testing.assert_array_equal(again[name], array)
        study.writer.save_analysis("wttc", {"ids": np.arange(1, 3), "distances": distances[:2, :2]}, {})
        assert study.read_analysis("wttc", "distances")[0]["distances"].shape == (2, 2)
        # Nothing of the larger one is left.
        assert study._database.query("SELECT COUNT(*) FROM arrays") == [(2,)]


@pytest.mark.parametrize("count", [1, 2, 255, 256, 257, 700])
@pytest.mark.parametrize("kind", ["<f8", "<f4"])
def test_half_of_the_distances_gives_back_all(study, count, kind):
    points = np.random.default_rng(count).random((count, 2))
    study.writer.add_pending(2, points, SPACE.values(points))
    # Pieces have half of it.
    study._database.connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, 20_000)
    distances = cdist(points, points).astype(kind)
    study.writer.save_analysis("wttc", {"ids": np.arange(count), "distances": distances}, {})
    found = study.read_analysis("wttc", "distances")[0]["distances"]
    assert found.dtype == distances.dtype
    np.testing.assert_array_equal(found, distances)
    packed = [one for (one,) in study._database.query("SELECT data FROM arrays WHERE name = 'distances' ORDER BY part")]
    condensed = np.concatenate([np.load(io.BytesIO(one))["distances"] for one in packed])
    np.testing.assert_array_equal(condensed, squareform(distances, checks=False))


def test_time_spent_adds_up(study):
    study.writer.add_elapsed_time("simulate", 1.5)
    study.writer.add_elapsed_time("simulate", 0.25)
    study.writer.add_elapsed_time("optimize", 1.0)
    assert study.elapsed_by_stage() == {"optimize": 1.0, "simulate": 1.75}


def test_making_a_study_leaves_the_one_that_is_there(study, tmp_path):
    with pytest.raises(InputError, match="exists already"):
        StudyFile.create(study.path, META)
    study.close()
    with pytest.raises(InputError, match="exists already"):
        StudyFile.create(study.path, META)
    with StudyFile.open(study.path, readonly=False) as again:
        assert len(again.rows()) == 3


def test_a_foreign_database_is_left_as_it_is(tmp_path):
    path = tmp_path / "other.db"
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE a (b)")
    connection.close()
    before = path.read_bytes()
    with pytest.raises(InputError, match="not a cornercase study"):
        StudyFile.open(path, readonly=False)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["other.db"]


def test_a_new_study_holds_nothing_of_one_that_was_removed(study):
    # A reader keeps the log of the one that is removed, as a killed explorer does.
    with StudyFile.open(study.path, readonly=True):
        study.close()
        study.path.unlink()
        assert study.path.with_name(study.path.name + "-wal").exists()
        with StudyFile.create(study.path, META) as anew:
            assert anew.rows() == []
            anew.writer.add_pending(1, POINTS[:1], SPACE.values(POINTS[:1]))
        with StudyFile.open(study.path, readonly=True) as reader:
            assert [row.state for row in reader.rows()] == ["pending"]


@pytest.mark.parametrize("version", [0, 2, 6])
def test_another_schema_version_is_refused(study, version):
    study.close()
    with sqlite3.connect(study.path) as connection:
        connection.execute(f"PRAGMA user_version = {version}")
    connection.close()
    for readonly in (True, False):
        with pytest.raises(InputError, match=rf"study\.db: has schema version {version}.*run `explore` again"):
            StudyFile.open(study.path, readonly=readonly)


def test_a_table_with_other_columns_is_refused(study):
    study.close()
    with sqlite3.connect(study.path) as connection:
        connection.execute("ALTER TABLE notes DROP COLUMN checksum")
    connection.close()
    with pytest.raises(InputError, match=r"study\.db: .*the table 'notes' with other columns.*run `explore` again"):
        StudyFile.open(study.path)


def test_a_full_disk_is_said_and_harms_nothing(study):
    connection = study._database.connection
    (pages,) = connection.execute("PRAGMA page_count").fetchone()
    connection.execute(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(InputError, match=r"study\.db.*full"):
        study.writer.record_result(3, recording(1), {"distance": (np.random.default_rng(0).random(100_000), 0.0)})
    study.close()
    with StudyFile.open(study.path, readonly=False) as again:
        assert [row.state for row in again.rows()] == ["done", "failed", "pending"]
        assert same_recording(again.recording(1), recording())


def test_a_place_that_cannot_be_written_is_said(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        StudyFile.create(tmp_path / "file" / "study.db", META)


def test_a_study_in_a_folder_that_cannot_be_written_is_read(study, monkeypatch):
    study.close()
    for left in ("study.db-wal", "study.db-shm", "study.db-journal"):
        assert not (study.path.parent / left).exists()
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with StudyFile.open(study.path, readonly=True) as reader:
        assert len(reader.rows()) == 3
        assert not (study.path.parent / "study.db-shm").exists()


def test_tables_hold_everything(study, tmp_path):
    study.writer.record_result(3, recording(1), courses(1))
    study.writer.save_analysis("wttc", {"ids": np.array([1, 3]), "labels": np.array([0, -1])}, {})
    study.export(tmp_path / "tables")
    with open(tmp_path / "tables" / "scenarios.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["state"] for row in rows] == ["done", "failed", "done"]
    assert [(float(r["a"]), float(r["b"])) for r in rows] == [(v["a"], v["b"]) for v in SPACE.values(POINTS)]
    assert [r["wttc"] for r in rows] == ["0.5", "", "1.5"]
    assert [r["cluster_by_wttc"] for r in rows] == ["0", "", "-1"]
    assert rows[1]["error"] == "the road ends"
    assert same_recording(read_recording(tmp_path / "tables" / "recordings" / "00003.csv"), recording(1))
    with open(tmp_path / "tables" / "courses" / "00001.csv", newline="", encoding="utf-8") as file:
        found = [float(row["distance"] or "nan") for row in csv.DictReader(file)]
    np.testing.assert_array_equal(found, courses()["distance"][0])


def test_a_damaged_study_leaves_nothing_of_an_export(study, tmp_path):
    study.writer.record_result(3, recording(1), courses(1))
    path = study.path
    study.close()
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE scenarios SET recording = substr(recording, 2) WHERE id = 3")
    with StudyFile.open(path, readonly=True) as reader, pytest.raises(InputError, match="damaged"):
        reader.export(tmp_path / "tables")
    assert not (tmp_path / "tables").exists()


def test_recordings_of_two_studies_are_unpacked_once_where_they_are_the_same(study, tmp_path):
    study.writer.record_result(3, recording(1), courses(1))
    one, other = study.read_recording_pair(1, study, 3)
    assert same_recording(one, study.recording(1))
    assert same_recording(other, study.recording(3))
    one, other = study.read_recording_pair(3, study, 3)
    assert one is other
    with pytest.raises(InputError, match="the scenario 2 was not run"):
        study.read_recording_pair(1, study, 2)


def test_parquet_without_its_package_names_the_extra(study, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(InputError, match=r"cornercase\[parquet\]"):
        study.export(tmp_path / "tables", parquet=True)


def test_a_row_of_the_table_is_a_scenario(study):
    study.writer.record_result(3, recording(1), courses(1))
    study.writer.save_analyses({"wttc": ({"ids": np.array([1, 3]), "labels": np.array([0, -1])}, {})}, {1: "Ego first"})
    table = study.table()
    assert list(table) == [
        "round", "state", "a", "b", "distance", "wttc", "collision", "impact speed", "fault",
        "fault reason", "cluster by wttc", "outcome", "error",
    ]  # fmt: skip
    assert (table.index.name, table.index.tolist()) == ("id", [1, 2, 3])
    np.testing.assert_array_equal(table["wttc"], [0.5, np.nan, 1.5])
    assert table["cluster by wttc"].tolist() == [0, pd.NA, -1]
    assert table["outcome"].tolist() == ["Ego first", None, None]
    assert table[["a", "b"]].to_dict("records") == SPACE.values(POINTS)
    assert str(table["a"].dtype) == "float64"


def test_a_table_reads_no_distances(study):
    arrays = {"ids": np.array([1]), "labels": np.array([0]), "distances": np.zeros((1, 1))}
    study.writer.save_analysis("wttc", arrays, {})
    with study._database.transaction() as connection:
        connection.execute("UPDATE arrays SET data = x'00' WHERE name = 'distances'")
    assert study.table()["cluster by wttc"].tolist() == [0, pd.NA, pd.NA]
    with pytest.raises(InputError, match=r"is damaged: .* 'distances', part '0'; `verify` lists"):
        study.read_analysis("wttc")


def test_a_parameter_that_is_called_like_a_metric_has_a_column_of_its_own(tmp_path):
    space = ParameterSpace.from_ranges(["distance=0:1", "state=0:1"])
    points = np.array([[0.25, 0.75]])
    with StudyFile.create(tmp_path / "s.db", about(space, "distance")) as study:
        study.writer.add_pending(1, points, space.values(points))
        study.writer.record_result(1, recording(), {"distance": courses()["distance"]})
        table = study.table()
    (row,) = table.to_dict("records")
    assert (row["parameter distance"], row["parameter state"], row["state"]) == (0.25, 0.75, "done")
    assert row["distance"] == courses()["distance"][1]


def test_what_is_read_together_is_of_one_moment(study):
    with StudyFile.open(study.path, readonly=True) as reader:
        with reader.snapshot():
            assert len(reader.scores("wttc")) == 1
            study.writer.record_result(3, recording(1), courses(1))
            assert len(reader.scores("wttc")) == len(reader.finished_rows()) == 1
        assert len(reader.scores("wttc")) == len(reader.finished_rows()) == 2


def test_a_study_with_damaged_facts_is_refused_in_a_sentence(study):
    study.close()
    with sqlite3.connect(study.path) as connection:
        connection.execute("UPDATE meta SET value = '[' WHERE key = 'metrics'")
    connection.close()
    with pytest.raises(InputError, match="its table meta has a wrong checksum for key 'metrics'"):
        StudyFile.open(study.path, readonly=False)
    reseal(study.path)
    for readonly in (True, False):
        with pytest.raises(InputError, match="cannot be used as a study"):
            StudyFile.open(study.path, readonly=readonly)


def test_what_an_earlier_version_did_not_write_is_noted_when_the_search_goes_on(study):
    limit = ParameterDeclaration("a", "double", "0", ((Constraint("lessThan", "5"),),))
    declared = [limit, ParameterDeclaration("b", "double", "0")]
    known = replace(META, space=ParameterSpace(SPACE.parameters, declared), critical=0.5)
    study.writer.check_and_update_meta(known)
    study.close()
    with StudyFile.open(study.path, readonly=False) as again:
        assert again.meta == known
        assert again.space.is_admissible(POINTS).tolist() == [True, True, True]
        assert not again.space.is_admissible(np.array([[0.9, 0.5]])).any()
        # A search that does not know them does not take them away.
        with pytest.raises(InputError, match=r"the threshold 0.5"):
            again.writer.check_and_update_meta(META)
        assert again.meta == known


def test_a_scenario_is_found_by_the_number_in_the_table(study):
    number = study.table().index[0]
    assert study.recording(number).names == study.recording(1).names
    np.testing.assert_array_equal(study.course(number, "wttc"), study.course(1, "wttc"))


@pytest.mark.parametrize("number", [1.0, "1", None, True, -1, 2**70])
def test_what_is_no_id_of_a_scenario_is_said(study, number):
    for ask in (study.recording, lambda one: study.course(one, "wttc")):
        with pytest.raises(InputError, match=r"`scenario` .*: give the id of a scenario, a whole number"):
            ask(number)


def test_a_study_that_is_closed_says_so(study):
    study.close()
    asks = (study.table, study.rows, lambda: study.writer.record_failure(3, SimulationError("the road ends")))
    for ask in asks:
        with pytest.raises(InputError, match="is closed; open it again"):
            ask()
    study.close()


@pytest.mark.parametrize("wrong", [None, 3, ""])
def test_what_is_no_path_is_refused(wrong):
    with pytest.raises(InputError, match=r"`path` .*: give the path of a file"):
        StudyFile.open(wrong, readonly=False)


def test_a_folder_is_no_study(tmp_path):
    with pytest.raises(InputError, match="is not a file; name the file of a study"):
        StudyFile.open(tmp_path, readonly=False)


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="needs a folder in which nobody can make files")
def test_a_folder_that_cannot_be_written_is_said():
    with pytest.raises(InputError, match="cannot be written"):
        StudyFile.create("/proc/study.db", META)
