"""Formats similar to OpenSCENARIO XML: openPASS, drafts of 1.4, the DSL, and versions before 1.0."""

from __future__ import annotations

from pathlib import Path

import pytest

from conftest import car, moving, run, scenario_file
from cornercase import check, convert
from cornercase._common.errors import InputError
from cornercase.scenario._bundle import ScenarioBundle
from cornercase.scenario._concrete_file import write_concrete_file
from cornercase.scenario._file import ScenarioFile
from helpers.command_line import cornercase

PROFILES = """<Profiles SchemaVersion="0.4.6"><AgentProfiles>
<AgentProfile Name="Middle" Type="Dynamic"><DriverProfiles><DriverProfile Name="R" Probability="1.0"/></DriverProfiles>
<VehicleProfiles><VehicleProfile Name="A" Probability="0.4"/><VehicleProfile Name="B" Probability="0.6"/></VehicleProfiles>
</AgentProfile>
<AgentProfile Name="Newer" Type="Dynamic"><VehicleModels><VehicleModel Name="small" Probability="1.0"/></VehicleModels>
</AgentProfile><AgentProfile Name="Static" Type="Static"><System/><VehicleModel>large</VehicleModel></AgentProfile>
<AgentProfile Name="Empty" Type="Dynamic"/></AgentProfiles>
<VehicleProfiles><VehicleProfile Name="A"><Model Name="small"/></VehicleProfile>
<VehicleProfile Name="B"><Model Name="large"/></VehicleProfile></VehicleProfiles>
<ProfileGroup Type="Driver"><Profile Name="R"/></ProfileGroup></Profiles>"""


def vehicle(name: str, length: float) -> str:
    body = car("x").partition("<Vehicle ")[2].rpartition("</ScenarioObject>")[0]
    return "<Vehicle " + body.replace('name="car"', f'name="{name}"').replace('length="4"', f'length="{length}"')


def of_openpass(folder: Path, profile: str = "Middle", catalog: str = "ProfilesCatalog.xml") -> Path:
    folder.mkdir(exist_ok=True)
    entity = (
        f'<ScenarioObject name="Ego"><CatalogReference catalogName="{catalog}" entryName="{profile}"/></ScenarioObject>'
    )
    path = scenario_file(folder, init=moving(), entities=entity)
    empty = "".join(f'<{kind}Catalog><Directory path=""/></{kind}Catalog>' for kind in ("Controller", "Route"))
    locations = f'<VehicleCatalog><Directory path="VehicleModelsCatalog.xosc"/></VehicleCatalog>{empty}'
    text = path.read_text().replace("<CatalogLocations/>", f"<CatalogLocations>{locations}</CatalogLocations>")
    path.write_text(text)
    models = vehicle("small", 3.5) + vehicle("large", 5.5)
    (folder / "VehicleModelsCatalog.xosc").write_text(
        '<OpenSCENARIO><FileHeader revMajor="1" revMinor="0" date="2020-01-01T00:00:00" description="" author=""/>'
        f'<Catalog name="VehicleCatalog">{models}</Catalog></OpenSCENARIO>'
    )
    (folder / "ProfilesCatalog.xml").write_text(PROFILES)
    return path


@pytest.mark.parametrize(
    ("profile", "length", "said"),
    [
        ("Middle", 5.5, "'large' is used, the most probable of 2"),
        ("Newer", 3.5, "'small' is"),
        ("Static", 5.5, "'large'"),
    ],
)
def test_43_8_of_an_agent_profile_of_openpass_the_vehicle_model_is_read(tmp_path, profile, length, said):
    path = of_openpass(tmp_path / "s", profile)
    assert run(path, duration=1.0).length[0] == length
    found = check(path)
    assert not found.run_errors
    (notice,) = [one for one in found.notices if one.rule]
    assert f"the agent profile '{profile}' of openPASS" in notice.reason
    assert said in notice.reason
    (whole,) = [one for one in found.notices if one.parts == ("<Profiles>",)]
    assert "drivers, sensors" in whole.reason
    assert not [one for one in found.notices if one.reason == "is not known here"]


def test_43_8_an_agent_profile_counts_and_goes_with_the_scenario(tmp_path):
    path = of_openpass(tmp_path / "s")
    before = ScenarioFile(path).fingerprint()
    (there := tmp_path / "there").mkdir()
    other = ScenarioBundle.from_file(ScenarioFile(path)).unpack(there)
    assert other.fingerprint() == before
    assert not check(other).run_errors
    write_concrete_file(ScenarioFile(path), {}, tmp_path / "one" / "one.xosc")
    convert(path, tmp_path / "two" / "two.xosc", ego="Ego")
    (tmp_path / "s" / "ProfilesCatalog.xml").write_text(PROFILES.replace("0.4", "0.9"))
    assert ScenarioFile(path).fingerprint() != before
    assert run(path, duration=0.1).length[0] == 3.5
    assert run(tmp_path / "one" / "one.xosc", duration=0.1).length[0] == 5.5
    assert run(tmp_path / "two" / "two.xosc", duration=0.1).length[0] == 5.5


@pytest.mark.parametrize(
    ("profile", "words"),
    [
        ("Midle", "ProfilesCatalog.xml: has no agent profile 'Midle'; did you mean 'Middle'?"),
        ("Empty", "has no vehicle model; use a vehicle of an OpenSCENARIO catalog"),
    ],
)
def test_43_8_an_agent_profile_without_a_vehicle_is_refused_with_the_way_out(tmp_path, profile, words):
    path = of_openpass(tmp_path / "s", profile)
    (why,) = check(path).run_errors
    assert words in why
    (tmp_path / "s" / "ProfilesCatalog.xml").unlink()
    (why,) = check(path).run_errors
    assert "is not next to the scenario; put it there, or use a vehicle" in why


def test_43_11_a_controller_that_is_an_agent_profile_is_named(tmp_path):
    profile = (
        '<ObjectController><Controller name="c"><Properties><Property name="AgentProfile" value="Middle"/></Properties>'
    )
    held = car("Ego").replace("</ScenarioObject>", f"{profile}</Controller></ObjectController></ScenarioObject>")
    notices = [str(one) for one in check(scenario_file(tmp_path, init=moving(), entities=held)).notices]
    (told,) = [one for one in notices if "AgentProfile" in one]
    assert "openPASS's ProfilesCatalog.xml, whose driver and sensors are ignored" in told


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.osc", "import osc.standard\n\nscenario cut_in:\n  ego: vehicle\n", "ASAM OpenSCENARIO DSL"),
        ("a.xosc", "# a comment\nscenario sut.cut_in:\n    do serial:\n", "OpenSCENARIO XML 1.0 to 1.3"),
        ("ProfilesCatalog.xml", PROFILES, "<Profiles> holds agent profiles of openPASS; give the scenario"),
        ("simulationConfig.xml", "<simulationConfig/>", "configures a simulation of openPASS; give the scenario"),
        (
            "old.xosc",
            "<OpenSCENARIO><FileHeader revMajor='0' revMinor='9'/><Catalogs/><RoadNetwork><Logics/></RoadNetwork>"
            "<Entities><Object name='Ego'/></Entities><Storyboard/></OpenSCENARIO>",
            "before 1.0, whose elements have other names; convert it to 1.0",
        ),
        ("text.xosc", "hello world", "is not well-formed XML"),
    ],
)
def test_43_11_what_is_of_another_format_is_named_with_the_way_out(tmp_path, name, content, words):
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(InputError) as caught:
        check(path)
    assert words in str(caught.value)
    assert str(caught.value).count(". ") == 0
    done = cornercase("simulate", path, "-o", tmp_path / "r.csv")
    assert done.returncode == 2
    assert words in " ".join(done.stderr.split())
    assert not (tmp_path / "r.csv").exists()


def test_43_11_a_draft_of_1_4_is_read_as_1_3_and_what_it_adds_is_named(tmp_path):
    path = scenario_file(tmp_path, init=moving())
    text = path.read_text().replace('revMinor="2"', 'revMinor="4"')
    path.write_text(text.replace("<Storyboard>", "<WeatherModels/><Storyboard>"))
    assert run(path, duration=1.0).time[-1] == pytest.approx(1.0)
    notices = check(path).notices
    (version,) = [one for one in notices if one.rule]
    assert "read as OpenSCENARIO XML 1.3" in version.reason
    assert "revMinor" in version.parts[0]
    (unknown,) = [one for one in notices if "<WeatherModels>" in " ".join(one.parts)]
    assert "OpenSCENARIO XML 1.4 may have it, 1.3 has not" in unknown.reason
    assert not [one for one in notices if one.parts == version.parts and not one.rule]


def test_43_11_what_a_draft_of_1_4_needs_is_refused_as_of_1_4(tmp_path):
    condition = (
        '<Condition name="c" delay="0" conditionEdge="none"><ByValueCondition><MoodCondition/></ByValueCondition>'
    )
    path = scenario_file(tmp_path, init=moving(), stop=f"<ConditionGroup>{condition}</Condition></ConditionGroup>")
    path.write_text(path.read_text().replace('revMinor="2"', 'revMinor="4"'))
    (why,) = check(path).run_errors
    assert "<MoodCondition> is not supported" in why
    assert "OpenSCENARIO XML 1.4, the file's version, may have it" in why
