"""Road files that break the standard and are read as esmini and CARLA read them, with a notice."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from cornercase._common.errors import InputError
from cornercase._common.io.support_table import NoticeLabel, list_adaptation_notices
from cornercase.roads._network import RoadNetwork
from cornercase.scenario._xml import XmlFileCache
from cornercase.simulators.builtin.tracks._nurbs import evaluate_nurbs
from helpers.road_networks import WIDTH, lane, linked, road, write


def read(path: Path) -> tuple[RoadNetwork, list[str]]:
    """The network of a file, and its notices."""
    root = XmlFileCache().get_root(path)
    elements = list(root.iter())
    network = RoadNetwork.from_xml(root, path)
    notices = list_adaptation_notices(elements[0], path)
    assert all(notice.label is NoticeLabel.ADAPTED and notice.rule for notice in notices)
    return network, [str(notice) for notice in notices]


def edited(folder: Path, old: str, new: str, *parts: str) -> Path:
    path = write(folder, *(parts or (road("1", 100.0, right=lane(-1)),)))
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path


def end_of(network: RoadNetwork, name: str = "1") -> tuple[float, float]:
    one = network.roads[network.road_index(name)]
    x, y, _ = one.lane_pose_at(-1, np.array([one.length]))
    return float(x[0]), float(y[0])


@pytest.mark.parametrize(
    ("old", "new", "end", "said"),
    [
        (' b="0"', "", (100.0, -2.0), "b of <width> (road.xodr, line 1): is missing, and is read as 0"),
        (' sOffset="0" a="4"', ' sOffset="" a="4"', (100.0, -2.0), "sOffset of <width> (road.xodr, line 1): is missing"),
        ("<line/>", '<paramPoly3 pRange="arcLength" bU="1"/>', (100.0, -2.0), "aU of <paramPoly3>"),
        ("<line/>", '<poly3 a="1"/>', (100.0, -1.0), "b of <poly3>"),
        ('<laneSection s="0">', '<laneOffset s="0" a="1"/><laneSection>', (100.0, -1.0), "b of <laneOffset>"),
        (' hdg="0.0"', "", (100.0, -2.0), "hdg of <geometry>"),
        ('<geometry s="0" x="0.0" y="0.0"', "<geometry", (100.0, -2.0), "s of <geometry>"),
        ('hdg="0.0" length="100.0"', 'hdg="0.0"', (100.0, -2.0), "length of <geometry> (road.xodr, line 1): is missing, and is read as 100"),
        ('id="1" length="100.0"', 'id="1"', (100.0, -2.0), "length of <road> (road.xodr, line 1): is missing, and is read as 100"),
    ],
)  # fmt: skip
def test_43_8_a_missing_coefficient_is_zero(tmp_path, old, new, end, said):
    network, notices = read(edited(tmp_path, old, new))
    assert end_of(network) == pytest.approx(end)
    assert any(said in notice for notice in notices), notices


def test_43_8_numbers_that_are_none_are_still_refused_by_their_line(tmp_path):
    for text in ("nan", "4,5", "inf"):
        with pytest.raises(InputError, match=f"line 1, road 1: a of <width> is '{text}', not a finite number"):
            read(edited(tmp_path, 'a="4"', f'a="{text}"'))


@pytest.mark.parametrize(
    ("old", "new", "kind", "said"),
    [
        (' type="driving"', "", "none", "type of <lane> (road.xodr, line 1): is missing, and is read as 'none'"),
        ('"driving"', '"Driving"', "driving", "type of <lane> (road.xodr, line 1): is 'Driving', and is read as 'driving'"),
        ('"driving"', '"autobahn"', "none", "type of <lane> (road.xodr, line 1): is 'autobahn', and is read as 'none'"),
        (WIDTH, "", "driving", "<lane> without a width (road.xodr, line 1): is 0 m wide"),
    ],
)  # fmt: skip
def test_43_8_a_lane_that_lacks_something_is_read(tmp_path, old, new, kind, said):
    network, notices = read(edited(tmp_path, old, new))
    assert network.roads[0].sections[0][1][-1].lane_type == kind
    assert notices == [said]


@pytest.mark.parametrize("end", ["predecessor", "successor"])
@pytest.mark.parametrize("contact", ["start", ""])
def test_43_8_a_road_that_is_linked_to_nothing_ends_there(tmp_path, end, contact):
    network, notices = read(write(tmp_path, road("1", 100.0, right=lane(-1), links=linked(end, "7", contact))))
    what = "road" if contact else "junction"
    assert notices == [
        f"link to the {what} '7' (road.xodr, line 1): leads to nothing that exists, so the road ends there"
    ]
    path = network.lane_path_from(0, -1, 50.0, True)
    assert path is not None
    assert path.has_end
    assert path.x[-1] == pytest.approx(100.0)


def test_43_8_a_link_without_a_contact_point_leads_to_the_nearer_end(tmp_path):
    link = '<successor elementType="road" elementId="2"/>'
    parts = (road("1", 100.0, right=lane(-1, after=1), links=link),
             road("2", 50.0, at=(150.0, 0.0, np.pi), left=lane(1)))  # fmt: skip
    network, notices = read(write(tmp_path, *parts))
    assert network.roads[0].successor is not None
    assert network.roads[0].successor.contact_point == "end"
    assert notices == [
        "<successor> of <road> (road.xodr, line 1): has no contactPoint; the end of the road is used, which is nearer"
    ]
    path = network.lane_path_from(0, -1, 50.0, True)
    assert path is not None
    assert path.x[-1] == pytest.approx(150.0)


def test_43_8_a_lane_that_is_linked_to_nothing_ends_there(tmp_path):
    parts = (road("1", 100.0, right=lane(-1, after=-5), links=linked("successor", "2", "start")),
             road("2", 50.0, at=(100.0, 0.0, 0.0), right=lane(-1)))  # fmt: skip
    network, notices = read(write(tmp_path, *parts))
    assert notices == ["<successor> of <lane> (road.xodr, line 1): leads to no lane that exists, so the lane ends"]
    path = network.lane_path_from(0, -1, 50.0, True)
    assert path is not None
    assert path.x[-1] == pytest.approx(100.0)


def test_43_8_a_connection_over_a_road_that_is_not_there_is_left_out(tmp_path):
    junction = ('<junction id="j"><connection id="0" incomingRoad="1" connectingRoad="9" contactPoint="start"/>'
                '<connection id="1" incomingRoad="1" connectingRoad="2"/></junction>')  # fmt: skip
    parts = (road("1", 100.0, right=lane(-1), links=linked("successor", "j")),
             road("2", 50.0, at=(100.0, 0.0, 0.0), right=lane(-1), links=linked("predecessor", "1", "end"), junction="j"))  # fmt: skip
    network, notices = read(write(tmp_path, *parts, junction))
    assert network.connections == {"j": (("1", "2", "start", {}),)}
    assert [notice.partition(":")[0] for notice in notices] == [
        "<connection> with the road '9' (road.xodr, line 1)", "<connection> (road.xodr, line 1)",
    ]  # fmt: skip


@pytest.mark.parametrize(("jump", "read_so"), [(0.05, True), (1.09, True), (1.99, True), (2.1, False)])
def test_43_8_a_reference_line_may_jump_by_two_metres(tmp_path, jump, read_so):
    second = f'</geometry><geometry s="40" x="40" y="{jump}" hdg="0" length="60"><line/></geometry></planView>'
    path = edited(tmp_path, "</geometry></planView>", second)
    if not read_so:
        with pytest.raises(InputError, match=r"begins 2\.1 m away from the end of the one before"):
            read(path)
        return
    network, notices = read(path)
    assert notices == (
        ["<geometry> (road.xodr, line 1): begins up to 2 m away from the end of the one before; entities jump across"]
        if jump > 0.1
        else []
    )
    lane_path = network.lane_path_from(0, -1, 0.0, True)
    assert lane_path is not None
    assert lane_path.y[-1] == pytest.approx(jump - 2.0)


def test_43_8_a_road_that_cannot_be_used_is_left_out(tmp_path):
    parts = (road("1", 100.0, right=lane(-1), links=linked("successor", "2", "start")),
             road("2", 50.0, at=(100.0, 0.0, 0.0), right=lane(-1)))  # fmt: skip
    path = edited(tmp_path, '<geometry s="0" x="100.0" y="0.0" hdg="0.0" length="50.0"><line/></geometry>', "", *parts)
    network, notices = read(path)
    assert [one.road_id for one in network.roads] == ["1"]
    assert notices == ["road 2 (road.xodr, line 1): is left out: has no <geometry> in its <planView>"]
    # Using it raises an error with the reason.
    with pytest.raises(InputError, match="road 2: has no <geometry>"):
        network.road_index("2")
    lane_path = network.lane_path_from(0, -1, 0.0, True)
    assert lane_path is not None
    assert lane_path.x[-1] == pytest.approx(100.0)


def test_43_8_places_out_of_order_are_put_in_order(tmp_path):
    second = WIDTH.replace('sOffset="0" a="4"', 'sOffset="50" a="2"')
    network, notices = read(edited(tmp_path, WIDTH, second + WIDTH))
    assert end_of(network)[1] == pytest.approx(-1.0)
    assert notices == ["order of <width> (road.xodr, line 1): they are sorted by where they begin"]


def test_43_8_words_in_another_case_and_a_missing_header_are_read(tmp_path):
    path = edited(tmp_path, '<header revMajor="1" revMinor="8"/>', "")
    path.write_text(path.read_text().replace('junction="-1"', 'junction="-1" rule="lht"'))
    network, notices = read(path)
    assert not network.roads[0].is_right_hand_traffic
    assert notices == [
        "<header> (road.xodr, line 1): is missing, and the file is read as OpenDRIVE 1.9",
        "rule of <road> (road.xodr, line 1): is 'lht', and is read as 'LHT'",
    ]


def test_43_8_a_curve_whose_first_points_coincide_has_a_direction_from_its_begin():
    x, y = np.array([[0.0, 0.0, 0.0, 5.0, 10.0]]), np.array([[0.0, 0.0, 10.0, 15.0, 15.0]])
    knots = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 2.0, 2.0, 2.0])
    heading = evaluate_nurbs(x, y, np.zeros((1, 5)), np.ones(5), knots, 4)[2]
    assert heading[0, 0] == pytest.approx(0.5 * np.pi, abs=0.1)


@pytest.mark.parametrize("text", ["1_0", "\u0664"])
def test_43_8_numbers_that_only_python_takes_are_refused_by_their_line(tmp_path, text):
    with pytest.raises(InputError, match=f"line 1, road 1: a of <width> is '{text}', not a finite number"):
        read(edited(tmp_path, 'a="4"', f'a="{text}"'))
    with pytest.raises(InputError, match=f"line 1, road 1: id of <lane> is '-{text}', not a finite number"):
        read(edited(tmp_path, 'lane id="-1"', f'lane id="-{text}"'))


def test_43_8_a_lane_number_with_decimals_is_the_whole_number(tmp_path):
    network, notices = read(edited(tmp_path, 'lane id="-1"', 'lane id="-1.0"'))
    assert end_of(network) == pytest.approx((100.0, -2.0))
    assert "id of <lane> (road.xodr, line 1): is '-1.0', and is read as -1" in notices


CENTER = '<center><lane id="0" type="none"/></center>'
SECOND = f'<laneSection s="{{}}">{CENTER}<right>{lane(-1, -1, -1, WIDTH.replace("4", "2"))}</right></laneSection>'


@pytest.mark.parametrize(
    ("old", "new", "end", "said"),
    [
        ("</lanes>", f"{SECOND.format(0)}</lanes>", -1.0, "<laneSection> at the position of another (road.xodr, line 1): several begin at s = 0 m; the last"),
        ("</lanes>", f"{SECOND.format(120)}</lanes>", -2.0, "<laneSection> beyond the end of its road (road.xodr, line 1): begins at s = 120 m, but the road ends at 100 m"),
        (WIDTH, WIDTH + WIDTH.replace("4", "2"), -1.0, "<width> at the position of another (road.xodr, line 1): several begin at 0 m; the last"),
        ('sOffset="0"', 'sOffset="50"', -2.0, "first <width> of <lane> (road.xodr, line 1): begins at 50 m of its lane section, and its curve holds before"),
        ('sOffset="0"', 'sOffset="-50"', -2.0, "first <width> of <lane> (road.xodr, line 1): begins at -50 m of its lane section"),
        ("</right>", f"{lane(-3)}</right>", -2.0, "number -3 of <lane> (road.xodr, line 1): the lane -2 is missing and taken as 0 m wide"),
        (CENTER, "", -2.0, "<laneSection> without <center> (road.xodr, line 1): the line from which"),
        ("</planView>", '<geometry s="100" x="100" y="0" hdg="0" length="-0"><line/></geometry></planView>', -2.0, "<geometry> of 0 m (road.xodr, line 1): is left out"),
    ],
)  # fmt: skip
def test_43_8_what_road_files_have_twice_or_not_is_said(tmp_path, old, new, end, said):
    network, notices = read(edited(tmp_path, old, new))
    one = network.roads[0]
    assert one.lane_pose_at(-1, np.array([99.0]))[1][0] == pytest.approx(end)
    assert any(notice.startswith(said) for notice in notices), notices


def test_43_8_a_sound_road_gives_no_notice(tmp_path):
    assert read(write(tmp_path, road("1", 100.0, right=lane(-1) + lane(-2), left=lane(1))))[1] == []


def test_43_8_sections_of_one_side_may_begin_together(tmp_path):
    sides = "".join(
        f'<laneSection s="0" singleSide="true">{CENTER}<{side}>{lane(number)}</{side}></laneSection>'
        for side, number in (("left", 1), ("right", -1))
    )
    network, notices = read(write(tmp_path, road("1", 100.0, sections=sides)))
    assert notices == []
    assert sorted(network.roads[0].sections[0][1]) == [-1, 1]


def test_a_road_whose_only_section_has_no_side_is_left_out(tmp_path):
    section = f'<laneSection s="0" singleSide="true">{CENTER}</laneSection>'
    sound = road("2", 100.0, at=(0.0, 50.0, 0.0), right=lane(-1))
    network, notices = read(write(tmp_path, road("1", 100.0, sections=section), sound))
    assert [one.road_id for one in network.roads] == ["2"]
    (notice,) = notices
    assert notice.startswith("road 1 (road.xodr, line 1): is left out: <laneSection> has singleSide, but neither")


@pytest.mark.parametrize(
    ("number", "said"), [(0, "the lane 0 belongs in <center>"), (1, "lanes on the right have numbers below 0")]
)
def test_43_8_a_lane_on_the_wrong_side_is_told_its_place(tmp_path, number, said):
    with pytest.raises(InputError, match=f"line 1, road 1: the lane {number} is in <right>; {said}"):
        read(write(tmp_path, road("1", 100.0, right=lane(number))))


def test_43_8_many_lane_sections_are_read_in_a_time_that_grows_with_their_number(tmp_path):
    def seconds(count: int) -> float:
        sections = "".join(SECOND.format(k) for k in range(count))
        root = XmlFileCache().get_root(write(tmp_path, road("1", float(count), sections=sections)))
        begin = time.process_time()
        RoadNetwork.from_xml(root, tmp_path / "road.xodr")
        return time.process_time() - begin

    # The square would be 64 times as long.
    assert seconds(4000) < 24 * min(seconds(500) for _ in range(3))


def test_43_8_a_file_without_a_lane_is_refused_by_the_line_of_its_first_road(tmp_path):
    path = write(tmp_path, "\n\n", road("1", 100.0, sections=f'<laneSection s="0">{CENTER}</laneSection>'))
    with pytest.raises(InputError, match=r"road.xodr, line 3: <road>: none of the roads has a lane"):
        read(path)[0].locate(np.zeros(1), np.zeros(1))
