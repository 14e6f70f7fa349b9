"""Warm start of a search from another study: what is read, stored and refused."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from typing import Any

import numpy as np
import pytest

from cornercase._common.errors import InputError
from cornercase.exploration import explore
from cornercase.exploration._study_critical_set import estimate_critical_set
from cornercase.exploration._warm_start import read_warm_start
from cornercase.metrics import METRICS
from cornercase.report import summarize
from cornercase.scenario import LogicalScenario
from cornercase.study import StudyFile, StudyMeta
from cornercase.study._objective import Objective
from helpers.checksums import changed, reseal
from helpers.command_line import SPACE, X, cornercase

WHOLE = LogicalScenario.read(X, SPACE)


def searched(path, *, logical=WHOLE, driver="normal:reaction_time=0.8", metrics=("wttc",), **more):
    options: dict[str, Any] = {"optimizer": "level-set", "critical": 0.5, "budget": 20, "seed": 1} | more
    return explore(logical, path, ego="Ego", other="Pedestrian", metrics=metrics, drivers={"Ego": driver}, **options)


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    """A study with another driver, and one more metric than the searched one."""
    path = tmp_path_factory.mktemp("other") / "other.db"
    searched(path, driver="normal", metrics=("distance", "wttc"), optimizer="sobol", budget=40, batch=20)
    return path


def content(path):
    with closing(sqlite3.connect(path)) as connection:
        tables = [name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        return {name: connection.execute(f"SELECT * FROM {name}").fetchall() for name in tables if name != "elapsed"}


def beginning(path, space, *names):
    return read_warm_start(path, space, Objective([METRICS.create(name) for name in names]), "Ego", ("Pedestrian",))


def test_it_goes_on_as_it_was_without_the_other_study(tmp_path, other):
    copied = tmp_path / "gone" / "other.db"
    copied.parent.mkdir()
    copied.write_bytes(other.read_bytes())
    searched(tmp_path / "once.db", warm_start=other, budget=30)
    searched(tmp_path / "twice.db", warm_start=copied, budget=20)
    copied.unlink()
    searched(tmp_path / "twice.db", budget=30)
    assert content(tmp_path / "once.db") == content(tmp_path / "twice.db")
    searched(tmp_path / "cold.db", budget=30)
    with (
        StudyFile.open(tmp_path / "once.db", readonly=True) as begun,
        StudyFile.open(tmp_path / "cold.db", readonly=False) as cold,
    ):
        assert cold.warm_start_data() is None
        assert "elsewhere" not in {key for key, *_ in content(cold.path)["meta"]}
        assert not np.array_equal(begun.points(), cold.points())
        assert StudyMeta.from_json(begun.meta.to_json()) == begun.meta
        # The estimate of the critical set uses the other study and the scenarios of this one.
        assert 0.0 < estimate_critical_set(begun.with_critical(0.5)).critical_fraction.value < 1.0
        assert len(begun.points()) == 30
    summarize(tmp_path / "once.db")


def test_scores_and_points_are_those_of_the_other_study(other):
    known = beginning(other, WHOLE.space, "wttc")
    with StudyFile.open(other, readonly=True) as study:
        np.testing.assert_array_equal(known.scores, study.scores("wttc"))
        np.testing.assert_allclose(known.points, study.points(), atol=1e-12)
    assert known.study_info["scenarios"] == 40
    assert known.study_info["simulator"] == "builtin"


def test_a_study_that_is_being_written_is_read_as_it_is_at_one_moment(tmp_path, other, monkeypatch):
    def end_one(*given):
        monkeypatch.setattr(StudyFile, "scores", scores)
        changed(tmp_path / "growing.db", "UPDATE scenarios SET state = 'done' WHERE id = 3")
        return scores(*given)

    (tmp_path / "growing.db").write_bytes(other.read_bytes())
    changed(tmp_path / "growing.db", "UPDATE scenarios SET state = 'pending' WHERE id = 3")
    scores = StudyFile.scores
    monkeypatch.setattr(StudyFile, "scores", end_one)
    found, every = beginning(tmp_path / "growing.db", WHOLE.space, "wttc"), beginning(other, WHOLE.space, "wttc")
    np.testing.assert_array_equal(found.points, np.delete(every.points, 2, axis=0))
    np.testing.assert_array_equal(found.scores, np.delete(every.scores, 2))


def test_a_study_that_is_being_written_is_replayed_as_it_is_at_one_moment(tmp_path, monkeypatch):
    def go_on(*given):
        monkeypatch.setattr(Objective, "minimized_scores", oriented_of)
        searched(tmp_path / "growing.db", budget=30)
        return oriented_of(*given)

    searched(tmp_path / "growing.db")
    oriented_of = Objective.minimized_scores
    monkeypatch.setattr(Objective, "minimized_scores", go_on)
    found = searched(tmp_path / "growing.db", check_proposals=True)
    assert (found.reproducible, found.done) == (True, 20)


def test_a_metric_that_it_lacks_is_measured_from_its_recordings(tmp_path, other):
    searched(
        tmp_path / "lacks.db",
        driver="normal",
        metrics=("distance",),
        optimizer="sobol",
        critical=1,
        budget=40,
        batch=20,
    )
    np.testing.assert_array_equal(
        beginning(tmp_path / "lacks.db", WHOLE.space, "wttc").scores, beginning(other, WHOLE.space, "wttc").scores
    )


def test_scenarios_outside_of_the_new_ranges_are_left_out(other):
    name = WHOLE.space.names[0]
    narrow = WHOLE.space.with_ranges([f"{name}=30:60"])
    known = beginning(other, narrow, "wttc")
    with StudyFile.open(other, readonly=True) as study:
        starts = [float(row.values[name]) for row in study.rows()]
    there = [start for start in starts if 30 <= start <= 60]
    assert [values[name] for values in narrow.values(known.points)] == pytest.approx(there)
    assert 10 <= len(there) < 40


def test_what_cannot_be_begun_from_is_refused_and_leaves_nothing(tmp_path, other):
    new = tmp_path / "new.db"
    fewer = LogicalScenario.read(X, ranges=["ego_start=20:80"])
    cases: dict[str, dict[str, Any]] = {
        "this space has no parameter": {"logical": fewer},
        "bayes learns nothing from another study; use auto, level-set": {"optimizer": "bayes"},
        "was not searched for the condition 'collision'; use a study with the same `critical_if`": {
            "critical_if": "collision"
        },
        "without a threshold or condition the optimizer is bayes, which learns nothing": {
            "metrics": ("distance",),
            "critical": None,
            "optimizer": None,
        },
        "there is no such study": {"warm_start": tmp_path / "missing.db"},
        "at least 10 are needed, and their scores must not all be equal": {
            "logical": LogicalScenario.read(X, SPACE, ["ego_start=80:90"])
        },
    }
    for words, more in cases.items():
        with pytest.raises(InputError, match=words):
            searched(new, **{"critical": None if "critical_if" in more else 0.5, "warm_start": other} | more)
        assert not new.exists()
    with pytest.raises(InputError, match="has no parameter"):
        searched(new, warm_start=_of(fewer, tmp_path))


def _of(logical, folder):
    searched(folder / "fewer.db", logical=logical, optimizer="sobol")
    return folder / "fewer.db"


def test_another_study_to_begin_from_is_another_search(tmp_path, other):
    searched(tmp_path / "new.db", warm_start=other)
    searched(tmp_path / "third.db", driver="normal", optimizer="sobol", seed=5)
    with pytest.raises(InputError, match="another warm start"):
        searched(tmp_path / "new.db", warm_start=tmp_path / "third.db", budget=30)
    with pytest.raises(InputError, match="another warm start"):
        searched(tmp_path / "new.db", warm_start=tmp_path / "third.db", check_proposals=True)
    with StudyFile.open(tmp_path / "new.db", readonly=False) as study:
        assert len(study.finished_rows()) == 20


def test_a_damaged_beginning_is_told(tmp_path, other):
    searched(tmp_path / "new.db", warm_start=other)
    with closing(sqlite3.connect(tmp_path / "new.db")) as connection, connection:
        connection.execute("DELETE FROM elsewhere WHERE rowid = 1")
    for command in (("show",), ("report", "-o", tmp_path / "page.html")):
        # The estimate of the critical set is not skipped as if there were too few scores.
        told = cornercase(command[0], tmp_path / "new.db", *command[1:])
        assert told.returncode == 2
        assert "elsewhere has missing or extra rows" in told.stderr
    with pytest.raises(InputError, match="elsewhere has missing or extra rows"):
        searched(tmp_path / "new.db", budget=30)
    reseal(tmp_path / "new.db")
    with pytest.raises(InputError, match="the warm-start data is incomplete"):
        searched(tmp_path / "new.db", budget=30)


def test_on_the_command_line(tmp_path, other):
    arguments = (
        "explore", X, "--space", SPACE, "--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc", "--critical", "0.5",
        "--budget", "12", "--warm-start", other, "-o", tmp_path / "new.db",
    )  # fmt: skip
    refused = cornercase(*arguments, "--optimizer", "sobol")
    assert refused.returncode == 2
    assert "--warm-start: sobol learns nothing from another study; use auto, level-set or committee." in refused.stderr
    assert cornercase(*arguments, "--optimizer", "level-set").returncode == 0
    with StudyFile.open(tmp_path / "new.db", readonly=True) as study:
        known = study.warm_start_data()
        assert known is not None
        assert len(known[1]) == 40


def test_it_is_replayed_and_goes_without_rounds(tmp_path, other):
    searched(tmp_path / "new.db", warm_start=other, budget=16, batch=8, asynchronous=True)
    found = searched(tmp_path / "new.db", budget=16, batch=8, asynchronous=True, check_proposals=True)
    assert found.reproducible
    assert searched(
        tmp_path / "new.db", warm_start=other, budget=16, batch=8, asynchronous=True, check_proposals=True
    ).reproducible
