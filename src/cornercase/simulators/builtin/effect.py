"""Parts of a scenario file without effect in the builtin simulator."""

from __future__ import annotations

from collections import Counter
from typing import Final

import numpy as np
from lxml import etree

from cornercase.scenario import DRIVER_PROPERTY, Scenario
from cornercase.simulators.builtin.actions.basic import WITHOUT_EFFECT
from cornercase.simulators.builtin.storyboard.triggers import NEVER_TRUE

# A road that climbs or banks by more than this is reported, since the simulator drives in the plane.
_HILLY: Final = 0.02


def without_effect(scenario: Scenario) -> dict[str, int]:
    """Count what of a scenario file changes nothing in the builtin simulator.

    Parameters
    ----------
    scenario : Scenario

    Returns
    -------
    dict of str to int
        Actions, conditions and controllers, by the name of the element; and roads that climb or bank by more than 2 %,
        since it drives in the plane.
    """
    tags = Counter(str(e.tag) for e in scenario.root.iter() if isinstance(e.tag, str))
    found = {tag: tags[tag] for tag in (*WITHOUT_EFFECT, *NEVER_TRUE) if tags[tag]}
    foreign = sum(
        all(item.get("name") != DRIVER_PROPERTY for item in controller.iterfind("Properties/Property"))
        for controller in scenario.root.iterfind(".//Controller")
    )
    if foreign:
        found["Controller of another program"] = foreign
    road = scenario.road_file()
    hilly = _hilly_roads(scenario.xml(road)) if road is not None and road.is_file() else 0
    return {**found, "elevation of roads": hilly} if hilly else found


def _hilly_roads(network: etree._Element) -> int:
    hilly = 0
    for road in network.iterfind("{*}road"):
        length = road.get("length", "0")
        climbs = (
            _steepest(road.findall("{*}elevationProfile/{*}elevation"), length, slope=True),
            _steepest(road.findall("{*}lateralProfile/{*}superelevation"), length, slope=False),
        )
        hilly += max(climbs) > _HILLY
    return hilly


def _steepest(records: list[etree._Element], length: str, slope: bool) -> float:
    """Largest slope (or value) of cubic records that follow each other on a road."""
    if not records:
        return 0.0
    try:
        cubics = [[float(record.get(key, 0.0)) for key in "sabcd"] for record in records]
        ends = [s for s, *_ in cubics[1:]] + [float(length)]
    except ValueError:
        return 0.0  # what is wrong with the road is said where it is read
    most = 0.0
    for (start, a, b, c, d), end in zip(cubics, ends, strict=True):
        s = np.linspace(0.0, max(end - start, 0.0), 20)
        curve = b + 2.0 * c * s + 3.0 * d * s**2 if slope else a + b * s + c * s**2 + d * s**3
        most = max(most, float(np.abs(curve).max()))
    return most
