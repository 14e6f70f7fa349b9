"""Road files that scenarios name without a path, as those for CARLA do."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from conftest import ROAD, car, moving, scenario_file
from cornercase import check, convert, explore
from cornercase import run_suite as run_scenarios
from cornercase._common.errors import InputError
from cornercase.report._report_data import read_report_data
from cornercase.report.live._analysis_worker import RoadDrawingCache
from cornercase.scenario import ConcreteScenario, LogicalScenario
from cornercase.scenario._bundle import ScenarioBundle
from cornercase.scenario._concrete_file import write_concrete_file
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._maps import MAPS_VARIABLE, use_map_folders
from cornercase.simulators import Esmini, simulate
from cornercase.simulators.pool._simulator import WorkerSimulator
from cornercase.study import StudyFile
from cornercase.study._scenario_file import find_explored_scenario
from helpers.command_line import cornercase

pytestmark = pytest.mark.filterwarnings("ignore:adapted:UserWarning")


@pytest.fixture
def maps(tmp_path: Path) -> Path:
    (folder := tmp_path / "maps").mkdir()
    (folder / "Town01.xodr").write_text(ROAD)
    return folder


def town(folder: Path, name: str = "Town01") -> Path:
    folder.mkdir(exist_ok=True)
    speed = '<ParameterDeclaration name="speed" parameterType="double" value="8"/>'
    both = moving(speed="$speed") + moving("80", "5", "B")
    path = scenario_file(folder, init=both, entities=car("Ego") + car("B"), parameters=speed)
    (folder / "road.xodr").unlink()
    path.write_text(path.read_text().replace('filepath="road.xodr"', f'filepath="{name}"'))
    return path


@pytest.mark.parametrize(
    "name", ["Town01", "Town01_Opt", "/Game/Carla/Maps/Town01", "Carla\\Maps\\Town01", "../maps of old/Town01.xodr"]
)
def test_43_7_a_map_is_found_by_its_name_and_a_notice_says_where(tmp_path, maps, monkeypatch, name):
    path = town(tmp_path / "s", name)
    monkeypatch.setenv(MAPS_VARIABLE, os.pathsep.join([str(tmp_path), str(maps)]))
    found = check(path)
    assert not found.run_errors
    (notice,) = [one for one in found.notices if one.rule]
    assert str(maps / "Town01.xodr") in notice.reason
    assert notice.parts == ("filepath of <LogicFile>",)
    assert ScenarioFile(path).road_path_for() == maps / "Town01.xodr"


@pytest.mark.parametrize("place", ["OpenDrive/Town01.xodr", "Town01/OpenDrive/Town01.xodr"])
def test_43_7_a_folder_of_carla_itself_serves(tmp_path, maps, place):
    path = town(tmp_path / "s")
    (inner := maps / place).parent.mkdir(parents=True)
    (maps / "Town01.xodr").rename(inner)
    with use_map_folders([maps]):
        assert ScenarioFile(path).road_path_for() == inner
    assert MAPS_VARIABLE not in os.environ


def test_43_7_a_file_that_is_named_and_there_goes_first(tmp_path, maps):
    path = town(tmp_path / "s", "Town01.xodr")
    (tmp_path / "s" / "Town01.xodr").write_text(ROAD)
    with use_map_folders([maps]):
        assert ScenarioFile(path).road_path_for() == tmp_path / "s" / "Town01.xodr"
        assert not [one for one in check(path).notices if one.rule]


def test_43_7_the_map_counts_in_the_fingerprint(tmp_path, maps):
    path = town(tmp_path / "s")
    with use_map_folders([maps]):
        before = ScenarioFile(path).fingerprint()
        (maps / "Town01.xodr").write_text(ROAD.replace('length="500"', 'length="500.0"') + "<!-- other -->")
        assert ScenarioFile(path).fingerprint() != before
    assert ScenarioFile(path).fingerprint() != before


@pytest.mark.parametrize(
    ("name", "file"),
    [("Town03", "Town03"), ("/Game/Carla/Maps/Town10HD_Opt", "Town10HD"), ("maps/Town15.xodr", "Town15")],
)
def test_43_7_what_is_not_there_is_told_to_be_carlas_and_how_to_get_it(tmp_path, maps, name, file):
    path = town(tmp_path / "s", name)
    done = cornercase("simulate", path, "--maps", maps, "-o", tmp_path / "r.csv")
    said = " ".join(done.stderr.split())
    assert done.returncode == 2
    assert "scenario.xosc, line 3: there is no road file" in said
    assert f"{name}; it is a map of CARLA" in said.replace("'", "")
    assert f"CarlaUE4/Content/Carla/Maps/OpenDrive/{file}.xodr" in said
    assert "--maps FOLDER" in said
    assert MAPS_VARIABLE in said


def test_43_7_of_other_roads_the_way_is_told_too(tmp_path):
    (why,) = check(town(tmp_path / "s", "../xodr/ring.xodr")).run_errors
    assert "s/../xodr/ring.xodr; put it there, or name its folder by --maps" in why
    assert "CARLA" not in why


@pytest.mark.parametrize(
    ("given", "said"),
    [("nowhere", "nowhere: there is no such folder"), ("//server/maps", "//server/maps: is a network address")],
)
def test_43_7_what_is_no_folder_here_is_refused(tmp_path, monkeypatch, given, said):
    path = town(tmp_path / "s")
    done = cornercase("check", path, "--maps", given)
    assert done.returncode == 2
    assert f"--maps {said}" in " ".join(done.stderr.split())
    monkeypatch.setenv(MAPS_VARIABLE, given)
    with pytest.raises(InputError, match=f"{MAPS_VARIABLE} {said}"):
        ScenarioFile(path).road_path_for()


def test_43_7_every_command_that_reads_scenarios_takes_folders(tmp_path, maps):
    path = town(tmp_path / "s")
    asked = ("--ego", "Ego", "--other", "B", "--metric", "distance", "--optimizer", "grid", "--duration", "1")
    found = {
        "check": cornercase("check", path, "--maps", maps),
        "simulate": cornercase("simulate", path, "--maps", maps, "-o", tmp_path / "r.csv"),
        "explore": cornercase(
            "explore", path, *asked, "--range", "speed=5:10:1", "--budget", "6", "--maps", maps, "-o", tmp_path / "s.db"
        ),
        "convert": cornercase("convert", path, "--ego", "Ego", "--maps", maps, "-o", tmp_path / "o" / "c.xosc"),
    }
    assert {name: one.returncode for name, one in found.items()} == dict.fromkeys(found, 0)
    assert "the map of that name is used:" in " ".join(found["explore"].stderr.split())
    for command in ("reduce", "report", "watch", "replay", "estimate", "compare", "verify", "test"):
        assert "--maps" in cornercase(command, "--help").stdout


def test_43_7_workers_find_what_the_command_finds(tmp_path, maps):
    path = town(tmp_path / "s")
    with use_map_folders([maps]):
        one = simulate(path, {}, duration=1.0)
        asked = (
            "from cornercase.scenario._file import ScenarioFile; import sys; "
            "print(ScenarioFile(sys.argv[1]).road_path_for())"
        )
        told = subprocess.run([sys.executable, "-c", asked, str(path)], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == str(maps / "Town01.xodr")
    assert one.names == ("Ego", "B")


def test_43_7_a_map_that_is_lost_on_the_way_is_told_by_a_worker(tmp_path, maps):
    """The message of a worker process arrives unchanged."""
    path = town(tmp_path / "s")
    with use_map_folders([maps]):
        concrete = ConcreteScenario(path, {}, ScenarioFile.read(path))
        with WorkerSimulator("builtin", {"duration": 1.0}) as simulator:
            assert not isinstance(next(iter(simulator.run([concrete]))), Exception)
    with (
        WorkerSimulator("builtin", {"duration": 1.0}) as simulator,
        pytest.raises(InputError, match="'Town01'; it is a"),
    ):
        list(simulator.run([ConcreteScenario(path, {})]))


def test_43_7_other_machines_get_the_map_with_the_scenario(tmp_path, maps):
    path = town(tmp_path / "s", "/Game/Carla/Maps/Town01")
    with use_map_folders([maps]):
        scenario = ScenarioFile(path)
        fingerprint, parcel = scenario.fingerprint(), ScenarioBundle.from_file(scenario)
    (there := tmp_path / "there").mkdir()
    shutil.rmtree(maps)
    other = parcel.unpack(there)
    assert other.fingerprint() == fingerprint
    assert not check(other).run_errors


def test_43_7_what_is_written_holds_the_map_and_a_study_says_that_it_needs_it(tmp_path, maps):
    path = town(tmp_path / "s")
    study = tmp_path / "s" / "study.db"
    with use_map_folders([maps]):
        logical = LogicalScenario.read(path, None, ["speed=5:30"])
        explore(
            logical, study, ego="Ego", other="B", metrics=["distance"], optimizer="grid", budget=8, duration=3.0,
            critical=0.0,
        )  # fmt: skip
    with StudyFile.open(study, readonly=True) as opened:
        with pytest.raises(
            InputError, match=r"differs from the scenario that .*study\.db was explored with: there is no road file 'To"
        ):
            find_explored_scenario(opened)
        with use_map_folders([maps]):
            scenario = find_explored_scenario(opened)
            assert scenario is not None
            write_concrete_file(scenario, {"speed": 7.0}, tmp_path / "set" / "one.xosc")
    shutil.rmtree(maps)
    assert 'filepath="Town01.xodr"' in (tmp_path / "set" / "one.xosc").read_text()
    result = run_scenarios(tmp_path / "set", tmp_path / "run.db", ego="Ego", other="B", duration=2.0)
    assert result.has_passed()


def test_43_7_esmini_refuses_a_map_that_it_would_not_find(tmp_path, maps):
    path, named = town(tmp_path / "s"), town(tmp_path / "t", "../maps/Town01.xodr")
    simulator = Esmini.__new__(Esmini)
    simulator._undriven, simulator._drivers = True, {}
    with use_map_folders([maps]):
        simulator.check_supported(ScenarioFile.read(named))
        with pytest.raises(InputError, match=r"names the road 'Town01', which was found as .*; name that file in"):
            simulator.check_supported(ScenarioFile.read(path))


def test_43_7_convert_leaves_the_name_of_carlas_map(tmp_path, maps):
    path = town(tmp_path / "s")
    (out := tmp_path / "out").mkdir()
    with use_map_folders([maps]):
        made = convert(path, out / "c.xosc", ego="Ego")
    assert 'filepath="Town01"' in made.path.read_text()
    assert not list(out.glob("*.xodr"))


def test_43_7_a_road_that_is_not_drawn_is_said_with_the_way_to_the_map(tmp_path, maps):
    path = town(tmp_path / "s")
    asked = ("--ego", "Ego", "--other", "B", "--metric", "distance", "--optimizer", "grid", "--duration", "1")
    study = tmp_path / "s" / "s.db"
    more = ("--range", "speed=5:10:1", "--budget", "6", "--maps", maps, "-o", study)
    assert cornercase("explore", path, *asked, *more).returncode == 0
    for command in (("replay", study, 1), ("report", study)):
        without = cornercase(*command, "-o", tmp_path / "page.html")
        said = " ".join(without.stderr.split())
        assert without.returncode == 0
        assert "The road is not drawn, as there is no road file Town01 of scenario.xosc; it is a map of CARLA" in said
        assert "--maps FOLDER" in said
        assert str(tmp_path) not in (tmp_path / "page.html").read_text()
        done = cornercase(*command, "--maps", maps, "-o", tmp_path / "page.html")
        assert done.returncode == 0
        assert "road is not drawn" not in done.stderr


def test_43_7_a_page_that_is_served_says_once_that_the_map_is_missing(tmp_path, maps):
    path = town(tmp_path / "s")
    with use_map_folders([maps]):
        logical = LogicalScenario.read(path, None, ["speed=5:10"])
        explore(logical, tmp_path / "s" / "s.db", ego="Ego", other="B", metrics=["distance"], budget=2, duration=1.0)
    around = RoadDrawingCache(None)
    with (
        StudyFile.open(tmp_path / "s" / "s.db", readonly=True) as study,
        warnings.catch_warnings(record=True) as caught,
    ):
        warnings.simplefilter("always")
        data = read_report_data(study, figures=False)
        for _ in range(2):
            assert "--maps FOLDER" in around.road_and_rerun_payload(study, data)["roads_missing"]
    assert len([one for one in caught if "--maps FOLDER" in str(one.message)]) == 1
