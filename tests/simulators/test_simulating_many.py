"""Running many concrete scenarios into a folder of recordings."""

from __future__ import annotations

import csv
import json
import re
import shutil
import signal
import warnings
from typing import Any

import pytest

import cornercase as cc
from conftest import EXAMPLES
from cornercase.simulators import SIMULATORS, Builtin
from cornercase.study import StudyFile
from helpers.command_line import X, cornercase

QUICK: Any = {"duration": 1.0}
STARTS = (20, 31.5, 40)


class Interrupted(Builtin):
    """Is interrupted in its third scenario."""

    batched = False

    def run(self, concretes):
        for place, outcome in enumerate(super().run(concretes)):
            if place == 2:
                signal.raise_signal(signal.SIGINT)
            yield outcome


@pytest.fixture(autouse=True)
def _without_notices():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", cc.NoticeWarning)
        yield


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "values.csv"
    path.write_text("ego_start,p1_speed\n" + "".join(f"{start},7\n" for start in STARTS))
    return path


def contents(folder):
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def test_each_line_of_a_table_gives_the_recording_that_it_gives_alone(table, tmp_path):
    result = cc.simulate_many(X, tmp_path / "runs", table=table, values={"truck_speed": 6}, **QUICK)
    assert (result.done, result.failed, result.n_existing) == (3, 0, 0)
    files = sorted((tmp_path / "runs").glob("x_*.csv"))
    assert [file.name for file in files] == [f"x_intersection-0000{k}.csv" for k in (1, 2, 3)]
    for file, start in zip(files, STARTS, strict=True):
        alone = cc.simulate(X, {"ego_start": start, "p1_speed": 7, "truck_speed": 6}, **QUICK)
        alone.to_csv(tmp_path / "alone.csv")
        assert file.read_bytes() == (tmp_path / "alone.csv").read_bytes()


def test_the_folder_can_be_imported(table, tmp_path):
    cc.simulate_many(X, tmp_path / "runs", table=table, **QUICK)
    study = tmp_path / "s.db"
    assert cc.import_recordings(tmp_path / "runs", study, ego="Ego", other="Truck", metrics=["distance"]).done == 3
    with StudyFile.open(study, readonly=True) as opened:
        assert tuple(opened.table()["ego_start"]) == STARTS


def test_processes_give_the_same_bytes(table, tmp_path):
    plain = cc.simulate_many(X, tmp_path / "plain", table=table, **QUICK)
    beside = cc.simulate_many(X, tmp_path / "beside", table=table, workers=2, **QUICK)
    assert (plain.done, beside.done) == (3, 3)
    assert contents(plain.folder) == contents(beside.folder)


@pytest.mark.slow
def test_a_cluster_gives_the_same_bytes(table, tmp_path):
    pytest.importorskip("distributed")
    plain = cc.simulate_many(X, tmp_path / "plain", table=table, **QUICK)
    far = cc.simulate_many(X, tmp_path / "far", table=table, cluster="local", workers=2, **QUICK)
    assert contents(plain.folder) == contents(far.folder)


def test_what_was_interrupted_goes_on_with_what_is_missing(table, tmp_path, monkeypatch):
    whole = cc.simulate_many(X, tmp_path / "whole", table=table, **QUICK)
    folder = tmp_path / "runs"
    with monkeypatch.context() as patched:
        patched.setitem(SIMULATORS._factories, "builtin", (Interrupted, {}))
        with pytest.raises(KeyboardInterrupt):
            cc.simulate_many(X, folder, table=table, **QUICK)
    made = {name: (folder / name).stat().st_mtime_ns for name in contents(folder) if name.startswith("x_")}
    assert len(made) == 2
    assert cc.simulate_many(X, folder, table=table, **QUICK).n_existing == 2
    assert contents(folder) == contents(whole.folder)
    (folder / "x_intersection-00001.csv").unlink()
    cc.simulate_many(X, folder, table=table, **QUICK)
    assert contents(folder) == contents(whole.folder)
    made.pop("x_intersection-00001.csv")
    assert made.items() <= {name: (folder / name).stat().st_mtime_ns for name in contents(folder)}.items()


def test_a_longer_table_goes_on(table, tmp_path):
    cc.simulate_many(X, tmp_path / "runs", table=table, **QUICK)
    table.write_text(table.read_text() + "44,7\n")
    result = cc.simulate_many(X, tmp_path / "runs", table=table, **QUICK)
    assert (result.done, result.n_existing) == (4, 3)


def test_nothing_is_taken_for_the_recording_of_something_else(table, tmp_path):
    shutil.copytree(X.parent, tmp_path / "x")
    scenario, folder = tmp_path / "x" / X.name, tmp_path / "runs"
    cc.simulate_many(scenario, folder, table=table, **QUICK)
    before = contents(folder)
    with pytest.raises(cc.InputError, match=r"`folder` .*runs: contains recordings with another time_step; choose"):
        cc.simulate_many(scenario, folder, table=table, time_step=0.1, **QUICK)
    rows = table.read_text()
    table.write_text(rows.replace("31.5", "32"))
    with pytest.raises(cc.InputError, match=r"00002\.csv: is a recording of other values of x_intersection\.xosc;"):
        cc.simulate_many(scenario, folder, table=table, **QUICK)
    table.write_text(rows)
    scenario.write_text(scenario.read_text().replace('value="2.2"', 'value="2.1"'))
    with pytest.raises(cc.InputError, match=r"00001\.csv: is a recording of another version of x_intersection\.xosc;"):
        cc.simulate_many(scenario, folder, table=table, **QUICK)
    assert contents(folder) == before


def test_files_of_somebody_else_are_left_alone(table, tmp_path):
    folder = tmp_path / "runs"
    folder.mkdir()
    (folder / "parameters.csv").write_text("mine")
    with pytest.raises(cc.InputError, match=r"contains a file parameters\.csv, but no simulation\.json"):
        cc.simulate_many(X, folder, table=table, **QUICK)
    assert contents(folder) == {"parameters.csv": b"mine"}
    (folder / "simulation.json").write_text("[1]")
    with pytest.raises(cc.InputError, match=r"simulation\.json: does not describe"):
        cc.simulate_many(X, folder, table=table, **QUICK)


def test_several_scenarios_and_those_that_fail(tmp_path):
    shutil.copytree(X.parent, tmp_path / "x")
    for name, start in (("near", 20), ("off", 100_000)):
        text = X.read_text().replace('name="ego_start" parameterType="double" value="50"', f'name="ego_start" parameterType="double" value="{start}"')  # fmt: skip
        (tmp_path / "x" / f"{name}.xosc").write_text(text)
    files = [tmp_path / "x" / name for name in ("near.xosc", "off.xosc", X.name)]
    ended = cornercase("-q", "simulate", *files, "--duration", "1", "-o", tmp_path / "runs")
    assert ended.returncode == 1
    assert "2 recordings in" in ended.stdout
    assert "1 scenario failed, off.csv first" in ended.stdout
    assert re.search(
        r"1 failed: .*off\.xosc, line \d+: <TeleportAction> of <Init>: Ego is placed off the map at t = 0 s",
        ended.stdout,
    )
    with (tmp_path / "runs" / "parameters.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows == [["file", "scenario"], ["near.csv", "near.xosc"], ["x_intersection.csv", "x_intersection.xosc"]]
    again = cornercase("-q", "simulate", *files, "--duration", "1", "-o", tmp_path / "runs")
    assert (again.returncode, "2 recordings in" in again.stdout) == (1, True)
    assert "2 of which existed before" in again.stdout


def test_where_nothing_can_be_run_nothing_is_left(tmp_path):
    table = tmp_path / "values.csv"
    table.write_text("file,ego_start\na.csv,100000\nb.csv,-5\n")
    ended = cornercase("-q", "simulate", X, "--parameters", table, "-o", tmp_path / "runs")
    assert ended.returncode == 2
    assert "Ego is placed off the map" in ended.stderr
    assert not (tmp_path / "runs").exists()


BAD = {
    "an unknown parameter": ("ego_strat\n1\n", "has a column 'ego_strat'", "did you mean 'ego_start'?"),
    "no number": ("ego_start\n1\nfast\n", "line 3: the parameter ego_start is 'fast'", "not a number"),
    "an empty field": ("ego_start,p1_speed\n1,\n", "line 2", "has an empty field"),
    "no rows": ("ego_start\n", "has a header but no rows", ""),
    "no header": ("", "needs a header", "an empty one"),
    "no parameter": ("file\na.csv\n", "needs a header", "not file"),
    "a parameter twice": ("ego_start,ego_start\n1,2\n", "needs a header", "each parameter once"),
    "a folder": ("file,ego_start\n../a.csv,1\n", "line 2: '../a.csv'", "without folder"),
    "no CSV": ("file,ego_start\na.erg,1\n", "line 2: 'a.erg'", "ends in .csv"),
    "the table": ("file,ego_start\nparameters.csv,1\n", "line 2", "is not parameters.csv"),
    "a name twice": ("file,ego_start\nA.csv,1\na.csv,2\n", "line 3: repeats the file name a.csv", "line 2"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_table_that_cannot_be_used_is_refused_by_its_line(case, table, tmp_path):
    text, *said = BAD[case]
    table.write_text(text)
    ended = cornercase("simulate", X, "--parameters", table, "-o", tmp_path / "runs")
    assert ended.returncode == 2
    assert str(table) in ended.stderr
    assert all(words in ended.stderr for words in said), ended.stderr
    assert not (tmp_path / "runs").exists()


def test_options_that_do_not_go_together_are_named(table, tmp_path):
    runs = tmp_path / "runs"
    for words, said in (
        ((X, "--parameters", table, "--set", "ego_start=3", "-o", runs), "--set ego_start: is also a column of"),
        ((X, "--workers", "2", "-o", tmp_path / "r.csv"), "--workers: is for several scenarios"),
        ((X, "--cluster", "local", "-o", tmp_path / "r.csv"), "--cluster: is for several scenarios"),
        ((X, X, "-o", runs), "rename one"),
        ((X, X, "--parameters", table, "-o", runs), "--parameters"),
        ((X, "--parameters", table, "-o", tmp_path / "r.csv"), "are written into a folder"),
        ((X, "--parameters", table, "-o", table), "is a file, not a folder"),
    ):
        ended = cornercase("simulate", *words)
        assert ended.returncode == 2
        assert said in ended.stderr
    assert sorted(file.name for file in tmp_path.iterdir()) == ["values.csv"]


def test_the_table_is_not_written_over(table, tmp_path):
    runs = tmp_path / "runs"
    cc.simulate_many(X, runs, table=table, **QUICK)
    with pytest.raises(cc.InputError, match="is the input file"):
        cc.simulate_many(X, runs, table=runs / "parameters.csv", **QUICK)
    noted = json.loads((runs / "simulation.json").read_text())
    assert noted["recordings"]["x_intersection-00002.csv"]["values"] == {"ego_start": "31.5", "p1_speed": "7"}


def test_a_file_that_cannot_be_read_takes_the_name_of_its_recording_too(tmp_path):
    shutil.copytree(X.parent, tmp_path / "x")
    (tmp_path / "broken").mkdir()
    broken = tmp_path / "broken" / X.name
    broken.write_text(X.read_text().replace("Storyboard>", "Storyboar>"))
    with pytest.raises(cc.InputError, match=r"has the same recording name as .*; rename one"):
        cc.simulate_many([broken, tmp_path / "x" / X.name], tmp_path / "runs", **QUICK)
    assert not (tmp_path / "runs").exists()


def test_recordings_of_another_call_with_the_same_parameters_stay_in_the_table(tmp_path):
    shutil.copytree(X.parent, tmp_path / "x")
    scenarios, folder = [tmp_path / "x" / f"{name}.xosc" for name in "abcd"], tmp_path / "runs"
    every_values: list[dict[str, float]] = [{"ego_start": 20}, {"ego_start": 30}, {"p1_speed": 7}, {"ego_start": 40}]
    for scenario, values in zip(scenarios, every_values, strict=True):
        shutil.copy(X, scenario)
        cc.simulate_many(scenario, folder, values=values, **QUICK)
    (folder / "a.csv").unlink()
    cc.simulate_many(scenarios[3], folder, values=every_values[3], **QUICK)
    with (folder / "parameters.csv").open(newline="") as file:
        assert list(csv.reader(file)) == [
            ["file", "scenario", "ego_start"], ["d.csv", "d.xosc", "40"], ["b.csv", "b.xosc", "30"],
        ]  # fmt: skip
    result = cc.import_recordings(folder, tmp_path / "i.db", ego="Ego", other="Pedestrian", metrics=["distance"])
    assert result.done == 2


def test_notes_that_do_not_describe_a_recording_are_refused(tmp_path):
    cc.simulate_many(X, tmp_path / "runs", **QUICK)
    notes = tmp_path / "runs" / "simulation.json"
    notes.write_text(notes.read_text().replace('"values"', '"valeus"'))
    with pytest.raises(cc.InputError, match=r"simulation\.json: does not describe"):
        cc.simulate_many(EXAMPLES / "t_intersection" / "t_intersection.xosc", tmp_path / "runs", **QUICK)
