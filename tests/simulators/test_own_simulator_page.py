"""The statements of docs/howto/own-simulator.md, checked with its example."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import cornercase as cc
from conftest import EXAMPLES
from cornercase import InputError, SimulationError, SimulatorError
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import SIMULATORS, check_settings
from cornercase.simulators.pool._simulator import WorkerSimulator
from cornercase.study import StudyFile
from documentation.test_documentation import ROOT, blocks_of
from helpers.command_line import cornercase

PAGE = ROOT / "docs" / "howto" / "own-simulator.md"


@pytest.fixture(scope="module")
def code() -> list[str]:
    return [block.text for block in blocks_of(PAGE) if block.language == "python"]


@pytest.fixture(scope="module")
def folder(code, tmp_path_factory) -> Iterator[Path]:
    """Folder with the first demonstration, in which the page's code has been run."""
    folder = tmp_path_factory.mktemp("page")
    (folder / "x").mkdir()
    (folder / "x" / "scenario").symlink_to(EXAMPLES / "x_intersection")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SIMULATORS, "_factories", dict(SIMULATORS._factories))
        patch.chdir(folder)
        found: dict[str, Any] = {"__name__": "page"}
        for text in code:
            exec(compile(text, str(PAGE), "exec"), found)
        yield folder


def test_42_11_the_page_runs_and_its_example_is_right(folder):
    with StudyFile.open("braking.db") as study:
        assert study.meta.settings == {"time_step": 0.05, "braking": 4.0}
        assert study.meta.repeatability["same"]
        collided = [bool(study.recording(row.id).collisions) for row in study.finished_rows()]
        gaps = study.scores("clearance")
    # A collision occurs exactly if the boxes touch.
    assert 0 < sum(collided) < len(collided)
    assert all(hit == (gap <= 0.0) for hit, gap in zip(collided, gaps.tolist(), strict=True))


def test_42_11_a_file_that_declares_parameters_and_entities_is_enough(folder):
    steps = (
        ("analyze", "line.db"), ("reduce", "line.db", "-o", "set"), ("report", "line.db", "-o", "line.html"),
        ("show", "line.db"),
    )  # fmt: skip
    for step in steps:
        done = cornercase("-q", *step, cwd=folder)
        assert done.returncode == 0, done.stderr
    assert list((folder / "set").glob("braking-*.xosc"))
    with StudyFile.open("line.db") as study:
        # Scenarios that do not brake within 10 s fail, and the search continues.
        assert len(study.rows()) == 40
    concrete = ConcreteScenario(Path("braking.xosc"), {"ego_start": 1000.0})
    (outcome,) = SIMULATORS.create("braking").run([concrete])
    assert isinstance(outcome, SimulationError)
    refused = cornercase("explore", "braking.xosc", "--range", "ego_strt=0:9", "--ego", "Ego", "--other", "Pedestrian",
                         "--metric", "clearance", "--simulator", "braking", "-o", "z.db", cwd=folder)  # fmt: skip
    assert "did you mean 'ego_start'?" in refused.stderr
    builtin = cornercase("explore", "braking.xosc", "--range", "ego_start=0:9", "--ego", "Ego", "--other",
                         "Pedestrian", "--metric", "clearance", "-o", "z.db", cwd=folder)  # fmt: skip
    assert (builtin.returncode, "is not a vehicle, pedestrian or misc object" in builtin.stderr) == (2, True)


def test_42_11_ranges_alone_are_told_what_they_need(tmp_path):
    refused = cornercase("explore", "--range", "v=5:20", "--ego", "Ego", "--other", "B", "--metric", "distance",
                         "-o", "z.db", cwd=tmp_path)  # fmt: skip
    assert refused.returncode == 2
    assert (
        "your own simulator only needs a file that declares parameters and entities (docs/howto/own-simulator.md)."
        in refused.stderr
    )
    with pytest.raises(InputError, match=r"or a `space` file that names one\.$"):
        cc.LogicalScenario.read(None)


def test_42_11_what_the_page_says_of_options_holds(folder):
    assert list(check_settings(0.05, 60.0, "continue", None)) == ["time_step", "duration", "on_collision", "drivers"]
    with pytest.raises(InputError, match="supports no drivers"):
        cc.simulate("braking.xosc", {"ego_start": 3.0}, simulator="braking", drivers={"Ego": "normal"})
    with pytest.warns(UserWarning, match=r"without effect: duration 20\.0 s"):
        cc.simulate("braking.xosc", {"ego_start": 3.0}, simulator="braking", duration=20.0)


def test_42_11_a_failure_of_the_program_is_tried_again_and_one_of_the_scenario_is_not(tmp_path):
    from helpers.fake_simulators import Plan

    (tmp_path / "plan").mkdir()
    plan = Plan(tmp_path / "plan", {1: ["lose", "well"], 2: ["fail", "well"]})
    scenario = EXAMPLES / "x_intersection" / "x_intersection.xosc"
    concretes = [ConcreteScenario(scenario, {"k": k}) for k in (1, 2)]
    with WorkerSimulator("failing", {"plan": plan}) as simulator:
        first, second = simulator.run(concretes)
    assert not isinstance(first, SimulationError)
    assert isinstance(second, SimulationError)
    assert issubclass(SimulatorError, SimulationError)


@pytest.mark.slow
def test_42_11_a_script_with_workers_keeps_its_call_to_itself(code, tmp_path):
    (tmp_path / "x").mkdir()
    (tmp_path / "x" / "scenario").symlink_to(EXAMPLES / "x_intersection")
    call = "\n".join(f"    {line}" for line in code[1].replace("budget=40", "budget=4, workers=2").splitlines())
    (tmp_path / "mine.py").write_text(f'{code[0]}\n\nif __name__ == "__main__":\n{call}\n')
    done = subprocess.run([sys.executable, "mine.py"], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("ExplorationResult") == 1
