"""Each element and attribute of OpenDRIVE is used, reported as without effect, or refused.

``PYTHONPATH=tests python tests/roads/test_road_ledger.py`` writes docs/opendrive.md from the ledger.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))

import pytest
from lxml import etree

from conftest import EXAMPLES, car, scenario_file, speed_action, teleport
from cornercase._common.errors import InputError
from cornercase._common.io.support_table import SupportStatus
from cornercase.roads._network import RoadNetwork
from cornercase.roads._support_table import SUPPORT_TABLE
from cornercase.roads._unsupported import list_unsupported
from cornercase.scenario._xml import XmlFileCache
from cornercase.simulators import check
from helpers.road_networks import WIDTH, lane, linked, road, virtual, write
from helpers.support_tables import gaps, page, strangers

PAGE = Path(__file__).parents[2] / "docs" / "opendrive.md"
REFERENCE = Path(__file__).parents[3] / "shared" / "reference" / "openscenario"
INIT = f'<Private entityRef="Ego">{teleport("10")}{speed_action("1")}</Private>'
HEAD = """
# What cornercase reads of OpenDRIVE

cornercase reads road files of OpenDRIVE 1.4 to 1.9. It uses each element and attribute of the standard, ignores it with a
notice, or refuses it.

- **Without effect**: `cornercase check` lists what a file contains and cornercase ignores; `simulate` and `explore` print as
  notices what could change the result if a simulator used it. They also list what the standard does not know.
- **Refused**: the command ends with exit code 2 and one sentence that names the element and its line.

If an element is refused or without effect, the same holds for everything inside it.

A road of OpenDRIVE 1.9 may have lanes in two layers, `<lanes layer="permanent">` and `<lanes layer="temporary">` for roadworks.
cornercase uses the permanent lanes, and a notice lists the others. To use those, make them the permanent lanes of the file.

Three more notices do not concern a single element: roads that climb or bank by more than 2 %, because vehicles drive in the
plane; lanes reserved for buses, taxis, trams or full cars, because all vehicles may drive on them; and linked roads that do not
touch, because they are not connected. The last are listed when the path of an entity reaches the end of such a road.

## What breaks the standard

Files that break the standard in ways that esmini and CARLA accept are read. A notice that begins with *adapted* says how:

- a missing coefficient, position (`s`, `x`, `y`, `hdg`) or `sOffset` is 0; a missing `s` of a `geometry` is the end of the previous
  one, and a missing `length` reaches to the next one;
- a lane without a type that the standard knows has the type `none`; one without `width` and `border` is 0 m wide;
- a road or lane that is linked to a missing one ends there, and a `connection` with a missing road is left out; a missing
  `contactPoint` is the nearer end;
- elements in the wrong order are sorted by where they begin; of several `width`, `border`, `laneOffset` or `laneSection` at the same
  position, the last one in the file counts;
- the curve of the first `width` also holds before its `sOffset`; a missing lane between others is 0 m wide, and a lane number such as
  `-1.0` is -1; a `laneSection` may lack its `center`, and one beyond the end of the road is never reached;
- a `geometry` of 0 m is left out;
- if a `geometry` begins up to 2 m away from the end of the previous one, entities jump across without turning; if lanes of linked
  roads are more than 0.5 m apart, a notice says so;
- a road that cannot be used, for example without `geometry` or with a larger gap, is left out. The file is refused if it has no other
  road; a scenario that places an entity on that road is refused, too;
- a `header` may be missing, and the case of words does not matter: `arclength` is read as `arcLength`.
"""
SCHEMAS = {
    "1.8.0": "OpenDRIVE_Core.xsd",
    "1.7.0": "opendrive_17_core.xsd",
    "1.6.1": "opendrive_16_core.xsd",
    "1.5": "OpenDRIVE_1.5M.xsd",
    "1.4": "OpenDRIVE_1.4H.xsd",
}
# Elements of OpenDRIVE 1.4 that later versions do not have.
EARLIER = {"neighbor", "crossfall", "visibility"}


def schema(version: str) -> Path:
    import qc_opendrive

    return Path(qc_opendrive.__file__).parent / "schema" / version / SCHEMAS[version]


@pytest.mark.parametrize("version", SCHEMAS)
def test_the_ledger_knows_all_of_the_standard(version):
    assert gaps(SUPPORT_TABLE, schema(version), "OpenDRIVE") == []


def test_the_ledger_knows_nothing_beyond_the_standard():
    beyond = {entry.element for entry in strangers(SUPPORT_TABLE, schema("1.8.0"), "OpenDRIVE") if not entry.attribute}
    assert beyond == EARLIER


def test_the_page_says_what_the_ledger_says():
    assert PAGE.read_text(encoding="utf-8") == page(SUPPORT_TABLE, HEAD), f"run python {Path(__file__).name}"


def told(path: Path) -> dict[str, str]:
    files = XmlFileCache()
    root = files.get_root(path)
    network = RoadNetwork.from_xml(root, path)
    network.lane_path_from(0, -1, 0.0, True)
    notices = list_unsupported(root, path, network)
    return {", ".join(notice.parts): notice.reason for notice in notices}


def test_nothing_is_said_of_what_is_used(tmp_path):
    assert told(write(tmp_path, *virtual())) == {}
    for name in ("x_intersection", "t_intersection"):
        assert told(EXAMPLES / name / f"{name}.xodr") == {}


@pytest.mark.parametrize(
    ("inside", "what"),
    [
        ('<access sOffset="0" rule="deny" restriction="bus"/>', "<access>"),
        ('<speed sOffset="0" max="50"/>', "<speed>"),
        ('<border sOffset="0" a="-5" b="0" c="0" d="0"/>', "<border> in <lane>"),
        ('<roadMark sOffset="0" type="solid" color="white"/>', "<roadMark>"),
        ('<kerb sOffset="0"/>', "<kerb> in <lane>"),
    ],
)
def test_what_of_a_lane_has_no_effect_is_named(tmp_path, inside, what):
    assert list(told(write(tmp_path, road("1", 100.0, right=lane(-1, inside=WIDTH + inside))))) == [what]


@pytest.mark.parametrize(
    ("more", "what"),
    [
        ('direction="both"', "direction of <lane>"),
        ('dynamicLaneDirection="true"', "dynamicLaneDirection of <lane>"),
        ('level="true"', "level of <lane>"),
        ('colour="blue"', "colour of <lane>"),
        ('direction="reversed" level="false"', None),
    ],
)
def test_what_an_attribute_of_a_lane_asks_for_in_vain_is_named(tmp_path, more, what):
    assert list(told(write(tmp_path, road("1", 100.0, right=lane(-1, more=more))))) == [what] * (what is not None)


@pytest.mark.parametrize("kind", ["bus", "taxi", "HOV"])
def test_lanes_for_some_vehicles_are_named(tmp_path, kind):
    reserved = lane(-1).replace("driving", kind)
    (why,) = told(write(tmp_path, road("1", 100.0, right=reserved))).values()
    assert why == "vehicles of all kinds may drive on every lane"


def test_roads_that_cross_are_named(tmp_path):
    crossing = ('<junction id="7" name="level crossing" type="crossing"><roadSection id="0" roadId="1" sStart="10"'
                ' sEnd="20"/></junction>')  # fmt: skip
    found = told(write(tmp_path, road("1", 100.0), crossing))
    assert found == {"type of <junction>, <roadSection>": "roads that cross are not linked there"}


def test_links_between_roads_that_lie_apart_are_named(tmp_path):
    apart = [road("1", 100.0, links=linked("successor", "2", "start")), road("2", 100.0, at=(140.0, 0.0, 0.0))]
    found = told(write(tmp_path, *apart))
    assert list(found) == ["link between the roads 1 and 2"]
    assert "are 40 m apart" in found["link between the roads 1 and 2"]


def test_a_file_that_includes_others_is_refused(tmp_path):
    path = write(tmp_path, road("1", 100.0), '<include file="more.xml"/>')
    with pytest.raises(InputError, match=r"line 1: <include> cannot be used; write what it includes into the file"):
        RoadNetwork.read(path)


def test_check_names_what_of_a_road_has_no_effect(tmp_path):
    scenario = scenario_file(tmp_path, init=INIT, entities=car("Ego"))
    write(tmp_path, road("1", 100.0), '<controller id="1"><control signalId="7"/></controller>')
    found = check(scenario)
    assert found.is_valid
    assert [str(one) for one in found.notices if one.file.name == "road.xodr"] == [
        "<controller> (road.xodr, line 1): vehicles ignore the signs and lights of the road file"
    ]


@pytest.mark.parametrize(
    ("text", "other", "said"),
    [
        ('junction="-1"', 'junction="-1" rule="left"', "rule 'left' of <road> in line 1"),
        ("<line/>", '<paramPoly3 pRange="arclen" aU="0" bU="1" cU="0" dU="0" aV="0" bV="0" cV="0" dV="0"/>',
         "pRange 'arclen' of <paramPoly3> in line 1"),
    ],
)  # fmt: skip
def test_a_word_that_an_attribute_cannot_have_is_refused(tmp_path, text, other, said):
    path = write(tmp_path, road("1", 100.0, right=lane(-1)))
    assert text in path.read_text()
    path.write_text(path.read_text().replace(text, other))
    with pytest.raises(InputError, match=f"{said} cannot be used; (did you mean|known are)"):
        RoadNetwork.read(path)


@pytest.mark.skipif(not REFERENCE.is_dir(), reason="needs the reference scenarios")
def test_of_the_roads_of_others_all_is_used_or_named_and_nothing_unknown():
    for path in sorted(REFERENCE.glob("**/*.xodr")):
        found = told(path)
        assert len(found) <= 8, path.name
        assert not [why for why in found.values() if "not known" in why or "nothing reads it" in why], path.name
        top = {str(one.tag) for one in etree.parse(str(path)).getroot().iterfind("road/*")}
        named = " ".join(found)
        assert [
            tag for tag in ("type", "objects", "signals", "surface") if tag in top and f"<{tag}>" not in named
        ] == []


def test_each_line_of_the_ledger_says_why():
    for entry in SUPPORT_TABLE.entries:
        assert entry.status is SupportStatus.USED or entry.note, entry


if __name__ == "__main__":
    PAGE.write_text(page(SUPPORT_TABLE, HEAD), encoding="utf-8")
