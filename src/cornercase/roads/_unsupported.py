"""Notices about the parts of a road file that have no effect."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.io.support_table import Notice, NoticeLabel, tag_without_namespace
from cornercase._common.io.tracked_xml import iter_children_untracked
from cornercase._common.text.element_locations import line_number
from cornercase.roads._lane import evaluate_polynomials
from cornercase.roads._network import RoadNetwork
from cornercase.roads._road import Road
from cornercase.roads._support_table import SUPPORT_TABLE

# Slope or bank above which a road is reported.
_MIN_REPORTED_SLOPE: Final = 0.02
# Missing geometry, or negative lane width, that is reported, in m.
_MIN_REPORTED_LENGTH: Final = 0.1
# Types of lanes that are reserved for some vehicles.
_RESERVED_LANE_TYPES: Final = ("bus", "taxi", "HOV", "tram", "rail")


def list_unsupported(
    root: etree._Element, file: Path, network: RoadNetwork | None = None, fully_read: bool = True
) -> tuple[Notice, ...]:
    """List the parts of a road file that have no effect.

    If `network` is given, also report linked roads that do not meet, roads that are longer than their geometries, and
    lanes of negative width. Elements that nothing has read are listed only if the file was `fully_read`.
    """
    elements = list(root.iter())
    reserved = [
        e for e in elements if tag_without_namespace(e) == "lane" and e.attrib.get("type") in _RESERVED_LANE_TYPES
    ]
    notices = [
        _make_notice("elevation of roads", "vehicles drive in the plane, also on roads that climb"
            " or bank by more than 2 %",
                file, _roads_with_slope(root)),
        _make_notice("lanes for buses, taxis, trams or full cars", "vehicles of all kinds may drive"
            " on every lane", file,
                reserved),
    ]  # fmt: skip
    if network is not None:
        roads = {
            str(element.attrib.get("id")): element
            for element in iter_children_untracked(root)
            if tag_without_namespace(element) == "road"
        }
        notices += _geometry_notices(roads, file, network)
        for road, other, distance in network.unconnected_links():
            reason = f"their ends are {distance:.3g} m apart, so they are not connected"
            notices.append(
                _make_notice(f"link between the roads {road} and {other}", reason, file, [roads[road], roads[other]])
            )
        for road, other, distance in network.links_with_small_gap():
            lines = tuple(sorted({line_number(roads[road]), line_number(roads[other])}))
            reason = f"their lanes are {distance:.3g} m apart; entities jump across"
            subject = f"link between the roads {road} and {other}"
            notices.append(Notice((subject,), reason, file, lines, NoticeLabel.ADAPTED, "lanes of linked roads meet"))
    return (
        *(notice for notice in notices if notice.lines),
        *SUPPORT_TABLE.list_unsupported_notices(root, file, fully_read),
    )


def _geometry_notices(elements: dict[str, etree._Element], file: Path, network: RoadNetwork) -> list[Notice]:
    """Return notices about roads that are longer than their geometries, and about lanes with negative width."""
    short, narrow = [], []
    for road in network.roads:
        first, last = road.geometries[0], road.geometries[-1]
        if max(first.s, road.length - last.s - last.length) > _MIN_REPORTED_LENGTH:
            short.append(elements[road.road_id])
        if any(_min_lane_width(road, k) < -_MIN_REPORTED_LENGTH for k in range(len(road.sections))):
            narrow.append(elements[road.road_id])
    return [
        _make_notice(
            "length of roads that have less geometry",
            "their first and last <geometry> are continued in their shape, a <paramPoly3> straight on",
            file,
            short,
        ),
        _make_notice("width of lanes below 0", "the lane is 0 m wide there", file, narrow),
    ]


def _min_lane_width(road: Road, section: int) -> float:
    """Return the smallest width in m of all lanes of a section, at 20 samples along the section."""
    s = np.linspace(0.0, max(float(np.diff(road.section_bounds)[section]), 0.0), 20)
    lanes = road.sections[section][1].values()
    return min((float(evaluate_polynomials(lane.widths, s).min()) for lane in lanes), default=0.0)


def _make_notice(subject: str, reason: str, file: Path, elements: list[etree._Element]) -> Notice:
    return Notice((subject,), reason, file, tuple(sorted(set(map(line_number, elements)))))


def _roads_with_slope(root: etree._Element) -> list[etree._Element]:
    hilly = []
    for road in (element for element in iter_children_untracked(root) if tag_without_namespace(element) == "road"):
        length = str(road.attrib.get("length", "0"))
        records = {
            tag: [element for element in road.iter() if tag_without_namespace(element) == tag]
            for tag in ("elevation", "superelevation")
        }
        climbs = _max_slope_or_value(records["elevation"], length, slope=True)
        banks = _max_slope_or_value(records["superelevation"], length, slope=False)
        if max(climbs, banks) > _MIN_REPORTED_SLOPE:
            hilly.append(road)
    return hilly


def _max_slope_or_value(records: list[etree._Element], length: str, slope: bool) -> float:
    """Return the largest absolute slope of a road's piecewise cubics; without `slope`, their largest absolute value."""
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
