"""Roads with small gaps between geometries: entities neither turn nor lose time there."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from conftest import scenario_file, speed_action, teleport
from cornercase import simulate
from cornercase.roads._network import RoadNetwork

LANE = (
    '<lanes><laneSection s="0"><center><lane id="0" type="none"/></center><right><lane id="-1" type="driving">'
    '<width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane></right></laneSection></lanes>'
)


def line(s, x, y, length):
    return f'<geometry s="{s}" x="{x}" y="{y}" hdg="0" length="{length}"><line/></geometry>'


def pieces(aside):
    """A road of 200 m whose geometries of 2 m are offset alternately to both sides."""
    geometries = "".join(line(2 * k, 2 * k, aside * (k % 2), 2) for k in range(100))
    return f'<road id="1" length="200" junction="-1"><planView>{geometries}</planView>{LANE}</road>'


def two_roads(aside, ahead):
    """Two linked roads; the second one starts beside the end of the first one, and ahead of it."""
    onto = '<link><successor elementType="road" elementId="2" contactPoint="start"/></link>'
    back = '<link><predecessor elementType="road" elementId="1" contactPoint="end"/></link>'
    first, second = (
        LANE.replace("<width", f'<link><{end} id="-1"/></link><width') for end in ("successor", "predecessor")
    )
    return (
        f'<road id="1" length="100" junction="-1">{onto}<planView>{line(0, 0, 0, 100)}</planView>{first}</road>'
        f'<road id="2" length="100" junction="-1">{back}<planView>{line(0, 100 + ahead, aside, 100)}</planView>{second}</road>'
    )


@pytest.mark.parametrize(("aside", "ahead"), [(0.0, 0.0), (0.3, 0.0), (1.5, 0.0), (0.0, 0.9), (0.0, -0.9), (0.5, -0.5)])
def test_43_nobody_turns_where_roads_do_not_quite_meet(tmp_path, aside, ahead):
    init = f'<Private entityRef="Ego">{teleport("80")}{speed_action("10")}</Private>'
    path = scenario_file(tmp_path, init=init)
    (tmp_path / "road.xodr").write_text(
        f'<OpenDRIVE><header revMajor="1" revMinor="6"/>{two_roads(aside, ahead)}</OpenDRIVE>', encoding="utf-8"
    )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = simulate(path, duration=4.0, time_step=0.01)
    assert np.abs(recording.heading[0]).max() < 0.01
    assert recording.y[0, -1] - recording.y[0, 0] == pytest.approx(aside, abs=1e-6)
    gap = np.hypot(aside, ahead)
    said = [str(one.message) for one in caught if "adapted: link between the roads 1 and 2" in str(one.message)]
    assert len(said) == (gap > 0.5)
    assert all(f"{gap:.3g} m apart" in one for one in said)


@pytest.mark.filterwarnings("ignore:adapted:UserWarning")
@pytest.mark.parametrize("aside", [0.0, 0.03, 0.3])
def test_43_8_a_jump_aside_neither_turns_nor_delays(tmp_path, aside):
    init = f'<Private entityRef="Ego">{teleport("5")}{speed_action("10")}</Private>'
    path = scenario_file(tmp_path, init=init)
    (tmp_path / "road.xodr").write_text(
        f'<OpenDRIVE><header revMajor="1" revMinor="6"/>{pieces(aside)}</OpenDRIVE>', encoding="utf-8"
    )
    recording = simulate(path, duration=15.0)
    assert np.abs(recording.heading[0]).max() < 0.01
    expected = 5.0 + 10.0 * recording.time
    assert np.abs(recording.x[0] - expected)[1:].max() < 0.08
    assert np.ptp(recording.y[0]) == pytest.approx(aside, abs=1e-6)


@pytest.mark.parametrize("at", [50.0, 30.05, 61.7])
def test_a_jump_aside_is_no_part_of_the_length_in_either_direction(tmp_path, at):
    two = line(0, 0, 0, at) + line(at, at, 1, 100 - at)
    road = f'<road id="1" length="100" junction="-1"><planView>{two}</planView>{LANE}</road>'
    path = tmp_path / "road.xodr"
    path.write_text(f'<OpenDRIVE><header revMajor="1" revMinor="6"/>{road}</OpenDRIVE>', encoding="utf-8")
    network = RoadNetwork.read(path)
    for forward in (True, False):
        lane_path = network.lane_path_from(0, -1, 10.0, forward)
        assert lane_path is not None
        assert lane_path.distance[-1] == pytest.approx(100.0, abs=1e-6)
