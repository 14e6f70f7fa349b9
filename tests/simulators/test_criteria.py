"""Conditions by which a scenario asks ScenarioRunner for its own criteria."""

from __future__ import annotations

from pathlib import Path

import pytest

from conftest import (
    car,
    event,
    moving,
    private,
    ran,
    run,
    same_recording,
    scenario_file,
    speed_action,
    story_of,
    teleport,
    time_trigger,
)
from cornercase import check, convert
from cornercase.scenario import ConcreteScenario
from cornercase.scenario._concrete_file import build_concrete_file, write_concrete_file
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._xml import read_xml
from cornercase.simulators import Builtin

NAMES = (
    "RunningStopTest", "RunningRedLightTest", "WrongLaneTest", "OnSidewalkTest", "KeepLaneTest", "CollisionTest",
    "DrivenDistanceTest",
)  # fmt: skip


def criterion(name: str, parameter: str = "", value: str = "", edge: str = "rising") -> str:
    return f"""<Condition name="criteria_{name}" delay="0" conditionEdge="{edge}"><ByValueCondition>
<ParameterCondition parameterRef="{parameter}" value="{value}" rule="lessThan"/></ByValueCondition></Condition>"""


def criteria() -> str:
    last = criterion("DrivenDistanceTest", "distance_success", "100")
    return f"<ConditionGroup>{''.join(map(criterion, NAMES[:-1]))}{last}</ConditionGroup>"


def test_43_6_criteria_are_never_true_and_a_notice_says_so(tmp_path: Path) -> None:
    path = scenario_file(tmp_path, init=moving(), stop=criteria())
    assert run(path, duration=3.0).time[-1] == pytest.approx(3.0)
    found = check(path)
    assert not found.run_errors
    (notice,) = [one for one in found.notices if one.rule]
    assert set(notice.parts) == {f"criteria_{name}" for name in NAMES}
    assert "never true" in notice.reason
    assert "declared parameter" in notice.rule


@pytest.mark.parametrize("edge", ["none", "rising", "falling", "risingOrFalling"])
def test_43_6_a_group_with_a_criterion_is_never_true_and_the_others_are_as_they_are(tmp_path: Path, edge: str) -> None:
    asked = criterion("CollisionTest", edge=edge)
    mixed = time_trigger("1").replace("</ConditionGroup>", f"{asked}</ConditionGroup>")
    assert run(scenario_file(tmp_path, init=moving(), stop=mixed), duration=3.0).time[-1] == pytest.approx(3.0)
    both = f"<ConditionGroup>{asked}</ConditionGroup>{time_trigger('1')}"
    assert run(scenario_file(tmp_path, init=moving(), stop=both), duration=3.0).time[-1] < 1.1


def test_43_6_a_condition_on_no_parameter_is_never_true_whatever_its_name(tmp_path: Path) -> None:
    stop = f"<ConditionGroup>{criterion('CollisionTest').replace('criteria_', 'end_')}</ConditionGroup>"
    path = scenario_file(tmp_path, init=moving(), stop=stop)
    assert run(path, duration=2.0).time[-1] == pytest.approx(2.0)
    (notice,) = [one for one in check(path).notices if one.rule]
    assert notice.parts == ("condition 'end_CollisionTest'",)


def test_43_6_a_misspelt_parameter_is_refused_still(tmp_path: Path) -> None:
    stop = f"<ConditionGroup>{criterion('x', 'spede', '3').replace('criteria_', 'end_')}</ConditionGroup>"
    speed = '<ParameterDeclaration name="speed" parameterType="double" value="3"/>'
    (why,) = check(scenario_file(tmp_path, init=moving(), stop=stop, parameters=speed)).run_errors
    assert "there is no parameter 'spede'" in why
    assert "did you mean 'speed'" in why


def test_43_6_a_criterion_on_a_declared_parameter_is_a_condition_like_others(tmp_path: Path) -> None:
    stop = f"<ConditionGroup>{criterion('DrivenDistanceTest', 'distance', '100', 'none')}</ConditionGroup>"
    declared = '<ParameterDeclaration name="distance" parameterType="double" value="3"/>'
    path = scenario_file(tmp_path, init=moving(), stop=stop, parameters=declared)
    assert run(path, duration=2.0).time[-1] < 0.1
    assert not [one for one in check(path).notices if one.rule]


def test_43_6_a_concrete_file_keeps_its_criteria(tmp_path: Path) -> None:
    path = scenario_file(tmp_path, init=moving(), stop=criteria())
    written = build_concrete_file(ScenarioFile(path), {}, tmp_path / "one.xosc").content.decode()
    assert all(f'name="criteria_{name}"' in written for name in NAMES)
    assert 'parameterRef="distance_success" value="100"' in written


def test_43_6_who_is_added_relative_to_another_waits_until_that_is_placed(tmp_path: Path) -> None:
    added = "".join(
        f"""<GlobalAction><EntityAction entityRef="{name}"><AddEntityAction><Position>
<RelativeRoadPosition entityRef="{other}" ds="{ds}" dt="0"/></Position></AddEntityAction></EntityAction></GlobalAction>"""
        for name, other, ds in (("C", "B", 30), ("B", "Ego", 120))
    )
    path = scenario_file(
        tmp_path,
        init=added + private("B", speed_action("5")) + private("Ego", teleport("50"), speed_action("10")),
        entities=car("Ego") + car("B") + car("C"),
        story=story_of(event("e", speed_action("0"), time_trigger("1"))),
    )
    recording = run(path, duration=1.0)
    x = {name: recording.x[k, 0] for k, name in enumerate(recording.names)}
    assert x["B"] - x["Ego"] == pytest.approx(120.0)
    assert x["C"] - x["B"] == pytest.approx(30.0)
    assert recording.speed[recording.entity_index("B"), -1] == pytest.approx(5.0)


def test_43_6_a_driver_that_was_chosen_drives_in_the_concrete_file_too(tmp_path: Path) -> None:
    """Scenarios for ScenarioRunner give the ego a controller of theirs as they begin."""
    assigned = """<PrivateAction><ControllerAction><AssignControllerAction><Controller name="HeroAgent"><Properties>
<Property name="module" value="external_control"/></Properties></Controller></AssignControllerAction></ControllerAction>
</PrivateAction>"""
    both = private("Ego", teleport("50"), speed_action("15"), assigned) + private("B", teleport("90"))
    path = scenario_file(tmp_path, init=both, entities=car("Ego") + car("B"))
    write_concrete_file(ScenarioFile(path), {}, tmp_path / "out" / "one.xosc", {"Ego": "normal"})
    (before,) = ran(Builtin(duration=4.0, drivers={"Ego": "normal"}), [ConcreteScenario(path, {})])
    after = run(tmp_path / "out" / "one.xosc", duration=4.0)
    assert before.speed[0, -1] < 14.0
    assert same_recording(before, after)
    assert not same_recording(before, run(path, duration=4.0))


def test_43_6_criteria_of_scenario_runner_stay_in_what_is_written_for_it(tmp_path: Path) -> None:
    more = f"<ConditionGroup>{criterion('Evil')}{criterion('ReachedRegionTest')}</ConditionGroup>"
    path = scenario_file(tmp_path, init=moving(), stop=criteria() + more)
    made = convert(path, tmp_path / "out" / "one.xosc", ego="Ego")
    told = [one for one in made.notes if "criteria_" in one]
    assert ["'criteria_Evil' is left out" in told[0], "'criteria_ReachedRegionTest' is" in told[1]] == [True, True]
    root = read_xml(made.path)
    found = root.xpath("Storyboard/StopTrigger/ConditionGroup/Condition[.//ParameterCondition]/@name")
    assert found == [f"criteria_{name}" for name in NAMES]
    assert root.xpath("//ParameterCondition[@parameterRef='distance_success']/@value") == ["100"]
    assert run(made.path, duration=2.0).time[-1] == pytest.approx(2.0)


WILD = Path(__file__).parents[3] / "shared" / "reference" / "wild"


@pytest.mark.skipif(not WILD.is_dir(), reason="the folder of others' scenarios is not there")
@pytest.mark.parametrize(
    "source",
    [
        "BRL-CAV+scenario_runner/srunner/examples/FollowLeadingVehicle.xosc",
        "TrustAISys+scenario_runner_rl/srunner/examples/rl_scenarios/RLTest_Town01.xosc",
        "carla-simulator+scenario_runner/srunner/examples/StoryDeleteEntityAction.xosc",
    ],
)
def test_43_6_what_others_wrote_for_scenario_runner_runs(source: str) -> None:
    assert run(WILD / source, duration=1.0).time[-1] == pytest.approx(1.0)
