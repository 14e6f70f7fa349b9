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
        pytest.param(file, marks=() if k % 40 == 7 and "_towns" not in file else pytest.mark.slow)
        for k, file in enumerate(files)
    ]


@pytest.mark.parametrize("file", by_file())
def test_43_1_every_lane_can_be_driven_with_the_speed_that_is_asked_for(file: str) -> None:
    try:
        network = RoadNetwork.read(WILD / file)
    except InputError:
        return
    wrong = [str(lane) for lane in drive_lanes(network) if lane.crash or lane.error > 1e-3]
    assert wrong == []


def test_43_3_lanes_are_where_carla_and_esmini_have_them() -> None:
    near = found = 0
    for file, points in centres().items():
        if "_towns" in file:
            continue
        try:
            network = RoadNetwork.read(WILD / file)
        except InputError:
            continue
        for point in points:
            found += 1
            x, y, _ = network.world(
                network.index_of(point["road"]), int(point["lane"]), np.array([float(point["s"])]), np.zeros(1)
            )
            apart = [
                np.hypot(x[0] - float(point[f"{who}_x"]), y[0] - float(point[f"{who}_y"]))
                for who in ("carla", "esmini") if point[f"{who}_x"]
            ]  # fmt: skip
            near += min(apart, default=0.0) <= NEAR
    assert found > 5000
    assert near / found >= 0.995
