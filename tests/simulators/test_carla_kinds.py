"""Entities and roads of which ScenarioRunner's versions do not do the same."""

from __future__ import annotations

import shutil

import pytest

from cornercase._common.errors import InputError
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._xml import read_xml
from cornercase.simulators.carla._controller_assignment import DrivingAgents
from cornercase.simulators.carla._openscenario_1_0 import ConversionOptions, write_openscenario_1_0
from helpers.command_line import X
from helpers.passing_cars import write_passing_cars

T = X.parents[1] / "t_intersection" / "t_intersection.xosc"


def written(path, tmp_path, **options):
    """The file that a run uses, and its notes."""
    given = ConversionOptions(duration=2.0, is_run=True, **options)
    notes = write_openscenario_1_0(ScenarioFile.read(path), {}, tmp_path / "one.xosc", ego="Ego", options=given)
    return read_xml(tmp_path / "one.xosc"), notes


@pytest.mark.parametrize(
    ("name", "category", "found"),
    [
        ("cone", "obstacle", "static.prop.streetbarrier"),
        ("static.prop.trafficcone01", "obstacle", "static.prop.trafficcone01"),
    ],
)
def test_a_thing_has_a_name_of_which_no_version_dies(tmp_path, name, category, found):
    thing = (
        f'<ScenarioObject name="Thing"><MiscObject name="{name}" mass="80" miscObjectCategory="{category}"><BoundingBox>'
        '<Center x="0" y="0" z="0.5"/><Dimensions length="1" width="1" height="1"/></BoundingBox><Properties/>'
        "</MiscObject></ScenarioObject></Entities>"
    )
    at = (
        '<Private entityRef="Thing"><PrivateAction><TeleportAction><Position><WorldPosition x="40" y="9"/></Position>'
        "</TeleportAction></PrivateAction></Private></Actions></Init>"
    )
    path = tmp_path / "with_thing.xosc"
    path.write_text(T.read_text().replace("</Entities>", thing).replace("</Actions>\n    </Init>", at))
    shutil.copy(T.with_suffix(".xodr"), tmp_path)
    root, _ = written(path, tmp_path)
    assert root.find("Entities/ScenarioObject[@name='Thing']/MiscObject").get("name") == found


ROUTE = (
    "<PrivateAction><RoutingAction><AcquirePositionAction><Position><WorldPosition {} y='-5.25'/></Position>"
    "</AcquirePositionAction></RoutingAction></PrivateAction></Private>"
)


@pytest.fixture
def right_hand(tmp_path):
    """Two cars on a motorway, of which the Ego has a route."""
    path = write_passing_cars(tmp_path)
    path.write_text(path.read_text().replace("</Private>", ROUTE.format("x='300'"), 1))
    return path


@pytest.fixture
def left_hand(right_hand):
    """The same in the other direction, with left-hand traffic."""
    path = right_hand.with_name("left.xosc")
    text = right_hand.read_text().replace('h="0.0"', 'h="3.14159265"').replace("x='300'", "x='20'")
    path.write_text(text.replace("motorway.xodr", "left.xodr"))
    road = right_hand.with_name("motorway.xodr").read_text()
    assert 'rule="RHT"' in road
    path.with_name("left.xodr").write_text(road.replace('rule="RHT"', 'rule="LHT"'))
    return path


def test_left_hand_traffic_is_for_versions_that_know_it(tmp_path, left_hand, right_hand):
    """CARLA's client reads it since 0.9.16; before, its lanes lead the other way."""
    words = "takes left-hand traffic for right-hand traffic"
    _, notes = written(left_hand, tmp_path)
    assert {note.partition(" ")[0] for note in notes if words in note} == {"Ego", "T00"}
    _, notes = written(left_hand, tmp_path, knows_left_hand_traffic=True)
    assert not [note for note in notes if words in note]
    agents = DrivingAgents({"Ego": "normal"})
    with pytest.raises(InputError, match="takes for right-hand traffic, so Ego would drive on the wrong side"):
        written(left_hand, tmp_path, agents=agents)
    written(left_hand, tmp_path, agents=agents, knows_left_hand_traffic=True)
    written(right_hand, tmp_path, agents=agents)
