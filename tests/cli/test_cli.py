from __future__ import annotations

import csv
import json
import os
import re
import shutil
import signal
import sys
from pathlib import Path

import numpy as np
import pytest

from conftest import at_night, same_recording, scenario_file, teleport, time_trigger
from cornercase.clustering import read_analysis
from cornercase.recordings import read_recording
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin
from cornercase.study import StudyFile
from helpers.command_line import SPACE, X, cornercase, waiting_after


@pytest.fixture(scope="module")
def demo(tmp_path_factory) -> Path:
    folder: Path = tmp_path_factory.mktemp("demo")
    result = cornercase("demo", "x-intersection", "--budget", "40", "--seed", "1", "-o", folder)
    assert result.returncode == 0, result.stderr
    assert str(folder / "report.html") in result.stdout
    return folder


def test_demo_leaves_everything_it_promises(demo):
    page = (demo / "report.html").read_text()
    assert 'id="contents"' in page
    assert not re.search(r"(src|href)=.?(https?:|//)", page)
    manifest = json.loads((demo / "reduced" / "manifest.json").read_text())
    files = {path.name for path in (demo / "reduced").glob("*.xosc")}
    assert files == {item["file"] for item in manifest["scenarios"]}
    assert manifest["run"] == 40
    assert 0 < manifest["kept"] < 20
    for item in manifest["scenarios"]:
        assert {"id", "file", "cluster", "role", "why", "values", "scores"} <= set(item)
    # Figures for a paper take a while, and are drawn when they are asked for.
    assert not (demo / "report-figures").exists()


def test_where_the_time_went_is_told_by_stage_and_by_function(demo, tmp_path):
    shown = json.loads(cornercase("show", demo / "study.db", "--json").stdout)["seconds"]
    stages = [
        "files",
        "optimize",
        "simulate",
        "measure",
        "store",
        "judge",
        "read",
        "compare",
        "cluster",
        "reduce",
        "draw",
    ]
    assert list(shown) == stages
    page = (demo / "report.html").read_text()
    told = ["read the scenario", *stages[1:]]
    assert [stage for stage in told if f"time to {stage} [s]" not in page] == []
    profile = tmp_path / "profile.txt"
    for _ in range(2):
        found = cornercase("analyze", demo / "study.db", "--by", "wttc", "--profile", profile)
        assert found.returncode == 0, found.stderr
        assert "_analyze.py" in profile.read_text()
    before = (demo / "report.html").read_bytes()
    refused = cornercase("analyze", demo / "study.db", "--profile", demo / "report.html")
    assert refused.returncode == 2
    assert "--profile: " in refused.stderr
    assert (demo / "report.html").read_bytes() == before


def test_reduced_scenarios_run_by_themselves_and_give_the_same_recording(demo):
    manifest = json.loads((demo / "reduced" / "manifest.json").read_text())
    with StudyFile.open(demo / "study.db", readonly=True) as study:
        for item in manifest["scenarios"][:4]:
            (again,) = Builtin().run([ConcreteScenario(demo / "reduced" / item["file"])])
            assert same_recording(again, study.recording(item["id"]))


@pytest.mark.slow
def test_the_same_demo_twice_gives_the_same_scores_and_labels(demo, tmp_path):
    assert cornercase("demo", "x-intersection", "--budget", "40", "--seed", "1", "-o", tmp_path).returncode == 0
    with (
        StudyFile.open(demo / "study.db", readonly=True) as a,
        StudyFile.open(tmp_path / "study.db", readonly=True) as b,
    ):
        for metric in a.meta.metrics:
            np.testing.assert_array_equal(a.scores(metric), b.scores(metric))
        for name in a.analyzed_aspects():
            np.testing.assert_array_equal(a.read_analysis(name)[0]["labels"], b.read_analysis(name)[0]["labels"])
    assert (demo / "reduced" / "manifest.json").read_bytes() == (tmp_path / "reduced" / "manifest.json").read_bytes()


def test_show_and_export(demo, tmp_path):
    summary = json.loads(cornercase("show", demo / "study.db", "--json").stdout)
    assert summary["run"] == 40
    assert "wttc" in cornercase("show", demo / "study.db").stdout
    assert cornercase("export", demo / "study.db", "-o", tmp_path).returncode == 0
    with open(tmp_path / "scenarios.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 40
    with StudyFile.open(demo / "study.db", readonly=True) as study:
        assert study.recording(7).collisions
        assert same_recording(read_recording(tmp_path / "recordings" / "00007.csv"), study.recording(7))
        assert [float(row["wttc"]) for row in rows] == study.scores("wttc").tolist()
        assert summary["metrics"]["wttc"]["most_critical"] == study.scores("wttc").min()


@pytest.mark.skipif(sys.platform == "win32", reason="a test cannot press Ctrl-C there")
def test_ctrl_c_stops_cleanly_and_the_same_command_goes_on(tmp_path):
    arguments = ["explore", X, "--space", SPACE, "--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc",
                 "--optimizer", "sobol", "--budget", "30", "-o"]  # fmt: skip
    study = tmp_path / "study.db"
    with waiting_after(12, tmp_path / "waiting", *arguments, study) as running:
        running.send_signal(signal.SIGINT)
        said, errors = running.communicate(timeout=120)
    assert running.returncode == 130, errors
    assert "Run the same command again to resume" in said
    assert "Traceback" not in errors
    with StudyFile.open(study) as stopped:
        assert 12 <= sum(row.state == "done" for row in stopped.rows()) < 30
    for one in (study, tmp_path / "whole.db"):
        assert cornercase(*arguments, one).returncode == 0
    with StudyFile.open(tmp_path / "whole.db") as one, StudyFile.open(study) as two:
        np.testing.assert_array_equal(one.points(), two.points())
        np.testing.assert_array_equal(one.scores("wttc"), two.scores("wttc"))


CATEGORICAL = f"""<OpenSCENARIO>
  <FileHeader revMajor="1" revMinor="2" date="2026-11-20T00:00:00" author="t" description="t"/>
  <ParameterValueDistribution>
    <ScenarioFile filepath="{X}"/>
    <Deterministic>
      <DeterministicSingleParameterDistribution parameterName="ego_start">
        <DistributionSet><Element value="30"/><Element value="40"/><Element value="50"/></DistributionSet>
      </DeterministicSingleParameterDistribution>
      <DeterministicSingleParameterDistribution parameterName="pedestrian_wait">
        <DistributionRange stepWidth="1"><Range lowerLimit="0" upperLimit="4"/></DistributionRange>
      </DeterministicSingleParameterDistribution>
    </Deterministic>
  </ParameterValueDistribution>
</OpenSCENARIO>
"""


@pytest.mark.parametrize(
    "kind", at_night(["categorical", "one parameter", "two scenarios"], {"one parameter", "two scenarios"})
)
def test_odd_spaces_from_end_to_end(kind, tmp_path):
    study, page = tmp_path / "s.db", tmp_path / "r.html"
    space = tmp_path / "c.xosc"
    space.write_text(CATEGORICAL)
    varied = ["--space", space] if kind == "categorical" else [X, "--range", "ego_start=20:60"]
    budget = 2 if kind == "two scenarios" else 20
    for command in (
        [
            "explore",
            *varied,
            "--ego",
            "Ego",
            "--other",
            "Pedestrian",
            "--metric",
            "wttc",
            "--budget",
            budget,
            "-o",
            study,
        ],
        ["analyze", study],
        ["reduce", study, "-o", tmp_path / "reduced"],
        ["report", study, "-o", page],
    ):
        result = cornercase(*command)
        assert result.returncode == 0, result.stderr
    manifest = json.loads((tmp_path / "reduced" / "manifest.json").read_text())
    assert manifest["run"] == {"categorical": 15, "one parameter": 20, "two scenarios": 2}[kind]
    assert 1 <= manifest["kept"] <= manifest["run"]
    text = page.read_text()
    assert "How much of the space is critical?" in text
    for item in manifest["scenarios"]:
        assert item["file"] in text
        assert (tmp_path / "reduced" / item["file"]).is_file()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="has no pipes with a name")
def test_a_pipe_is_not_replaced_and_a_link_is_followed(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "real.csv").write_text("before")
    (tmp_path / "link.csv").symlink_to(tmp_path / "real.csv")
    result = cornercase("simulate", X, "-o", tmp_path / "pipe")
    assert result.returncode == 2
    assert (tmp_path / "pipe").is_fifo()
    assert cornercase("simulate", X, "-o", tmp_path / "link.csv").returncode == 0
    assert (tmp_path / "link.csv").is_symlink()
    assert (tmp_path / "real.csv").read_text().startswith("time")


def test_the_page_of_settings_changes_no_clusters(demo, tmp_path):
    study = shutil.copy(demo / "study.db", tmp_path / "study.db")
    assert cornercase("analyze", study, "--by", "wttc", "--gamma", "2", "--eps", "0.3").returncode == 0
    with StudyFile.open(study, readonly=True) as opened:
        before, analyzed = read_analysis(opened, "wttc"), opened.analyzed_aspects()
    assert "ego-speed" not in analyzed
    page = tmp_path / "settings.html"
    # What was not analyzed yet is analyzed first.
    ended = cornercase("analyze", study, "--by", "wttc", "--by", "ego-speed", "--explore-settings", page)
    assert ended.returncode == 0
    assert str(page) in ended.stdout
    with StudyFile.open(study, readonly=True) as opened:
        after = read_analysis(opened, "wttc")
        assert opened.analyzed_aspects() == sorted([*analyzed, "ego-speed"], key=opened.analyzed_aspects().index)
    assert (
        (after.clustering.gamma, after.clustering.eps) == (before.clustering.gamma, before.clustering.eps) == (2, 0.3)
    )
    text = page.read_text(encoding="utf-8")
    assert "has used the outcome" in text
    assert str(tmp_path) not in text
    for given in (("--gamma", "1"), ("--keep-clusters",)):
        ended = cornercase("analyze", study, *given, "--explore-settings", page)
        assert (ended.returncode, ended.stderr.count("\n")) == (2, 1)
        assert f"--explore-settings, {given[0]}: give only one of them" in ended.stderr
    ended = cornercase("analyze", study, "--by", "wttc", "--explore-settings", tmp_path / "settings.txt")
    assert (ended.returncode, ended.stderr.count("\n")) == (2, 1)
    assert "give a file name that ends with .html" in ended.stderr
    ended = cornercase("analyze", study, "--by", "wttc", "--explore-settings", study)
    assert ended.returncode == 2


def test_analyze_by_hand(demo):
    result = cornercase(
        "analyze", demo / "study.db", "--by", "wttc", "--gamma", "2", "--eps", "0.3", "--min-samples", "4"
    )
    assert result.returncode == 0, result.stderr
    with StudyFile.open(demo / "study.db", readonly=True) as study:
        _, info = study.read_analysis("wttc")
    assert (info["gamma"], info["eps"], info["min_samples"]) == (2, 0.3, 4)
    assert cornercase("analyze", demo / "study.db").returncode == 0


def test_simulate_and_measure(tmp_path):
    recording, courses = tmp_path / "r.csv", tmp_path / "c.csv"
    assert cornercase("simulate", X, "--set", "ego_start=40", "-o", recording).returncode == 0
    assert read_recording(recording).names == ("Ego", "Truck", "C", "Pedestrian")
    result = cornercase("measure", recording, "--ego", "Ego", "--other", "Pedestrian", "--metric", "distance",
                        "--metric", "wttc", "-o", courses)  # fmt: skip
    assert result.returncode == 0, result.stderr
    with open(courses, newline="") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["time", "distance", "wttc"]
    read = read_recording(recording)
    gap = np.hypot(*(read.box_center("Ego") - read.box_center("Pedestrian")).T)
    np.testing.assert_allclose([float(row[1]) for row in rows[1:]], gap)


def test_a_driver_of_ones_own(tmp_path):
    (tmp_path / "mine.py").write_text(
        "import numpy as np\nclass Sleeper:\n    settings = {'driver': 'sleeper'}\n"
        "    def start(self, scenarios, others): pass\n"
        "    def acceleration(self, situation): return np.zeros_like(situation.speed)\n"
    )
    result = cornercase("simulate", X, "--driver", "Ego=mine:Sleeper", "-o", "r.csv", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert (read_recording(tmp_path / "r.csv").speed[0] == 10).all()


EXPLORE = ("explore", X, "--space", SPACE, "--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc", "--budget", "5")
BAD = {
    "no XML": (("simulate", "{tmp}/text.xosc", "-o", "{tmp}/r.csv"), "not well-formed XML"),
    "no file": (("simulate", "{tmp}/absent.xosc", "-o", "{tmp}/r.csv"), "absent.xosc"),
    "no ego": ((*EXPLORE[:5], "Egg", *EXPLORE[6:], "-o", "{tmp}/s.db"), "did you mean 'Ego'"),
    "no other": ((*EXPLORE, "--other", "Bus", "-o", "{tmp}/s.db"), "no entity 'Bus'"),
    "low above high": ((*EXPLORE, "--range", "ego_start=5:5", "-o", "{tmp}/s.db"), "below the upper"),
    "unknown range": ((*EXPLORE, "--range", "ego_strat=1:5", "-o", "{tmp}/s.db"), "did you mean 'ego_start'"),
    "unknown set": (("simulate", X, "--set", "ego_strat=1", "-o", "{tmp}/r.csv"), "did you mean 'ego_start'"),
    "unknown metric": ((*EXPLORE, "--metric", "wtc", "-o", "{tmp}/s.db"), "did you mean 'wttc'"),
    "unknown optimizer": ((*EXPLORE, "--optimizer", "bays", "-o", "{tmp}/s.db"), "did you mean 'bayes'"),
    "unknown simulator": ((*EXPLORE, "--simulator", "bultin", "-o", "{tmp}/s.db"), "did you mean 'builtin'"),
    "unknown simulator of one": (
        ("simulate", X, "--simulator", "bultin", "-o", "{tmp}/r.csv"),
        "did you mean 'builtin'",
    ),
    "unknown driver": ((*EXPLORE, "--driver", "Ego=norml", "-o", "{tmp}/s.db"), "did you mean 'normal'"),
    "unknown example": (("demo", "y-intersection", "-o", "{tmp}"), "y-intersection"),
    "no study": (("report", "{tmp}/absent.db", "-o", "{tmp}/r.html"), "no such study"),
    "not writable": ((*EXPLORE, "-o", "/proc/nowhere/s.db"), "cannot be written"),
    "full disk": (("simulate", X, "-o", "/dev/full/r.csv"), "cannot be written"),
    "a folder": (("simulate", X, "-o", "{tmp}"), "is not a file"),
    "half a pair": (("simulate", X, "--set", "ego_start", "-o", "{tmp}/r.csv"), "NAME=VALUE"),
    "no option": (("explore", X), "Missing option"),
}


if sys.platform == "win32":
    # Folders in which nobody can write are made anew there.
    del BAD["not writable"], BAD["full disk"]


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_sentence_and_exit_code_2(tmp_path, name):
    (tmp_path / "text.xosc").write_text("hello")
    arguments, words = BAD[name]
    result = cornercase(*(str(a).replace("{tmp}", str(tmp_path)) for a in arguments))
    assert result.returncode == 2
    assert words in result.stderr
    assert "Traceback" not in result.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["text.xosc"]


@pytest.mark.parametrize(
    "command", ["explore", "analyze", "reduce", "report", "demo", "simulate", "measure", "show", "export"]
)
def test_every_command_has_an_example(command):
    result = cornercase(command, "--help")
    assert result.returncode == 0
    assert f"cornercase {command}" in result.stdout


@pytest.mark.parametrize(
    ("profile", "noticed"),
    [
        ('<elevationProfile><elevation s="0" a="0" b="0.05" c="0" d="0"/></elevationProfile>', True),
        ('<lateralProfile><superelevation s="0" a="0" b="0.001" c="0" d="0"/></lateralProfile>', True),
        ('<elevationProfile><elevation s="0" a="90" b="0.001" c="0" d="0"/></elevationProfile>', False),
    ],
)
def test_a_road_that_climbs_or_banks_is_noticed(tmp_path, profile, noticed):
    path = scenario_file(
        tmp_path, init=f'<Private entityRef="Ego">{teleport("10")}</Private>', stop=time_trigger("0.2")
    )
    road = tmp_path / "road.xodr"
    road.write_text(road.read_text().replace("<lanes>", profile + "<lanes>", 1))
    run = cornercase("check", path)
    assert ("elevation of roads (road.xodr, line" in run.stdout) == noticed
    run = cornercase("simulate", path, "-o", tmp_path / "r.csv")
    assert run.returncode == 0
    assert ("Without effect: elevation of roads" in run.stderr) == noticed


def test_check_says_who_drives():
    lines = cornercase("check", X).stdout.splitlines()
    assert "Ego: driven by normal" in lines
    assert "Truck, C, Pedestrian: follow the storyboard and do not react; --driver Truck=normal drives Truck" in lines
