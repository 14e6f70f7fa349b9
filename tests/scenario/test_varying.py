"""Numbers of a scenario file that are not parameters: their names, and the file in which they vary."""

from __future__ import annotations

import difflib
import json
import re
from pathlib import Path

import pytest
from lxml import etree

from conftest import EXAMPLES, at_night, event, moving, private, scenario_file, speed_action, story_of, time_trigger
from cornercase import InputError, NoticeWarning, SimulationError
from cornercase.recordings import Recording
from cornercase.scenario import Variable, list_variables, vary
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._vary import VariedScenario
from cornercase.simulators import simulate
from helpers.openpass_files import of_openpass

pytestmark = pytest.mark.filterwarnings("ignore::cornercase.NoticeWarning")

WILD = Path(__file__).parents[3] / "shared" / "reference" / "wild"
CUT_IN = EXAMPLES / "r157" / "cut_in.xosc"
X = EXAMPLES / "x_intersection" / "x_intersection.xosc"
GENERATED = "scenariogeneration-examples/generator"


def of_entity(name: str, inner: str, delay: str = "0") -> str:
    return (
        f'<Condition name="{name}" delay="{delay}" conditionEdge="none"><ByEntityCondition><TriggeringEntities'
        ' triggeringEntitiesRule="any"><EntityRef entityRef="Ego"/></TriggeringEntities><EntityCondition>'
        f"{inner}</EntityCondition></ByEntityCondition></Condition>"
    )


def travelled(value: str, name: str = "far") -> str:
    return of_entity(name, f'<TraveledDistanceCondition value="{value}"/>')


def braking(over: str = "3") -> str:
    return speed_action("2", "linear", "time", over)


def written(folder: Path, events: str = "", parameters: str = "", init: str = "") -> Path:
    story = story_of(events) if events else ""
    path: Path = scenario_file(folder, init=init or moving("10"), story=story, parameters=parameters)
    return path


def listed(path: Path) -> dict[str, Variable]:
    found = {one.name: one for one in list_variables(path)}
    assert len(found) == len(list_variables(path))
    return found


def everything_varied(path: Path, folder: Path) -> Path:
    """The scenario in another folder, with each of its numbers as a parameter."""
    source = ScenarioFile.read(path)
    numbers = tuple(one for one in list_variables(path) if not one.reason_fixed and not one.is_declared)
    target = folder / "deeper" / path.name
    target.parent.mkdir(parents=True)
    target.write_bytes(VariedScenario(source, (), numbers).scenario_content(target.parent))
    assert not numbers or len(list_variables(target)) > len(numbers)
    return target


def content(recording: Recording, folder: Path) -> bytes:
    recording.to_csv(folder / "recording.csv")
    return (folder / "recording.csv").read_bytes()


def require_same_recording(path: Path, folder: Path, duration: float = 10.0) -> None:
    varied = everything_varied(path, folder)
    before, after = (content(simulate(one, duration=duration), folder) for one in (path, varied))
    assert before == after


def test_43_12_numbers_have_names_units_lines_and_proposals(tmp_path: Path) -> None:
    path = written(tmp_path, event("my brake", braking(), time_trigger("4")))
    found = listed(path)
    assert {name: (one.value_text, one.unit, one.proposed_range) for name, one in found.items()} == {
        "Ego.initial.s": ("10", "m", "0:30"),
        "Ego.initial.lane": ("-1", "", ""),
        "Ego.initial.speed": ("10", "m/s", "7:13"),
        "a.start.delay": ("0", "s", "0:2"),
        "a.start.time": ("0", "s", "0:2"),
        "my_brake.trigger.delay": ("0", "s", "0:2"),
        "my_brake.trigger.time": ("4", "s", "2:6"),
        "my_brake.duration": ("3", "s", "1.5:4.5"),
        "my_brake.speed": ("2", "m/s", "1.4:2.6"),
    }
    lines = path.read_text().splitlines()
    assert all(one.value_text in lines[one.line - 1] for one in found.values())
    assert found["Ego.initial.s"].maximum == 500.0
    assert found["my_brake.duration"].parameter_name == "my_brake_duration"


def test_43_12_a_step_takes_no_time_and_is_not_listed(tmp_path: Path) -> None:
    assert "Ego.initial.duration" not in listed(written(tmp_path))


def test_43_12_equal_names_get_different_ones(tmp_path: Path) -> None:
    twice = event("e", braking(), time_trigger("1")) + event("e", braking(), time_trigger("2"))
    both = "".join(f'<Action name="{name}">{braking()}</Action>' for name in ("first", "second.one"))
    events = (
        f'{twice}<Event name="two" priority="parallel">{both}<StartTrigger>{time_trigger("3")}</StartTrigger></Event>'
    )
    found = listed(written(tmp_path, events))
    assert {"e.speed", "e_2.speed", "e.trigger.time", "e_2.trigger.time"} <= set(found)
    assert {"two.first.speed", "two.second_one.speed"} <= set(found)
    parameters = [one.parameter_name for one in found.values()]
    assert len(set(parameters)) == len(parameters)
    assert all(re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", one) for one in parameters)


def test_43_12_a_condition_in_several_groups_varies_as_one(tmp_path: Path) -> None:
    groups = "".join(
        f"<ConditionGroup>{travelled('20')}{of_entity('', inner)}</ConditionGroup>"
        for inner in ('<SpeedCondition value="5" rule="greaterThan"/>', '<SpeedCondition value="6" rule="lessThan"/>')
    )
    path = written(tmp_path, event("e", braking(), groups))
    found = listed(path)
    assert len(found["e.trigger.travelled"].occurrences) == 2
    assert {"e.trigger.speed", "e.trigger.speed_2"} <= set(found)
    vary(path, ["e.trigger.travelled=10:30"], tmp_path / "out.xosc")
    assert (tmp_path / "out.xosc").read_text().count("$e_trigger_travelled") == 2


def test_43_12_what_is_a_parameter_already_is_said(tmp_path: Path) -> None:
    declared = '<ParameterDeclaration name="v" parameterType="double" value="8"/>'
    path = written(tmp_path, parameters=declared, init=moving("${2 * $v}", "$v"))
    found = listed(path)
    assert found["v"].is_declared
    assert not found["v"].reason_fixed
    assert found["Ego.initial.speed"].reason_fixed == "it is $v; vary the parameter"
    assert found["Ego.initial.s"].reason_fixed == "it is ${2 * $v}"
    with pytest.raises(InputError, match=r"Ego\.initial\.speed=1:2: cannot be varied: it is \$v; vary the parameter"):
        vary(path, ["Ego.initial.speed=1:2"], tmp_path / "out.xosc")
    logical = vary(path, ["v=5:20"], tmp_path / "out.xosc")
    assert logical.space.names == ("v",)
    assert (tmp_path / "out.xosc").read_bytes() == path.read_bytes()


def test_43_12_a_maneuver_of_a_catalog_is_named_and_what_it_is_given_varies(tmp_path: Path) -> None:
    maneuver = (
        '<Maneuver name="brakes"><ParameterDeclarations><ParameterDeclaration name="over" parameterType="double"'
        f' value="2"/></ParameterDeclarations>{event("e", braking("$over"), time_trigger("1"))}</Maneuver>'
    )
    (tmp_path / "catalogs").mkdir()
    (tmp_path / "catalogs" / "m.xosc").write_text(
        f'<OpenSCENARIO><FileHeader/><Catalog name="M">{maneuver}</Catalog></OpenSCENARIO>'
    )
    reference = (
        '<CatalogReference catalogName="M" entryName="brakes"><ParameterAssignments><ParameterAssignment'
        ' parameterRef="$over" value="3"/></ParameterAssignments></CatalogReference>'
    )
    path = written(tmp_path, "EVENTS")
    text = path.read_text().replace('<Maneuver name="m">EVENTS</Maneuver>', reference)
    where = '<CatalogLocations><ManeuverCatalog><Directory path="catalogs"/></ManeuverCatalog></CatalogLocations>'
    path.write_text(text.replace("<CatalogLocations/>", where))
    found = listed(path)
    assert found["brakes.over"].value_text == "3"
    assert "are in the catalog M" in found["brakes.catalog"].reason_fixed
    require_same_recording(path, tmp_path)
    vary(path, ["brakes.over=1:5"], tmp_path / "elsewhere" / "out.xosc")
    slow = simulate(tmp_path / "elsewhere" / "out.xosc", {"brakes_over": 5.0}, duration=10)
    assert slow.speed[0, -1] == pytest.approx(2.0)


def test_43_12_only_what_varies_is_written_anew(tmp_path: Path) -> None:
    vary(CUT_IN, ["Ego.initial.x=90:110", "Other_cuts_in.trigger.time"], tmp_path / "there" / "out.xosc")
    before, after = CUT_IN.read_text("utf-8").splitlines(), (tmp_path / "there" / "out.xosc").read_text("utf-8")
    changes = [line for line in difflib.ndiff(before, after.splitlines()) if line[0] in "+-"]
    assert [line[0] for line in changes] == list("++-+-+-+")
    road = re.search(r'LogicFile filepath="([^"]*)"', after)
    assert road is not None
    assert (tmp_path / "there" / road[1]).samefile(CUT_IN.with_name("motorway.xodr"))
    assert '    <ParameterDeclaration name="Ego_initial_x" parameterType="double" value="100"/>' in after


@pytest.mark.parametrize(
    "declarations", ["", "<ParameterDeclarations/>", "<ParameterDeclarations>\n </ParameterDeclarations>"]
)
@pytest.mark.parametrize("encoding", ["utf-8", "iso-8859-1", "utf-16"])
def test_43_12_files_are_written_as_they_came(tmp_path: Path, declarations: str, encoding: str) -> None:
    path = written(tmp_path)
    text = path.read_text().replace("<ParameterDeclarations></ParameterDeclarations>", declarations)
    text = text.replace("<CatalogLocations/>", "<!-- <LanePosition s='ü' --><CatalogLocations />")
    text = f'<?xml version="1.0" encoding="{encoding}"?>\n{text}'.replace("\n", "\r\n").replace('s="10"', "s = '10'")
    path.write_bytes(text.encode(encoding))
    vary(path, ["Ego.initial.s=5:20"], tmp_path / "out.xosc")
    after = (tmp_path / "out.xosc").read_bytes().decode(encoding)
    assert "<!-- <LanePosition s='ü' --><CatalogLocations />" in after
    assert 's = "$Ego_initial_s"' in after
    assert after.count("\n") == after.count("\r\n")
    assert simulate(tmp_path / "out.xosc", duration=1).x[0, 0] == simulate(path, duration=1).x[0, 0]


def test_a_file_whose_declaration_names_another_encoding_keeps_its_characters(tmp_path: Path) -> None:
    path = written(tmp_path)
    text = f'<?xml version="1.0" encoding="UTF-8"?>\n<!-- Überholen -->{path.read_text()}'
    path.write_bytes(text.encode("cp1252"))
    vary(path, ["Ego.initial.s=5:20"], tmp_path / "out.xosc")
    after = (tmp_path / "out.xosc").read_bytes().decode("cp1252")
    assert "<!-- Überholen -->" in after
    assert 's="$Ego_initial_s"' in after


def test_43_12_the_space_has_units_types_and_steps(tmp_path: Path) -> None:
    path = written(tmp_path)
    lanes = EXAMPLES / "r157" / "motorway.xodr"
    path.write_text(path.read_text().replace('filepath="road.xodr"', f'filepath="{lanes}"'))
    logical = vary(path, ["Ego.initial.s=5:20", "Ego.initial.speed"], tmp_path / "out.xosc")
    assert [str(one) for one in logical.space.parameters] == [
        "Ego_initial_s 5 to 20 m",
        "Ego_initial_speed 7 to 13 m/s",
    ]
    logical = vary(path, ["Ego.initial.s=5:20:0.5"], tmp_path / "out.xosc")
    assert [one.step for one in logical.space.parameters] == [0.5]
    for step in ("0.5", "1"):
        with pytest.raises(InputError, match="Ego_initial_s has a step and Ego_initial_speed has none"):
            vary(path, [f"Ego.initial.s=5:20:{step}", "Ego.initial.speed=5:10"], tmp_path / "out.xosc")


def test_43_12_what_is_proposed_can_be_typed_at_the_end_of_a_road(tmp_path: Path) -> None:
    path = written(tmp_path, init=moving("22.02"))
    for old, new in (('length="500"', 'length="22.027099999999997"'),):
        road = tmp_path / "road.xodr"
        assert old in road.read_text()
        road.write_text(road.read_text().replace(old, new))
    proposed = listed(path)["Ego.initial.s"].proposed_range
    assert proposed == "2:22.0271"
    logical = vary(path, [f"Ego.initial.s={proposed}"], tmp_path / "out.xosc")
    assert logical.space.parameters[0].high == 22.027099999999997


def test_43_12_lanes_are_whole_numbers_of_lanes_that_are_there(tmp_path: Path) -> None:
    text = CUT_IN.read_text("utf-8").replace(
        '<WorldPosition x="100" y="-5.25" h="0"/>', '<LanePosition roadId="1" laneId="-1" s="100"/>'
    )
    path = tmp_path / "lanes.xosc"
    path.write_text(text.replace("motorway.xodr", str(CUT_IN.with_name("motorway.xodr"))), "utf-8")
    proposed = listed(path)["Ego.initial.lane"]
    assert proposed.proposed_range
    logical = vary(path, ["Ego.initial.lane", "Ego.initial.s=90:110"], tmp_path / "out.xosc")
    values = [point["Ego_initial_lane"] for point in logical.space.values(logical.space.representative_points())]
    assert all(isinstance(value, int) for value in values)
    assert 'parameterType="integer"' in (tmp_path / "out.xosc").read_text("utf-8")
    for value in range(round(proposed.proposed_low or 0), round(proposed.proposed_high or 0) + 1):
        simulate(tmp_path / "out.xosc", {"Ego_initial_lane": value}, duration=0.5)
    with pytest.raises(InputError, match=r"the road has no lane -\d+ at this position; its lanes are"):
        vary(path, ["Ego.initial.lane=-9:-1"], tmp_path / "out.xosc")
    with pytest.raises(InputError, match="use whole numbers"):
        vary(path, ["Ego.initial.lane=-2:-1:0.5"], tmp_path / "out.xosc")


def test_lanes_go_on_beside_a_section_of_one_side_and_roadworks(tmp_path: Path) -> None:
    def lanes(side: str, *numbers: int) -> str:
        return f"<{side}>" + "".join(f'<lane id="{number}" type="driving"/>' for number in numbers) + f"</{side}>"

    path = written(tmp_path, init=moving("60"))
    sections = (
        f'<lanes><laneSection s="0">{lanes("left", 1)}{lanes("right", -1, -2)}</laneSection>'
        f'<laneSection s="50" singleSide="true">{lanes("left", 2, 1)}</laneSection></lanes>'
        f'<lanes layer="temporary"><laneSection s="0">{lanes("right", -1)}</laneSection></lanes>'
    )
    road = tmp_path / "road.xodr"
    road.write_text(re.sub("<lanes>.*</lanes>", sections, road.read_text(), flags=re.DOTALL))
    path.write_text(path.read_text().replace('laneId="1"', 'laneId="-1"'))
    assert listed(path)["Ego.initial.lane"].allowed_lanes == {-2, -1, 1, 2}


@pytest.mark.parametrize(
    ("ranges", "words"),
    [
        (["Ego.initial.spede=1:2"], "`vary` Ego.initial.spede=1:2: {} has no 'Ego.initial.spede' that can be varied; did"
         " you mean 'Ego.initial.speed'?"),
        (["zzz"], "{} has no 'zzz' that can be varied; 'cornercase vary' with the scenario alone lists the names."),
        (["Ego.initial.s=-5:20"], "`vary` Ego.initial.s=-5:20: the minimum is 0 m."),
        (["Ego.initial.s=5:501"], "the maximum is 500 m."),
        (["a.start.time=-1:1"], "the minimum is 0 s."),
        (["Ego.initial.s=1:2", "Ego.initial.s"], "Ego.initial.s is varied twice; keep one of them."),
        (["Ego.initial.s=20:5"], "the lower bound must be below the upper."),
        (["Ego.initial.s="], "write it as NAME, NAME=LOW:HIGH or NAME=LOW:HIGH:STEP."),
        (["Ego.initial.s=x:5"], "'x' is not a number."),
        (["Ego.initial.lane"], "no range is proposed; give one, as Ego.initial.lane=LOW:HIGH."),
        ([], "nothing is varied; name numbers to vary with `vary`."),
    ],
)  # fmt: skip
def test_43_12_what_cannot_vary_is_refused_in_a_sentence(tmp_path: Path, ranges: list[str], words: str) -> None:
    path = written(tmp_path, event("e", braking(), time_trigger("1")))
    with pytest.raises(InputError) as refused:
        vary(path, ranges, tmp_path / "out.xosc")
    assert words.format(path) in str(refused.value)
    assert not list(tmp_path.glob("out*"))


def test_43_12_a_file_is_not_written_over_the_one_that_it_is_made_from(tmp_path: Path) -> None:
    path = written(tmp_path)
    for output in (path, tmp_path / "road.xodr"):
        before = output.read_bytes()
        with pytest.raises(InputError, match=r"is the input file|ends with \.xosc"):
            vary(path, ["Ego.initial.s"], output)
        assert output.read_bytes() == before


def test_43_12_a_road_that_a_parameter_names_is_found_from_another_folder(tmp_path: Path) -> None:
    road = '<ParameterDeclaration name="Road" parameterType="string" value="road.xodr"/>'
    path = written(tmp_path, parameters=road)
    path.write_text(path.read_text().replace('filepath="road.xodr"', 'filepath="$Road"'))
    vary(path, ["Ego.initial.s"], tmp_path / "there" / "out.xosc")
    assert simulate(tmp_path / "there" / "out.xosc", duration=1).x[0, 0] == simulate(path, duration=1).x[0, 0]
    path.write_text(path.read_text().replace('filepath="$Road"', """filepath="${'road' + '.xodr'}\""""))
    with pytest.raises(InputError, match=r"line 3: <LogicFile> has an expression as path.*into the folder"):
        vary(path, ["Ego.initial.s=40:60"], tmp_path / "there" / "other.xosc")


def test_43_12_a_left_handed_file_stays_left_handed(tmp_path: Path) -> None:
    place = '<PrivateAction><TeleportAction><Position><WorldPosition x="50" y="1.75" z="0" h="0.1"/></Position></TeleportAction></PrivateAction>'
    path = written(tmp_path, init=private("Ego", place, speed_action("5")))
    path.write_text(path.read_text().replace('description="d"', 'description="CARLA:d"'))
    assert listed(path)["Ego.initial.y"].value_text == "1.75"
    require_same_recording(path, tmp_path)
    vary(path, ["Ego.initial.y=1:3"], tmp_path / "out.xosc")
    assert simulate(tmp_path / "out.xosc", {"Ego_initial_y": 2.5}, duration=1).y[0, 0] == pytest.approx(-2.5)


@pytest.mark.parametrize(
    "path", [X, EXAMPLES / "t_intersection" / "t_intersection.xosc", CUT_IN], ids=lambda one: one.stem
)
def test_43_12_examples_give_the_same_recording(path: Path, tmp_path: Path) -> None:
    require_same_recording(path, tmp_path, 5.0)


@pytest.mark.parametrize("each", at_night([4, 1], {1}))
def test_43_12_a_value_does_what_it_does_in_the_file(tmp_path: Path, each: int) -> None:
    path = X
    varied = everything_varied(path, tmp_path)
    for one in list_variables(path)[::each]:
        if (
            one.reason_fixed
            or one.is_declared
            or one.proposed_low is None
            or one.proposed_high is None
            or "delay" in one.name
        ):
            continue
        value = one.proposed_low + 0.75 * (one.proposed_high - one.proposed_low)
        tree = etree.parse(str(path))
        elements = list(tree.getroot().iter("*"))
        for number, attribute in one.occurrences:
            elements[number].set(attribute, repr(value))
        edited = tmp_path / "edited.xosc"
        tree.getroot().find("RoadNetwork/LogicFile").set("filepath", str(path.with_suffix(".xodr")))  # type: ignore[union-attr]
        tree.write(str(edited))
        by_hand, by_parameter = simulate(edited, duration=1), simulate(varied, {one.parameter_name: value}, duration=1)
        assert content(by_hand, tmp_path) == content(by_parameter, tmp_path), one.name


@pytest.mark.skipif(not WILD.is_dir(), reason="the folder of others' scenarios is not there")
@pytest.mark.parametrize("name", ["CCRb/CCRb_scenarios/xosc/CCRb1.xosc", "CCRs/CCRs_scenarios/xosc/CCRs41.xosc"])
def test_43_12_scenarios_of_others_give_the_same_recording(name: str, tmp_path: Path) -> None:
    require_same_recording(WILD / GENERATED / name, tmp_path, 3.0)


@pytest.mark.slow
@pytest.mark.skipif(not WILD.is_dir(), reason="the folder of others' scenarios is not there")
def test_43_12_each_scenario_of_others_gives_the_same_recording(tmp_path: Path) -> None:
    compared = 0
    for k, entry in enumerate(json.loads((WILD / "index.json").read_text("utf-8"))):
        path = WILD / entry["source"] / entry["path"]
        if entry["kind"] != "scenario" or "expected" not in entry:
            continue
        try:
            simulate(path, duration=20.0)
        except (InputError, SimulationError):
            continue
        require_same_recording(path, tmp_path / str(k), 20.0)
        compared += 1
    assert compared > 50


def test_43_no_range_is_proposed_along_a_road_that_is_missing(tmp_path: Path) -> None:
    path = written(tmp_path)
    assert listed(path)["Ego.initial.s"].proposed_range
    (tmp_path / "road.xodr").unlink()
    with pytest.warns(NoticeWarning, match="no range is proposed for positions on roads: there is no road file"):
        found = listed(path)
    assert not found["Ego.initial.s"].proposed_range
    assert found["Ego.initial.speed"].proposed_range
    world = (
        '<PrivateAction><TeleportAction><Position><WorldPosition x="50" y="1.75"/></Position></TeleportAction>'
        "</PrivateAction>"
    )
    written(tmp_path, init=private("Ego", world, speed_action("5")))
    (tmp_path / "road.xodr").unlink()
    with pytest.warns(NoticeWarning, match="there is no road file"):
        assert listed(path)["Ego.initial.x"].proposed_range


def test_43_what_is_never_true_is_not_listed(tmp_path: Path) -> None:
    def held(name: str, parameter: str) -> str:
        return (
            f'<Condition name="{name}" delay="1" conditionEdge="none"><ByValueCondition><ParameterCondition'
            f' parameterRef="{parameter}" value="60" rule="lessThan"/></ByValueCondition></Condition>'
        )

    known = '<ParameterDeclaration name="p" parameterType="double" value="1"/>'
    stop = (
        f"<ConditionGroup>{held('criteria_RunningStopTest', '')}{travelled('30', 'unheard')}</ConditionGroup>"
        f"<ConditionGroup>{held('criteria_DrivenDistanceTest', 'distance_success')}</ConditionGroup>"
        f"<ConditionGroup>{held('of nothing', '')}</ConditionGroup>"
        f"<ConditionGroup>{held('heard', 'p')}{travelled('90', 'far')}</ConditionGroup>"
    )
    path = scenario_file(tmp_path, init=moving("10"), stop=stop, parameters=known)
    assert [name for name in listed(path) if name.startswith("storyboard")] == [
        "storyboard.stop.heard.delay", "storyboard.stop.far.delay", "storyboard.stop.travelled",
    ]  # fmt: skip


def test_43_rates_below_zero_get_a_range_in_the_right_order(tmp_path: Path) -> None:
    def rate(value: str) -> Path:
        return written(tmp_path, event("e", speed_action("2", "linear", "rate", value), time_trigger("1")))

    assert listed(rate("-4"))["e.rate"].proposed_range == "-5.2:-2.8"
    assert listed(rate("0"))["e.rate"].proposed_range == "0:1"
    vary(rate("-4"), ["e.rate"], tmp_path / "out.xosc")


def test_43_where_no_range_is_proposed_that_is_said(tmp_path: Path) -> None:
    path = scenario_file(tmp_path, init="")
    with pytest.raises(InputError, match="no ranges are proposed; give one with"):
        vary(path, [], tmp_path / "out.xosc", proposed=True)


@pytest.mark.parametrize("name", ["y.xodr", "y", "y.space"])
def test_43_a_scenario_is_written_into_a_file_of_its_ending_only(tmp_path: Path, name: str) -> None:
    (tmp_path / "a").mkdir()
    path = written(tmp_path / "a")
    with pytest.raises(InputError, match=r"the output is a scenario; use a name that ends with \.xosc"):
        vary(path, ["Ego.initial.speed"], tmp_path / name)
    assert [one.name for one in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize("beside", [True, False])
def test_43_what_lies_beside_a_scenario_is_found_from_another_folder(tmp_path: Path, beside: bool) -> None:
    path = of_openpass(tmp_path / "a", beside)
    for _ in range(2):
        vary(path, ["Ego.initial.speed"], tmp_path / "b" / "out.xosc")
        after = simulate(tmp_path / "b" / "out.xosc", duration=1)
        assert content(after, tmp_path) == content(simulate(path, duration=1), tmp_path)


def test_43_another_file_beside_a_varied_scenario_is_kept(tmp_path: Path) -> None:
    path = of_openpass(tmp_path / "a")
    (tmp_path / "ProfilesCatalog.xml").write_text("<Profiles/>")
    with pytest.raises(InputError, match=r"differs from .*choose another folder"):
        vary(path, ["Ego.initial.speed"], tmp_path / "out.xosc")
    assert (tmp_path / "ProfilesCatalog.xml").read_text() == "<Profiles/>"
    assert not (tmp_path / "out.xosc").exists()
