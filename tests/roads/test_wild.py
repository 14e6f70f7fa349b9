"""Roads of other projects: lane positions agree with CARLA and esmini, and each lane can be driven."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from conftest import at_night
from cornercase._common.errors import InputError
from cornercase.roads._network import RoadNetwork
from helpers.lane_centres import OTHER_VERSION, compare_centres, read_centres
from helpers.lane_driving import drive_lanes

WILD = Path(__file__).parents[3] / "shared" / "reference" / "wild"
CENTRES = WILD / "lane_centres.csv.gz"
pytestmark = pytest.mark.skipif(not CENTRES.is_file(), reason="the folder of others' roads is not there")


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
    # A lane starts at a right angle to its road.
    "new_lane_appear_junction_valid_1": 2.2,
}


@pytest.mark.parametrize("file", by_file())
def test_43_every_lane_can_be_driven_at_the_speed_asked_for(file: str) -> None:
    try:
        network = RoadNetwork.read(WILD / file)
    except InputError:
        return
    exact = max((error for part, error in INEXACT.items() if part in file), default=1e-3)
    wrong = [str(lane) for lane in drive_lanes(network) if lane.crash or lane.error > exact]
    assert wrong == []


@pytest.mark.parametrize("each", at_night([4, 1], {1}))
def test_43_3_lanes_are_where_carla_and_esmini_have_them(each: int) -> None:
    good, explained, off = 0, Counter[str](), []
    for file, points in [*read_centres(CENTRES).items()][1 % each :: each]:
        centres = compare_centres(RoadNetwork.read(WILD / file), points)
        good += centres.good
        explained.update(centres.explained)
        off += [f"{file}, {one}" for one in centres.off]
    del explained[OTHER_VERSION]
    assert off == []
    assert good > 8000 / each
    assert explained.total() < 0.02 * good
