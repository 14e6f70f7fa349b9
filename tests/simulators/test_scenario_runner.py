"""OpenSCENARIO 1.0 for CARLA's ScenarioRunner."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from conftest import ran
from cornercase._common.errors import InputError
from cornercase.scenario import ConcreteScenario
from cornercase.scenario._xml import read_xml
from cornercase.simulators import Builtin, convert
from helpers.command_line import cornercase

pytest.importorskip("qc_openscenario", reason="the schema comes with the extra 'validate'")

EXAMPLES = Path(__file__).parents[2] / "examples"
X = EXAMPLES / "x_intersection" / "x_intersection.xosc"
T = EXAMPLES / "t_intersection" / "t_intersection.xosc"


def issues(path):
    """Findings of ASAM's checker."""
    from qc_baselib import Configuration, Result
    from qc_openscenario import constants
    from qc_openscenario.main import run_checks

    config, result = Configuration(), Result()
    config.set_config_param("InputFile", str(path))
    result.register_checker_bundle(
        name=constants.BUNDLE_NAME, description="", version=constants.BUNDLE_VERSION, summary=""
    )
    result.set_result_version(version=constants.BUNDLE_VERSION)
    run_checks(config, result)
    return [issue.description for issue in result.get_issues_by_rule_uid("") or []] + [
        issue.description for checker in result.get_checker_bundle_results()[0].checkers for issue in checker.issues
    ]


@pytest.mark.parametrize("path", [X, T])
def test_asams_checker_finds_nothing_and_no_parameter_is_left(path, tmp_path):
    target = tmp_path / "one.xosc"
    convert(path, target, ego="Ego")
    assert issues(target) == []
    root = read_xml(target)
    assert "$" not in target.read_text()
    assert root.xpath("FileHeader/@revMinor") == ["0"]
    kind = "Entities/ScenarioObject[@name{}'Ego']/Vehicle/Properties/Property[@name='type']/@value"
    assert root.xpath(kind.format("=")) == ["ego_vehicle"]
    others = root.xpath("Entities/ScenarioObject[Vehicle and @name!='Ego']/@name")
    assert isinstance(others, list)
    assert others
    assert root.xpath(kind.format("!=")) == ["simulation"] * len(others)
    assert (tmp_path / "one.xodr").read_bytes() == path.with_suffix(".xodr").read_bytes()


def test_the_checker_would_find_something(tmp_path):
    target = tmp_path / "one.xosc"
    convert(X, target, ego="Ego")
    target.write_text(target.read_text().replace("<Storyboard>", "<Storyboard><Surprise/>", 1))
    assert issues(target)


def test_values_are_those_of_the_concrete_scenario_and_others_move_the_same(tmp_path):
    values = {"pedestrian_wait": 5.0, "p1_speed": 6.0}
    target = tmp_path / "one.xosc"
    convert(X, target, ego="Ego", values=values)
    (before,) = ran(Builtin(duration=12.0), [ConcreteScenario(X, values)])
    (after,) = ran(Builtin(duration=12.0, drivers={"Ego": "normal"}), [ConcreteScenario(target, {})])
    shared = min(before.time.size, after.time.size)
    for name in ("Truck", "C", "Pedestrian"):
        k, j = before.names.index(name), after.names.index(name)
        gap = np.hypot(before.x[k, :shared] - after.x[j, :shared], before.y[k, :shared] - after.y[j, :shared])
        # A step later if a condition was "greater or equal".
        assert gap.max() <= 0.07 * max(before.speed[k].max(), 1.0) + 1e-6


def test_a_road_that_a_parameter_names_is_that_of_the_concrete_scenario(tmp_path):
    path = tmp_path / "road.xosc"
    declared = '<ParameterDeclaration name="Road" parameterType="string" value="nowhere.xodr"/>'
    text = T.read_text().replace('filepath="t_intersection.xodr"', 'filepath="$Road"')
    path.write_text(text.replace("<ParameterDeclarations>", f"<ParameterDeclarations>{declared}", 1))
    (tmp_path / "other.xodr").write_bytes(T.with_suffix(".xodr").read_bytes())
    convert(path, tmp_path / "out" / "one.xosc", ego="Ego", values={"Road": "other.xodr"})
    written = read_xml(tmp_path / "out" / "one.xosc")
    assert written.xpath("RoadNetwork/LogicFile/@filepath") == ["one.xodr"]
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == [
        "cornercase_driver.py", "one.xodr", "one.xosc",
    ]  # fmt: skip


def test_what_is_not_the_same_is_said(tmp_path):
    found = convert(T, tmp_path / "t.xosc", ego="Ego", values={"c_speed": 9.0})
    notes = found.notes
    assert found.path == tmp_path / "t.xosc"
    assert repr(found).startswith(f"<Conversion {found.path}:\n  ")
    assert len(repr(found).splitlines()) == 1 + len(notes)
    assert any("C is driven by the storyboard only, not by cornercase's driver 'simple'" in one for one in notes)
    assert any("final speed of 9 m/s" in one for one in notes)
    assert any("'greaterOrEqual' became 'greaterThan'" in one for one in notes)
    written = read_xml(tmp_path / "t.xosc")
    assert written.xpath(".//SynchronizeAction/FinalSpeed/AbsoluteSpeed/@value") == ["9"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("<RoadNetwork>", "<Surprise/><RoadNetwork>", "<Surprise> is not in the table of what ScenarioRunner does"),
        ('<Event name="', '<Event mood="good" name="', "mood 'good' of <Event> is not in the table"),
        ("<Vehicle ", "<ExternalObjectReference name='x'/><Vehicle ", "ScenarioRunner has no such entity"),
    ],
)
def test_what_cannot_be_said_is_refused_and_nothing_is_written(tmp_path, old, new, words):
    path = tmp_path / "x_intersection.xosc"
    path.write_text(X.read_text().replace(old, new))
    (tmp_path / "x_intersection.xodr").write_bytes(X.with_suffix(".xodr").read_bytes())
    with pytest.raises(InputError) as caught:
        convert(path, tmp_path / "out" / "one.xosc", ego="Ego")
    assert words in str(caught.value)
    assert not (tmp_path / "out").exists()


def changed(tmp_path, *pairs):
    """The T-intersection with a part replaced."""
    path, text = tmp_path / "in" / "t_intersection.xosc", T.read_text()
    path.parent.mkdir()
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new, 1)
    path.write_text(text)
    path.with_suffix(".xodr").write_bytes(T.with_suffix(".xodr").read_bytes())
    return path


COMMAND = """<Event name="run" priority="parallel"><Action name="run"><UserDefinedAction>
<CustomCommandAction type="python evil.py">x</CustomCommandAction></UserDefinedAction></Action><StartTrigger/></Event>"""
MODULE = """<PrivateAction><ControllerAction><AssignControllerAction><Controller name="c"><Properties>
<Property name="module" value="/tmp/evil.py"/></Properties></Controller></AssignControllerAction></ControllerAction>
</PrivateAction>"""


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("</Event>", f"</Event>{COMMAND}", "<UserDefinedAction> with the <CustomCommandAction> 'python evil.py'"),
        ("</Private>", f"{MODULE}</Private>", "names the module '/tmp/evil.py'"),
        ('<Condition name="', '<Condition name="criteria_', "would run a class of its own"),
    ],
)
def test_code_that_a_scenario_names_is_refused_by_name(tmp_path, old, new, words):
    path = changed(tmp_path, (old, new))
    with pytest.raises(InputError) as caught:
        convert(path, tmp_path / "out" / "one.xosc", ego="Ego")
    assert words in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_code_in_a_catalog_is_refused_too(tmp_path):
    maneuver = f'<Maneuver name="m"><ParameterDeclarations/>{COMMAND}</Maneuver>'
    header = T.read_text().partition("<FileHeader")[2].partition("/>")[0]
    reference = '<CatalogReference catalogName="c" entryName="m"/>'
    path = changed(
        tmp_path,
        ("<CatalogLocations/>", '<CatalogLocations><ManeuverCatalog><Directory path="catalogs"/></ManeuverCatalog></CatalogLocations>'),
        ("</Maneuver>", f"</Maneuver>{reference}"),
    )  # fmt: skip
    (path.parent / "catalogs").mkdir()
    (path.parent / "catalogs" / "c.xosc").write_text(
        f'<OpenSCENARIO><FileHeader{header}/><Catalog name="c">{maneuver}</Catalog></OpenSCENARIO>'
    )
    with pytest.raises(InputError, match=r"<CustomCommandAction> 'python evil\.py'"):
        convert(path, tmp_path / "one.xosc", ego="Ego")


@pytest.mark.parametrize("kind", ["text", "other XML", "missing"])
def test_only_a_road_file_is_copied(tmp_path, kind):
    secret = tmp_path / "secret"
    if kind != "missing":
        secret.write_text({"text": "host", "other XML": "<keys>1</keys>"}[kind])
    path = changed(tmp_path, ('filepath="t_intersection.xodr"', f'filepath="{secret}.xodr"'))
    if kind != "missing":
        secret.rename(f"{secret}.xodr")
    with pytest.raises(InputError, match=r"secret\.xodr(, line 1)?[:;] "):
        convert(path, tmp_path / "out" / "one.xosc", ego="Ego")
    assert not (tmp_path / "out").exists()


def test_a_scenario_chooses_neither_names_of_files_nor_the_ego(tmp_path):
    kind = '<ObjectController><Controller name="k"><Properties><Property name="type" value="ego_vehicle"/></Properties></Controller></ObjectController>'
    path = changed(
        tmp_path,
        ('filepath="t_intersection.xodr"', 'filepath="carla.py"'),
        ("</ScenarioObject>", f"{kind}</ScenarioObject>"),
    )
    path.with_suffix(".xodr").rename(path.parent / "carla.py")
    text = path.read_text()
    start = text.index('description="') + len('description="')
    path.write_text(text[:start] + "CARLA:../../victim" + text[text.index('"', start) :])
    found = convert(path, tmp_path / "out" / "one.xosc", ego="C")
    root = read_xml(found.path)
    ours = {"one.xosc", "one.xodr", "cornercase_driver.py", "cornercase_trajectory.py"}
    assert {file.name for file in (tmp_path / "out").iterdir()} <= ours
    assert root.xpath("FileHeader/@description") == ["cornercase"]
    assert len(root.findall(".//Property[@value='ego_vehicle']")) == 1
    assert any("<ObjectController>: without effect" in note for note in found.notes)


class Eight(float):
    """A number as in NumPy 2: a float whose repr contains its type."""

    def __repr__(self):
        return f"np.float64({float(self)})"


def test_numbers_are_written_plainly_with_every_version_of_numpy(tmp_path, monkeypatch):
    from cornercase.scenario import _attributes as attributes

    monkeypatch.setattr(attributes, "round_result", lambda value: Eight(value) if isinstance(value, float) else value)
    scenario = changed(
        tmp_path, ('<SimulationTimeCondition value="', '<SimulationTimeCondition value="${8.33 * 2}" was="')
    )
    scenario.write_text(re.sub(r' was="[^"]*"', "", scenario.read_text()))
    convert(scenario, tmp_path / "one.xosc", ego="Ego")
    assert 'value="16.66"' in (tmp_path / "one.xosc").read_text()
    assert "np.float64" not in (tmp_path / "one.xosc").read_text()


def test_the_command(tmp_path):
    done = cornercase("convert", T, "--set", "c_start_time=1", "--ego", "Ego", "-o", tmp_path / "t.xosc")
    assert done.returncode == 0, done.stderr
    assert "not by cornercase's driver" in done.stderr
    assert issues(tmp_path / "t.xosc") == []
    done = cornercase("convert", T, "--set", "c_strat_time=1", "--ego", "Ego", "-o", tmp_path / "u.xosc")
    assert done.returncode == 2
    assert "did you mean 'c_start_time'" in done.stderr
