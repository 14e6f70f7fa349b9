"""Files that belong to a scenario: catalogs, and road files that a parameter names."""

from __future__ import annotations

import pickle
import re

import pytest

from conftest import ROAD, scenario_file, teleport
from cornercase import check
from cornercase._common.errors import InputError
from cornercase.scenario import LogicalScenario
from cornercase.scenario._concrete_file import write_concrete_file
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._scenario_search import find_scenario_file
from cornercase.simulators import simulate
from helpers.isolation import ROOT

DECELERATION = ROOT / "examples" / "r157" / "deceleration.xosc"
VEHICLE = """<Vehicle name="{name}" vehicleCategory="car"><BoundingBox><Center x="1.4" y="0" z="0.7"/>
<Dimensions length="{length}" width="2" height="1.5"/></BoundingBox>
<Performance maxSpeed="60" maxAcceleration="200" maxDeceleration="200"/><Axles/><Properties/></Vehicle>"""


def catalog(folder, file, name, *entries):
    folder.mkdir(parents=True, exist_ok=True)
    inner = "".join(VEHICLE.format(name=entry, length=length) for entry, length in entries)
    (folder / f"{file}.xosc").write_text(
        '<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="2026-01-01T00:00:00" author="a" description="d"/>'
        f'<Catalog name="{name}">{inner}</Catalog></OpenSCENARIO>'
    )


def from_catalogs(folder, *locations, name="Cars", entry="small"):
    path = scenario_file(
        folder,
        init=f'<Private entityRef="Ego">{teleport("5")}</Private>',
        entities=f'<ScenarioObject name="Ego"><CatalogReference catalogName="{name}" entryName="{entry}"/></ScenarioObject>',
    )
    directories = "".join(f'<VehicleCatalog><Directory path="{one}"/></VehicleCatalog>' for one in locations)
    path.write_text(
        path.read_text().replace("<CatalogLocations/>", f"<CatalogLocations>{directories}</CatalogLocations>")
    )
    return path


def test_an_entry_is_found_in_any_catalog_of_the_name(tmp_path):
    catalog(tmp_path / "a", "one", "Cars", ("large", 6))
    catalog(tmp_path / "b", "two", "Cars", ("small", 3))
    assert simulate(from_catalogs(tmp_path, "a", "b"), duration=0.1).length == [3.0]
    # As in esmini, the file name is also the name of the catalog.
    assert simulate(from_catalogs(tmp_path, "a", "b", name="two"), duration=0.1).length == [3.0]


def test_entries_that_differ_are_refused_and_those_that_do_not_are_one(tmp_path):
    catalog(tmp_path / "a", "one", "Cars", ("small", 3))
    catalog(tmp_path / "b", "two", "Cars", ("small", 3))
    path = from_catalogs(tmp_path, "a", "b")
    assert simulate(path, duration=0.1).length == [3.0]
    catalog(tmp_path / "b", "two", "Cars", ("small", 4))
    with pytest.raises(
        InputError, match=r"the entry 'small' of the catalog 'Cars' is in .*one\.xosc and in .*two\.xosc"
    ):
        simulate(path, duration=0.1)
    catalog(tmp_path / "c", "Cars", "Cars", ("small", 5))
    assert simulate(from_catalogs(tmp_path, "a", "b", "c"), duration=0.1).length == [5.0]


def test_catalogs_of_two_folders_of_one_name_are_both_written(tmp_path):
    catalog(tmp_path / "a" / "catalogs", "cars", "Large", ("small", 6))
    catalog(tmp_path / "b" / "catalogs", "cars", "Small", ("small", 3))
    path = from_catalogs(tmp_path, "a/catalogs", "b/catalogs", name="Small")
    write_concrete_file(ScenarioFile.read(path), {}, tmp_path / "out" / "scenario.xosc")
    assert simulate(tmp_path / "out" / "scenario.xosc", duration=0.1).length == [3.0]


def test_catalog_folders_whose_names_look_numbered_are_all_written(tmp_path):
    folders = ("x/a", "y/a-3", "z/a")
    for length, folder in enumerate(folders, start=3):
        catalog(tmp_path / folder, "cars", f"Cars{length}", ("small", length))
    path = from_catalogs(tmp_path, *folders, name="Cars5")
    write_concrete_file(ScenarioFile.read(path), {}, tmp_path / "out" / "scenario.xosc")
    assert simulate(tmp_path / "out" / "scenario.xosc", duration=0.1).length == [5.0]


def declared(path, **values):
    """Declare parameters in a scenario; a tuple of values declares one several times."""
    pairs = [(name, one) for name, given in values.items() for one in ([given] if isinstance(given, str) else given)]
    inner = "".join(f'<ParameterDeclaration name="{a}" parameterType="string" value="{b}"/>' for a, b in pairs)
    path.write_text(path.read_text().replace("<ParameterDeclarations>", f"<ParameterDeclarations>{inner}"))
    return path


def test_a_catalog_folder_that_two_locations_name_by_one_parameter_is_written(tmp_path):
    catalog(tmp_path / "cars", "cars", "Cars", ("small", 3))
    path = declared(from_catalogs(tmp_path, "$folder", "$folder"), folder="cars")
    write_concrete_file(ScenarioFile.read(path), {}, tmp_path / "out" / "scenario.xosc")
    assert simulate(tmp_path / "out" / "scenario.xosc", duration=0.1).length == [3.0]


@pytest.mark.parametrize(
    ("reference", "values"),
    [
        ("$road", {"map": "road.xodr", "road": "$map"}),
        ("${$road}", {"road": "road.xodr"}),
        ("$road", {"road": ("missing.xodr", "road.xodr")}),
    ],
    ids=["by_two_parameters", "by_expression", "declared_twice"],
)
@pytest.mark.filterwarnings("ignore::cornercase.NoticeWarning")
def test_a_road_that_a_parameter_names_is_written_and_belongs_to_the_scenario(tmp_path, reference, values):
    path = scenario_file(tmp_path, init=f'<Private entityRef="Ego">{teleport("5")}</Private>')
    path.write_text(path.read_text().replace('filepath="road.xodr"', f'filepath="{reference}"'))
    scenario = ScenarioFile.read(declared(path, **values))
    assert tmp_path / "road.xodr" in scenario.all_paths()
    write_concrete_file(scenario, {}, tmp_path / "out" / "scenario.xosc")
    written = simulate(tmp_path / "out" / "scenario.xosc", duration=0.1)
    assert (written.x == simulate(path, duration=0.1).x).all()


def with_roads_by_parameter(folder):
    path = scenario_file(
        folder,
        init=f'<Private entityRef="Ego">{teleport("5")}</Private>',
        parameters='<ParameterDeclaration name="road" parameterType="string" value="road.xodr"/>',
    )
    path.write_text(path.read_text().replace('filepath="road.xodr"', 'filepath="$road"'))
    (folder / "other.xodr").write_text(ROAD)
    (folder / "space.xosc").write_text(
        '<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="2026-01-01T00:00:00" author="a" description="d"/>'
        '<ParameterValueDistribution><ScenarioFile filepath="scenario.xosc"/><Deterministic>'
        '<DeterministicSingleParameterDistribution parameterName="road"><DistributionSet><Element value="road.xodr"/>'
        '<Element value="other.xodr"/></DistributionSet></DeterministicSingleParameterDistribution></Deterministic>'
        "</ParameterValueDistribution></OpenSCENARIO>"
    )
    return folder / "space.xosc"


def test_a_road_that_a_varied_parameter_names_belongs_to_the_scenario(tmp_path):
    space = with_roads_by_parameter(tmp_path)
    before = LogicalScenario.read(None, space)
    assert find_scenario_file("scenario.xosc", before.fingerprint, [tmp_path], before.space) is not None
    copy = pickle.loads(pickle.dumps(before.scenario_file))
    (tmp_path / "other.xodr").write_text(ROAD.replace('a="4"', 'a="3"'))
    after = LogicalScenario.read(None, space)
    assert after.fingerprint != before.fingerprint
    # A worker that reads it now detects the change.
    with pytest.raises(InputError, match="has changed since it was read"):
        _ = copy.root
    # Not part of the fingerprint if the parameter does not vary.
    assert ScenarioFile.read(tmp_path / "scenario.xosc").fingerprint() not in (before.fingerprint, after.fingerprint)


@pytest.mark.parametrize("name", ["9" * 400, "a/" * 3000])
def test_what_is_no_name_of_a_file_is_refused(tmp_path, name):
    path = scenario_file(tmp_path, init=f'<Private entityRef="Ego">{teleport("5")}</Private>')
    path.write_text(path.read_text().replace("road.xodr", name))
    with pytest.raises(InputError, match="not a valid file name"):
        simulate(path, duration=0.1)


def test_a_place_at_the_end_of_the_world_is_none(tmp_path):
    path = scenario_file(
        tmp_path,
        init='<Private entityRef="Ego"><PrivateAction><TeleportAction><Position><WorldPosition x="-1e300" y="0"/></Position>'
        "</TeleportAction></PrivateAction></Private>",
    )
    with pytest.warns(UserWarning, match="Ego lies beyond the end of the nearest road"):
        simulate(path, duration=0.1)


@pytest.mark.parametrize("other", ["<OpenSCENARIO>", "scenario", "space"])
def test_43_only_files_that_hold_a_catalog_are_catalogs(tmp_path, other):
    """The scenario's own folder, with other scenarios in it, may be the catalog folder."""
    catalog(tmp_path, "one", "Cars", ("small", 3))
    path = from_catalogs(tmp_path, "")
    before = ScenarioFile(path).fingerprint(), check(path).notices
    text = path.read_text()
    (tmp_path / "other.xosc").write_text(
        {"scenario": text, "space": "<OpenSCENARIO><FileHeader/><ParameterValueDistribution/></OpenSCENARIO>"}.get(
            other, other
        )
    )
    assert ScenarioFile(path).catalog_files() == [tmp_path / "one.xosc"]
    assert (ScenarioFile(path).fingerprint(), check(path).notices) == before
    assert simulate(path, duration=0.1).length == [3.0]
    written = write_concrete_file(ScenarioFile.read(path), {}, tmp_path / "there" / "out.xosc")
    assert tmp_path / "there" / "other.xosc" not in written
    assert "other.xosc" not in [one.name for one in written]


def test_an_initial_controller_of_an_entity_named_by_a_parameter_is_not_written(tmp_path):
    path = tmp_path / "deceleration.xosc"
    (tmp_path / "motorway.xodr").write_bytes((DECELERATION.parent / "motorway.xodr").read_bytes())
    who = '<ParameterDeclaration name="who" parameterType="string" value="Ego"/></ParameterDeclarations>'
    private = """<Private entityRef="$who"><PrivateAction><ControllerAction><AssignControllerAction><Controller name="c">
<Properties><Property name="cornercase.driver" value="cautious"/></Properties></Controller></AssignControllerAction>
</ControllerAction></PrivateAction></Private></Actions></Init>"""
    text = DECELERATION.read_text().replace("</ParameterDeclarations>", who, 1)
    path.write_text(re.sub(r"</Actions>\s*</Init>", private, text, count=1))
    assert "AssignControllerAction" in path.read_text()
    target = tmp_path / "out" / "scenario.xosc"
    write_concrete_file(ScenarioFile.read(path), {}, target, drivers={"Ego": "aggressive"})
    assert "AssignControllerAction" not in target.read_text()
    assert ScenarioFile.read(target).drivers["Ego"] == "aggressive"
