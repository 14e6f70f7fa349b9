"""Roads with features as short as rounding errors, as in exports of road editors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from conftest import moving, private, run, scenario_file, speed_action, teleport
from cornercase._common.errors import InputError
from cornercase.roads._network import RoadNetwork
from cornercase.simulators.builtin.tracks._lane import LaneTrack
from helpers import road_networks as rn

# m; below, at and above the tolerance for rounding.
LENGTHS = (0.0, 1e-15, 1e-12, 1e-9, 4.6e-8, 5e-7, 1e-6, 1.1e-6, 3e-6, 1e-5, 2.1e-5, 1e-4, 3e-3, 0.04)
WIDTH = '<width sOffset="{}" a="4" b="0" c="0" d="0"/>'
GEOMETRY = '<geometry s="{}" x="{}" y="0" hdg="0" length="{}">{}</geometry>'


def section(s: float, right: str) -> str:
    return f'<laneSection s="{s}"><center><lane id="0" type="none"/></center><right>{right}</right></laneSection>'


def one_road(*, geometries: str = "", offsets: str = "", sections: str = "", length: float = 100.0) -> str:
    plan = geometries or GEOMETRY.format(0, 0, length, "<line/>")
    return (
        f'<road id="1" length="{length}" junction="-1"><planView>{plan}</planView>'
        f"<lanes>{offsets}{sections or section(0, rn.lane(-1))}</lanes></road>"
    )


def short_section(length: float) -> str:
    return one_road(
        sections=section(0, rn.lane(-1, None, -1)) + section(50, rn.lane(-1, -1, -1))
        + section(50 + length, rn.lane(-1, -1, None))
    )  # fmt: skip


def short_sections_in_a_row(length: float) -> str:
    starts = [0.0, *(50 + k * length for k in range(4)), 60.0]
    return one_road(sections="".join(section(s, rn.lane(-1, -1, -1)) for s in dict.fromkeys(starts)))


def short_last_section(length: float) -> str:
    return one_road(sections=section(0, rn.lane(-1, None, -1)) + section(100 - length, rn.lane(-1, -1, None)))


def section_behind_the_end(length: float) -> str:
    return one_road(sections=section(0, rn.lane(-1, None, -1)) + section(100 + length, rn.lane(-1, -1, None)))


def short_geometry(shape: str):
    def road(length: float) -> str:
        return one_road(
            geometries=GEOMETRY.format(0, 0, 50, "<line/>") + GEOMETRY.format(50, 50, length, shape)
            + GEOMETRY.format(50 + length, 50 + length, 50 - length, "<line/>")
        )  # fmt: skip

    return road


def short_last_geometry(length: float) -> str:
    # It must not be continued to the end of the road.
    return one_road(
        geometries=GEOMETRY.format(0, 0, 99.99, "<line/>")
        + GEOMETRY.format(99.99, 99.99, min(length, 1e-6), '<spiral curvStart="0" curvEnd="0.1"/>')
    )


def short_offset(length: float) -> str:
    offset = '<laneOffset s="{}" a="0" b="{}" c="0" d="0"/>'
    return one_road(offsets=offset.format(0, 0) + offset.format(50, 0.3) + offset.format(50 + length, 0))


def short_width(length: float) -> str:
    wide = '<width sOffset="50" a="4" b="0.3" c="0" d="0"/>'
    return one_road(sections=section(0, rn.lane(-1, inside=WIDTH.format(0) + wide + WIDTH.format(50 + length))))


def short_road(length: float) -> str:
    length = max(length, 1e-9)
    return "".join(
        (
            rn.road("1", 50.0, links=rn.linked("successor", "2", "start")),
            rn.road("2", length, at=(50.0, 0.0, 0.0),
                    links=rn.linked("predecessor", "1", "end") + rn.linked("successor", "3", "start")),
            rn.road("3", 50.0, at=(50.0 + length, 0.0, 0.0), links=rn.linked("predecessor", "2", "end")),
        )
    )  # fmt: skip


FEATURES = {
    "section": short_section, "sections": short_sections_in_a_row, "last section": short_last_section,
    "section behind the end": section_behind_the_end, "line": short_geometry("<line/>"),
    "arc": short_geometry('<arc curvature="0.1"/>'), "spiral": short_geometry('<spiral curvStart="0" curvEnd="0.1"/>'),
    "cubic": short_geometry('<paramPoly3 pRange="arcLength" aU="0" bU="1" cU="0" dU="0" aV="0" bV="0" cV="0" dV="0"/>'),
    "last geometry": short_last_geometry, "offset": short_offset, "width": short_width, "road": short_road,
}  # fmt: skip


@pytest.mark.parametrize("feature", FEATURES)
def test_43_1_a_short_feature_of_a_road_changes_no_motion(tmp_path: Path, feature: str) -> None:
    for length in LENGTHS:
        path = scenario_file(tmp_path, init=moving("1.17"))
        rn.write(tmp_path, FEATURES[feature](length))
        recording = run(path, duration=9.0)
        x = 1.17 + 10.0 * recording.time
        # An arc or spiral of some centimetres changes the heading a little.
        near = 1e-6 + (length if feature in ("arc", "spiral", "offset", "width", "road") else 0.0)
        np.testing.assert_allclose(recording.x[0], x, atol=near, err_msg=f"{feature} of {length:g} m")
        np.testing.assert_allclose(recording.y[0], -2.0, atol=near, err_msg=f"{feature} of {length:g} m")


@pytest.mark.parametrize("lane", [-1, 1])
@pytest.mark.parametrize("where", [0.0, 0.5, 1.0])
def test_43_1_somebody_can_be_put_on_a_lane_that_is_shorter_than_rounding(
    tmp_path: Path, lane: int, where: float
) -> None:
    both = rn.lane(1, 1, 1)
    for length in LENGTHS[3:]:
        starts = (0.0, 50.0, 50.0 + length)
        sections = "".join(
            f'<laneSection s="{s}"><left>{both}</left><center><lane id="0" type="none"/></center>'
            f"<right>{rn.lane(-1, -1, -1)}</right></laneSection>" for s in starts
        )  # fmt: skip
        at = 50.0 + where * length
        path = scenario_file(tmp_path, init=private("Ego", teleport(repr(at), str(lane)), speed_action("10")))
        rn.write(tmp_path, one_road(sections=sections))
        recording = run(path, duration=4.0)
        along = 1.0 if lane < 0 else -1.0
        np.testing.assert_allclose(
            recording.x[0], at + along * 10.0 * recording.time, atol=1e-5, err_msg=f"{length:g} m"
        )
        np.testing.assert_allclose(recording.y[0], -2.0 * along, atol=1e-6)


def test_43_1_a_road_that_is_shorter_than_rounding_is_its_own_end(tmp_path: Path) -> None:
    for length in (1e-9, 4.6e-8, 1e-5):
        path = scenario_file(tmp_path, init=private("Ego", teleport("0"), speed_action("10")))
        rn.write(tmp_path, one_road(length=length))
        recording = run(path, duration=1.0)
        np.testing.assert_allclose(recording.x[0], 0.0, atol=2e-5)
        np.testing.assert_allclose(recording.heading[0], 0.0, atol=1e-6)
        assert recording.speed[0, -1] == 0.0


def test_43_1_somebody_at_the_end_of_a_lane_is_not_on_the_next_that_lies_beside_it(tmp_path: Path) -> None:
    rn.write(
        tmp_path,
        rn.road("1", 50.0, links=rn.linked("successor", "2", "start")),
        rn.road("2", 50.0, at=(50.0, 3.0, 0.0), links=rn.linked("predecessor", "1", "end")),
    )
    network = RoadNetwork.read(tmp_path / "road.xodr")
    path = network.lane_path_from(0, -1, 25.0, True)
    assert path is not None
    x, y, _ = LaneTrack(path).pose_at(path.distance_of_s(np.array([49.97, 50.0])), np.zeros(2), np.array([0, 0]))
    np.testing.assert_allclose(x, [49.97, 50.0], atol=0.03)
    np.testing.assert_allclose(y, -2.0, atol=0.5)


def test_43_1_of_records_at_one_place_the_last_holds(tmp_path: Path) -> None:
    widths = '<width sOffset="0" a="5" b="0" c="0" d="0"/><width sOffset="0" a="3" b="0" c="0" d="0"/>'
    network = rn.network(tmp_path, rn.road("1", 50.0, right=rn.lane(-1, inside=widths)))
    assert network.roads[0].lane_width(0, -1, np.array([10.0])) == pytest.approx(3.0)


def test_43_1_a_piece_of_a_length_below_0_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a <geometry> has the length -1 m; it must be above 0"):
        rn.network(tmp_path, one_road(geometries=GEOMETRY.format(0, 0, -1, "<line/>")))


def test_43_1_before_the_first_offset_lanes_are_shifted_as_where_it_begins(tmp_path: Path) -> None:
    late = '<laneOffset s="25" a="0.5" b="0.1" c="0.01" d="-0.001"/>'
    road = rn.network(tmp_path, one_road(offsets=late)).roads[0]
    np.testing.assert_allclose(road.lane_center(0, -1, np.array([0.0, 10.0, 24.9, 25.0])), -1.5)
    assert road.lane_center(0, -1, np.array([27.0])) == pytest.approx(-1.5 + 0.1 * 2 + 0.01 * 4 - 0.001 * 8)
