"""Parameters of a driver as dimensions: explored, resumed, reduced, tested, compared."""

from __future__ import annotations

import json
import sqlite3
import warnings
from pathlib import Path

import pytest
from lxml import etree

import cornercase as cc
from conftest import at_night, same_recording
from cornercase.simulators import Builtin, Simulator
from cornercase.study import StudyFile
from helpers.command_line import SPACE, X, cornercase

DRIVERS = """
import cornercase as cc


class Aeb(cc.SystemUnderTest):
    def __init__(self, reaction: float = 0.3, brake: float = 6.0):
        if reaction < 0.0:
            raise ValueError("reaction has to be 0 or more")
        self.reaction, self.brake, self.since = reaction, brake, None

    def step(self, view, dt):
        leader = view.leader
        if leader is None or leader.gap > 15.0:
            return 0.0
        self.since = view.time if self.since is None else self.since
        return -self.brake if view.time - self.since >= self.reaction else 0.0


class Plain(cc.SystemUnderTest):
    def step(self, view, dt):
        return -1.0
"""
SEARCH = ("--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc", "--optimizer", "sobol", "--duration", "12")


def explore(study: Path, *more: object, ranges=("Ego.reaction=0.1:1.5",), driver="own_aeb:Aeb", budget=16):
    varied = [word for text in ranges for word in ("--range", text)]
    driven = ["--driver", f"Ego={driver}"] if driver else []
    words = (X, "--space", SPACE, *varied, *driven, *SEARCH, "--budget", budget, "-o", study.name, *more)
    return cornercase("explore", *words, cwd=study.parent)


def content(study: Path):
    with sqlite3.connect(study) as connection:
        tables = (
            "SELECT id, point, state FROM scenarios ORDER BY id",
            "SELECT * FROM courses ORDER BY scenario, metric",
        )
        return [connection.execute(table).fetchall() for table in tables]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("dimensions")
    (path / "own_aeb.py").write_text(DRIVERS)
    ended = explore(path / "own.db")
    assert ended.returncode == 0, ended.stderr
    ended = explore(path / "preset.db", ranges=["Ego.reaction_time=0.1:1.5"], driver="normal")
    assert ended.returncode == 0, ended.stderr
    for name in ("own", "preset"):
        for command in (
            ("analyze", f"{name}.db", "--by", "wttc"),
            ("reduce", f"{name}.db", "--size", 3, "-o", f"{name}-set"),
        ):
            ended = cornercase(*command, cwd=path)
            assert ended.returncode == 0, ended.stderr
    return path


def test_each_scenario_runs_with_its_own_value(folder, monkeypatch):
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(folder)
    with StudyFile.open(folder / "own.db", readonly=True) as study:
        assert study.space.names[-1] == "Ego.reaction"
        rows = study.finished_rows()
        assert len({row.values["Ego.reaction"] for row in rows}) == 16
        for row in rows[:3]:
            values = dict(row.values)
            fixed = f"own_aeb:Aeb:reaction={values.pop('Ego.reaction')!r}"
            again = cc.simulate(X, values, drivers={"Ego": fixed}, duration=12.0)
            assert same_recording(study.recording(row.id), again)


def test_resuming_and_more_workers_give_the_same_bytes(folder, tmp_path):
    (tmp_path / "own_aeb.py").write_text(DRIVERS)
    assert explore(tmp_path / "parts.db", budget=7).returncode == 0
    assert explore(tmp_path / "parts.db", budget=16).returncode == 0
    assert content(tmp_path / "parts.db") == content(folder / "own.db")
    assert explore(tmp_path / "two.db", "--workers", 2).returncode == 0
    assert content(tmp_path / "two.db") == content(folder / "own.db")


@pytest.mark.parametrize(
    ("ranges", "driver", "sentence"),
    [
        (["Ego.reacton=0.1:1"], "own_aeb:Aeb", "no option 'reacton' that takes numbers; did you mean 'reaction'?"),
        (["Eg.reaction=0.1:1"], "own_aeb:Aeb", "has no entity 'Eg' with a driver; did you mean 'Ego.reaction'?"),
        (["Truck.reaction=0.1:1"], "own_aeb:Aeb", "is a parameter of the driver of Truck, but Truck has no driver"),
        (["Ego.reaction=0.1:1"], "own_aeb:Aeb:reaction=0.3", "is given with a fixed 'reaction'; leave 'reaction' out"),
        (["Ego.reaction=-1:1"], "own_aeb:Aeb", "Ego.reaction=-1: reaction has to be 0 or more."),
        (["Ego.reaction=0.1:1", "Ego.driver.reaction=0.1:1"], "own_aeb:Aeb", "is the same option as Ego.reaction"),
        (["Ego.reaction=0.1:1"], "", "the driver of Ego (normal) has no option 'reaction'"),
    ],
)
def test_what_cannot_be_varied_is_said_before_anything_runs(folder, tmp_path, ranges, driver, sentence):
    (tmp_path / "own_aeb.py").write_text(DRIVERS)
    ended = explore(tmp_path / "refused.db", ranges=ranges, driver=driver)
    assert ended.returncode == 2
    assert sentence in " ".join(ended.stderr.split())
    assert len(ended.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "refused.db").exists()


def test_a_simulator_without_drivers_of_ours_refuses_them_by_name(tmp_path):
    ended = explore(tmp_path / "refused.db", "--simulator", "carmaker", driver="")
    assert ended.returncode == 2
    assert "which the simulator 'carmaker' does not take" in ended.stderr

    class Own(Simulator):
        name = "own"

        def __init__(self):
            self.settings = {}

        def run(self, concretes):
            raise AssertionError

    with pytest.raises(cc.InputError, match="the simulator 'own' does not take"):
        cc.simulate(X, {"Ego.reaction": 0.3}, simulator=Own())


def test_a_preset_is_written_with_its_value_so_that_files_run_on_their_own(folder):
    scenarios = json.loads((folder / "preset-set" / "manifest.json").read_text())["scenarios"]
    for scenario in scenarios:
        root = etree.parse(folder / "preset-set" / scenario["file"])
        (item,) = root.iterfind(".//ScenarioObject[@name='Ego']//Property[@name='cornercase.driver']")
        assert item.get("value") == f"normal:reaction_time={scenario['values']['Ego.reaction_time']!r}"
    ended = cornercase("test", "preset-set", "-o", "preset-again.db", cwd=folder)
    assert ended.returncode == 0, ended.stderr
    assert "3 of 3 recordings are identical" in ended.stdout
    with StudyFile.open(folder / "preset.db", readonly=True) as study:
        alone = cc.simulate(folder / "preset-set" / scenarios[0]["file"], duration=12.0)
        assert same_recording(alone, study.recording(scenarios[0]["id"]))


def test_a_suite_gives_an_own_driver_its_values(folder):
    ended = cornercase("test", "own-set", "-o", "own-again.db", cwd=folder)
    assert ended.returncode == 2
    assert "give the driver, as in Ego=own_aeb:Aeb." in ended.stderr
    ended = cornercase("test", "own-set", "--driver", "Ego=own_aeb:Aeb", "-o", "own-again.db", cwd=folder)
    assert ended.returncode == 0, ended.stderr
    assert "3 of 3 recordings are identical" in ended.stdout
    ended = cornercase(
        "test", "own-set", "--driver", "Ego=own_aeb:Aeb:brake=2", "-o", "own-other.db", "--workers", 2, cwd=folder
    )
    assert ended.returncode == 0, ended.stderr
    ended = cornercase("compare", "own-again.db", "own-other.db", cwd=folder)
    assert "Ego.reaction" in ended.stdout


@pytest.mark.parametrize(
    ("driver", "why"),
    [
        ("own_aeb:Plain", "the driver of Ego (own_aeb:Plain) has no option 'reaction' that takes numbers."),
        ("own_aeb:Aeb:reaction=0.2", "the driver of Ego (own_aeb:Aeb:reaction=0.2) is given with a fixed 'reaction'."),
    ],
)
def test_another_driver_of_a_suite_need_not_take_its_values(folder, tmp_path, driver, why):
    ended = cornercase("test", "own-set", "--driver", f"Ego={driver}", "-o", tmp_path / "test.db", cwd=folder)
    assert ended.returncode == 0, ended.stderr
    assert f"Without effect in this run: Ego.reaction: {why}" in " ".join(ended.stderr.split())


def test_changed_values_in_a_manifest_make_another_suite(folder, tmp_path):
    manifest = json.loads((folder / "own-set" / "manifest.json").read_text())
    for path in (folder / "own-set").iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    manifest["scenarios"][0]["values"]["Ego.reaction"] = 0.123
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    words = ("test", tmp_path, "--driver", "Ego=own_aeb:Aeb", "-o", "own-again.db")
    assert cornercase("test", "own-set", *words[2:], cwd=folder).returncode == 0
    ended = cornercase(*words, cwd=folder)
    assert ended.returncode == 2, ended.stdout


def test_report_and_command_name_the_dimension(folder):
    ended = cornercase("report", "own.db", "-o", "own.html", cwd=folder)
    assert ended.returncode == 0, ended.stderr
    page = (folder / "own.html").read_text()
    assert "--range Ego.reaction=0.1:1.5" in page
    assert "Ego.reaction" in cornercase("show", "own.db", "--all", cwd=folder).stdout


def test_a_damaged_study_is_repaired_with_the_values(folder, tmp_path):
    (tmp_path / "own_aeb.py").write_text(DRIVERS)
    study = tmp_path / "damaged.db"
    study.write_bytes((folder / "own.db").read_bytes())
    with sqlite3.connect(study) as connection:
        connection.execute("UPDATE scenarios SET recording = zeroblob(10) WHERE id = 3")
    words = ("verify", "damaged.db", "--repair", "--driver", "Ego=own_aeb:Aeb", "--scenario", X)
    assert cornercase(*words, cwd=tmp_path).returncode == 0
    assert content(study) == content(folder / "own.db")


def test_parameters_in_a_table_and_on_the_command_line(folder, tmp_path):
    table = tmp_path / "values.csv"
    table.write_text("ego_start,Ego.reaction\n40,0.3\n40,1.2\n")
    words: tuple[object, ...] = ("simulate", X, "--driver", "Ego=own_aeb:Aeb", "--duration", 8)
    ended = cornercase(*words, "--parameters", table, "-o", tmp_path / "runs", cwd=folder)
    assert ended.returncode == 0, ended.stderr
    words = (*words, "--set", "ego_start=40")
    ended = cornercase(*words, "--set", "Ego.reaction=1.2", "-o", tmp_path / "one.csv", cwd=folder)
    assert ended.returncode == 0, ended.stderr
    assert (tmp_path / "one.csv").read_bytes() == (tmp_path / "runs" / "x_intersection-00002.csv").read_bytes()
    ended = cornercase(*words, "--set", "Ego.reaction=soon", "-o", tmp_path / "no.csv", cwd=folder)
    assert ended.returncode == 2
    assert "the parameter Ego.reaction is 'soon', which is not a number." in ended.stderr
    words = ("import", tmp_path / "runs", "--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc")
    ended = cornercase(*words, "-o", "imported.db", cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert "Ego.reaction: 0.3 to 1.2" in cornercase("show", "imported.db", "--all", cwd=tmp_path).stdout


def test_a_space_file_and_a_problem_name_them_too(tmp_path):
    space = tmp_path / "driver.space.xosc"
    space.write_text(
        SPACE.read_text()
        .replace("</Deterministic>", _REACTION_DISTRIBUTION + "</Deterministic>")
        .replace('filepath="x_intersection.xosc"', f'filepath="{X}"')
    )
    ended = cornercase("check", X, "--space", space)
    assert ended.returncode == 0, ended.stdout
    assert "varied: Ego.reaction_time: 0.2 to 0.8 in steps of 0.1 (of a driver, not checked)" in ended.stdout
    logical = cc.LogicalScenario.read(X, space)
    assert logical.space == cc.LogicalScenario.read(X, SPACE, ["Ego.reaction_time=0.2:0.8:0.1"]).space
    problem = cc.Problem(logical, ego="Ego", other="Pedestrian", metrics="wttc")
    simulator = Builtin(drivers={"Ego": "normal"}, duration=8.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", cc.NoticeWarning)
        study = cc.Study.create(tmp_path / "study.db", problem, simulator)
        assert study.explore("sobol", budget=4).done == 4
        with pytest.raises(cc.InputError, match="is given with a fixed"):
            cc.Study.create(tmp_path / "no.db", problem, Builtin(drivers={"Ego": "simple:reaction_time=0.2"}))


_REACTION_DISTRIBUTION = (
    '<DeterministicSingleParameterDistribution parameterName="Ego.reaction_time"><DistributionRange stepWidth="0.1">'
    '<Range lowerLimit="0.2" upperLimit="0.8"/></DistributionRange></DeterministicSingleParameterDistribution>'
)


@pytest.mark.parametrize("more", at_night([(), ("--asynchronous",)], [("--asynchronous",)]))
def test_a_reference_driver_does_not_get_the_values_of_the_driver(folder, tmp_path, more):
    condition = ("--critical-if", "collision and not reference:cc-human", "--metric", "clearance")
    study = tmp_path / "condition.db"
    ended = cornercase(
        *("explore", X, "--space", SPACE, "--range", "Ego.reaction_time=0.5:2.5", "--driver", "Ego=normal"),
        *("--ego", "Ego", "--other", "Pedestrian", *condition, "--optimizer", "sobol", "--budget", 16, *more),
        *("-o", study),
    )
    assert ended.returncode == 0, ended.stderr
    assert " failed" not in ended.stdout
    with StudyFile.open(study, readonly=True) as opened:
        collided = [row.id for row in opened.finished_rows() if opened.recording(row.id).collisions]
        assert collided
        assert any(opened.reference_outcome(number, "cc-human") is not None for number in collided)


def test_mutants_need_a_driver_whose_options_are_not_varied(folder):
    ended = cornercase("reduce", "preset.db", "--kill-mutants", 5, "-o", "mutants", cwd=folder)
    assert ended.returncode == 2
    assert "driver of Ego in all scenarios, but Ego.reaction_time is a parameter of the scenarios;" in ended.stderr


def test_sumo_says_that_it_drives_itself(tmp_path):
    pytest.importorskip("libsumo")
    ended = explore(
        tmp_path / "sumo.db", "--simulator", "sumo", ranges=["Ego.reaction_time=0.1:0.5"], driver="normal", budget=2
    )
    assert ended.returncode == 2
    assert "SUMO itself drives Ego as 'normal'" in ended.stderr


@pytest.mark.slow
def test_an_estimate_runs_new_scenarios_with_values(folder):
    ended = cornercase("estimate", "preset.db", "--budget", 100, "-o", "estimate.db", cwd=folder)
    assert ended.returncode == 0, ended.stderr
    with StudyFile.open(folder / "estimate.db", readonly=True) as study:
        assert not study.failed_rows()
        assert all("Ego.reaction_time" in row.values for row in study.finished_rows())


@pytest.mark.slow
def test_a_dask_cluster_gives_the_same_bytes(folder, tmp_path):
    pytest.importorskip("distributed")
    (tmp_path / "own_aeb.py").write_text(DRIVERS)
    ended = explore(tmp_path / "cluster.db", "--cluster", "local", "--workers", 2)
    assert ended.returncode == 0, ended.stderr
    assert content(tmp_path / "cluster.db") == content(folder / "own.db")
