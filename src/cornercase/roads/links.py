"""Links between roads, junctions and lanes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.recorded_xml import adapt, unrecorded
from cornercase.roads.lane import is_permanent, lane_number
from cornercase.roads.reference_line import read_word
from cornercase.roads.road import Link, Road
from cornercase.roads.road_graph import Connection

_RULE: Final = "a link names a road, a junction or a lane of the file"


def settled(roads: Sequence[Road], elements: Mapping[str, etree._Element], junctions: set[str]) -> tuple[Road, ...]:
    """Return the roads with completed links, and without those that lead to nothing.

    `elements` has the XML elements of all roads by id, including excluded ones; `junctions` their ids.
    """
    by_name = {road.name: road for road in roads}
    resolved = []
    for road in roads:
        ends = {}
        for end, link in (("predecessor", road.predecessor), ("successor", road.successor)):
            ends[end] = None if link is None else _settled(road, end, link, elements, by_name, junctions)
        resolved.append(replace(road, predecessor=ends["predecessor"], successor=ends["successor"]))
    _note_lanes({road.name: road for road in resolved}, elements)
    return tuple(resolved)


def _settled(
    road: Road,
    end: str,
    link: Link,
    elements: Mapping[str, etree._Element],
    by_name: Mapping[str, Road],
    junctions: set[str],
) -> Link | None:
    element, subject = unrecorded(elements[road.name], "link", end)[0], f"<{end}> of <road>"
    if not link.kind:
        link = replace(link, kind="junction" if link.element in junctions - {*by_name} else "road")
        adapt(element, subject, f"has no elementType; it is read as a {link.kind}", f"<{end}> has an elementType")
    if link.element not in (by_name if link.kind == "road" else junctions):
        # Excluded roads are reported already.
        if link.kind == "junction" or link.element not in elements:
            subject = f"link to the {link.kind} '{link.element}'"
            adapt(element, subject, "leads to nothing that exists, so the road ends there", _RULE)
        return None
    if link.kind == "road" and not link.contact and link.s is None:
        link = replace(link, contact=_nearer_end(road, end, by_name[link.element]))
        reason = f"has no contactPoint; the {link.contact} of the road is used, which is nearer"
        adapt(element, subject, reason, "a link to a road has a contactPoint")
    return link


def _nearer_end(road: Road, end: str, other: Road) -> str:
    (x, *_), (y, *_), _ = road.reference(np.array([road.length if end == "successor" else 0.0]))
    to_x, to_y, _ = other.reference(np.array([0.0, other.length]))
    start, stop = np.hypot(to_x - x, to_y - y).tolist()
    return "end" if stop < start else "start"


def _note_lanes(roads: Mapping[str, Road], elements: Mapping[str, etree._Element]) -> None:
    """Record lanes that are linked to lanes that do not exist."""
    for name, road in roads.items():
        lost = set(_lost_links(road, roads))
        if not lost:
            continue
        starts = {start for start, *_ in lost}
        for section in unrecorded(elements[name], "lanes", "laneSection"):
            start = float(section.attrib.get("s") or 0.0)
            for lane in (element for side in ("left", "right") for element in unrecorded(section, side, "lane")):
                for end in ("predecessor", "successor") if start in starts else ():
                    for link in unrecorded(lane, "link", end):
                        if (start, lane.attrib.get("id"), end, link.attrib.get("id")) in lost:
                            adapt(link, f"<{end}> of <lane>", "leads to no lane that exists, so the lane ends", _RULE)


def _lost_links(road: Road, roads: Mapping[str, Road]) -> Iterator[tuple[float, str, str, str]]:
    """Yield links to lanes that do not exist: start of the section, lane, end, linked lane."""
    last_index = len(road.sections) - 1
    for k, (start, lanes) in enumerate(road.sections):
        ahead = road.sections[k + 1][1] if k < last_index else _lanes_beyond(road.successor, roads)
        behind = road.sections[k - 1][1] if k else _lanes_beyond(road.predecessor, roads)
        for number, lane in lanes.items():
            if ahead is not None:
                for linked in lane.successors:
                    if linked not in ahead:
                        yield start, str(number), "successor", str(linked)
            if behind is not None:
                for linked in lane.predecessors:
                    if linked not in behind:
                        yield start, str(number), "predecessor", str(linked)


def _lanes_beyond(link: Link | None, roads: Mapping[str, Road]) -> Mapping[int, object] | None:
    """Return the lanes at the end of a linked road; None if the link does not determine them."""
    if link is None or link.kind != "road" or link.s is not None:
        return None
    return roads[link.element].sections[-1 if link.contact == "end" else 0][1]


def read_connections(
    junction: etree._Element, where: str, roads: Mapping[str, Road], elements: Mapping[str, etree._Element]
) -> tuple[Connection, ...]:
    """Read the connections of a junction, except those of roads that do not exist."""
    connections = []
    for e in junction.iterfind("connection"):
        links = {
            lane_number(k, where, "from"): lane_number(k, where, "to")
            for k in e.iterfind("laneLink")
            if is_permanent(k, "fromLayer", "toLayer")
        }
        incoming, connecting = e.get("incomingRoad", ""), e.get("connectingRoad") or e.get("linkedRoad") or ""
        contact = read_word(e, "contactPoint", ("start", "end"), "", where)
        # Skip connections without an existing road.
        lost = [name for name in (incoming, connecting) if name and name not in roads]
        if lost:
            if lost[0] not in elements:
                subject = f"<connection> with the road '{lost[0]}'"
                adapt(e, subject, "leads over a road that does not exist, and is left out", _RULE)
            continue
        if connecting and not contact:
            successor = roads[connecting].successor
            contact = "end" if successor is not None and successor.element == incoming else "start"
            reason = f"has no contactPoint; the {contact} of its road is used"
            adapt(e, "<connection>", reason, "a <connection> has a contactPoint")
        connections.append((incoming, connecting, contact or "start", links))
    return tuple(connections)
