"""Scenario files whose description begins with CARLA:, which turns their axes, as in ScenarioRunner."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from conftest import (
    car,
    place,
    private,
    run,
    same_recording,
    scenario_file,
    speed_action,
    story_of,
    time_trigger,
    trajectory,
)
from conftest import event as one_event
from cornercase import check, convert
from cornercase._common.errors import InputError
from cornercase.scenario._concrete_file import build_concrete_file
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators import Builtin, Esmini

PARAMETERS = '<ParameterDeclaration name="side" parameterType="double" value="{}"/>'
RELATIVE = (
    '<Position><{tag} entityRef="Ego" dx="12" dy="{dy}"><Orientation type="relative" h="{h}"/></{tag}></Position>'
)


def teleport(position: str) -> str:
    return f"<PrivateAction><TeleportAction>{position}</TeleportAction></PrivateAction>"


def polyline(sign: float) -> str:
    vertices = "".join(
        f'<Vertex time="{time}">{place(x, sign * y, f"""h="{sign * h}" """)}</Vertex>'
        for time, x, y, h in ((0, 100, 2, 0), (2, 120, 3, 0.2), (4, 140, 6, 0.4))
    )
    return f"<Polyline>{vertices}</Polyline>"


def clothoid(sign: float) -> str:
    return (
        f'<Clothoid curvature="{sign * 0.01}" curvaturePrime="{sign * 0.001}" length="60" startTime="0" stopTime="5">'
        f'{place(150, sign * 3, f"""h="{sign * 0.1}" """)}</Clothoid>'
    )


def written(folder: Path, description: str, sign: float, **more: str) -> Path:
    """A scenario of several kinds of positions, in axes whose y has this sign."""
    folder.mkdir(exist_ok=True)
    road = f'<Position><RoadPosition roadId="1" s="60" t="{sign * 1.5}"><Orientation type="relative" h="{sign * 0.2}"/>'
    lane = '<Position><LanePosition roadId="1" laneId="-1" s="200" offset="0.3"><Orientation type="relative" '
    first = teleport(place("${20 + 2}", "$side", 'h="${0.1 * $side}"'))
    path = scenario_file(
        folder,
        parameters=PARAMETERS.format(sign * -2.5),
        entities="".join(map(car, ("Ego", "A", "B", "C", "D", "E"))),
        init=private("Ego", first, speed_action("10"))
        + private("A", teleport(RELATIVE.format(tag="RelativeObjectPosition", dy=sign * 3, h=sign * 0.3)), speed_action("5"))
        + private("B", teleport(RELATIVE.format(tag="RelativeWorldPosition", dy=sign * 4, h=sign * 0.3)), speed_action("5"))
        + private("C", teleport(f"{road}</RoadPosition></Position>"), speed_action("5"))
        + private("D", teleport(f'{lane}h="{sign * 0.1}"/></LanePosition></Position>'), speed_action("5"))
        + private("E", teleport(place(80, sign * 2, f'h="{sign * -0.1}"')), speed_action("5")),
        story=story_of(one_event("a", trajectory(polyline(sign), TIMING), time_trigger("1")), "A")
        + story_of(one_event("b", trajectory(clothoid(sign), TIMING), time_trigger("1")), "B").replace('"s"', '"s2"'),
        **more,
    )  # fmt: skip
    path.write_text(path.read_text().replace('description="d"', f'description="{description}"'))
    return path


TIMING = '<Timing domainAbsoluteRelative="relative" scale="1" offset="0"/>'


def test_43_2_a_file_of_carlas_is_turned(tmp_path: Path) -> None:
    turned, plain = written(tmp_path / "a", "CARLA:x", -1.0), written(tmp_path / "b", "x", 1.0)
    one, other = run(turned, 4.0), run(plain, 4.0)
    assert same_recording(one, other)
    assert one.y[0, 0] == -2.5
    assert one.heading[0, 0] == pytest.approx(-0.25)
    # What is said by lanes alone is the same in all axes.
    again = run(turned, 4.0, side=3.0)
    assert again.y[0, 0] == -3.0


def test_43_2_a_file_of_carlas_is_named(tmp_path: Path) -> None:
    turned, plain = written(tmp_path / "a", "CARLA:x", -1.0), written(tmp_path / "b", "x CARLA:", 1.0)
    (notice,) = [one for one in check(turned).notices if "left-handed" in str(one)]
    assert str(notice).startswith(
        "signs of y and headings (scenario.xosc, line 2): the description begins with 'CARLA:'"
    )
    assert notice in Builtin.notices(ScenarioFile.read(turned))
    assert not any("left-handed" in str(one) for one in check(plain).notices)


def test_43_2_catalogs_of_a_file_of_carlas_are_turned_too(tmp_path: Path) -> None:
    found = []
    for sign, description in ((-1.0, "CARLA:x"), (1.0, "x")):
        folder = tmp_path / description[-1] / str(sign)
        folder.mkdir(parents=True)
        reference = (
            '<PrivateAction><RoutingAction><FollowTrajectoryAction><TrajectoryRef><CatalogReference catalogName="t"'
            f' entryName="one"/></TrajectoryRef><TimeReference>{TIMING}</TimeReference><TrajectoryFollowingMode'
            ' followingMode="position"/></FollowTrajectoryAction></RoutingAction></PrivateAction>'
        )
        path = scenario_file(
            folder,
            init=private("Ego", teleport(place(20, sign * -2)), speed_action("10")),
            story=story_of(one_event("e", reference, time_trigger("1"))),
        )
        text = path.read_text().replace('description="d"', f'description="{description}"')
        locations = '<CatalogLocations><TrajectoryCatalog><Directory path="t"/></TrajectoryCatalog></CatalogLocations>'
        path.write_text(text.replace("<CatalogLocations/>", locations))
        (folder / "t").mkdir()
        (folder / "t" / "t.xosc").write_text(
            '<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="2026-01-01T00:00:00" author="a" description="d"/>'
            f'<Catalog name="t"><Trajectory name="one" closed="false"><Shape>{polyline(sign)}</Shape></Trajectory>'
            "</Catalog></OpenSCENARIO>"
        )
        found.append(run(path, 6.0))
    assert same_recording(*found)
    assert found[0].y[0, -1] > 5.0


def test_43_2_a_converted_file_of_carlas_is_in_the_axes_of_the_road(tmp_path: Path) -> None:
    turned, plain = written(tmp_path / "a", "CARLA:x", -1.0), written(tmp_path / "b", "x", 1.0)
    found, expected = (
        convert(path, tmp_path / f"{k}.xosc", ego="Ego") for k, path in enumerate((turned, plain))
    )  # fmt: skip
    text = found.path.read_text()
    assert text.replace("0.xodr", "1.xodr") == expected.path.read_text()
    assert 'description="cornercase"' in text
    assert 'y="-2.5"' in text
    assert any("left-handed" in note for note in found.notes)
    assert not any("left-handed" in note for note in expected.notes)


def test_43_2_a_concrete_file_stays_in_its_axes(tmp_path: Path) -> None:
    turned = written(tmp_path / "a", "CARLA:x", -1.0)
    made = build_concrete_file(ScenarioFile.read(turned), {"side": 2.0}, tmp_path / "one.xosc", description="score 1.2")
    path = turned.with_name("one.xosc")
    path.write_bytes(made.content)
    assert b'description="CARLA:score 1.2"' in made.content
    assert same_recording(run(path, 3.0), run(turned, 3.0, side=2.0))


def test_43_2_esmini_which_does_not_know_such_axes_refuses_them(tmp_path: Path) -> None:
    turned, plain = written(tmp_path / "a", "CARLA:x", -1.0), written(tmp_path / "b", "x", 1.0)
    simulator = Esmini.__new__(Esmini)
    simulator._undriven, simulator._drivers = True, {}
    simulator.check_supported(ScenarioFile.read(plain))
    with pytest.raises(InputError, match=r"scenario\.xosc: its description begins with 'CARLA:'.*`cornercase convert`"):
        simulator.check_supported(ScenarioFile.read(turned))


WILD = Path(__file__).parents[3] / "shared" / "reference" / "wild"


@pytest.mark.skipif(not WILD.is_dir(), reason="the folder of others' scenarios is not there")
def test_43_2_what_others_wrote_for_carla_lies_on_its_towns() -> None:
    from cornercase.roads._network import RoadNetwork

    networks: dict[Path, RoadNetwork] = {}
    beside = []
    for path in sorted((WILD / "carla-simulator+scenario_runner").rglob("*.xosc")):
        scenario = ScenarioFile(path)
        road = scenario.road_path_for() if scenario.root.find("Storyboard") is not None else None
        if road is None or not road.is_file() or not scenario.has_left_handed_axes or "Town01" not in road.name:
            continue
        network = networks.setdefault(road, RoadNetwork.read(road) if road not in networks else networks[road])
        for position in scenario.root.iterfind("Storyboard/Init//WorldPosition"):
            try:
                x, y = np.array([float(position.get("x", ""))]), np.array([-float(position.get("y", ""))])
            except ValueError:
                continue
            spot = network.locate(x, y)
            half = 0.5 * network.roads[int(spot.road[0])].lane_width(
                int(network.roads[int(spot.road[0])].section_at(spot.s)[0]), int(spot.lane[0]), spot.s
            )
            beside.append(max(abs(float(spot.offset[0])) - float(half[0]), 0.0))
    assert len(beside) > 10
    assert np.median(beside) == 0.0
