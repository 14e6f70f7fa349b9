"""The suite that the T-intersection's demonstration keeps, run by drivers of other characters."""

import json
from pathlib import Path

import pytest
from lxml import etree

from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin
from cornercase.study import StudyFile
from helpers.command_line import cornercase

SCHEMA = etree.XMLSchema(etree.parse(str(Path(__file__).parents[1] / "data" / "junit.xsd")))


@pytest.fixture(scope="module")
def demonstrated(tmp_path_factory) -> Path:
    folder: Path = tmp_path_factory.mktemp("t")
    done = cornercase("demo", "t-intersection", "--budget", "60", "--seed", "1", "-o", folder)
    assert done.returncode == 0, done.stderr
    assert f"cornercase test {folder / 'suite'} --driver Ego=aggressive" in done.stdout.replace("\n", "")
    return folder


def collides(file: Path, driver: str) -> bool:
    simulator = Builtin(drivers={"Ego": driver}, on_collision="stop")
    (recording,) = simulator.run([ConcreteScenario(file)])
    assert isinstance(recording, Recording), recording
    return any("Ego" in one.entities for one in recording.collisions)


def run(folder: Path, driver: str) -> tuple[int, Path]:
    report = folder / f"{driver}.xml"
    ended = cornercase(
        "test", folder / "suite", "--driver", f"Ego={driver}", "--require", "no collision",
        "--junit", report, "-o", folder / f"{driver}.db",
    )  # fmt: skip
    return ended.returncode, report


@pytest.mark.slow
def test_an_aggressive_driver_fails_where_it_collides_and_a_cautious_one_passes(demonstrated):
    code, report = run(demonstrated, "aggressive")
    assert code == 1
    tree = etree.parse(str(report))
    assert SCHEMA.validate(tree), SCHEMA.error_log
    failed = {case.get("name") for case in tree.iter("testcase") if case.find("failure") is not None}
    files = sorted((demonstrated / "suite").glob("t_intersection-*.xosc"))
    assert len(files) == 20
    assert failed == {file.stem for file in files if collides(file, "aggressive")} != set()
    assert run(demonstrated, "cautious")[0] == 0
    assert not any(collides(file, "cautious") for file in files)


@pytest.mark.slow
def test_the_study_remembers_the_set_that_represents_it(demonstrated):
    manifest = json.loads((demonstrated / "reduced" / "manifest.json").read_text())
    kept = [one["id"] for one in manifest["scenarios"]]
    with StudyFile.open(demonstrated / "study.db", readonly=True) as study:
        remembered = study.read_reduction()
    assert remembered is not None
    assert [one["id"] for one in remembered["kept"]] == kept


@pytest.mark.slow
def test_where_a_driver_has_no_mutants_it_says_so_and_goes_on(tmp_path):
    done = cornercase("demo", "t-intersection", "--budget", "12", "--driver", "cc-human", "-o", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "No suite of tests was made. " in done.stderr
    assert (tmp_path / "report.html").exists()
    assert not (tmp_path / "suite").exists()
