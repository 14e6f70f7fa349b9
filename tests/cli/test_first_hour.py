"""What a new user stumbled over in the first hour, by number."""

from __future__ import annotations

import csv
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
import warnings
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pandas as pd
import pytest

from cornercase._common.errors import InputError, NoticeWarning
from cornercase._common.progress import format_duration
from cornercase.exploration._explore import explore_config
from cornercase.exploration._paper_examples import paper_experiment_config
from cornercase.optimizers._grid import Grid
from cornercase.scenario import ParameterSpace
from cornercase.simulators.carmaker import _simulator as carmaker
from cornercase.study import StudyFile
from helpers.command_line import SPACE, X, cornercase

SEARCH = ("explore", X, "--space", SPACE, "--ego", "Ego", "--other", "Pedestrian", "--budget", "2", "--batch", "2")

ROOT = Path(__file__).parents[2]
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PARQUET = ("scenarios", "recordings", "courses")


@pytest.fixture
def notices():
    """Filters that a command sets are gone after it."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", NoticeWarning)
        yield


def test_stumble_07_nothing_is_taken_for_markup_and_no_carmaker_is_here_that_is_not(monkeypatch):
    monkeypatch.setattr(carmaker, "is_cmapi_installed", lambda: False)
    monkeypatch.setattr(carmaker, "_is_port_open", lambda: False)
    found = json.loads(cornercase("simulators", "--json").stdout)
    assert "no CarMaker listens on port 16660" in found["carmaker"]["missing"]
    shown = cornercase("simulators").stdout
    (line,) = [one for one in shown.splitlines() if one.split()[:1] == ["carmaker"]]
    assert line.split()[1] == "no"
    monkeypatch.setattr(carmaker, "is_cmapi_installed", lambda: True)
    assert not json.loads(cornercase("simulators", "--json").stdout)["carmaker"]["missing"]


@pytest.mark.parametrize("names", [["a"], ["a", "b", "c"]])
def test_stumble_09_a_grid_of_a_billion_is_refused_at_once(names):
    space = ParameterSpace.from_ranges([f"{name}=0:1" for name in names])
    with pytest.raises(InputError, match=r"`budget` 1000000000: its grid has more than 1000000 points"):
        Grid().start(space, 0, budget=1_000_000_000)
    # Few points are few, however large the budget is.
    steps = ParameterSpace.from_ranges(["a=0:1:0.1", "b=0:1:0.5"])
    assert len(Grid().start(steps, 0, budget=1_000_000_000).ask(100)) == 33


def test_stumble_10_python_runs_it_as_a_module():
    done = subprocess.run([sys.executable, "-m", "cornercase", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("cornercase 0.")


def test_stumble_10_a_shell_can_complete_commands(monkeypatch):
    monkeypatch.setenv("_CORNERCASE_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", "cornercase re")
    monkeypatch.setenv("COMP_CWORD", "1")
    program = "import sys; sys.argv = ['cornercase']; from cornercase.cli import main; main()"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert sorted(done.stdout.split()) == ["reduce", "replay", "report"]


def test_stumble_10_a_metric_tells_its_definition():
    told = cornercase("metrics", "wttc", "ttc:accelerating=true").stdout
    assert told.startswith("wttc, in s; low is critical\n\nTime to collision if both entities do the worst")
    assert "accelerating" in told
    found = json.loads(cornercase("metrics", "pet", "--json").stdout)
    assert [one["name"] for one in found] == ["pet"]
    assert cornercase("metrics", "nothing").returncode == 2


def test_stumble_10_many_files_are_checked_at_once(tmp_path):
    shutil.copytree(X.parent, tmp_path / "x")
    good, bad = tmp_path / "x" / X.name, tmp_path / "x" / "bad.xosc"
    assert cornercase("check", good, good).stdout.endswith("2 of 2 are valid and can be run\n")
    bad.write_text("<OpenSCENARIO>")
    done = cornercase("check", bad, good)
    assert done.returncode == 1
    assert done.stdout.endswith("1 of 2 are valid and can be run\n")
    assert f"{good}:" in done.stdout
    assert cornercase("check", good, good, "--space", SPACE).returncode == 2


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--metric", "WTTC"), "did you mean 'wttc'?"),
        (("--metric", "wttc", "--driver", "aggressive"), "write it as ENTITY=NAME, as in Ego=aggressive"),
    ],
)
def test_stumble_10_what_is_meant_is_suggested(options, words, tmp_path):
    done = cornercase(*SEARCH, *options, "-o", tmp_path / "study.db")
    assert done.returncode == 2
    assert words in done.stderr


def test_stumble_10_other_settings_are_told_with_both_values_and_quiet_is_quiet(tmp_path, notices):
    search = (*SEARCH, "--metric", "wttc", "--optimizer", "sobol", "-o", tmp_path / "study.db")
    quiet = cornercase("-q", *search)
    assert quiet.returncode == 0
    assert not quiet.stderr
    assert "2 scenarios in" in quiet.stdout
    done = cornercase(*search, "--time-step", "0.1")
    assert done.returncode == 2
    assert "other simulator settings (time_step: 0.05 in the study, 0.1 given)" in done.stderr
    cornercase("-q", "analyze", tmp_path / "study.db", "--by", "wttc")
    assert "settings at most" in cornercase("-v", "analyze", tmp_path / "study.db", "--by", "wttc").stderr


def test_stumble_06_fewer_than_asked_for_is_said(tmp_path, notices):
    search = (*SEARCH, "--metric", "wttc", "--optimizer", "sobol", "-o", tmp_path / "study.db")
    for command in (search, ("analyze", tmp_path / "study.db", "--by", "wttc")):
        assert cornercase(*command).returncode == 0
    done = cornercase("reduce", tmp_path / "study.db", "--size", "5000", "--scenario", X, "-o", tmp_path / "reduced")
    assert done.returncode == 0
    assert "5000 scenarios were asked for, but " in done.stderr
    assert (
        "asked for" not in cornercase("reduce", tmp_path / "study.db", "--scenario", X, "-o", tmp_path / "two").stderr
    )


@pytest.fixture(scope="module")
def searched(tmp_path_factory):
    """A study of 24 scenarios, analysed and reduced, of which 21 are critical."""
    folder = tmp_path_factory.mktemp("searched")
    study = folder / "study.db"
    search = (*SEARCH[:-4], "--budget", "24", "--metric", "wttc", "--optimizer", "sobol", "--critical", "1")
    for command in (
        (*search, "-o", study),
        ("analyze", study, "--by", "wttc"),
        ("reduce", study, "--scenario", X, "-o", folder / "reduced"),
    ):
        assert cornercase(*command).returncode == 0
    return study


def test_stumble_04_what_is_critical_is_asked_anew_of_a_study_that_stays_as_it_is(searched, tmp_path):
    study = tmp_path / "study.db"
    shutil.copy(searched, study)
    before = study.read_bytes()

    def shown(*options):
        return json.loads(cornercase("show", study, "--json", *options).stdout)

    own = shown()
    scores = [float(row["wttc"]) for row in rows_of(study, tmp_path / "tables")]
    threshold = sorted(scores)[len(scores) // 2]
    asked = shown("--critical", str(threshold))
    assert own["critical"]["scenarios"] == sum(one <= 1 for one in scores)
    assert asked["critical"]["scenarios"] == sum(one <= threshold for one in scores) < own["critical"]["scenarios"]
    assert "asked" not in own["critical"]
    assert "the study's own is wttc ≤ 1 s" in asked["critical"]["asked"]
    assert asked["critical"]["share"]["value"] < own["critical"]["share"]["value"]
    # What is told of the reduced set is of this threshold too, and says by which it was chosen.
    assert "They were chosen by wttc ≤ 1 s" in asked["chosen"]
    assert "chosen" not in own
    assert study.read_bytes() == before
    assert shown("--critical", "1") == own


@pytest.mark.slow
def test_stumble_04_report_analyze_and_reduce_ask_anew_what_is_critical_too(searched, tmp_path):
    study = tmp_path / "study.db"
    shutil.copy(searched, study)

    def shown(*options):
        return json.loads(cornercase("show", study, "--json", *options).stdout)

    own = shown()
    scores = [float(row["wttc"]) for row in rows_of(study, tmp_path / "tables")]
    threshold = sorted(scores)[len(scores) // 2]
    page = tmp_path / "report.html"
    assert cornercase("report", study, "--critical", str(threshold), "--scenario", X, "-o", page).returncode == 0
    text = page.read_text(encoding="utf-8")
    assert "This threshold was chosen afterwards: the study's own is wttc" in text
    assert "--critical 1 " in text, "the command that makes the study again has its own threshold"

    assert cornercase("analyze", study, "--by", "wttc", "--critical", str(threshold)).returncode == 0
    kept = tmp_path / "kept"
    options = ("--critical", str(threshold), "--scenario", X, "-o", kept)
    assert cornercase("reduce", study, *options).returncode == 0
    manifest = json.loads((kept / "manifest.json").read_text(encoding="utf-8"))
    assert manifest["critical_threshold"] == threshold
    assert manifest["critical_threshold_of_the_study"] == 1
    assert "chosen" not in shown("--critical", str(threshold))
    # Without it, the study is asked by its own again.
    again = shown()
    assert again["critical"] == own["critical"]
    assert f"They were chosen by wttc ≤ {threshold:g} s" in again["chosen"]
    assert again["clusters"]["wttc"]["mutual_information_with"] == own["clusters"]["wttc"]["mutual_information_with"]


def rows_of(study, folder):
    cornercase("export", study, "-o", folder)
    with (folder / "scenarios.csv").open(encoding="utf-8", newline="") as text:
        return list(csv.DictReader(text))


def test_stumble_12_columns_have_no_spaces_and_parquet_holds_courses_and_recordings(searched, tmp_path):
    assert cornercase("export", searched, "-o", tmp_path / "csv").returncode == 0
    head = (tmp_path / "csv" / "scenarios.csv").read_text(encoding="utf-8").splitlines()[0]
    assert "cluster_by_wttc" in head
    assert " " not in head
    # The package may be there and refuse NumPy.
    pytest.importorskip("pyarrow", exc_type=ImportError)
    assert cornercase("export", searched, "--parquet", "-o", tmp_path / "parquet").returncode == 0
    rows = {name: pd.read_parquet(tmp_path / "parquet" / f"{name}.parquet") for name in PARQUET}
    assert list(rows["scenarios"]) == head.split(",")
    for name in ("recordings", "courses"):
        for scenario, part in rows[name].groupby("scenario"):
            plain = pd.read_csv(tmp_path / "csv" / name / f"{scenario:05}.csv", keep_default_na=False)
            pd.testing.assert_frame_equal(
                part.drop(columns="scenario").reset_index(drop=True), plain, check_dtype=False
            )
    assert set(rows["courses"]["scenario"]) == set(rows["scenarios"]["id"])


def test_stumble_12_what_fits_to_each_other_is_installed():
    extras = SETTINGS["project"]["optional-dependencies"]
    # pyarrow itself does not say which NumPy it runs with: from 26 on it refuses those before 2.
    assert any(one.startswith("numpy>=2") for one in extras["parquet"])
    assert any(one.startswith("asam-qc-opendrive") for one in extras["dev"]), "else the bound below can go"
    (bound,) = [one for one in extras["dev"] if one.startswith("pyarrow")]
    assert bound.endswith(",<26")


def test_stumble_04_where_no_score_says_what_is_critical_that_is_said(tmp_path):
    search = (*SEARCH, "--metric", "wttc", "--metric", "distance", "--optimizer", "sobol")
    for options, words in (
        (("--pareto",), "a Pareto front has no threshold; leave out --critical"),
        (("--critical-if", "wttc < 1"), "the condition 'wttc < 1' decides what is critical; leave out --critical"),
    ):
        study = tmp_path / f"study{options[0]}.db"
        assert cornercase(*search, *options, "-o", study).returncode == 0
        done = cornercase("show", study, "--critical", "0.5")
        assert done.returncode == 2
        assert words in done.stderr
    assert cornercase("show", study, "--critical", "nan").returncode == 2


def test_stumble_10_a_study_file_stands_for_many_options(searched, tmp_path, monkeypatch):
    shutil.copytree(X.parent, tmp_path / "x")
    study = tmp_path / "study.db"
    shutil.copy(searched, study)
    monkeypatch.chdir(tmp_path)
    told = cornercase("show", study, "--config").stdout
    plain = tomllib.loads(told)
    assert plain["scenario"] == f"x/{X.name}"
    assert plain["space"] == f"x/{SPACE.name}"
    assert (plain["critical"], plain["budget"], plain["metric"]) == (1, 24, ["wttc"])
    # Paths are relative to the file, wherever one is.
    (tmp_path / "study.toml").write_text(told, encoding="utf-8")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    done = cornercase("explore", "--config", "../study.toml", "--budget", "26", "-o", study)
    assert done.returncode == 0
    assert "26 scenarios in" in done.stdout
    assert cornercase("explore", "--config", "../study.toml", "--budget", "4", "-o", "again.db").returncode == 0
    first = [row["wttc"] for row in rows_of(study, tmp_path / "one")][:4]
    assert [row["wttc"] for row in rows_of("again.db", tmp_path / "two")] == first


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('mteric = ["wttc"]', "has 'mteric', which is not known; did you mean 'metric'?"),
        (
            'driver = ["Ego=mine:Driver"]',
            "If it is a class, give it on the command line, --driver Ego=mine:Driver: a study file must not name code.",
        ),
        ('driver = ["Ego=normal:horizon=x"]', "in a file, options are numbers"),
        ('simulator = "carla:port=1"', "has options, which could start programs"),
        (
            'cluster = "tcp://10.0.0.1:8786"',
            "'cluster' is not allowed in a study file; give --cluster on the command line",
        ),
        ('output = "../study.db"', "'output' is not allowed in a study file"),
        ('budget = "3"', "'budget' is not a whole number"),
        ("critical = true", "'critical' is not a number"),
        ("ego = 3", "'ego' is not a string"),
        ("metric = [3]", "'metric' is not a list of strings"),
        ('pareto = "yes"', "'pareto' is neither true nor false"),
        ("ego = ", "is not valid TOML"),
    ],
)
def test_stumble_10_a_study_file_names_no_code_and_nothing_unknown(line, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text("raise SystemExit('it was run')")
    file = tmp_path / "study.toml"
    file.write_text(line, encoding="utf-8")
    done = cornercase("explore", X, "--config", file, "-o", "study.db")
    assert done.returncode == 2
    assert done.stderr.startswith(f"cornercase: {file}: ")
    assert words in done.stderr
    assert not (tmp_path / "study.db").exists()


README = (ROOT / "README.md").read_text(encoding="utf-8")
TOUR = README[README.index("## A tour") :]


@pytest.mark.skipif(sys.platform == "win32", reason="it is typed into a shell of Unix")
def test_stumble_01_who_follows_the_readme_has_the_command_on_the_path(tmp_path):
    """What is printed before the first command is typed where `make demo` has been; the documentation's tests run the rest."""
    if not Path(sys.prefix, "bin", "activate").exists():
        pytest.skip("the tests run in no virtual environment")
    # The recipe installs the command into `.venv`, as tests have it in theirs.
    recipe = MAKEFILE[MAKEFILE.index("demo: $(VENV)/.installed") :].splitlines()[1]
    assert recipe.split()[:2] == ["$(BIN)/cornercase", "demo"]
    (tmp_path / ".venv").symlink_to(sys.prefix)
    (tmp_path / "demo").mkdir()
    typed = [one.strip() for one in TOUR[: TOUR.index("    cornercase ")].splitlines() if one.startswith("    ")]
    assert typed
    script = "\n".join([*typed, "command -v cornercase", "pwd"])
    bare = {"PATH": os.defpath, "HOME": str(tmp_path)}
    done = subprocess.run(["sh", "-e", "-c", script], capture_output=True, text=True, cwd=tmp_path, env=bare)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [str(Path(sys.prefix, "bin", "cornercase")), str(tmp_path / "demo")]


def test_stumble_01_the_installation_leaves_nothing_at_home():
    """The pip that builds the package is started by the one that is called, and gets no options but the environment."""
    for name in ("PIP_NO_CACHE_DIR", "PIP_DISABLE_PIP_VERSION_CHECK"):
        assert f"\n$(VENV)/.installed: export {name} := 1\n" in MAKEFILE


def test_stumble_01_the_tour_leaves_nothing_in_the_checkout():
    ignored = (ROOT / ".gitignore").read_text(encoding="utf-8").split()
    assert {"/demo/", ".venv/"} <= set(ignored)
    lines = TOUR.replace("\\\n", " ").splitlines()
    written = [shlex.split(line) for line in lines if line.startswith("    cornercase ")]
    for words in written:
        for option, path in pairwise(words):
            assert option not in ("-o", "--output", "--junit") or not path.startswith(("/", ".", "~")), words
    assert len(written) > 10


def test_stumble_01_extras_that_are_named_can_be_installed():
    known = set(SETTINGS["project"]["optional-dependencies"])
    pages = [README, *(one.read_text(encoding="utf-8") for one in (ROOT / "docs").rglob("*.md"))]
    named = {
        name for page in pages for found in re.findall(r"cornercase\[([\w,-]+)\]", page) for name in found.split(",")
    }
    assert "sumo" in named <= known


def test_stumble_02_where_nothing_critical_was_run_an_upper_bound_holds(searched, tmp_path):
    done = cornercase("show", searched, "--critical", "-1", "--json")
    found = json.loads(done.stdout)["critical"]
    assert found["scenarios"] == 0
    # With a share of one tenth, none of 24 scenarios that fill the space would be critical in 8 of 100 cases.
    assert found["share"]["high"] > 0.05
    page = tmp_path / "report.html"
    assert cornercase("report", searched, "--critical", "-1", "--scenario", X, "-o", page).returncode == 0
    text = page.read_text(encoding="utf-8")
    assert "None of the 24 scenarios that were run is critical" in text
    assert "Nothing critical was found, so whatever is critical was missed." in text


def test_stumble_05_where_all_runs_fail_that_is_no_success(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lost_driver.py").write_text(
        "import numpy as np\nfrom cornercase.drivers import Driver\n\n\nclass Lost(Driver):\n"
        "    def acceleration(self, situation):\n        return np.full_like(situation.speed, np.nan)\n",
        encoding="utf-8",
    )
    search = (*SEARCH, "--metric", "wttc", "--optimizer", "sobol", "--driver", "Ego=lost_driver:Lost", "-o", "study.db")
    done = cornercase(*search, cwd=tmp_path)
    assert done.returncode == 1, done.stdout + done.stderr
    assert "2 of which failed" in done.stdout
    assert "  2 failed: " in done.stdout
    assert json.loads(cornercase("show", "study.db", "--json").stdout)["failed"] == 2


def test_stumble_08_times_are_told_as_people_do():
    assert [format_duration(one) for one in (42, 7500)] == ["42 s", "2 h 5 min"]


def test_stumble_08_each_long_step_tells_how_far_it_is(searched, tmp_path):
    """What an interrupted command says is in `test_interrupts.py`, and what the first estimate is in `test_progress.py`."""
    study = tmp_path / "study.db"
    shutil.copy(searched, study)
    for command, things in (
        (("analyze", study, "--by", "wttc"), "settings"),
        (("reduce", study, "--scenario", X, "-o", tmp_path / "reduced"), "sets"),
        (("report", study, "--scenario", X, "-o", tmp_path / "report.html"), "recordings"),
    ):
        done = cornercase("-v", *command)
        assert done.returncode == 0, done.stderr
        assert re.search(rf"^\d+ of \d+ {things}", done.stderr, re.MULTILINE), done.stderr


def test_stumble_11_a_study_that_is_read_blocks_nobody(searched, tmp_path):
    study = tmp_path / "study.db"
    shutil.copy(searched, study)
    with StudyFile.open(study) as one, StudyFile.open(study) as two:
        assert one.readonly
        assert two.readonly
        assert cornercase("analyze", study, "--by", "wttc").returncode == 0
        assert one.analyzed_aspects() == ["wttc"]


def given_to_pytest(text):
    """The options of the one line in a text that runs all tests."""
    (line,) = [one for one in text.splitlines() if "-m pytest" in one and " tests/" not in one]
    return shlex.split(line.partition("-m pytest")[2])


def recipe_of(target):
    return MAKEFILE.partition(f"\n{target}:")[2].partition("\n\n")[0]


def nightly(schedule):
    """What CI runs by its schedule, or for each change."""
    workflow = (ROOT / ".github" / "workflows" / "tests.yml").read_text(encoding="utf-8")
    assert re.search(r"^  schedule:\n    - cron: ", workflow, re.MULTILINE)
    choice = r"\$\{\{ github.event_name == 'schedule' && '([^']*)' \|\| '([^']*)' \}\}"
    return re.sub(choice, r"\1" if schedule else r"\2", workflow)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        pytest.param(recipe_of("test"), {"quick"}, id="make test"),
        pytest.param(recipe_of("test-all"), {"quick", "slow"}, id="make test-all", marks=pytest.mark.slow),
        pytest.param(nightly(False), {"quick"}, id="CI", marks=pytest.mark.slow),
        pytest.param(nightly(True), {"quick", "slow"}, id="CI at night"),
    ],
)
def test_stumble_13_what_takes_long_is_left_to_the_night_and_is_run_there(text, expected, tmp_path):
    tests = "".join(f"\n\n@pytest.mark.{mark}\ndef test_{mark}():\n    pass\n" for mark in ("slow", "torture"))
    (tmp_path / "test_marked.py").write_text(f"import pytest\n\n\ndef test_quick():\n    pass\n{tests}")
    options = given_to_pytest(text)
    command = [sys.executable, "-m", "pytest", "-c", ROOT / "pyproject.toml", "--rootdir", tmp_path, *options]
    done = subprocess.run(
        [*command, "--collect-only", tmp_path / "test_marked.py"], capture_output=True, text=True, cwd=tmp_path
    )
    assert set(re.findall(r"test_marked\.py::test_(\w+)", done.stdout)) == expected, done.stdout + done.stderr


def test_stumble_13_much_is_marked_as_slow():
    """Else all of it would be run by day again."""
    files = [one for one in (ROOT / "tests").rglob("test_*.py") if "mark.slow" in one.read_text(encoding="utf-8")]
    parameters = [one for one in (ROOT / "tests").rglob("test_*.py") if "at_night(" in one.read_text(encoding="utf-8")]
    assert len(files) > 15
    assert len(parameters) > 15


@pytest.mark.parametrize("name", ["x-intersection", "t-intersection"])
def test_stumble_03_what_the_demonstration_calls_critical_divides(name, tmp_path):
    configuration = replace(paper_experiment_config(name), budget=64, optimizer="sobol")
    explore_config(configuration, tmp_path / "study.db")
    with StudyFile.open(tmp_path / "study.db") as study:
        critical = study.critical_mask()
    assert 0.02 < critical.mean() < 0.5


def test_check_says_once_what_many_files_share(tmp_path):
    text = Path(X).read_text(encoding="utf-8")
    road = Path(X).with_suffix(".xodr").read_text(encoding="utf-8")
    tree = '<objects><object type="tree" id="1" name="tree" s="1" t="9" zOffset="0" orientation="none"/></objects>'
    (tmp_path / "x_intersection.xodr").write_text(road.replace("</road>", f"{tree}</road>", 1), encoding="utf-8")
    files = [tmp_path / f"{name}.xosc" for name in "abc"]
    for file in files:
        file.write_text(text, encoding="utf-8")
    alone = cornercase("check", files[0]).stdout.splitlines()
    shared = [line for line in alone if "x_intersection.xodr" in line]
    assert shared
    said = cornercase("check", *files).stdout.splitlines()
    assert all(said.count(line) == 1 for line in shared)
    more = f"and {len(shared)} notice{'' if len(shared) == 1 else 's'} on files that it shares, as above"
    assert said.count(more) == 2
