"""What varies without being a parameter: listed, written, explored, and taken through all commands."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pandas
import pytest

from conftest import EXAMPLES, moving, scenario_file
from cornercase import InputError
from cornercase.study import StudyFile
from helpers.command_line import Ended, cornercase
from helpers.openpass_files import of_openpass
from helpers.waiting import until

CUT_IN = EXAMPLES / "r157" / "cut_in.xosc"
WILD = Path(__file__).parents[3] / "shared" / "reference" / "wild"
VARIED = ("--vary", "Ego.initial.x=60:110", "--vary", "Other_cuts_in.trigger.time", "--range", "gap=10:40")
MEASURED = ("--ego", "Ego", "--other", "Other", "--metric", "ttc")
SEARCH = (*MEASURED, "--optimizer", "random", "--duration", "5")


def explored(study: Path, *more: object, scenario: Path = CUT_IN) -> Ended:
    return cornercase("explore", scenario, *VARIED, *SEARCH, *more, "-o", study)


def table(study: Path) -> pandas.DataFrame:
    with StudyFile.open(study, readonly=True) as opened:
        found: pandas.DataFrame = opened.table()
    return found


def test_43_12_the_list_fits_a_terminal_and_names_what_can_be_typed():
    done = cornercase("vary", CUT_IN)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[0].split() == ["name", "value", "unit", "proposed", "line"]
    assert ["Ego.initial.x", "100", "m", "95:105", "69"] in [line.split() for line in lines]
    assert lines.index("entity Ego") < lines.index("event Other cuts in") < lines.index("storyboard")
    assert "Values with $ refer to parameters: vary the parameter." in lines


def test_43_12_a_scenario_and_its_ranges_are_written_and_found_good(tmp_path):
    done = cornercase("vary", CUT_IN, *VARIED[:4], "-o", tmp_path / "out" / "a.xosc")
    assert done.returncode == 0, done.stderr
    assert "varied: Ego_initial_x 60 to 110 m" in done.stdout
    checked = cornercase("check", tmp_path / "out" / "a.xosc", "--space", tmp_path / "out" / "a.space.xosc")
    assert checked.returncode == 0, checked.stdout
    every = cornercase("vary", CUT_IN, "--all", "--vary", "Ego.initial.x=60:110", "-o", tmp_path / "b.xosc")
    assert every.returncode == 0, every.stderr
    assert "varied: Ego_initial_x 60 to 110 m" in every.stdout
    assert every.stdout.count("varied: ") > 8


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("-o", "x.xosc"), "-o x.xosc: only for a varied scenario; give --vary NAME or --all, too."),
        (("--all",), "--vary, --all: give the scenario to write, with -o OUT.xosc."),
        (("--vary", "Ego.initial.z", "-o", "x.xosc"), "--vary Ego.initial.z: "),
    ],
)
def test_43_12_what_is_missing_is_said(options, words, tmp_path):
    done = cornercase("vary", CUT_IN, *options, cwd=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_43_12_explore_varies_at_once_and_goes_on(tmp_path):
    """As if the scenario had been varied before; the same command goes on, from another folder and with a missing file."""
    assert explored(tmp_path / "a" / "s.db", "--budget", "10").returncode == 0
    (tmp_path / "a" / "s.varied.xosc").unlink()
    done = explored(tmp_path / "a" / "s.db", "--budget", "20")
    assert done.returncode == 0, done.stderr
    written = cornercase("vary", CUT_IN, *VARIED[:4], "-o", tmp_path / "b" / "s.varied.xosc")
    assert written.returncode == 0, written.stderr
    ranges = ("gap=10:40", "Ego_initial_x=60:110", "Other_cuts_in_trigger_time=0:2")
    asked = [word for one in ranges for word in ("--range", one)]
    done = cornercase(
        "explore", tmp_path / "b" / "s.varied.xosc", *asked, *SEARCH, "--budget", "20", "-o", tmp_path / "b" / "s.db"
    )
    assert done.returncode == 0, done.stderr
    first, second = table(tmp_path / "a" / "s.db"), table(tmp_path / "b" / "s.db")
    pandas.testing.assert_frame_equal(first, second)
    assert first["Ego_initial_x"].between(60, 110).all()
    assert first["Ego_initial_x"].nunique() == 20
    with StudyFile.open(tmp_path / "a" / "s.db", readonly=True) as opened:
        assert opened.meta.scenario == "s.varied.xosc"
        assert {one.name: one.unit for one in opened.space.parameters}["Ego_initial_x"] == "m"
    replayed = explored(tmp_path / "a" / "s.db", "--budget", "20", "--check-proposals")
    assert replayed.returncode == 0, replayed.stdout


def test_43_12_a_search_that_cannot_begin_leaves_nothing(tmp_path):
    done = cornercase("explore", CUT_IN, *VARIED, *SEARCH, "--other", "Nobody", "-o", tmp_path / "new" / "s.db")
    assert done.returncode == 2
    assert str(CUT_IN) in done.stderr
    assert "Nobody" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_43_12_a_study_goes_on_with_the_same_names_only(tmp_path):
    assert explored(tmp_path / "s.db", "--budget", "2").returncode == 0
    before = (tmp_path / "s.varied.xosc").read_bytes()
    done = cornercase("explore", CUT_IN, "--vary", "Ego.initial.y", *SEARCH, "--budget", "4", "-o", tmp_path / "s.db")
    assert done.returncode == 2
    assert "was created with another scenario file or other names for --vary (s.varied.xosc differs)" in done.stderr
    assert (tmp_path / "s.varied.xosc").read_bytes() == before
    again = cornercase(
        "explore", tmp_path / "s.varied.xosc", "--vary", "Ego.initial.y", *SEARCH, "-o", tmp_path / "s.db"
    )
    assert again.returncode == 2
    assert "is the input file" in again.stderr


def test_43_12_a_study_file_says_what_varies(tmp_path):
    (tmp_path / "study.toml").write_text(
        f'scenario = "{CUT_IN.as_posix()}"\nvary = ["Ego.initial.x=60:110"]\nego = "Ego"\nother = ["Other"]\nmetric = ["ttc"]\n'
    )
    asked = ("--optimizer", "random", "--duration", "5", "--budget", "2")
    done = cornercase("explore", "--config", tmp_path / "study.toml", *asked, "-o", tmp_path / "s.db")
    assert done.returncode == 0, done.stderr
    assert table(tmp_path / "s.db")["Ego_initial_x"].between(60, 110).all()


def test_43_12_roads_that_a_space_names_are_those_beside_the_scenario(tmp_path):
    (tmp_path / "here").mkdir()
    text = CUT_IN.read_text("utf-8").replace('filepath="motorway.xodr"', 'filepath="$Road"')
    road = '<ParameterDeclaration name="Road" parameterType="string" value="motorway.xodr"/>'
    text = text.replace("</ParameterDeclarations>", f"{road}</ParameterDeclarations>")
    scenario = tmp_path / "here" / "roads.xosc"
    scenario.write_text(text, "utf-8")
    for name in ("motorway.xodr", "other.xodr"):
        (tmp_path / "here" / name).write_bytes(CUT_IN.with_name("motorway.xodr").read_bytes())
    space = tmp_path / "here" / "space.xosc"
    space.write_text(
        '<OpenSCENARIO><FileHeader/><ParameterValueDistribution><ScenarioFile filepath="roads.xosc"/><Deterministic>'
        '<DeterministicSingleParameterDistribution parameterName="Road"><DistributionSet><Element value="motorway.xodr"/>'
        '<Element value="other.xodr"/></DistributionSet></DeterministicSingleParameterDistribution></Deterministic>'
        "</ParameterValueDistribution></OpenSCENARIO>",
        "utf-8",
    )
    asked = ("--space", space, "--budget", "4")
    assert explored(tmp_path / "here" / "s.db", *asked, scenario=scenario).returncode == 0
    done = explored(tmp_path / "there" / "s.db", *asked, scenario=scenario)
    assert done.returncode == 2
    assert "the parameter Road names road files relative to the scenario" in done.stderr
    assert not (tmp_path / "there").exists()


def through_all_commands(scenario: Path, vary: list[str], folder: Path, *measured: str, budget: int) -> None:
    """The whole chain, by relative paths in a folder where nothing is."""
    asked = [word for one in vary for word in ("--vary", one)]
    lines: list[tuple[object, ...]] = [
        ("vary", scenario),
        ("vary", scenario, *asked, "-o", "varied/scenario.xosc"),
        ("explore", "varied/scenario.xosc", "--space", "varied/scenario.space.xosc", *measured,
         "--budget", budget, "--duration", "10", "-o", "study.db"),
        ("analyze", "study.db"),
        ("reduce", "study.db", "--size", "3", "-o", "reduced"),
        ("test", "reduced", "-o", "run.db"),
        ("report", "study.db", "-o", "report.html"),
    ]  # fmt: skip
    for line in lines:
        done = cornercase(*line, cwd=folder)
        assert done.returncode in ((0, 1) if line[0] == "test" else (0,)), f"{line}\n{done.stderr}"
        if line[0] == "test":
            assert "3 of 3 recordings are identical to those in study.db" in done.stdout
    page = (folder / "report.html").read_text("utf-8")
    with StudyFile.open(folder / "study.db", readonly=True) as opened:
        assert len(opened.finished_rows()) == budget
        assert all(name in page for name in opened.space.names)
        assert len(opened.space.names) == len(vary)


def test_43_12_a_study_with_its_scenario_is_reduced_and_tested_elsewhere(tmp_path):
    assert explored(tmp_path / "a" / "s.db", "--budget", "5").returncode == 0
    (tmp_path / "a").rename(tmp_path / "sent")
    for line in (
        ("analyze", "sent/s.db", "--by", "ttc"),
        ("reduce", "sent/s.db", "--size", "2", "-o", "sent/reduced"),
        ("test", "sent/reduced", "-o", "run.db"),
    ):
        done = cornercase(*line, cwd=tmp_path)
        assert done.returncode in ((0, 1) if line[0] == "test" else (0,)), f"{line}\n{done.stderr}"
    assert "2 of 2 recordings are identical to those in" in done.stdout


@pytest.mark.slow
def test_43_12_an_example_goes_through_all_commands(tmp_path):
    through_all_commands(CUT_IN, ["Ego.initial.x=60:110", "Other_cuts_in.trigger.time"], tmp_path, *MEASURED, budget=12)


@pytest.mark.slow
@pytest.mark.skipif(not WILD.is_dir(), reason="the folder of others' scenarios is not there")
@pytest.mark.parametrize(
    ("name", "vary", "ego", "other"),
    [
        ("scenariogeneration-examples/generator/CCRs/CCRs_scenarios/xosc/CCRs41.xosc",
         ["Ego.initial.speed=5:20", "Ego.initial.s=20:30"], "Ego", "Target1"),
        ("scenariogeneration-examples/xosc/syncronize_straight_example/xosc/syncronize_straight_example0.xosc",
         ["Ego.initial.speed=5:20:0.5", "Target.initial.lane", "target_event.master_s=150:220:1"], "Ego", "Target"),
        ("carla-simulator+scenario_runner/srunner/examples/LaneOffsetActionExample.xosc",
         ["hero.initial.s", "adversary.initial.x", "adversary.initial.speed"], "hero", "adversary"),
        ("NgaLogic+openscenario/data/MyRoundabout.xosc", ["TargetCar.initial.speed", "Ego.initial.x"], "Ego", "TargetCar"),
    ],
)  # fmt: skip
def test_43_12_scenarios_of_others_go_through_all_commands(name, vary, ego, other, tmp_path):
    measured = ("--ego", ego, "--other", other, "--metric", "distance")
    through_all_commands(WILD / name, vary, tmp_path, *measured, budget=30)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="kills by a signal")
def test_43_12_a_killed_search_goes_on_with_the_same_command(tmp_path):
    study, whole = tmp_path / "a" / "s.db", tmp_path / "b" / "s.db"
    more = ("--budget", "100", "--batch", "5")
    words = ["explore", str(CUT_IN), *VARIED, *SEARCH, *more, "-o", str(study)]
    program = [sys.executable, "-c", "from cornercase.cli import main; main()"]

    def has_some() -> bool:
        with suppress(InputError):
            return study.exists() and int((table(study)["state"] == "done").sum()) >= 10
        return False

    with subprocess.Popen([*program, *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as running:
        until(has_some)
        os.kill(running.pid, signal.SIGKILL)
    assert 10 <= int((table(study)["state"] == "done").sum()) < 100
    for one in (study, whole):
        assert explored(one, *more).returncode == 0
    pandas.testing.assert_frame_equal(table(study), table(whole))
    assert (study.parent / "s.varied.xosc").read_bytes() == (whole.parent / "s.varied.xosc").read_bytes()


def test_43_a_map_is_found_and_the_command_that_is_told_can_be_typed(tmp_path):
    (tmp_path / "maps").mkdir()
    path = scenario_file(tmp_path, init=moving("10"))
    (tmp_path / "road.xodr").rename(tmp_path / "maps" / "Town01.xodr")
    path.write_text(path.read_text().replace('filepath="road.xodr"', 'filepath="Town01"'))
    done = cornercase("vary", path)
    assert done.returncode == 0, done.stderr
    assert "it is a map of CARLA" in " ".join(done.stderr.split())
    assert "–" in next(line for line in done.stdout.splitlines() if "Ego.initial.s " in line)
    output = tmp_path / "v b" / "out.xosc"
    done = cornercase("vary", path, "--maps", tmp_path / "maps", "--vary", "Ego.initial.s", "-o", output)
    assert done.returncode == 0, done.stderr
    command = next(line for line in done.stdout.splitlines() if line.startswith("  cornercase explore"))
    assert shlex.split(command)[2:5] == [str(output), "--space", str(output.with_suffix(".space.xosc"))]


def test_43_explore_copies_what_lies_beside_a_scenario_and_leaves_nothing_where_it_fails(tmp_path):
    path = of_openpass(tmp_path / "a")
    asked = ("--vary", "Ego.initial.speed", "--ego", "Ego", "--metric", "distance", "--duration", "1", "--budget", "3")
    study = tmp_path / "b" / "s.db"
    failed = cornercase("explore", path, *asked, "--other", "Nobody", "-o", study)
    assert failed.returncode == 2
    assert not (tmp_path / "b").exists()
    text = path.read_text()
    ego = text[text.index("<ScenarioObject") : text.index("</ScenarioObject>") + len("</ScenarioObject>")]
    both = moving("10") + moving("60", entity="B")
    text = text.replace(ego, ego + ego.replace('"Ego"', '"B"')).replace(moving("10"), both)
    path.write_text(text)
    done = cornercase("explore", path, *asked, "--other", "B", "-o", study)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "b" / "ProfilesCatalog.xml").read_bytes() == (
        tmp_path / "a" / "ProfilesCatalog.xml"
    ).read_bytes()
    assert cornercase("explore", path, *asked, "--other", "B", "-o", study).returncode == 0
