"""Notices on parts of a road file that have no effect."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.ledger import Label, Notice, local_name
from cornercase._common.places import line_of
from cornercase._common.recorded_xml import children
from cornercase.roads.lane import evaluate_polynomials
from cornercase.roads.ledger import LEDGER
from cornercase.roads.opendrive import RoadNetwork
from cornercase.roads.road import Road

# Slope or bank above which a road is reported.
_HILLY: Final = 0.02
# Missing geometry, or negative lane width, that is reported, in m.
_MISSING: Final = 0.1
# Types of lanes that are reserved for some vehicles.
_RESERVED: Final = ("bus", "taxi", "HOV", "tram", "rail")


def name_without_effect(
    root: etree._Element, file: Path, network: RoadNetwork | None = None, read: bool = True
) -> tuple[Notice, ...]:
    """List what has no effect in a road file.

    `network` is needed to find linked roads that do not meet. Unless `fully_read`, unused elements are not listed.
    """
    elements = list(root.iter())
    reserved = [e for e in elements if local_name(e) == "lane" and e.attrib.get("type") in _RESERVED]
    notices = [
        _notice("elevation of roads", "vehicles drive in the plane, also on roads that climb or bank by more than 2 %",
                file, _hilly_roads(root)),
        _notice("lanes for buses, taxis, trams or full cars", "vehicles of all kinds may drive on every lane", file,
                reserved),
    ]  # fmt: skip
    if network is not None:
        roads = {str(element.attrib.get("id")): element for element in children(root) if local_name(element) == "road"}
        notices += _contradictions(roads, file, network)
        for road, other, distance in network.gaps():
            reason = f"their ends are {distance:.3g} m apart, so they are not connected"
            notices.append(
                _notice(f"link between the roads {road} and {other}", reason, file, [roads[road], roads[other]])
            )
        for road, other, distance in network.crossings():
            lines = tuple(sorted({line_of(roads[road]), line_of(roads[other])}))
            reason = f"their lanes are {distance:.3g} m apart; entities jump across"
            subject = f"link between the roads {road} and {other}"
            notices.append(Notice((subject,), reason, file, lines, Label.ADAPTED, "lanes of linked roads meet"))
    return (*(notice for notice in notices if notice.lines), *LEDGER.notices(root, file, read))


def _contradictions(elements: dict[str, etree._Element], file: Path, network: RoadNetwork) -> list[Notice]:
    """Notices on roads that are longer than their geometry, and on lanes with negative width."""
    short, narrow = [], []
    for road in network.roads:
        first, last = road.geometries[0], road.geometries[-1]
        if max(first.s, road.length - last.s - last.length) > _MISSING:
            short.append(elements[road.name])
        if any(_narrowest(road, k) < -_MISSING for k in range(len(road.sections))):
            narrow.append(elements[road.name])
    return [
        _notice(
            "length of roads that have less geometry",
            "their first and last <geometry> are continued in their shape, a <paramPoly3> straight on",
            file,
            short,
        ),
        _notice("width of lanes below 0", "the lane is 0 m wide there", file, narrow),
    ]


def _narrowest(road: Road, section: int) -> float:
    """Return the smallest width of the lanes of a section by its cubics, in m."""
    s = np.linspace(0.0, max(float(np.diff(road.seams)[section]), 0.0), 20)
    lanes = road.sections[section][1].values()
    return min((float(evaluate_polynomials(lane.widths, s).min()) for lane in lanes), default=0.0)


def _notice(what: str, why: str, file: Path, where: list[etree._Element]) -> Notice:
    return Notice((what,), why, file, tuple(sorted(set(map(line_of, where)))))


def _hilly_roads(root: etree._Element) -> list[etree._Element]:
    hilly = []
    for road in (element for element in children(root) if local_name(element) == "road"):
        length = str(road.attrib.get("length", "0"))
        records = {
            tag: [element for element in road.iter() if local_name(element) == tag]
            for tag in ("elevation", "superelevation")
        }
        climbs = _steepest(records["elevation"], length, slope=True)
        banks = _steepest(records["superelevation"], length, slope=False)
        if max(climbs, banks) > _HILLY:
            hilly.append(road)
    return hilly


def _steepest(records: list[etree._Element], length: str, slope: bool) -> float:
    """Return the largest absolute slope (or value) of piecewise cubics on a road."""
    if not records:
        return 0.0
    try:
        cubics = [[float(record.attrib.get(key, 0.0)) for key in "sabcd"] for record in records]
        ends = [s for s, *_ in cubics[1:]] + [float(length)]
    except ValueError:
        return 0.0  # reported when the road is read
    steepest = 0.0
    for (start, a, b, c, d), end in zip(cubics, ends, strict=True):
        s = np.linspace(0.0, max(end - start, 0.0), 20)
        curve = b + 2.0 * c * s + 3.0 * d * s**2 if slope else a + b * s + c * s**2 + d * s**3
        steepest = max(steepest, float(np.abs(curve).max()))
    return steepest
