"""Links of a road file to roads, junctions and lanes that are there."""

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
    """Roads whose links lead to what is there, where an end of a road is linked to nothing else.

    Parameters
    ----------
    roads : sequence of Road
    elements : mapping of str to lxml element
        Those of the roads, also of roads that were left out, by their id.
    junctions : set of str
        Ids of the junctions.

    Returns
    -------
    tuple of Road
    """
    by_name = {road.name: road for road in roads}
    found = []
    for road in roads:
        ends = {}
        for end, link in (("predecessor", road.predecessor), ("successor", road.successor)):
            ends[end] = None if link is None else _settled(road, end, link, elements, by_name, junctions)
        found.append(replace(road, predecessor=ends["predecessor"], successor=ends["successor"]))
    _note_lanes({road.name: road for road in found}, elements)
    return tuple(found)


def _settled(
    road: Road,
    end: str,
    link: Link,
    elements: Mapping[str, etree._Element],
    by_name: Mapping[str, Road],
    junctions: set[str],
) -> Link | None:
    element, what = unrecorded(elements[road.name], "link", end)[0], f"<{end}> of <road>"
    if not link.kind:
        link = replace(link, kind="junction" if link.element in junctions - {*by_name} else "road")
        adapt(element, what, f"has no elementType, and is read as that of a {link.kind}", f"<{end}> has an elementType")
    if link.element not in (by_name if link.kind == "road" else junctions):
        # Of a road that was left out is said why.
        if link.kind == "junction" or link.element not in elements:
            what = f"link to the {link.kind} '{link.element}'"
            adapt(element, what, "leads to nothing that is there, so that the road ends there", _RULE)
        return None
    if link.kind == "road" and not link.contact and link.s is None:
        link = replace(link, contact=_nearer_end(road, end, by_name[link.element]))
        why = f"has no contactPoint, and is read as that to the {link.contact} of the road, which is nearer"
        adapt(element, what, why, "a link to a road has a contactPoint")
    return link


def _nearer_end(road: Road, end: str, other: Road) -> str:
    (x, *_), (y, *_), _ = road.reference(np.array([road.length if end == "successor" else 0.0]))
    to_x, to_y, _ = other.reference(np.array([0.0, other.length]))
    start, stop = np.hypot(to_x - x, to_y - y).tolist()
    return "end" if stop < start else "start"


def _note_lanes(roads: Mapping[str, Road], elements: Mapping[str, etree._Element]) -> None:
    """Note lanes that are linked to lanes that are not there."""
    for name, road in roads.items():
        lost = set(_lost_links(road, roads))
        if not lost:
            continue
        starts = {start for start, *_ in lost}
        for section in unrecorded(elements[name], "lanes", "laneSection"):
            start = float(section.attrib.get("s") or 0.0)
            for lane in (one for side in ("left", "right") for one in unrecorded(section, side, "lane")):
                for end in ("predecessor", "successor") if start in starts else ():
                    for link in unrecorded(lane, "link", end):
                        if (start, lane.attrib.get("id"), end, link.attrib.get("id")) in lost:
                            adapt(
                                link,
                                f"<{end}> of <lane>",
                                "leads to no lane that is there, so that the lane ends",
                                _RULE,
                            )


def _lost_links(road: Road, roads: Mapping[str, Road]) -> Iterator[tuple[float, str, str, str]]:
    """Links of lanes to lanes that are not there: start of the section, lane, end, and lane that is linked."""
    last = len(road.sections) - 1
    for k, (start, lanes) in enumerate(road.sections):
        ahead = road.sections[k + 1][1] if k < last else _lanes_beyond(road.successor, roads)
        behind = road.sections[k - 1][1] if k else _lanes_beyond(road.predecessor, roads)
        for number, lane in lanes.items():
            if ahead is not None:
                for other in lane.successors:
                    if other not in ahead:
                        yield start, str(number), "successor", str(other)
            if behind is not None:
                for other in lane.predecessors:
                    if other not in behind:
                        yield start, str(number), "predecessor", str(other)


def _lanes_beyond(link: Link | None, roads: Mapping[str, Road]) -> Mapping[int, object] | None:
    """Lanes at the end of a linked road; None where a link says nothing of lanes."""
    if link is None or link.kind != "road" or link.s is not None:
        return None
    return roads[link.element].sections[-1 if link.contact == "end" else 0][1]


def read_connections(
    junction: etree._Element, where: str, roads: Mapping[str, Road], elements: Mapping[str, etree._Element]
) -> tuple[Connection, ...]:
    """Read the connections of a junction, without those of roads that are not there.

    Parameters
    ----------
    junction : lxml element
    where : str
        File and junction, for messages.
    roads : mapping of str to Road
    elements : mapping of str to lxml element
        Those of the roads, also of roads that were left out, by their id.

    Raises
    ------
    InputError
        A number of a lane is none.
    """
    found = []
    for e in junction.iterfind("connection"):
        links = {
            lane_number(k, where, "from"): lane_number(k, where, "to")
            for k in e.iterfind("laneLink")
            if is_permanent(k, "fromLayer", "toLayer")
        }
        incoming, connecting = e.get("incomingRoad", ""), e.get("connectingRoad") or e.get("linkedRoad") or ""
        contact = read_word(e, "contactPoint", ("start", "end"), "", where)
        # Connections without a road between are none that one drives on.
        lost = [name for name in (incoming, connecting) if name and name not in roads]
        if lost:
            if lost[0] not in elements:
                what = f"<connection> with the road '{lost[0]}'"
                adapt(e, what, "leads over a road that is not there, and is left out", _RULE)
            continue
        if connecting and not contact:
            own = roads[connecting].successor
            contact = "end" if own is not None and own.element == incoming else "start"
            why = f"has no contactPoint, and is read as that to the {contact} of its road"
            adapt(e, "<connection>", why, "a <connection> has a contactPoint")
        found.append((incoming, connecting, contact or "start", links))
    return tuple(found)
