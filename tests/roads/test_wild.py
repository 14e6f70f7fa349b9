"""Roads that nobody here wrote: where their lanes are by CARLA and esmini, and whether each can be driven."""

from __future__ import annotations

import csv
import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cornercase._common.errors import InputError
from cornercase.roads import RoadNetwork
from driven_lanes import drive_lanes

WILD = Path(__file__).parents[3] / "shared" / "reference" / "wild"
CENTRES = WILD / "lane_centres.csv.gz"
pytestmark = pytest.mark.skipif(not CENTRES.is_file(), reason="the folder of others' roads is not there")
# m, as CARLA and esmini themselves agree on.
NEAR = 0.01


def centres() -> dict[str, list[dict[str, str]]]:
    """Lane centres by road file."""
    found: dict[str, list[dict[str, str]]] = {}
    with gzip.open(CENTRES, "rt", encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            found.setdefault(row["file"], []).append(row)
    return found


def by_file() -> list[Any]:
    """Road files, of which one in forty, and no town, is looked at by day."""
    files = sorted(str(path.relative_to(WILD)) for path in WILD.rglob("*.xodr")) if CENTRES.is_file() else []
    return [
        pytest.param(
            file, id=file.replace("/", "-"), marks=() if k % 40 == 7 and "_towns" not in file else pytest.mark.slow
        )
        for k, file in enumerate(files)
    ]


# Files on whose lanes the speed differs by more than 0.1 %, by a part of their path.
INEXACT = {
    # The file gives its curve another length than it has.
    "poly3_length_match_invalid": 2e-3,
    # The road goes on with a corner where its geometry ends.
    "parampoly3_arclength_range_valid": 0.25,
    # Its bend comes and goes within three metres, 20 m beside the reference line.
    "kreuz-frankfurt": 7e-3,
}


@pytest.mark.parametrize("file", by_file())
def test_43_1_every_lane_can_be_driven_at_the_speed_asked_for_but_for_what_is_allowed(file: str) -> None:
    try:
        network = RoadNetwork.read(WILD / file)
    except InputError:
        return
    exact = max((error for part, error in INEXACT.items() if part in file), default=1e-3)
    wrong = [str(lane) for lane in drive_lanes(network) if lane.crash or lane.error > exact]
    assert wrong == []


# Files in which lanes are elsewhere, by a part of their path, and why.
ELSEWHERE = {
    "_towns/Town01": "the centres are those of another version of it, with other roads",
    "_towns/Town02": "the centres are those of another version of it, with other roads",
    "_towns/Town04": "the centres are those of another version of it, with other roads",
    "border": "neither of them reads <border>, and lanes without a width have none there",
    "redundant_info_lane_offset": "before the first <laneOffset>, esmini takes s from the begin of the road",
    "redundant_info_superelevation": "esmini banks the road, which the file leans by 20 rad",
    "parampoly3_arclength_range_valid": "the road is 61 m longer than its geometry",
    "Ex_Entry_Exit": "esmini banks the road: 1.9 cm",
    "smoothness_example/many_invalid": "esmini banks the road: two points, 2 and 7 cm",
}


def test_43_3_lanes_are_where_carla_and_esmini_have_them() -> None:
    found, off = 0, []
    for file, points in centres().items():
        if any(part in file for part in ELSEWHERE):
            continue
        network = RoadNetwork.read(WILD / file)
        for point in points:
            found += 1
            road, s = network.index_of(point["road"]), np.array([float(point["s"])])
            x, y, _ = network.world(road, int(point["lane"]), s, np.zeros(1))
            apart = [
                np.hypot(x[0] - float(point[f"{who}_x"]), y[0] - float(point[f"{who}_y"]))
                for who in ("carla", "esmini")
                if point[f"{who}_x"]
            ]
            if min(apart, default=0.0) > NEAR:
                off.append(f"{file}, road {point['road']}, lane {point['lane']}, s = {point['s']}: {min(apart):.3g} m")
    assert found > 7500
    assert off == []
