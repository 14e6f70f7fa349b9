"""Links between roads, junctions and lanes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.io.tracked_xml import find_untracked, note_adaptation
from cornercase.roads._lane import is_in_permanent_layer, read_lane_number
from cornercase.roads._reference_line import read_enumeration
from cornercase.roads._road import Road, RoadLink
from cornercase.roads._road_graph import JunctionConnection

_LINK_RULE: Final = "a link names a road, a junction or a lane of the file"


def resolve_links(
    roads: Sequence[Road], elements: Mapping[str, etree._Element], junctions: set[str]
) -> tuple[Road, ...]:
    """Return the roads with complete links; links that lead to nothing are removed.

    `elements` has the XML elements of all roads by id, including excluded roads. `junctions` has the ids of the
    junctions.
    """
    by_name = {road.road_id: road for road in roads}
    resolved = []
    for road in roads:
        ends = {}
        for end, link in (("predecessor", road.predecessor), ("successor", road.successor)):
            ends[end] = None if link is None else _resolve_link(road, end, link, elements, by_name, junctions)
        resolved.append(replace(road, predecessor=ends["predecessor"], successor=ends["successor"]))
    _record_missing_lanes({road.road_id: road for road in resolved}, elements)
    return tuple(resolved)


def _resolve_link(
    road: Road,
    end: str,
    link: RoadLink,
    elements: Mapping[str, etree._Element],
    by_name: Mapping[str, Road],
    junctions: set[str],
) -> RoadLink | None:
    element, subject = find_untracked(elements[road.road_id], "link", end)[0], f"<{end}> of <road>"
    if not link.target_type:
        link = replace(link, target_type="junction" if link.target_id in junctions - {*by_name} else "road")
        note_adaptation(
            element, subject, f"has no elementType; it is read as a {link.target_type}", f"<{end}> has an elementType"
        )
    if link.target_id not in (by_name if link.target_type == "road" else junctions):
        # Excluded roads are reported already.
        if link.target_type == "junction" or link.target_id not in elements:
            subject = f"link to the {link.target_type} '{link.target_id}'"
            note_adaptation(element, subject, "leads to nothing that exists, so the road ends there", _LINK_RULE)
        return None
    if link.target_type == "road" and not link.contact_point and link.s is None:
        link = replace(link, contact_point=_nearer_end(road, end, by_name[link.target_id]))
        reason = f"has no contactPoint; the {link.contact_point} of the road is used, which is nearer"
        note_adaptation(element, subject, reason, "a link to a road has a contactPoint")
    return link


def _nearer_end(road: Road, end: str, other: Road) -> str:
    (x, *_), (y, *_), _ = road.reference_pose(np.array([road.length if end == "successor" else 0.0]))
    to_x, to_y, _ = other.reference_pose(np.array([0.0, other.length]))
    start, stop = np.hypot(to_x - x, to_y - y).tolist()
    return "end" if stop < start else "start"


def _record_missing_lanes(roads: Mapping[str, Road], elements: Mapping[str, etree._Element]) -> None:
    """Note violations of the standard: lanes that are linked to lanes that do not exist."""
    for name, road in roads.items():
        lost = set(_links_to_missing_lanes(road, roads))
        if not lost:
            continue
        starts = {start for start, *_ in lost}
        for section in find_untracked(elements[name], "lanes", "laneSection"):
            start = float(section.attrib.get("s") or 0.0)
            for lane in (element for side in ("left", "right") for element in find_untracked(section, side, "lane")):
                for end in ("predecessor", "successor") if start in starts else ():
                    for link in find_untracked(lane, "link", end):
                        if (start, lane.attrib.get("id"), end, link.attrib.get("id")) in lost:
                            note_adaptation(
                                link, f"<{end}> of <lane>", "leads to no lane that exists, so the lane ends", _LINK_RULE
                            )


def _links_to_missing_lanes(road: Road, roads: Mapping[str, Road]) -> Iterator[tuple[float, str, str, str]]:
    """Yield each link to a lane that does not exist: start of the lane section, lane, kind of link, and missing lane.

    The kind of link is ``"predecessor"`` or ``"successor"``.
    """
    last_index = len(road.sections) - 1
    for k, (start, lanes) in enumerate(road.sections):
        ahead = road.sections[k + 1][1] if k < last_index else _lanes_of_linked_end(road.successor, roads)
        behind = road.sections[k - 1][1] if k else _lanes_of_linked_end(road.predecessor, roads)
        for number, lane in lanes.items():
            if ahead is not None:
                for linked in lane.successors:
                    if linked not in ahead:
                        yield start, str(number), "successor", str(linked)
            if behind is not None:
                for linked in lane.predecessors:
                    if linked not in behind:
                        yield start, str(number), "predecessor", str(linked)


def _lanes_of_linked_end(link: RoadLink | None, roads: Mapping[str, Road]) -> Mapping[int, object] | None:
    """Return the lanes at the road end that a link leads to; None if there is no link, or it leads to no road end.

    A link may also lead to a junction, or to a position along a road.
    """
    if link is None or link.target_type != "road" or link.s is not None:
        return None
    return roads[link.target_id].sections[-1 if link.contact_point == "end" else 0][1]


def read_junction_connections(
    junction: etree._Element, location: str, roads: Mapping[str, Road], elements: Mapping[str, etree._Element]
) -> tuple[JunctionConnection, ...]:
    """Read the connections of a junction; connections with roads that do not exist, or cannot be used, are left out."""
    connections = []
    for e in junction.iterfind("connection"):
        links = {
            read_lane_number(k, location, "from"): read_lane_number(k, location, "to")
            for k in e.iterfind("laneLink")
            if is_in_permanent_layer(k, "fromLayer", "toLayer")
        }
        incoming, connecting = e.get("incomingRoad", ""), e.get("connectingRoad") or e.get("linkedRoad") or ""
        contact = read_enumeration(e, "contactPoint", ("start", "end"), "", location)
        # Skip connections without an existing road.
        lost = [name for name in (incoming, connecting) if name and name not in roads]
        if lost:
            if lost[0] not in elements:
                subject = f"<connection> with the road '{lost[0]}'"
                note_adaptation(e, subject, "leads over a road that does not exist, and is left out", _LINK_RULE)
            continue
        if connecting and not contact:
            successor = roads[connecting].successor
            contact = "end" if successor is not None and successor.target_id == incoming else "start"
            reason = f"has no contactPoint; the {contact} of its road is used"
            note_adaptation(e, "<connection>", reason, "a <connection> has a contactPoint")
        connections.append((incoming, connecting, contact or "start", links))
    return tuple(connections)
