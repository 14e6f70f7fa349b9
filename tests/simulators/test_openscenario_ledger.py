"""What is said of OpenSCENARIO's elements and attributes is complete and true."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from shutil import copytree

import pytest
from lxml import etree

import cornercase as cc
from conftest import EXAMPLES, at_night
from cornercase._common.errors import InputError, NoticeWarning
from cornercase._common.io.support_table import SupportEntry, SupportStatus
from cornercase._common.io.tracked_xml import is_read, iter_children_untracked, requested_attributes
from cornercase.scenario import LogicalScenario
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators.builtin._ignored_content import read_and_collect_notices
from cornercase.simulators.builtin._prepared_file import OPENSCENARIO_SUPPORT
from helpers.command_line import cornercase
from helpers.support_tables import gaps, page, strangers
from helpers.xml_schemas import Schema

EVERYTHING = Path(__file__).parents[1] / "data" / "everything"
REFERENCE = Path(__file__).parents[3] / "shared" / "reference" / "openscenario"
PAGE = Path(__file__).parents[2] / "docs" / "openscenario.md"

HEAD = """# OpenSCENARIO, element by element

This page lists what the builtin simulator does with each element and attribute of OpenSCENARIO XML 1.3. It reads files of
versions 1.0 to 1.2 in the same way.

- **Without effect**: `cornercase check SCENARIO.xosc` lists what a file contains and the simulator ignores, with lines and reasons.
  `simulate`, `explore` and `test` print as notices (in Python a `NoticeWarning`) what could change the result if a simulator used
  it; the rest is a count, and `cornercase -v` lists all. Elements that this page does not know, such as those of later versions or
  other programs, and elements in places where nothing reads them, could change the result.
- **Refused**: the command ends with exit code 2 and one sentence.

If an element is refused or without effect, the same holds for everything inside it. This page is generated from the table
that the simulator itself uses, `simulators/builtin/openscenario.csv`; after a change, run
`PYTHONPATH=tests python tests/simulators/test_openscenario_ledger.py`.
"""


def schema() -> Path:
    package = pytest.importorskip("qc_openscenario")
    return Path(package.__file__).parent / "schema" / "1.3.0" / "OpenSCENARIO.xsd"


def test_each_element_and_attribute_of_the_schema_has_its_line():
    assert gaps(OPENSCENARIO_SUPPORT, schema(), "OpenSCENARIO") == []


def test_each_line_names_something_of_the_schema():
    assert strangers(OPENSCENARIO_SUPPORT, schema(), "OpenSCENARIO") == []


def test_what_is_refused_or_without_effect_says_why():
    silent = [
        entry for entry in OPENSCENARIO_SUPPORT.entries if entry.status is not SupportStatus.USED and not entry.note
    ]
    assert silent == []


def test_no_line_stands_twice():
    names = [(entry.element, entry.attribute) for entry in OPENSCENARIO_SUPPORT.entries]
    assert len(set(names)) == len(names)


def test_the_page_is_in_step_with_the_ledger():
    assert PAGE.read_text(encoding="utf-8") == page(OPENSCENARIO_SUPPORT, HEAD)


def reading(*files: ScenarioFile) -> dict[SupportEntry, bool]:
    """Whether each line of the ledger that files have something for was read in one of them."""
    found: dict[SupportEntry, bool] = {}

    def look(element, path: tuple[str, ...]) -> None:
        entry = OPENSCENARIO_SUPPORT.find_entry(path)
        if entry is None or entry.status is not SupportStatus.USED:
            return
        asked, read = requested_attributes(element) or (), is_read(element)
        found[entry] = found.get(entry, False) or read or len(list(iter_children_untracked(element))) > 0
        for name in element.keys():  # noqa: SIM118 - an element is no mapping
            of = OPENSCENARIO_SUPPORT.find_entry(path, name)
            if of is not None:
                found[of] = found.get(of, False) or name in asked
        for child in iter_children_untracked(element):
            look(child, (*path, child.tag))

    for file in files:
        for _, part in file.used_elements():
            if not part.tag.endswith("OpenDRIVE"):
                above = ("OpenSCENARIO", "Catalog") if part.tag != "OpenSCENARIO" else ()
                look(part, (*above, part.tag))
    return found


def test_what_is_said_to_be_used_is_read():
    files = []
    for space in sorted(EVERYTHING.glob("*.space.xosc")):
        logical = LogicalScenario.read(None, space)
        for notice in read_and_collect_notices(logical.scenario_file):
            assert not any("nothing reads" in why or "not known" in why for why in (notice.reason,)), notice
        files.append(logical.scenario_file)
    found = reading(*files)
    # What may go unread says so by a star.
    used = [
        entry
        for entry in OPENSCENARIO_SUPPORT.entries
        if entry.status is SupportStatus.USED and entry.ignored_values != ("*",)
    ]
    catalog = [entry for entry in used if entry.element in ("Catalog", "OpenSCENARIO")]
    assert [entry for entry in used if entry not in found and entry not in catalog] == []
    assert [entry for entry in used if not found.get(entry, True)] == []


def changed(folder: Path, *changes: tuple[str, str]) -> Path:
    """The file that has everything, with changes."""
    copytree(EVERYTHING, folder / "everything")
    path = folder / "everything" / "everything.xosc"
    text = path.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path.write_text(text, encoding="utf-8")
    return path


DYNAMICS = '<SpeedActionDynamics dynamicsShape="linear" dynamicsDimension="time" value="1"'
WITHOUT_EFFECT = {
    "followingMode of <SpeedActionDynamics>": (DYNAMICS, f'{DYNAMICS} followingMode="follow"'),
    "continuous of <LaneOffsetAction>": ('LaneOffsetAction continuous="false"', 'LaneOffsetAction continuous="true"'),
    "coordinateSystem of <LateralDistanceAction>": (
        "<LateralDistanceAction ",
        '<LateralDistanceAction coordinateSystem="entity" ',
    ),
    "closed of <Route>": ('<Route name="r" closed="false"', '<Route name="r" closed="true"'),
    "routeStrategy of <Waypoint>": ('routeStrategy="shortest"', 'routeStrategy="fastest"'),
    "<TrafficSignalGroupState>": (
        '<Phase name="go" duration="5"/>',
        '<Phase name="go" duration="5"><TrafficSignalGroupState state="a"/></Phase>',
    ),
    "y of <Center>": ('<Center x="1.4" y="0"', '<Center x="1.4" y="0.2"'),
    "z of <WorldPosition>": ('<WorldPosition x="50" y="-2" h="0"', '<WorldPosition x="50" y="-2" h="0" z="1"'),
    "p of <Orientation>": ('<Orientation type="relative"', '<Orientation type="relative" p="0.1"'),
    "weather of <RoadNetwork>": ("<RoadNetwork>", '<RoadNetwork weather="rain">'),
    "<Wormhole> in <Storyboard>": ("<Storyboard>", "<Storyboard><Wormhole/>"),
    "<Property colour>": ("<Properties>", '<Properties><Property name="colour" value="red"/>'),
    "<UserDefinedAction>": (
        "<Init><Actions>",
        "<Init><Actions><UserDefinedAction><CustomCommandAction type='a'>b</CustomCommandAction></UserDefinedAction>",
    ),
    "revMinor of <FileHeader>": ('revMinor="3"', 'revMinor="9"'),
}


@pytest.mark.parametrize("what", WITHOUT_EFFECT)
def test_what_has_no_effect_is_named_once(tmp_path, what):
    before = [
        name
        for notice in read_and_collect_notices(ScenarioFile.read(EVERYTHING / "everything.xosc"))
        for name in notice.parts
    ]
    after = [
        name
        for notice in read_and_collect_notices(ScenarioFile.read(changed(tmp_path, WITHOUT_EFFECT[what])))
        for name in notice.parts
    ]
    assert what not in before
    assert after.count(what) == 1


POSITION = '<LanePosition roadId="1" laneId="-1" s="400"/>'
REFUSED = {
    "GeoPosition": (POSITION, '<GeoPosition latitudeDeg="1" longitudeDeg="1"/>'),
    "FromCurrentEntity": ('<FromRoadCoordinates pathS="20" t="-2"/>', '<FromCurrentEntity entityRef="Lead"/>'),
    "TrafficAction": ("<Init><Actions>", "<Init><Actions><GlobalAction><TrafficAction/></GlobalAction>"),
    "RandomRouteAction": (f"<AcquirePositionAction><Position>{POSITION}</Position></AcquirePositionAction>", "<RandomRouteAction/>"),
    "ExternalObjectReference": ('<MiscObject name="cone"', '<ExternalObjectReference name="cone"/><MiscObject name="cone"'),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_used_is_refused_by_name(tmp_path, what):
    path = changed(tmp_path, REFUSED[what])
    with pytest.raises(InputError, match=rf"everything\.xosc.*<?{what}>?.*; "):
        cc.simulate(path, duration=0.1)
    assert any(what in trouble for trouble in cc.check(path).run_errors)


def test_each_line_that_refuses_is_tried():
    refusing = {
        entry.element.split("/")[-1] for entry in OPENSCENARIO_SUPPORT.entries if entry.status is SupportStatus.REFUSED
    }
    assert refusing <= {*REFUSED, "UserDefinedDistribution"}


def test_a_word_that_the_schema_does_not_know_is_refused():
    root = ScenarioFile.read(EVERYTHING / "everything.xosc").root
    tried = set()
    for element in root.iter(etree.Element):
        path = tuple(reversed([element.tag, *(above.tag for above in element.iterancestors())]))
        for name, value in [(str(a), str(b)) for a, b in element.items()]:
            entry = OPENSCENARIO_SUPPORT.find_entry(path, name)
            if entry is not None and entry.allowed_values:
                element.set(name, "xyzzy")
                with pytest.raises(InputError, match=f"{name} 'xyzzy' of <{element.tag}> cannot be used; known are: "):
                    OPENSCENARIO_SUPPORT.check_supported(root, "a.xosc")
                element.set(name, value)
                tried.add(entry)
    OPENSCENARIO_SUPPORT.check_supported(root, "a.xosc")
    # Of the catalog, and what older files have.
    left = {
        (entry.element, entry.attribute)
        for entry in OPENSCENARIO_SUPPORT.entries
        if entry.allowed_values and entry not in tried
    }
    assert left <= {("ParameterDeclaration", "parameterType")}


def test_the_words_of_an_attribute_are_those_of_the_schema():
    known = Schema(schema()).words("OpenSCENARIO")
    for entry in OPENSCENARIO_SUPPORT.entries:
        if entry.status is SupportStatus.USED and entry.attribute:
            words = known.get((entry.element.split("/")[-1], entry.attribute), set())
            assert bool(words) == bool(entry.allowed_values), entry
            assert set(entry.allowed_values) <= words, entry


def test_a_user_defined_distribution_is_refused(tmp_path):
    path = changed(tmp_path)
    space = path.with_name("deterministic.space.xosc")
    text = space.read_text(encoding="utf-8")
    text = text.replace(
        '<DistributionSet><Element value="1"/><Element value="2"/></DistributionSet>',
        "<UserDefinedDistribution type='a'/>",
    )
    space.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="user-defined distributions are not"):
        LogicalScenario.read(path, space)


def test_the_seed_and_number_of_a_stochastic_space_are_named(tmp_path):
    found = cc.check(EVERYTHING / "everything.xosc", EVERYTHING / "stochastic.space.xosc")
    whats = {name for notice in found.notices for name in notice.parts}
    assert {"numberOfTestRuns of <Stochastic>", "randomSeed of <Stochastic>"} <= whats


def test_a_used_catalog_entry_counts_and_others_do_not(tmp_path):
    path = changed(tmp_path)
    catalog = path.parent / "catalogs" / "everything.xosc"
    text = catalog.read_text(encoding="utf-8")
    unused = '<Pedestrian name="other"><Wormhole/></Pedestrian>'
    catalog.write_text(text.replace("</Catalog>", f"{unused}</Catalog>"), encoding="utf-8")
    assert not any(
        "Wormhole" in name for one in read_and_collect_notices(ScenarioFile.read(path)) for name in one.parts
    )
    catalog.write_text(
        text.replace('<Pedestrian name="walker" mass="80"', '<Pedestrian name="walker" wings="2"'), encoding="utf-8"
    )
    assert any("wings of <Pedestrian>" in one.parts for one in read_and_collect_notices(ScenarioFile.read(path)))


def test_a_controller_of_a_catalog_names_a_driver(tmp_path):
    assert ScenarioFile.read(EVERYTHING / "everything.xosc").drivers["Lead"] == "normal"
    path = changed(tmp_path)
    catalog = path.parent / "catalogs" / "everything.xosc"
    text = catalog.read_text(encoding="utf-8")
    catalog.write_text(text.replace("cornercase.driver", "another.driver"), encoding="utf-8")
    scenario = ScenarioFile.read(path)
    assert "Lead" not in scenario.drivers
    assert any(
        "<CatalogReference> in <ObjectController>" in n or "<ObjectController> in <ScenarioObject>" in n
        for one in read_and_collect_notices(scenario)
        for n in one.parts
    )


def test_simulate_and_explore_warn_and_the_command_line_prints(tmp_path):
    path = EXAMPLES / "t_intersection" / "t_intersection.xosc"
    rest = "3 parts of the files are ignored, on which no position or speed depends; `check` lists them"
    with pytest.warns(NoticeWarning, match=rest) as caught:
        cc.simulate(path, duration=0.1)
    assert all(one.filename == __file__ for one in caught)
    with pytest.warns(NoticeWarning, match=rest):
        cc.explore(
            path, tmp_path / "study.db", ego="Ego", other="C", metrics=["distance"], ranges=["c_start_time=1:2"],
            optimizer="sobol", budget=1, duration=0.1,
        )  # fmt: skip
    printed = cornercase("simulate", path, "--duration", 0.1, "-o", tmp_path / "r.csv")
    assert printed.returncode == 0
    rest = "3 parts of the files are ignored, on which no position or speed depends; 'cornercase check' lists them.\n"
    assert rest in printed.stderr
    assert "<Axles>" not in printed.stderr
    printed = cornercase("-v", "simulate", path, "--duration", 0.1, "-o", tmp_path / "r.csv")
    assert "Without effect: " in printed.stderr
    assert "<Axles>" in printed.stderr
    assert "<Axles>" in cornercase("check", path).stdout


def test_43_5_what_can_change_the_result_comes_first_and_the_rest_is_a_count(tmp_path):
    text = (EXAMPLES / "t_intersection" / "t_intersection.xosc").read_text(encoding="utf-8")
    path = tmp_path / "t.xosc"
    road = EXAMPLES / "t_intersection" / "t_intersection.xodr"
    text = re.sub(r'filepath="[^"]*\.xodr"', f'filepath="{road}"', text)
    weather = '<EnvironmentAction><Environment name="e"><Weather/></Environment></EnvironmentAction>'
    path.write_text(text.replace("<Private ", f"<GlobalAction>{weather}</GlobalAction><Private ", 1))
    listed = [line for line in cornercase("check", path).stdout.splitlines() if line.startswith("without effect: ")]
    assert "<Weather>" in listed[0]
    assert "<Axles>" in listed[-1]
    (first, rest) = cornercase("simulate", path, "--duration", 0.1, "-o", tmp_path / "r.csv").stderr.splitlines()[:2]
    assert "<Weather>" in first
    assert rest.startswith("3 more parts of the files are ignored, ")


@pytest.mark.parametrize("each", ["builtin/openscenario.csv", "../roads/opendrive.csv", "carla/scenario_runner.csv"])
def test_43_5_each_line_without_effect_says_whether_it_could_change_the_result(each):
    folder = Path(cc.__file__).parent / "simulators"
    with (folder / each).open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["status"] == "without effect"]
    assert rows
    assert {row["matters"] for row in rows} == {"yes", "no"}


@pytest.mark.skipif(not REFERENCE.is_dir(), reason="needs the reference scenarios")
@pytest.mark.parametrize("each", at_night([5, 1], {1}))
def test_every_reference_file_has_its_notices(each):
    named, files = 0, sorted(REFERENCE.glob("**/*.xosc"))[::each]
    for file in files:
        try:
            scenario = ScenarioFile.read(file)
        except InputError:
            continue  # a catalog or a space
        found = read_and_collect_notices(scenario)
        named += len(found)
        assert not any("is not known here" in one.reason for one in found), (file, found)
        there = {element.tag for element in scenario.root.iter()}
        for what in ("Weather", "AppearanceAction", "SceneGraphFile"):
            assert (what in there) == any(f"<{what}>" in one.parts for one in found if one.file == file), file
    assert named > len(files) / 2


if __name__ == "__main__":
    PAGE.write_text(page(OPENSCENARIO_SUPPORT, HEAD), encoding="utf-8")
