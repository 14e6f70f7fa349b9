"""What of a road file has no effect."""

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

# A road that climbs or banks by more than this is named.
_HILLY: Final = 0.02
# m; a road that lacks more of its geometry than this is named, or a lane that is so much narrower than nothing.
_MISSING: Final = 0.1
# Lanes of these types are for some kinds of vehicles.
_RESERVED: Final = ("bus", "taxi", "HOV", "tram", "rail")


def name_without_effect(
    root: etree._Element, file: Path, network: RoadNetwork | None = None, read: bool = True
) -> tuple[Notice, ...]:
    """Name what of a road file changes nothing.

    Parameters
    ----------
    root : lxml element
    file : Path
        Where it comes from.
    network : RoadNetwork, optional
        What was made of it; without it, it is not said which linked roads lie apart.
    read : bool, default True
        Whether it was read to its end; otherwise it is not said what nobody read.

    Returns
    -------
    tuple of Notice
    """
    found = [
        _notice("elevation of roads", "vehicles drive in the plane, also on roads that climb or bank by more than 2 %",
                file, _hilly_roads(root)),
        _notice("lanes for buses, taxis, trams or full cars", "vehicles of all kinds may drive on every lane", file,
                [one for one in root.iter() if local_name(one) == "lane" and one.attrib.get("type") in _RESERVED]),
    ]  # fmt: skip
    if network is not None:
        roads = {str(one.attrib.get("id")): one for one in children(root) if local_name(one) == "road"}
        found += _contradictions(roads, file, network)
        for one, other, apart in network.gaps():
            why = f"they lie {apart:.3g} m apart, so that no way leads from one to the other"
            found.append(_notice(f"link between the roads {one} and {other}", why, file, [roads[one], roads[other]]))
        for one, other, apart in network.crossings():
            what, lines = (
                f"link between the roads {one} and {other}",
                [line_of(roads[k]) for k in (one, other)],
            )
            why = f"their lanes lie {apart:.3g} m apart; entities get across at once"
            rule = "lanes of linked roads meet"
            found.append(Notice((what,), why, file, tuple(sorted({*lines})), Label.ADAPTED, rule))
    return (*(notice for notice in found if notice.lines), *LEDGER.notices(root, file, read))


def _contradictions(elements: dict[str, etree._Element], file: Path, network: RoadNetwork) -> list[Notice]:
    """Name roads, whose elements are given by id, that are longer than their geometry, and lanes without a width."""
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
            "their first and last <geometry> go on in their shape, a <paramPoly3> straight on",
            file,
            short,
        ),
        _notice("width of lanes below 0", "a lane is as wide as nothing there", file, narrow),
    ]


def _narrowest(road: Road, section: int) -> float:
    """Smallest width of the lanes of a section by its cubics, in m."""
    s = np.linspace(0.0, max(float(np.diff(road.seams)[section]), 0.0), 20)
    lanes = road.sections[section][1].values()
    return min((float(evaluate_polynomials(lane.widths, s).min()) for lane in lanes), default=0.0)


def _notice(what: str, why: str, file: Path, where: list[etree._Element]) -> Notice:
    return Notice((what,), why, file, tuple(sorted(set(map(line_of, where)))))


def _hilly_roads(root: etree._Element) -> list[etree._Element]:
    hilly = []
    for road in (one for one in children(root) if local_name(one) == "road"):
        length = str(road.attrib.get("length", "0"))
        records = {
            tag: [one for one in road.iter() if local_name(one) == tag] for tag in ("elevation", "superelevation")
        }
        climbs = _steepest(records["elevation"], length, slope=True)
        banks = _steepest(records["superelevation"], length, slope=False)
        if max(climbs, banks) > _HILLY:
            hilly.append(road)
    return hilly


def _steepest(records: list[etree._Element], length: str, slope: bool) -> float:
    """Largest slope (or value) of cubic records that follow each other on a road."""
    if not records:
        return 0.0
    try:
        cubics = [[float(record.attrib.get(key, 0.0)) for key in "sabcd"] for record in records]
        ends = [s for s, *_ in cubics[1:]] + [float(length)]
    except ValueError:
        return 0.0  # what is wrong with the road is said where it is read
    most = 0.0
    for (start, a, b, c, d), end in zip(cubics, ends, strict=True):
        s = np.linspace(0.0, max(end - start, 0.0), 20)
        curve = b + 2.0 * c * s + 3.0 * d * s**2 if slope else a + b * s + c * s**2 + d * s**3
        most = max(most, float(np.abs(curve).max()))
    return most
