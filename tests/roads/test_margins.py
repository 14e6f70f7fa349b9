"""Compiled reference lines and edges of roads agree with those of `Road`."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from cornercase.roads._kernels.heading import reference_cos_and_sin, reference_heading, stays_on_road
from cornercase.roads._kernels.width import road_edge_offsets
from cornercase.roads._locator import OFF_ROAD_TOLERANCE, RoadLocator
from cornercase.roads._network import RoadNetwork
from helpers import road_networks as rn

_ROOT = Path(__file__).parents[2]
_FILES = ("examples/x_intersection/x_intersection.xodr", "tests/data/everything/road.xodr")
_BORDERS = (
    '<laneSection s="0"><left><lane id="1" type="driving"><border sOffset="0" a="3" b="0.01" c="0" d="0"/></lane>'
    '<lane id="2" type="driving"><border sOffset="0" a="6" b="0" c="0.001" d="0"/></lane></left>'
    '<center><lane id="0" type="none"/></center></laneSection>'
    '<laneSection s="12"><center><lane id="0" type="none"/></center><right><lane id="-1" type="driving">'
    '<width sOffset="0" a="3" b="0.2" c="0" d="0"/><width sOffset="5" a="4" b="-0.5" c="0" d="0"/></lane></right></laneSection>'
)


def _networks(folder: Path) -> list[RoadNetwork]:
    shapes = ("<line/>", '<arc curvature="-0.02"/>', '<spiral curvStart="0.01" curvEnd="0.01"/>')
    made = [rn.road(str(k), 30.0, at=(40.0 * k, 5.0, 0.7), shape=one) for k, one in enumerate(shapes)]
    made.append(rn.road("borders", 30.0, at=(0.0, 50.0, 2.0), sections=_BORDERS))
    return [rn.network(folder, *made), *(RoadNetwork.read(_ROOT / file) for file in _FILES)]


def test_edges_are_the_same_compiled(tmp_path: Path) -> None:
    for network in _networks(tmp_path):
        for k, road in enumerate(network.roads):
            s = np.concatenate([np.linspace(-1.0, road.length + 1.0, 17), road.section_bounds])
            for at, right, left in zip(s, *road.road_edge_offsets(s), strict=True):
                assert road_edge_offsets(network.road_tables.edges, k, at) == pytest.approx(
                    (right, left), rel=1e-14, abs=1e-14
                )


def test_who_stays_on_its_road_is_the_same_compiled(tmp_path: Path) -> None:
    random, stayed = np.random.default_rng(0), 0
    for network in _networks(tmp_path):
        tables, locator = network.road_tables, RoadLocator(network.roads)
        for k, road in enumerate(network.roads):
            if not tables.position_known[k]:
                assert any(piece.kind not in ("line", "arc") for piece in road.geometries)
                continue
            s, t = random.uniform(-3.0, road.length + 3.0, 40), random.uniform(-15.0, 15.0, 40)
            x, y, _ = road.pose_at(np.clip(s, 0.0, road.length), t)
            guess = s + random.normal(0.0, 3.0, 40)
            found = guess.copy()
            inside = locator._is_on_road(np.full(40, k), x, y, found, 1, OFF_ROAD_TOLERANCE)
            for i in range(40):
                stays, at = stays_on_road(tables, k, guess[i], x[i], y[i])
                assert stays == inside[i]
                assert not stays or at == pytest.approx(found[i], rel=1e-13, abs=1e-12)
            stayed += int(inside.sum())
    assert stayed > 100


def test_a_place_between_the_inner_edges_is_on_the_road_wherever_along_it(tmp_path: Path) -> None:
    known = 0
    for network in _networks(tmp_path):
        edges = network.road_tables.edges
        for k, road in enumerate(network.roads):
            right, left = road.road_edge_offsets(np.linspace(0.0, road.length, 200))
            assert edges.always_inside[k, 0] >= right.max()
            assert edges.always_inside[k, 1] <= left.min()
            if np.isfinite(edges.always_inside[k, 0]):
                known += 1
                assert edges.always_inside[k] == pytest.approx((right.max(), left.min()), abs=1e-6)
    assert known > 3


def test_directions_are_those_of_headings(tmp_path: Path) -> None:
    for network in _networks(tmp_path):
        for k, road in enumerate(network.roads):
            if network.road_tables.heading_known[k]:
                for s in np.linspace(0.0, road.length, 7):
                    heading = reference_heading(network.road_tables, k, s)
                    assert reference_cos_and_sin(network.road_tables, k, s) == (math.cos(heading), math.sin(heading))
