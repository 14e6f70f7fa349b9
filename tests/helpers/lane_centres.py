"""Where lanes are by CARLA's map and esmini's road manager, and why some are elsewhere here."""

from __future__ import annotations

import csv
import gzip
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cornercase.roads._lane import differentiate_polynomials, evaluate_polynomials, read_polynomials
from cornercase.roads._network import RoadNetwork
from cornercase.roads._road import Road
from cornercase.scenario._xml import read_xml

NEAR = 0.01
"""m; a lane centre that is no further away is the same, as far as CARLA and esmini agree themselves."""
OTHER_VERSION = "of files of which the centres are those of another version, with roads that they lack"


@dataclass(frozen=True)
class Centres:
    """Lane centres of a road file, compared.

    Attributes
    ----------
    good : int
        How many are the same.
    explained : dict
        How many are elsewhere, by the reason.
    off : tuple of str
        The others.
    """

    good: int
    explained: dict[str, int]
    off: tuple[str, ...]


def read_centres(file: Path) -> dict[str, list[dict[str, str]]]:
    """Lane centres of a table, by road file."""
    found: dict[str, list[dict[str, str]]] = {}
    with gzip.open(file, "rt", encoding="utf-8", newline="") as table:
        for row in csv.DictReader(table):
            found.setdefault(row["file"], []).append(row)
    return found


def compare_centres(network: RoadNetwork, points: Sequence[dict[str, str]]) -> Centres:
    """Compare lane centres of a road file with those of CARLA and of esmini."""
    roads = {road.road_id: road for road in network.roads}
    if any(point["road"] not in roads for point in points):
        return Centres(0, {OTHER_VERSION: len(points)}, ())
    good, explained, off = 0, Counter[str](), []
    for point in points:
        road = roads[point["road"]]
        apart = _apart(point, road)
        if apart <= NEAR:
            good += 1
        elif reason := _known(point, road, network.path):
            explained[reason] += 1
        else:
            off.append(f"road {road.road_id}, lane {point['lane']}, s = {point['s']}: {apart:.3g} m")
    return Centres(good, dict(explained), tuple(off))


def _apart(point: dict[str, str], road: Road, lean: float = 0.0, climb: float = 0.0) -> float:
    """How far a lane centre is from that of CARLA or of esmini, the nearer one, in m; the road leans by so many rad."""
    s, lane = np.array([float(point["s"])]), int(point["lane"])
    t = road.lane_center(int(road.section_at(s)[0]), lane, s)
    x, y, heading = road.pose_at(s, np.cos(lean) * t)
    # On a road that climbs, what it leans by leans backwards.
    back = np.sin(lean) * np.sin(climb) * t
    x, y = x - back * np.cos(heading), y - back * np.sin(heading)
    apart = [
        float(np.hypot(x[0] - float(point[f"{who}_x"]), y[0] - float(point[f"{who}_y"])))
        for who in ("carla", "esmini")
        if point[f"{who}_x"]
    ]
    return min(apart, default=0.0)


def _known(point: dict[str, str], road: Road, file: Path) -> str:
    """Why a lane centre is elsewhere by CARLA and esmini; empty where it is not known."""
    s = float(point["s"])
    sections = tuple(
        (start, {number: replace(lane, borders=()) for number, lane in lanes.items()}) for start, lanes in road.sections
    )
    if _apart(point, replace(road, sections=sections)) <= NEAR:
        return "by a <border>, which CARLA and esmini do not read"
    element = next(one for one in read_xml(file).iter("road") if one.get("id") == road.road_id)
    begins = [float(one.get("s", 0.0)) for one in element.iterfind("lanes/laneOffset")]
    if begins and s < min(begins):
        return "before the first <laneOffset>, which esmini evaluates from the begin of the road"
    banks = read_polynomials(element.iterfind("lateralProfile/superelevation"), "s", "")
    climbs = differentiate_polynomials(read_polynomials(element.iterfind("elevationProfile/elevation"), "s", ""))
    lean, slope = (float(evaluate_polynomials(of, np.array([s]))[0]) for of in (banks, climbs))
    if lean and _apart(point, road, lean, np.arctan(slope)) <= NEAR:
        return "on a road that leans, as in esmini but not here"
    if s > road.geometries[-1].s + road.geometries[-1].length:
        return "beyond the end of the geometry of its road, where CARLA and esmini differ too"
    return ""
