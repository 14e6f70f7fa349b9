"""Studies that earlier versions of cornercase wrote.

``study_version_1.db`` was written by the last version with schema 1: 10 scenarios of the T-intersection, run twice each,
analysed and reduced. ``study_version_1_first_release.db`` is the same without what the first releases did not know.
``study_version_2.db`` was written by the last version with schema 2, in the same way.
"""

from __future__ import annotations

import io
import json
import math
import os
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from command_line import cornercase
from cornercase._common.errors import InputError
from cornercase.clustering import ScenarioClustering
from cornercase.report import put_in_words, summarize, write_report
from cornercase.study import Study, migrations
from cornercase.study.schema import SCHEMA_VERSION

DATA = Path(__file__).parents[1] / "data"
LAST, FIRST, SECOND = "study_version_1.db", "study_version_1_first_release.db", "study_version_2.db"


def version(path: Path) -> int:
    with closing(sqlite3.connect(path)) as connection:
        return int(connection.execute("PRAGMA user_version").fetchone()[0])


@pytest.fixture(params=[LAST, FIRST, SECOND])
def old(request, tmp_path):
    return Path(shutil.copy(DATA / request.param, tmp_path / request.param))


def held(study: Study) -> dict[str, object]:
    """All that a study holds, as plain values."""
    return {
        "meta": study.meta.to_json(),
        "rows": [(row.id, row.round, row.point.tolist(), row.values, row.state, row.error) for row in study.rows()],
        "ends": [study.recording(row.id).x[:, -1].tolist() for row in study.done()],
        "scores": {name: study.scores(name).tolist() for name in study.meta.metrics},
        "courses": {name: study.course(3, name).tolist() for name in study.meta.metrics},
        "analyses": {
            name: [{key: array.tolist() for key, array in found.items()} if isinstance(found, dict) else None for found in study.analysis(name)[:1]]
            for name in study.analyses()
        },
        "infos": json.dumps({name: study.analysis(name, "ids")[1] for name in study.analyses()}),
        "reduction": study.reduction(),
        "elapsed": study.elapsed(),
    }  # fmt: skip


def test_a_reader_leaves_an_old_study_as_it_is(old, monkeypatch):
    before = old.read_bytes()
    with Study.open(old, readonly=True) as study:
        assert study.meta.optimizer == "sobol"
        assert study.meta.repeats == (1 if old.name == FIRST else 2)
        assert study.meta.critical == (None if old.name == FIRST else 1.5)
        assert len(study.done()) == 10
        assert study.analyses() == ["ego-trajectory", "ttc", "distance"]
        arrays, info = study.analysis("distance")
        assert arrays["distances"].shape == (10, 10)
        assert info["fitted"] == arrays["ids"].tolist() == list(range(1, 11))
        reduction = study.reduction()
        assert reduction is not None
        assert len(reduction["kept"]) == 4
        assert (study.spread("ttc") is None) == (old.name == FIRST)
    assert old.read_bytes() == before
    assert [path.name for path in old.parent.iterdir()] == [old.name]
    # As for one in a folder that cannot be written.
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with Study.open(old, readonly=True) as study:
        assert len(study.done()) == 10


def test_a_migrated_study_holds_what_a_reader_of_the_old_one_sees(old):
    with Study.open(old, readonly=True) as study:
        seen = held(study)
    with Study.open(old, readonly=False) as study:
        assert held(study) == seen
    assert version(old) == SCHEMA_VERSION
    # Once is enough.
    with Study.open(old, readonly=False) as study:
        assert held(study) == seen


def test_an_old_study_is_shown_exported_and_reported(old, tmp_path):
    with Study.open(old, readonly=True) as study:
        reduced = summarize(study).reduced
        assert reduced is not None
        assert len(reduced) == 4
        write_report(study, tmp_path / "r.html")
        study.export(tmp_path / "tables")
        table = study.table()
    assert "What the kept scenarios leave out" in (tmp_path / "r.html").read_text(encoding="utf-8")
    assert len(table) == 10
    assert table["cluster by distance"].dtype == "Int64"
    # Version 1 did not store it.
    assert ("outcome" in table) == (old.name == SECOND)


def test_an_old_study_is_analysed_again_by_the_command_line(old):
    done = cornercase("analyze", old, "--by", "distance", "--keep-clusters")
    assert done.returncode == 0, done.stderr
    with Study.open(old, readonly=True) as study:
        assert set(study.outcomes()) == set(range(1, 11))
        assert study.table()["outcome"].notna().all()
        np.testing.assert_array_equal(study.analysis("distance")[0]["labels"].shape, (10,))


def test_landmarks_that_version_1_only_counted_are_those_that_it_drew():
    points = np.random.default_rng(0).random((40, 2))
    distances = cdist(points, points)
    arrays = {"ids": np.arange(1, 41), "distances": distances}
    model = ScenarioClustering(landmarks=15).fit(distances)
    found = migrations._landmarks({"landmarks": 15, "fitted": list(range(1, 41))}, arrays)
    np.testing.assert_array_equal(found, model.landmarks_)
    # Of a study that has grown since, they are among those that the clusters were found from.
    model = ScenarioClustering(landmarks=15).fit(distances[:30, :30])
    found = migrations._landmarks({"landmarks": 15, "fitted": list(range(1, 31))}, arrays)
    np.testing.assert_array_equal(found, model.landmarks_)
    assert len(migrations._landmarks({"landmarks": 0, "fitted": list(range(1, 41))}, arrays)) == 0


def test_a_migration_that_fails_leaves_the_study_as_it_was(old, monkeypatch):
    before = version(old)
    step = migrations._STEPS[before]

    def failing(connection):
        step(connection)
        raise KeyboardInterrupt

    monkeypatch.setitem(migrations._STEPS, before, failing)
    with pytest.raises(KeyboardInterrupt):
        Study.open(old, readonly=False)
    monkeypatch.undo()
    assert version(old) == before
    with Study.open(old, readonly=True) as study:
        assert len(study.analysis("distance")[0]["labels"]) == 10


def test_an_old_study_with_damaged_facts_is_refused_in_a_sentence(old):
    before = version(old)
    with closing(sqlite3.connect(old)) as connection, connection:
        connection.execute("UPDATE analyses SET info = '{}' WHERE name = 'distance'")
    for readonly in (True, False):
        with pytest.raises(InputError, match="cannot be used as a study"):
            Study.open(old, readonly=readonly)
    assert version(old) == before


def test_the_distances_of_version_2_are_the_same_in_pieces(tmp_path):
    old = Path(shutil.copy(DATA / SECOND, tmp_path / SECOND))
    with closing(sqlite3.connect(old)) as connection:
        packed = dict(connection.execute("SELECT analysis, data FROM arrays WHERE name = 'distances'").fetchall())
    with Study.open(old, readonly=False) as study:
        for name in study.analyses():
            found = study.analysis(name, "distances")[0]["distances"]
            np.testing.assert_array_equal(found, np.load(io.BytesIO(packed[name]))["distances"])
    assert version(old) == SCHEMA_VERSION


def test_figures_of_what_they_were_chosen_with_are_not_told_any_more(tmp_path):
    old = Path(shutil.copy(DATA / SECOND, tmp_path / SECOND))
    with Study.open(old, readonly=True) as study:
        summary = summarize(study)
        write_report(study, tmp_path / "r.html")
    rules = {rule.text: rule for one in summary.analyses.values() for each in one.profiles for rule in each.rules}
    assert len(rules) > 1
    for text, rule in rules.items():
        # That all is everywhere was not found from any.
        assert (math.isnan(rule.covers), math.isnan(rule.purity)) == ((text != "everywhere",) * 2)
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "c_start_time &lt;= " in page
    assert "nan%" not in page + json.dumps(put_in_words(summary))
