"""Scenario files as other people's tools write them: read where only one thing can be meant, and refused by name."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from conftest import (
    car,
    event,
    moving,
    private,
    ran,
    scenario_file,
    speed_action,
    story_of,
    teleport,
    time_trigger,
    trajectory,
)
from cornercase import ConcreteScenario, InputError, LogicalScenario
from cornercase._common.errors import NoticeWarning, SimulationError
from cornercase._common.io.support_table import NoticeLabel
from cornercase.cli import app
from cornercase.recordings import Recording
from cornercase.scenario._concrete_file import write_concrete_file
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators import Builtin, check

PARAMETERS = """<ParameterDeclaration name="speed" parameterType="double" value="10"/>
<ParameterDeclaration name="owner" parameterType="string" value="Ego"/>
<ParameterDeclaration name="grade" parameterType="string" value="10"/>
<ParameterDeclaration name="on" parameterType="boolean" value="true"/>"""

DISTANCE = """<ConditionGroup><Condition name="d" delay="0" conditionEdge="none"><ByEntityCondition>
<TriggeringEntities triggeringEntitiesRule="any"><EntityRef entityRef="$owner"/></TriggeringEntities><EntityCondition>
<RelativeDistanceCondition entityRef="B" relativeDistanceType="cartesianDistance" value="1000" freespace="true"
rule="lessThan"/></EntityCondition></ByEntityCondition></Condition></ConditionGroup>"""

VALUE = """<ConditionGroup><Condition name="v" delay="0" conditionEdge="none"><ByValueCondition>
<ParameterCondition parameterRef="on" rule="equalTo" value="true"/></ByValueCondition></Condition></ConditionGroup>"""

LANE_CHANGE = """<PrivateAction><LateralAction><LaneChangeAction>
<LaneChangeActionDynamics dynamicsShape="linear" value="2" dynamicsDimension="time"/>
<LaneChangeTarget><AbsoluteTargetLane value="-1"/></LaneChangeTarget></LaneChangeAction></LateralAction></PrivateAction>"""

TEXTS = """<ConditionGroup><Condition name="t" delay="0" conditionEdge="none"><ByValueCondition>
<ParameterCondition parameterRef="grade" rule="equalTo" value="10"/></ByValueCondition></Condition></ConditionGroup>"""


def written(folder: Path, *changes: tuple[str, str], encoding: str = "utf-8") -> Path:
    """A good scenario, each change of which has to find its place."""
    story = story_of(
        event("slow", speed_action("5"), DISTANCE)
        + event("fast", speed_action("20"), VALUE)
        + event("lane", LANE_CHANGE, TEXTS)
    )
    path = scenario_file(
        folder,
        init=moving(speed="$speed") + private("B", teleport("100"), speed_action("10")),
        story=story,
        stop=time_trigger("3"),
        parameters=PARAMETERS,
        entities=car("Ego") + car("B"),
    )
    text = path.read_text()
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    path.write_bytes(text.encode(encoding))
    return path


def checked(path: Path, *options: str):
    return CliRunner().invoke(app, ["check", str(path), *options])


def test_the_scenario_that_is_broken_below_is_good(tmp_path):
    found = check(written(tmp_path), strict=True)
    assert found.is_valid
    assert [notice for notice in found.notices if notice.label is NoticeLabel.ADAPTED] == []


# What is changed, and what is said of it; each such file gives the recording of the good one.
READ: dict[str, tuple[list[tuple[str, str]], str]] = {
    "a dollar in a declared name": ([('name="owner"', 'name="$owner"')], "'$owner' is read as 'owner'"),
    "bool": ([('"boolean"', '"bool"')], "'bool' is read as boolean"),
    "Boolean": ([('"boolean"', '"Boolean"')], "'Boolean' is read as boolean"),
    "float": ([('"double"', '"float"')], "'float' is read as double"),
    "Double": ([('"double"', '"Double"')], "'Double' is read as double"),
    "String": ([('"string"', '"String"')], "'String' is read as string"),
    "no type of a number": ([(' parameterType="double"', "")], "'speed' is read as double"),
    "no type of a truth": ([(' parameterType="boolean"', "")], "'on' is read as boolean"),
    "True": ([('"boolean" value="true"', '"boolean" value="True"')], "'True' is read as true"),
    "TRUE in a condition": ([('rule="equalTo" value="true"', 'rule="equalTo" value="TRUE"')], "'TRUE' is read as true"),
    "FALSE of an attribute": ([('Entities="false"', 'Entities="FALSE"')], "'FALSE' is read as false"),
    "an edge in capitals": ([('conditionEdge="none"', 'conditionEdge="None"')], "'None' is read as none"),
    "a rule in capitals": ([('rule="lessThan"', 'rule="LessThan"')], "'LessThan' is read as lessThan"),
    "a rule with a line": ([('rule="lessThan"', 'rule="less_than"')], "'less_than' is read as lessThan"),
    "Euclid in English": ([("cartesianDistance", "euclideanDistance")], "is read as euclidianDistance"),
    "a shape in capitals": ([('"linear"', '"Linear"')], "'Linear' is read as linear"),
    "a priority in capitals": ([('"parallel"', '"Parallel"')], "'Parallel' is read as parallel"),
    "a category in capitals": ([('Category="car"', 'Category="Car"')], "'Car' is read as car"),
    "no edge": ([(' conditionEdge="none"', "")], "is read as none"),
    "no delay": ([(' delay="0"', "")], "is read as 0"),
    "an empty delay": ([(' delay="0"', ' delay=""')], "is read as 0"),
    "no priority": ([(' priority="parallel"', "")], "is read as parallel"),
    "no count of a group": ([('name="g" maximumExecutionCount="1"', 'name="g"')], "is read as 1"),
    "a count without end": ([('name="g" maximumExecutionCount="1"', 'name="g" maximumExecutionCount="-1"')], "-1 is"),
    "no rule of entities": ([(' triggeringEntitiesRule="any"', "")], "is read as any"),
    "no dimension": ([(' dynamicsDimension="time"', "")], "is read as time"),
    "no value of a step": ([(' dynamicsDimension="time" value="0"', "")], "missing value of <SpeedActionDynamics>"),
    "no selectTriggeringEntities": ([(' selectTriggeringEntities="false"', "")], "is read as false"),
    "another case of a name": ([("freespace=", "freeSpace=")], "is read as freespace"),
    "spaces around a name": ([('entityRef="B"', 'entityRef="B "')], "'B' is read without the spaces around it"),
    "spaces around a declared name": ([('name="on"', 'name=" on"')], "'on' is read without the spaces around it"),
    "no header": ([('<FileHeader revMajor="1" revMinor="2" date="2026-01-01T00:00:00" author="a"\ndescription="d"/>', "")],
                  "missing <FileHeader>"),
    "a namespace": ([("<OpenSCENARIO>", '<OpenSCENARIO xmlns="http://openscenario.org/1.0">')], "is left out"),
    "a prefix": ([("<OpenSCENARIO>", '<o:OpenSCENARIO xmlns:o="urn:o">'), ("</OpenSCENARIO>", "</o:OpenSCENARIO>")],
                 "is left out"),
    "another case of the root": ([("OpenSCENARIO>", "OpenScenario>")], "is read as <OpenSCENARIO>"),
    "an action without one": ([("<Private entityRef=\"B\">", '<Private entityRef="B"><PrivateAction/>')], "is skipped"),
    "a wrapper without an action": (
        [('<Private entityRef="B">', '<Private entityRef="B"><PrivateAction><LongitudinalAction/></PrivateAction>')],
        "is skipped",
    ),
    "an event without an action": (
        [('<Maneuver name="m">', '<Maneuver name="m"><Event name="e" priority="parallel"><Action name="x"/></Event>')],
        "<Action> without an action",
    ),
    "a variable that nobody declares": (
        [("<Init><Actions>", '<Init><Actions><GlobalAction><VariableAction variableRef="x"><SetAction value="1"/>'
          "</VariableAction></GlobalAction>")],
        "is skipped, as there is no variable 'x'",
    ),
    "a controller that is not there": (
        [("<Init><Actions>", "<Init><Actions><GlobalAction><InfrastructureAction><TrafficSignalAction>"
          '<TrafficSignalControllerAction trafficSignalControllerRef="c" phase="p"/></TrafficSignalAction>'
          "</InfrastructureAction></GlobalAction>")],
        "is skipped, as there is no signal controller 'c'",
    ),
    "a controller without phases": (
        [("</RoadNetwork>", '<TrafficSignals><TrafficSignalController name="c"/></TrafficSignals></RoadNetwork>')],
        "'c' is skipped",
    ),
    "lines before the declaration": ([("<OpenSCENARIO>", '\n\n<?xml version="1.0"?><OpenSCENARIO>')], "XML declaration"),
}  # fmt: skip


@pytest.mark.parametrize("fault", READ)
def test_43_8_what_means_only_one_thing_is_read_so_and_said(tmp_path, fault):
    changes, said = READ[fault]
    (good,) = ran(Builtin(duration=4.0), [ConcreteScenario(written(tmp_path))])
    path = written(tmp_path, *changes)
    found = check(path)
    adapted = [notice for notice in found.notices if notice.label is NoticeLabel.ADAPTED]
    assert found.run_errors == ()
    assert any(said in str(notice) for notice in adapted), adapted
    assert all(notice.rule and notice.lines for notice in adapted)
    (recording,) = ran(Builtin(duration=4.0), [ConcreteScenario(path)])
    np.testing.assert_array_equal(recording.x, good.x)
    np.testing.assert_array_equal(recording.y, good.y)
    assert not check(path, strict=True).is_valid


# What runs as it stands, without a word.
SILENT: dict[str, list[tuple[str, str]]] = {
    "truths as digits": [('Entities="false"', 'Entities="0"'), ('freespace="true"', 'freespace="1"')],
    "no stop trigger": [(f"<StopTrigger>{time_trigger('3')}</StopTrigger>", "")],
    "an empty maneuver": [('<Maneuver name="m">', '<Maneuver name="z"/><Maneuver name="m">')],
    "comments": [("<Init>", "<!-- a --><Init><!-- b -->"), ("<Condition ", "<!-- c --><Condition ")],
    "a processing instruction": [("<Init>", "<?tool x?><Init>")],
    "spaces around numbers": [('value="$speed"', 'value=" $speed "'), ('value="20"', 'value=" 20 "')],
    "names with spaces": [('"Ego"', '"The ego, v1"')],
}


@pytest.mark.parametrize("what", SILENT)
def test_43_8_what_breaks_no_rule_is_not_said_to_be_adapted(tmp_path, what):
    found = check(written(tmp_path, *SILENT[what]), strict=True)
    assert (found.run_errors, found.standard_violations) == ((), ())


# What is refused, and why: it may mean more than one thing, or nothing.
REFUSED: dict[str, tuple[list[tuple[str, str]], str]] = {
    "a decimal comma": ([('value="20"', 'value="20,5"')], r"line \d+: value of .* write it with a point, as 20\.5"),
    "no rule": ([('\nrule="lessThan"', "")], r"line \d+: rule of <RelativeDistanceCondition>"),
    "a rule of no kind": ([('rule="lessThan"', 'rule="near"')], r"line \d+: rule 'near'"),
    "an edge of no kind": ([('conditionEdge="none"', 'conditionEdge="any"')], r"line \d+: conditionEdge 'any'"),
    "a truth of no kind": ([('Entities="false"', 'Entities="maybe"')], r"line \d+: selectTriggeringEntities .*'maybe'"),
    "a count of 0": ([('Count="1"', 'Count="0"')], "at least 1"),
    "a parameter of no name": ([('entityRef="$owner"', 'entityRef="$nobody"')], r"line \d+: entityRef .*'nobody'"),
    "an entity of no name": ([('entityRef="B"', 'entityRef="C"')], "'C'"),
    "a road that is not there": ([("road.xodr", "way")], r"line \d+: there is no road file 'way';"),
    "a drive of Windows": ([("road.xodr", "C:\\maps\\way.xodr")], r"line \d+: there is no road file .*way\.xodr;"),
    "version 0.9": ([('revMajor="1" revMinor="2"', 'revMajor="0" revMinor="9"')], r"OpenSCENARIO 0\.9.*migration"),
    "a box below 0": ([('width="2', 'width="-2')], "positive length and width"),
    "a variable that a condition may ask for": (
        [("<Init><Actions>", '<Init><Actions><GlobalAction><VariableAction variableRef="x"><SetAction value="1"/>'
          "</VariableAction></GlobalAction>"),
         ("ParameterCondition parameterRef=\"on\"", 'VariableCondition variableRef="x"')],
        r"line \d+: <\w+>: there is no variable 'x'",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", REFUSED)
def test_43_8_what_may_mean_something_else_is_refused_by_name(tmp_path, fault):
    changes, why = REFUSED[fault]
    path = written(tmp_path, *changes)
    with pytest.raises(InputError, match=why) as refused:
        ran(Builtin(duration=1.0), [ConcreteScenario(ScenarioFile.read(path).path)])
    assert str(tmp_path) in str(refused.value)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_43_8_files_in_other_encodings_are_read(tmp_path, encoding):
    path = written(tmp_path, ('author="a"', 'author="Jürgen"'), ('"Ego"', '"Größe"'), encoding=encoding)
    assert check(path).run_errors == ()
    assert ScenarioFile.read(path).entities[0] == "Größe"


@pytest.mark.parametrize(
    ("rule", "value", "holds"),
    [("greaterThan", "9", True), ("lessThan", "9", False), ("greaterOrEqual", "10.0", True), ("lessThan", "100", True)],
)
def test_43_8_numbers_in_texts_are_compared_as_numbers(tmp_path, rule, value, holds):
    old = '"grade" rule="equalTo" value="10"'
    lane = ('<AbsoluteTargetLane value="-1"/>', '<AbsoluteTargetLane value="1"/>')
    path = written(tmp_path, (old, f'"grade" rule="{rule}" value="{value}"'), lane)
    (recording,) = ran(Builtin(duration=2.5), [ConcreteScenario(path)])
    assert (abs(recording.y[0, -1] - recording.y[0, 0]) > 1.0) == holds
    assert any("is compared as a number" in str(notice) for notice in check(path).notices)


@pytest.mark.parametrize(("kind", "length", "width"), [("car", 5.04, 2.0), ("bicycle", 1.8, 0.5), ("bus", 12.0, 2.55)])
def test_43_8_a_box_of_nothing_is_that_of_its_kind(tmp_path, kind, length, width):
    text = written(tmp_path).read_text()
    box = re.search("<Dimensions[^>]*>", text)
    assert box is not None
    path = written(
        tmp_path, (box[0], '<Dimensions length="0" width="0.0" height="0"/>'), ('Category="car"', f'Category="{kind}"')
    )
    (recording,) = ran(Builtin(duration=1.0), [ConcreteScenario(path)])
    assert (recording.length[0], recording.width[0]) == (length, width)
    assert any(f"the {kind} is taken as {length:g} m long" in str(notice) for notice in check(path).notices)


def test_43_8_what_is_written_of_a_lenient_file_breaks_no_rule(tmp_path):
    changes = [
        ('name="owner"', 'name="$owner"'),
        ('"boolean"', '"bool"'),
        (' conditionEdge="none"', ""),
        ('"B"', '"B "'),
    ]
    source = written(tmp_path, *changes)
    folder = tmp_path / "out"
    folder.mkdir()
    target = folder / "one.xosc"
    write_concrete_file(ScenarioFile.read(source), {"owner": "B"}, target)
    assert check(target, strict=True).is_valid
    assert 'name="owner" parameterType="string" value="B"' in target.read_text()


def test_43_8_a_space_may_name_its_parameter_with_a_dollar(tmp_path):
    written(tmp_path, ('name="speed"', 'name="$speed"'))
    space = tmp_path / "space.xosc"
    space.write_text("""<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="2026-01-01T00:00:00" author="a"
description="d"/><ParameterValueDistribution><ScenarioFile filepath="scenario.xosc"/><Deterministic>
<DeterministicSingleParameterDistribution parameterName="$speed"><DistributionRange stepWidth="1">
<Range lowerLimit="5" upperLimit="9"/></DistributionRange></DeterministicSingleParameterDistribution></Deterministic>
</ParameterValueDistribution></OpenSCENARIO>""")
    logical = LogicalScenario.read(None, space)
    assert [one.name for one in logical.space.parameters] == ["speed"]
    (values,) = logical.space.values(logical.space.center_point())
    ran(Builtin(duration=1.0), [ConcreteScenario(logical.scenario_file.path, values)])


def test_43_8_a_space_is_checked_as_it_is_read(tmp_path):
    path, space = written(tmp_path), tmp_path / "space.xosc"
    space.write_text("""<OpenSCENARIO xmlns="http://www.asam.net/x"><FileHeader revMajor="1" revMinor="2"
date="2026-01-01T00:00:00" author="a" description="d"/><ParameterValueDistribution><ScenarioFile filepath="scenario.xosc"/>
<Deterministic><DeterministicSingleParameterDistribution parameterName="speed"><DistributionRange stepWidth="1"><Range
lowerLimit="5" upperLimit="9"/></DistributionRange></DeterministicSingleParameterDistribution></Deterministic>
</ParameterValueDistribution></OpenSCENARIO>""")
    assert check(path, space).schema_errors == ()
    assert not check(path, space, strict=True).is_valid


def test_43_8_strict_refuses_with_the_rule_and_exit_code_1(tmp_path):
    path = written(tmp_path, ('"boolean"', '"bool"'))
    assert checked(path).exit_code == 0
    ended = checked(path, "--strict")
    assert ended.exit_code == 1
    said = re.sub(r"\s+", " ", ended.stdout)
    assert re.search(r"refused: parameterType of <ParameterDeclaration> \(scenario\.xosc, line \d+\): 'bool'", said)
    assert "The standard: it is boolean, dateTime" in said
    assert checked(written(tmp_path), "--strict").exit_code == 0


def noticed(path: Path, duration: float = 6.0, **values: float) -> tuple[Recording, list[str]]:
    """A recording, and the sentences that are said of its run."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        (recording,) = ran(Builtin(duration=duration), [ConcreteScenario(path, values)])
    return recording, [str(one.message) for one in caught]


def changing(folder: Path, lane: str, offset: str = "0") -> Path:
    change = LANE_CHANGE.replace('<AbsoluteTargetLane value="-1"/>', lane)
    change = change.replace("<LaneChangeAction>", f'<LaneChangeAction targetLaneOffset="{offset}">')
    return scenario_file(folder, init=moving(), story=story_of(event("e", change, time_trigger("$when"))),
                         parameters='<ParameterDeclaration name="when" parameterType="double" value="1"/>')  # fmt: skip


@pytest.mark.parametrize(
    "lane", ['<AbsoluteTargetLane value="-3"/>', '<RelativeTargetLane entityRef="Ego" value="2"/>']
)
def test_43_9_who_is_to_change_to_a_lane_that_is_not_there_stays_in_its_own(tmp_path, lane):
    recording, said = noticed(changing(tmp_path, lane))
    np.testing.assert_allclose(recording.y[0], -2.0)
    assert recording.x[0, -1] == pytest.approx(110.0)
    place = "adapted: <LaneChangeAction> (scenario.xosc, line "
    (sentence,) = [one for one in said if place in one]
    assert "Ego is to change to a lane that does not exist, and stays in its own lane; first at 1" in sentence


def test_43_9_it_goes_to_the_offset_that_it_is_to_have(tmp_path):
    # As in esmini, that is where it ends.
    recording, _ = noticed(changing(tmp_path, '<AbsoluteTargetLane value="-3"/>', "-1"))
    assert recording.y[0, -1] == pytest.approx(-3.0)
    assert np.abs(np.diff(recording.y[0])).max() < 0.05


def test_43_9_each_scenario_of_a_batch_changes_when_it_is_told_to(tmp_path):
    path = changing(tmp_path, '<AbsoluteTargetLane value="-3"/>', "-1")
    with pytest.warns(NoticeWarning, match="lane that does not exist"):
        late, early = ran(Builtin(duration=4.0), [ConcreteScenario(path, {"when": w}) for w in (9.0, 0.5)])
    assert (late.y[0, -1], early.y[0, -1]) == (pytest.approx(-2.0), pytest.approx(-3.0))


@pytest.mark.parametrize(
    ("position", "x"),
    [
        ('<RelativeRoadPosition entityRef="Ego" ds="5000" dt="0"/>', 500.0),
        ('<RelativeLanePosition entityRef="Ego" ds="-5000" dLane="0"/>', 0.0),
        ('<RelativeLanePosition entityRef="Ego" dsLane="451" dLane="0"/>', 500.0),
    ],
)
def test_43_9_what_lies_beyond_the_end_relative_to_another_is_at_the_end(tmp_path, position, x):
    placed = f"<PrivateAction><TeleportAction><Position>{position}</Position></TeleportAction></PrivateAction>"
    path = scenario_file(tmp_path, init=moving() + private("B", placed), entities=car("Ego") + car("B"))
    recording, said = noticed(path, 1.0)
    assert recording.x[1, 0] == pytest.approx(x)
    assert any("B would be beyond the end of the road, and is placed at that end" in one for one in said)


def test_43_9_what_lies_on_the_road_is_not_said_to_be_beyond(tmp_path):
    placed = teleport("50").replace(
        '<LanePosition roadId="1" laneId="-1" s="50"/>', '<RelativeRoadPosition entityRef="Ego" ds="450" dt="0"/>'
    )
    path = scenario_file(tmp_path, init=moving() + private("B", placed), entities=car("Ego") + car("B"))
    recording, said = noticed(path, 1.0)
    assert recording.x[1, 0] == pytest.approx(500.0)
    assert not any("beyond" in one for one in said)


def drawn(folder: Path, *times: str) -> Path:
    """Follows a line, on which it is each 10 m at one of these times."""
    vertices = "".join(
        f'<Vertex time="{time}"><Position><WorldPosition x="{50 + 10 * k}" y="-2" h="0"/></Position></Vertex>'
        for k, time in enumerate(times)
    )
    timing = '<Timing domainAbsoluteRelative="absolute" scale="1" offset="0"/>'
    follow = trajectory(f"<Polyline>{vertices}</Polyline>", timing)
    return scenario_file(folder, init=moving(), story=story_of(event("f", follow, time_trigger("0"))))


def test_43_8_vertices_are_passed_over_while_the_time_goes_back(tmp_path):
    path = drawn(tmp_path, "0", "2", "4", "3", "4", "5")
    recording, _ = noticed(path, 4.8)
    when = np.searchsorted(recording.time, [1.0, 3.0, 4.5])
    # At 4 s it is at two places; from there the last of them counts, as in esmini.
    np.testing.assert_allclose(recording.x[0, when], [55.0, 65.0, 95.0], atol=1e-6)
    adapted = [notice for notice in check(path).notices if notice.label is NoticeLabel.ADAPTED]
    assert ["time goes back to 3 s" in str(notice) for notice in adapted] == [True]


def test_43_8_times_that_end_before_they_did_are_refused(tmp_path):
    (result,) = Builtin(duration=2.0).run([ConcreteScenario(drawn(tmp_path, "0", "4", "2"))])
    assert "must not decrease" in str(result)


@pytest.mark.parametrize(
    ("relative", "needed", "at"),
    [
        ('<RelativeLanePosition entityRef="Ego" {} ds="20"/>', 'dLane="0"', 70.0),
        ('<RelativeObjectPosition entityRef="Ego" dx="20" {}/>', 'dy="0"', 70.0),
        ('<RelativeObjectPosition entityRef="Ego" {} dy="0"/>', 'dx="0"', 50.0),
        ('<RelativeWorldPosition entityRef="Ego" dx="20" {}/>', 'dy="0"', 70.0),
        ('<RelativeRoadPosition entityRef="Ego" ds="20" {}/>', 'dt="0"', 70.0),
    ],
)
def test_43_8_a_distance_that_is_missing_is_none(tmp_path, relative, needed, at):
    found = []
    for each in (needed, ""):
        place = f"<PrivateAction><TeleportAction><Position>{relative.format(each)}</Position></TeleportAction></PrivateAction>"
        path = scenario_file(tmp_path, init=moving("50", "10") + private("B", place), entities=car("Ego") + car("B"))
        with warnings.catch_warnings(record=True):
            warnings.simplefilter("always")
            (recording,) = ran(Builtin(duration=0.2), [ConcreteScenario(path, {})])
        found.append(recording.x[1, 0])
        said = [one.reason for one in check(path).notices if "missing" in str(one)]
        assert (said == ["is read as 0"]) == (each == "")
    assert found == [at, at]


ON = '<ParameterDeclaration name="on" parameterType="boolean" value="true"/>'
VARIABLE = '<VariableDeclaration name="n" variableType="integer" value="{}"/>'
BOARD = "<Storyboard><Init><Actions/></Init><StopTrigger/></Storyboard>"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "<CatalogLocations/>",
            f"<VariableDeclarations>{VARIABLE.format(1)}{VARIABLE.format(2)}</VariableDeclarations><CatalogLocations/>",
            "<VariableDeclaration>: 'n' is declared twice; keep one of them",
        ),
        ("</Entities>", f"{car('B')}</Entities>", "every <ScenarioObject> needs a unique name"),
        ("<CatalogLocations/>", "<CatalogLocations/>\n<CatalogLocations/>", "<CatalogLocations>: repeats the one"),
        ("<Entities>", f"<Entities>{car('C')}</Entities>\n<Entities>", "<Entities>: repeats the one in"),
        ("</RoadNetwork>", "</RoadNetwork><RoadNetwork/>", "<RoadNetwork>: repeats the one in line"),
        ("</Storyboard>", f"</Storyboard>{BOARD}", "<Storyboard>: repeats the one in line"),
        ("</Init>", "</Init><Init><Actions/></Init>", "<Init>: repeats the one in line"),
        (
            "<CatalogLocations/>",
            f"<ParameterDeclarations>{ON}</ParameterDeclarations><CatalogLocations/>",
            "<ParameterDeclarations>: repeats the one in line",
        ),
    ],
)
def test_43_3_what_a_file_has_once_is_refused_the_second_time(tmp_path, old, new, said):
    path = written(tmp_path, (old, new))
    with pytest.raises(InputError, match=rf"^{re.escape(str(path))}, line \d+: {re.escape(said)}"):
        ran(Builtin(duration=0.1), [ConcreteScenario(path)])


@pytest.mark.parametrize("first", ["false", "true"])
def test_43_3_of_two_declarations_of_a_parameter_the_later_one_counts(tmp_path, first):
    (once,) = ran(Builtin(duration=2.0), [ConcreteScenario(written(tmp_path))])
    path = written(tmp_path, (ON, f"{ON.replace('true', first)}\n{ON}"))
    assert "'on' is declared in line 5, too; the later one counts" in " ".join(map(str, check(path).notices))
    (twice,) = ran(Builtin(duration=2.0), [ConcreteScenario(path)])
    np.testing.assert_array_equal(twice.speed, once.speed)
    assert ScenarioFile.read(path).parameters.count("on") == 1


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('value="5"', 'value="1_0"', "value of <AbsoluteTargetSpeed> is '1_0', which is not a number"),
        (
            'value="5"',
            'value="\u0661\u0662"',
            "value of <AbsoluteTargetSpeed> is '\u0661\u0662', which is not a number",
        ),
        ('value="5"', 'value="${\u0661+1}"', "value of <AbsoluteTargetSpeed> cannot be evaluated"),
        ('value="5"', 'value="${1_0}"', "value of <AbsoluteTargetSpeed> cannot be evaluated"),
        ('Type="double" value="10"', 'Type="double" value="1_0"', "value of <AbsoluteTargetSpeed> is '1_0', which is"),
    ],
)
def test_43_8_what_only_python_takes_as_a_number_is_refused(tmp_path, old, new, said):
    path = written(tmp_path, (old, new))
    with pytest.raises(InputError, match=re.escape(said)):
        ran(Builtin(duration=0.1), [ConcreteScenario(path)])


def test_43_8_a_value_that_only_python_takes_as_a_number_is_refused(tmp_path):
    with pytest.raises(SimulationError, match="speed is '1_0', which is not a number"):
        ran(Builtin(duration=0.1), [ConcreteScenario(written(tmp_path), {"speed": "1_0"})])


@pytest.mark.parametrize("expression", ["${nobody * 2}", "${speeed * 2}", "$nobody"])
def test_43_8_a_sentence_on_an_expression_ends_once(tmp_path, expression):
    path = written(tmp_path, ('value="5"', f'value="{expression}"'))
    with pytest.raises(InputError) as raised:
        ran(Builtin(duration=0.1), [ConcreteScenario(path)])
    assert re.search(r"[^.?][.?]$", str(raised.value)), str(raised.value)


@pytest.mark.parametrize(("before", "line"), [("", 2), ("<!-- <!DOCTYPE a> -->\n\n", 4)])
def test_43_8_a_document_type_is_refused_with_its_line(tmp_path, before, line):
    path = written(tmp_path)
    _, _, rest = path.read_text().partition("<OpenSCENARIO")
    path.write_text(f'<?xml version="1.0"?>\n{before}<!DOCTYPE a>\n<OpenSCENARIO{rest}')
    with pytest.raises(InputError, match=f"scenario.xosc, line {line}: has a document type declaration"):
        ScenarioFile.read(path)


def test_43_7_a_condition_group_of_nothing_is_true_at_once_and_said(tmp_path):
    path = written(tmp_path, (DISTANCE, "<ConditionGroup/>"))
    assert any(
        notice.label is NoticeLabel.ADAPTED and "<ConditionGroup> without a condition" in str(notice)
        for notice in check(path).notices
    )


def test_43_7_a_start_trigger_of_nothing_breaks_no_rule(tmp_path):
    path = written(tmp_path, (DISTANCE, ""))
    assert [str(notice) for notice in check(path).notices if notice.label is NoticeLabel.ADAPTED] == []
