"""Whatever is wrong with a file: the message names the file, the line and an element, and in a run the instant."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from shutil import copytree

import pytest
from lxml import etree

import cornercase as cc
from conftest import EXAMPLES, at_night, car, event, scenario_file, speed_action, story_of, teleport, time_trigger
from cornercase._common.errors import InputError
from cornercase.scenario import LogicalScenario

EVERYTHING = Path(__file__).parents[1] / "data" / "everything"
PLACED = re.compile(r"(?P<file>.+?\.(xosc|xodr)), line \d+[:,] .*?(<\w+>|\w+ of <\w+>)")

# Messages that name no element: of a file that is no XML or not there, and of a space that is of another scenario.
WITHOUT_ELEMENT = ("is not well-formed XML", "cannot be read (", "declares no parameter")


def message(path: Path, **options) -> str:
    """What a file is refused with; nothing where it runs."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            cc.simulate(path, **{"duration": 0.2, **options})
    except InputError as error:
        return str(error)
    return ""


def breaks(root: etree._Element) -> Iterator[str]:
    """Break each element and attribute in turn, and say which; the file is as it was afterwards."""
    for element in list(root.iter("*")):
        above = element.getparent()
        if above is not None:
            place = above.index(element)
            above.remove(element)
            yield f"without <{element.tag}> in <{above.tag}>, line {element.sourceline}"
            above.insert(place, element)
        tag, element.tag = element.tag, "Nonsense"
        yield f"<Nonsense> for <{tag}>, line {element.sourceline}"
        element.tag = tag
        attributes = [(str(name), str(value)) for name, value in element.attrib.items()]
        for name, value in attributes:
            del element.attrib[name]
            yield f"without {name} of <{tag}>, line {element.sourceline}"
            for key, text in attributes:
                element.set(key, text)
            for nonsense in ("", "nonsense", "-1", "$nonsense", "${1/0}"):
                element.set(name, nonsense)
                yield f"{name}={nonsense!r} of <{tag}>, line {element.sourceline}"
            element.set(name, value)


SCENARIOS = {
    "t_intersection": (EXAMPLES / "t_intersection", "t_intersection.xosc", "t_intersection.xosc"),
    "x_intersection": (EXAMPLES / "x_intersection", "x_intersection.xosc", "x_intersection.xosc"),
    "cut_in": (EXAMPLES / "r157", "cut_in.xosc", "cut_in.xosc"),
    "everything": (EVERYTHING, "everything.xosc", "everything.xosc"),
    "road of everything": (EVERYTHING, "everything.xosc", "road.xodr"),
    "road": (EXAMPLES / "r157", "cut_in.xosc", "motorway.xodr"),
}


@pytest.mark.parametrize("each", at_night([197, 7], {7}))
@pytest.mark.parametrize("name", SCENARIOS)
def test_43_10_each_message_names_file_line_and_element(tmp_path, name, each):
    folder, scenario, broken = SCENARIOS[name]
    copied = Path(copytree(folder, tmp_path / "copy"))
    tree, refused, wrong = etree.parse(copied / broken), 0, []
    for k, what in enumerate(breaks(tree.getroot())):
        if k % each:
            continue
        tree.write(copied / broken)
        said = message(copied / scenario)
        refused += said != ""
        if said and PLACED.match(said) is None and not any(one in said for one in WITHOUT_ELEMENT):
            wrong.append((what, said))
    assert wrong == []
    assert refused > 0


@pytest.mark.parametrize("name", ["deterministic.space.xosc", "stochastic.space.xosc"])
def test_43_10_each_message_of_a_space_names_file_line_and_element(tmp_path, name):
    folder = Path(copytree(EVERYTHING, tmp_path / "copy"))
    tree, refused, wrong = etree.parse(folder / name), 0, []
    for k, what in enumerate(breaks(tree.getroot())):
        if k % 5:
            continue
        tree.write(folder / name)
        try:
            LogicalScenario.read(folder / "everything.xosc", folder / name)
        except InputError as error:
            refused += 1
            if PLACED.match(str(error)) is None and not any(one in str(error) for one in WITHOUT_ELEMENT):
                wrong.append((what, str(error)))
    assert wrong == []
    assert refused > 5


def two(folder: Path, story: str = "", init: str = "", **options) -> str:
    placed = f'<Private entityRef="Ego">{teleport("10")}{speed_action("10")}{init}</Private>'
    path = scenario_file(folder, init=placed, story=story, stop=time_trigger("5"), entities=car("Ego"))
    return message(path, **{"duration": 6.0, **options})


def test_43_10_a_failure_in_a_run_names_the_action_and_the_instant(tmp_path):
    said = two(tmp_path, story_of(event("gone", teleport("9000"), time_trigger("3.2"))))
    line = (tmp_path / "scenario.xosc").read_text(encoding="utf-8").split('s="9000"')[0].count("\n") + 1
    assert said == (
        f"{tmp_path / 'scenario.xosc'}, line {line}: <TeleportAction> of 'gone-action': Ego is placed off the map at"
        " t = 3.2 s."
    )


def test_43_10_a_failure_of_an_init_action_names_it_and_the_instant(tmp_path):
    said = two(tmp_path, init=teleport("9000"))
    assert re.search(
        r"scenario\.xosc, line \d+: <TeleportAction> of <Init>: Ego is placed off the map at t = 0 s\.", said
    )


def test_43_10_times_that_go_back_are_named_with_action_and_instant(tmp_path):
    corners = "".join(
        f'<Vertex time="{time}"><Position><WorldPosition x="{x}" y="0"/></Position></Vertex>'
        for time, x in ((0, 10), (2, 30), (1, 50))
    )
    back = (
        '<PrivateAction><RoutingAction><FollowTrajectoryAction><TrajectoryRef><Trajectory name="t" closed="false">'
        f"<Shape><Polyline>{corners}</Polyline></Shape></Trajectory></TrajectoryRef><TimeReference>"
        '<Timing domainAbsoluteRelative="relative" scale="1" offset="0"/></TimeReference>'
        '<TrajectoryFollowingMode followingMode="position"/></FollowTrajectoryAction></RoutingAction></PrivateAction>'
    )
    said = two(tmp_path, story_of(event("e", back, time_trigger("1"))))
    if said:  # else it is read otherwise, with a notice
        assert re.search(r"scenario\.xosc, line \d+: <FollowTrajectoryAction> of 'e-action': .* at t = 1 s\.", said)


def test_43_10_who_is_never_placed_is_named_with_the_instant(tmp_path):
    path = scenario_file(tmp_path, init="", stop=time_trigger("1"), entities=car("Ego"))
    assert re.fullmatch(
        r".*scenario\.xosc, line \d+: <Init>: no action places an entity on the map up to t = 1 s\.",
        message(path, duration=9.0),
    )


def test_43_10_what_is_wrong_in_a_catalog_is_named_by_the_catalog(tmp_path):
    folder = Path(copytree(EVERYTHING, tmp_path / "copy"))
    catalog = next(one for one in (folder / "catalogs").glob("*.xosc") if "<Vehicle " in one.read_text("utf-8"))
    text = catalog.read_text(encoding="utf-8")
    begin = text.index("<Dimensions")
    line = text[:begin].count("\n") + 1
    catalog.write_text(text[:begin] + re.sub(r'length="[^"]*"', 'length="nonsense"', text[begin:], count=1))
    said = [message(one) for one in sorted(folder.glob("*.xosc"))]
    assert any(one.startswith(f"{catalog}, line {line}: length of <Dimensions> is 'nonsense'") for one in said), said


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('catalogName="', 'catalogName="No', "there is no catalog 'No"),
        ('entryName="', 'entryName="No', "has no entry 'No"),
    ],
)
def test_43_10_a_catalog_that_is_not_there_is_named_with_the_line_of_its_reference(tmp_path, old, new, words):
    folder = Path(copytree(EVERYTHING, tmp_path / "copy"))
    said = []
    for path in sorted(folder.glob("*.xosc")):
        text = path.read_text(encoding="utf-8")
        if old in text and "<Storyboard" in text:
            path.write_text(text.replace(old, new, 1), encoding="utf-8")
            line = text.split(old)[0].count("\n") + 1
            said.append(message(path))
            assert said[-1].startswith(f"{path}, line {line}: <CatalogReference>: "), said
            assert words in said[-1]
    assert said
