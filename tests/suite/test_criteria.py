"""Requirements from the criteria that scenarios ask ScenarioRunner for."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from conftest import car, moving, scenario_file
from cornercase import InputError, NoticeWarning, analyze, explore, reduce
from cornercase import run_suite as run_scenarios
from cornercase.scenario import LogicalScenario
from cornercase.scenario._concrete_file import write_concrete_file
from cornercase.scenario._file import ScenarioFile
from cornercase.suite import Requirement, judge
from cornercase.suite._judge import compute_margin
from helpers.command_line import cornercase
from helpers.two_cars import met

pytestmark = pytest.mark.filterwarnings("ignore:adapted:UserWarning", "ignore:not used:UserWarning")


def asks(name: str, parameter: str = "", value: str = "") -> str:
    return f"""<Condition name="criteria_{name}" delay="0" conditionEdge="rising"><ByValueCondition>
<ParameterCondition parameterRef="{parameter}" value="{value}" rule="lessThan"/></ByValueCondition></Condition>"""


def with_criteria(folder: Path, *criteria: str, speed: str = "10", name: str = "scenario.xosc") -> Path:
    """An ego that drives towards B, which stands 100 m ahead of it."""
    folder.mkdir(exist_ok=True)
    both = moving("50", "$speed") + moving("150", "0", "B")
    return scenario_file(
        folder,
        init=both,
        entities=car("Ego") + car("B"),
        stop=f"<ConditionGroup>{''.join(criteria)}</ConditionGroup>",
        parameters=f'<ParameterDeclaration name="speed" parameterType="double" value="{speed}"/>',
        name=name,
    )


ALL = (asks("CollisionTest"), asks("KeepLaneTest"), asks("DrivenDistanceTest", "distance_success", "60"))


def test_43_6_criteria_of_files_become_requirements_and_the_others_are_named(tmp_path):
    for name, speed, criteria in (
        ("far", "10", (*ALL, asks("MaxVelocityTest", "max_velocity", "9"))), ("slow", "3", ALL), ("fast", "20", ALL)
    ):  # fmt: skip
        with_criteria(tmp_path / "set", *criteria, speed=speed, name=f"{name}.xosc")
    options = ("--ego", "Ego", "--other", "B", "--duration", "8", "--require-from-file", "--json")
    done = cornercase("test", tmp_path / "set", *options, "-o", tmp_path / "run.db")
    assert done.returncode == 1, done.stderr
    said = " ".join(done.stderr.split())
    assert "Not used as requirements from the scenarios of set: KeepLaneTest; a recording cannot answer them" in said
    told = {one["file"]: one for one in json.loads(done.stdout)["scenarios"]}
    states = {file: {one["requirement"]: one["state"] for one in each["verdicts"]} for file, each in told.items()}
    assert states == {
        "far.xosc": {
            "no collision": "passed", "drive 60": "passed", "for far.xosc: ego.speed <= 9 m/s": "failed",
        },
        "slow.xosc": {"no collision": "passed", "drive 60": "failed"},
        "fast.xosc": {"no collision": "failed", "drive 60": "passed"},
    }  # fmt: skip


def test_43_6_one_file_is_a_suite_and_what_is_asked_twice_counts_once(tmp_path):
    path = with_criteria(tmp_path / "s", *ALL)
    result = run_scenarios(
        path, tmp_path / "run.db", ego="Ego", other="B", duration=5.0, require=["no collision"], require_from_file=True
    )
    assert result.requirements == ("no collision", "drive 60")
    assert [one.state for one in result.scenarios[0].verdicts] == ["passed", "failed"]
    assert "drives 50 m until 5 s, less than 60 m" in result.scenarios[0].verdicts[1].reason


def test_43_6_a_concrete_file_keeps_what_its_scenario_asks_for(tmp_path):
    path = with_criteria(tmp_path / "s", asks("DrivenDistanceTest", "distance", "$speed"))
    write_concrete_file(ScenarioFile(path), {"speed": 12.0}, tmp_path / "set" / "one.xosc")
    result = run_scenarios(
        tmp_path / "set", tmp_path / "run.db", ego="Ego", other="B", duration=3.0, require_from_file=True
    )
    assert result.requirements == ("drive 12",)
    assert result.has_passed()


@pytest.mark.parametrize(
    ("criteria", "words"),
    [
        ((), "has none of ScenarioRunner's criteria that can be used"),
        (
            (asks("RunningRedLightTest"), asks("DrivenDistanceTest")),
            "not used: RunningRedLightTest, DrivenDistanceTest;",
        ),
        ((asks("DrivenDistanceTest", "d", "far"),), "value of <ParameterCondition>"),
        ((asks("DrivenDistanceTest", "d", "-5"),), "give a distance above 0"),
    ],
)
def test_43_6_files_that_hold_nothing_to_take_are_refused(tmp_path, criteria, words):
    with_criteria(tmp_path / "set", *criteria)
    with pytest.raises(InputError) as caught:
        run_scenarios(tmp_path / "set", tmp_path / "run.db", ego="Ego", other="B", require_from_file=True)
    assert words in str(caught.value)
    assert not (tmp_path / "run.db").exists()


def test_43_6_how_far_the_ego_drives_is_judged():
    recording = met((np.array([0.0, 1.0, 3.0, 6.0, 4.0, 4.0]), 0.0, 0.0, 1.0), (np.full(6, 90.0), 0.0, 0.0, 0.0))
    passed = judge(Requirement.parse("drive  6 m"), recording, "Ego", "Other")
    assert (passed.state, passed.reason) == ("passed", "Ego has driven 6 m at 0.3 s")
    failed = judge(Requirement.parse("drive 8.5"), recording, "Ego", "Other")
    assert failed.state == "failed"
    assert failed.value == pytest.approx(8.0)
    assert compute_margin(Requirement.parse("drive 8.5"), recording, "Ego", ["Other"]) == pytest.approx(-0.5)
    with pytest.raises(InputError, match="give a distance"):
        Requirement.parse("drive far")


def test_43_the_notice_of_a_reduced_set_names_its_scenarios(tmp_path):
    path = with_criteria(tmp_path, *ALL)
    logical = LogicalScenario.read(path, None, ["speed=5:20"])
    explore(logical, tmp_path / "s.db", ego="Ego", other="B", metrics=["distance"], budget=6, duration=4.0)
    analyze(tmp_path / "s.db", ["distance"])
    reduce(tmp_path / "s.db", tmp_path / "set", scenario=path)
    with pytest.warns(NoticeWarning) as told:
        run_scenarios(tmp_path / "set", tmp_path / "run.db", require_from_file=True)
    (said,) = [str(one.message) for one in told if "not used" in str(one.message)]
    files = sorted(one.name for one in (tmp_path / "set").glob("*.xosc"))
    names = files[0] if len(files) == 1 else "the scenarios of set"
    assert said.startswith(f"not used as requirements from {names}: KeepLaneTest; ")
