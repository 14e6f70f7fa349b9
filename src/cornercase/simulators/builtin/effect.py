"""Parts of a scenario without effect in the builtin simulator."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.ledger import Notice, local_name, merged
from cornercase.scenario import Scenario, Value, VariesError
from cornercase.simulators.builtin.batch import Batch
from cornercase.simulators.builtin.openscenario import LEDGER
from cornercase.simulators.builtin.prepared import PreparedScenario

# A road that climbs or banks by more than this is reported, since the simulator drives in the plane.
_HILLY: Final = 0.02


def notices(scenario: Scenario, values: Mapping[str, Value] | None = None) -> tuple[Notice, ...]:
    """Read a scenario as for a run, and name what of its files changes nothing.

    Parameters
    ----------
    scenario : Scenario
    values : mapping of str to float or str, optional
        Of its parameters, on which may depend what is read.

    Returns
    -------
    tuple of Notice
        Where the scenario cannot be run, without what nobody read.
    """
    try:
        Batch(PreparedScenario.of(scenario), [dict(values or {})], 0.05, 1.0, False, {})
    except (InputError, VariesError):
        return notices_after_reading(scenario, read=False)
    return notices_after_reading(scenario)


def notices_after_reading(scenario: Scenario, read: bool = True) -> tuple[Notice, ...]:
    """Name what of the files of a scenario changed nothing, once it was read.

    Parameters
    ----------
    scenario : Scenario
    read : bool, default True
        Whether it was read to its end.

    Returns
    -------
    tuple of Notice
    """
    found: list[Notice] = []
    scenario.catalog_files()  # They are looked for only where the scenario refers to one of them.
    for file, element in scenario.read_parts():
        if local_name(element) == "OpenDRIVE":
            found += _of_road(element, file)
        else:
            found += LEDGER.notices(element, file, read)
    return merged(found)


def _of_road(network: etree._Element, file: Path) -> list[Notice]:
    lines = _hilly_roads(network)
    why = "vehicles drive in the plane, also on roads that climb or bank by more than 2 %"
    return [Notice(("elevation of roads",), why, file, lines)] if lines else []


def _hilly_roads(network: etree._Element) -> tuple[int, ...]:
    """Lines of the roads that climb or bank."""
    hilly = []
    for road in network.iterfind("{*}road"):
        length = road.get("length", "0")
        climbs = (
            _steepest(road.findall("{*}elevationProfile/{*}elevation"), length, slope=True),
            _steepest(road.findall("{*}lateralProfile/{*}superelevation"), length, slope=False),
        )
        if max(climbs) > _HILLY:
            hilly.append(int(str(road.sourceline)))
    return tuple(hilly)


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
