"""Scenarios that failed for an external reason: they are reported, and run again."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
import typer

import cornercase as cc
from cornercase.cli.options import finish_exploration_command
from cornercase.exploration import ExplorationResult
from cornercase.study import StudyFile

EXAMPLE = Path(__file__).parents[2] / "examples" / "x_intersection"


def explored(path, **more):
    return cc.explore(
        EXAMPLE / "x_intersection.xosc", path, ego="Ego", other="Pedestrian", metrics=["wttc"], space=EXAMPLE / "x_intersection.space.xosc",
        optimizer="sobol", budget=6, batch=3, duration=6.0, time_step=0.2, **more,
    )  # fmt: skip


def stored(path):
    tables = ("meta", "scenarios", "courses", "tallies")
    with closing(sqlite3.connect(path)) as connection:
        return {name: connection.execute(f"SELECT * FROM {name}").fetchall() for name in tables}


@pytest.mark.filterwarnings("ignore::cornercase.NoticeWarning")
@pytest.mark.parametrize("asynchronous", [False, True])
def test_what_failed_is_run_once_more_when_that_is_asked(tmp_path, asynchronous):
    path = tmp_path / "s.db"
    explored(path, asynchronous=asynchronous)
    before = stored(path)
    with StudyFile.open(path, readonly=False) as study:
        for one in (2, 5):
            study.writer.record_failure(one, cc.SimulationError("a worker was ended from outside"))
    again = explored(path, asynchronous=asynchronous)
    assert (again.done, again.failed) == (4, 2)
    assert again.failure_counts == {"a worker was ended from outside": 2}
    again = explored(path, asynchronous=asynchronous, retry_failed=True)
    assert (again.done, again.failed, again.failure_counts) == (6, 0, {})
    now = stored(path)
    if asynchronous:
        # Their results arrived later.
        del before["tallies"], now["tallies"]
    assert now == before


def test_failures_are_counted_and_all_of_them_is_a_no(capsys):
    some = ExplorationResult(Path("s.db"), 4, 2, "it ended", failure_counts={"too slow": 2})
    finish_exploration_command(some)
    assert "2 failed: too slow" in capsys.readouterr().out
    with pytest.raises(typer.Exit) as ended:
        finish_exploration_command(ExplorationResult(Path("s.db"), 0, 2, "it ended", failure_counts={"a": 1, "b": 1}))
    assert ended.value.exit_code == 1
