"""Folders and lists of scenarios, of which some cannot be run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from conftest import car, moving, scenario_file
from cornercase import InputError
from cornercase import run_suite as run_scenarios
from cornercase.simulators import simulate_many
from helpers.command_line import cornercase

SIGNAL = '<ScenarioObject name="signal"/>'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two scenarios that run, one that the simulator refuses, and one that is no XML."""
    (place := tmp_path / "suite").mkdir()
    both = moving() + moving("80", "5", "B")
    for name in ("b.xosc", "d.xosc"):
        scenario_file(place, init=both, entities=car("Ego") + car("B"), name=name)
    scenario_file(place, init=both, entities=car("Ego") + car("B") + SIGNAL, name="a.xosc")
    (place / "c.xosc").write_text("<OpenSCENARIO")
    return place


@pytest.mark.parametrize("workers", [1, 2])
def test_43_one_file_that_cannot_be_run_leaves_the_verdicts_of_the_others(folder, tmp_path, workers):
    asked = ("--ego", "Ego", "--other", "B", "--duration", "1", "--workers", workers, "-o", tmp_path / "s.db")
    done = cornercase("test", folder, *asked, "--require", "no collision", "--junit", tmp_path / "j.xml")
    assert done.returncode == 1, done.stderr
    assert "2 passed, 2 not run of 4 scenarios" in done.stdout
    said = " ".join(done.stdout.split())
    assert "'signal' is not a vehicle" in said
    assert "line 1: is not well-formed XML" in said
    again = cornercase("test", folder, *asked, "--require", "no collision")
    assert again.returncode == 1, again.stderr
    assert "4 of them were already in" in again.stdout
    assert cornercase("report", tmp_path / "s.db", "-o", tmp_path / "r.html").returncode == 0


def test_43_mutants_leave_out_what_cannot_be_run(folder, tmp_path):
    result = run_scenarios(
        folder, tmp_path / "s.db", ego="Ego", other="B", duration=1.0, drivers={"Ego": "normal"}, mutants=1
    )
    assert result.kill_matrix is not None
    assert result.kill_matrix.scenarios == (2, 4)


@pytest.mark.parametrize("without", ["B", "name"])
def test_43_a_file_that_lacks_an_entity_is_one_that_could_not_be_run(folder, tmp_path, without):
    text = (folder / "b.xosc").read_text()
    lost = text.replace('name="B"', 'name="C"').replace('entityRef="B"', 'entityRef="C"')
    (folder / "b.xosc").write_text(
        lost if without == "B" else text.replace('ScenarioObject name="B"', "ScenarioObject")
    )
    result = run_scenarios(folder, tmp_path / "s.db", ego="Ego", other="B", duration=1.0)
    assert [one.state for one in result.scenarios] == ["error", "error", "error", "passed"]
    why = {"B": "has no entity 'B' to be the other", "name": "every <ScenarioObject> needs a unique name"}[without]
    assert why in result.scenarios[1].verdicts[0].reason
    with pytest.raises(InputError, match="has no entity 'D' to be the other"):
        run_scenarios(folder, tmp_path / "t.db", ego="Ego", other="D", duration=1.0)


def test_43_one_file_that_cannot_be_run_leaves_the_other_recordings(folder, tmp_path):
    for before in ("", ", 2 of which existed before"):
        done = cornercase("simulate", *sorted(folder.glob("*.xosc")), "--duration", "1", "-o", tmp_path / "out")
        assert done.returncode == 1, done.stderr
        assert f"2 recordings in {tmp_path / 'out'}{before}." in done.stdout.replace("\n", "")
        assert "2 scenarios failed" in done.stdout
    assert sorted(one.name for one in (tmp_path / "out").glob("?.csv")) == ["b.csv", "d.csv"]


def test_43_where_nothing_can_be_run_the_first_is_refused(folder, tmp_path):
    for name in ("b.xosc", "d.xosc"):
        (folder / name).unlink()
    with pytest.raises(InputError, match=r"a\.xosc, line [0-9]+: the <ScenarioObject> 'signal'"):
        run_scenarios(folder, tmp_path / "s.db", ego="Ego", other="B")
    with pytest.raises(InputError, match=r"a\.xosc, line [0-9]+: the <ScenarioObject> 'signal'"):
        simulate_many([folder / "a.xosc", folder / "c.xosc"], tmp_path / "out")
    (folder / "a.xosc").unlink()
    with pytest.raises(InputError, match=r"c\.xosc, line 1: is not well-formed XML"):
        run_scenarios(folder, tmp_path / "s.db", ego="Ego", other="B")
    assert not (tmp_path / "s.db").exists()
    assert not (tmp_path / "out").exists()


def test_43_a_file_that_is_not_there_is_refused_at_once(folder, tmp_path):
    with pytest.raises(InputError, match=r"e\.xosc: cannot be read"):
        simulate_many([folder / "b.xosc", folder / "e.xosc"], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_43_a_run_of_a_folder_that_has_changed_says_so(folder, tmp_path):
    asked: dict[str, Any] = {"ego": "Ego", "other": "B", "duration": 1.0}
    run_scenarios(folder, tmp_path / "s.db", **asked)
    (folder / "c.xosc").unlink()
    with pytest.raises(InputError, match=r"s\.db: holds other scenarios than the folder, because files were added"):
        run_scenarios(folder, tmp_path / "s.db", **asked)
    (folder / "a.xosc").write_text((folder / "b.xosc").read_text())
    with pytest.raises(InputError, match=r"s\.db: holds other scenarios than the folder"):
        run_scenarios(folder, tmp_path / "s.db", **asked)
