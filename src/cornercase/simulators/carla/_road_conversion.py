"""Conversion of road files for CARLA: ground beside the roads, and a form that ScenarioRunner recognizes."""

from __future__ import annotations

from typing import Final

import numpy as np
from lxml import etree

from cornercase.recordings import Recording
from cornercase.roads._network import RoadNetwork

# Width in m of the ground on both sides of roads: with added lanes, and without them.
VERGE_WIDTH: Final = 10.0
NARROW_WIDTH: Final = 0.6
_MARK: Final = '<roadMark sOffset="0" type="none" weight="standard" color="standard" width="0" laneChange="none"/>'
_LANE_CONTENT: Final = f'<width sOffset="0" a="{VERGE_WIDTH:g}" b="0" c="0" d="0"/>{_MARK}'


def road_text_for_carla(root: etree._Element) -> str:
    """Return the text of a road file for CARLA, with road marks on all lanes, and ground beside roads if all are flat.

    The text begins with ``<OpenDRIVE>`` without attributes, since ScenarioRunner 0.9.13 searches for exactly this tag.
    ScenarioRunner compares the text from there on with the text of the loaded map, and loads the map again if they
    differ. CARLA makes ground from all lanes, so lanes are added as ground. The added lanes have the type ``none``, so
    they do not change CARLA's waypoints and routes.
    """
    root = etree.fromstring(etree.tostring(root))
    for element in root.iter("*"):
        element.tag = etree.QName(element).localname
    root.attrib.clear()
    for lane in root.iterfind("road/lanes/laneSection/*/lane"):
        _add_missing_mark(lane)
    if is_flat(root):
        for section in root.iterfind("road/lanes/laneSection"):
            _add_verges(section)
    etree.cleanup_namespaces(root)
    text = etree.tostring(root).decode("ascii")
    return f"<OpenDRIVE>{text[text.index('>') + 1 :].rstrip()}\n"


def is_flat(root: etree._Element) -> bool:
    """Return whether all roads are level and at the same height.

    Otherwise, ground beside one road could form a step on another road.
    """
    heights = set()
    for road in root.iterfind("{*}road"):
        entries = road.findall("{*}elevationProfile/{*}elevation")
        heights |= {round(float(entry.get("a", "0")), 2) for entry in entries} or {0.0}
        sloping = [*entries, *road.iterfind("{*}lateralProfile/{*}superelevation")]
        slopes = [float(entry.get(key, "0")) for entry in sloping for key in "bcd"]
        leaning = [float(entry.get("a", "0")) for entry in road.iterfind("{*}lateralProfile/{*}superelevation")]
        if any(abs(value) > 1e-6 for value in [*slopes, *leaning]):
            return False
    return len(heights) < 2


def find_entities_beyond_ground(recording: Recording, network: RoadNetwork, width: float) -> dict[str, float]:
    """Return the largest distance from the roads in m of each entity that leaves the ground of CARLA's generated world.

    `width` is the width in m of the ground beside the roads.
    """
    distances = {}
    for k, name in enumerate(recording.names):
        present = np.isfinite(recording.x[k])
        positions = network.locate(recording.x[k][present], recording.y[k][present])
        distance = 0.0
        for road, lane in {*zip(positions.road.tolist(), positions.lane.tolist(), strict=True)}:
            rows = (positions.road == road) & (positions.lane == lane)
            s, offset = positions.s[rows], np.abs(positions.offset[rows])
            sections = network.roads[road].section_at(s)
            for section in np.unique(sections).tolist():
                inside = sections == section
                half_widths = 0.5 * network.roads[road].lane_width(section, lane, s[inside])
                distance = max(distance, float((offset[inside] - half_widths).max()))
        if distance > width:
            distances[name] = distance
    return distances


def _add_missing_mark(lane: etree._Element) -> None:
    """Add a road mark to a lane that has none at its start, since CARLA's agents fail there."""
    if not any(float(mark.get("sOffset", "0")) <= 0.0 for mark in lane.iterfind("roadMark")):
        lane.append(etree.fromstring(_MARK))


def _add_verges(section: etree._Element) -> None:
    """Add a lane as ground on both sides of a lane section."""
    center = section.find("center")
    if center is None:
        return
    for side, sign in (("left", 1), ("right", -1)):
        group = section.find(side)
        if group is None:
            group = etree.Element(side)
            if sign > 0:
                center.addprevious(group)
            else:
                center.addnext(group)
        outermost = max((sign * int(lane.get("id", "0")) for lane in group.iterfind("lane")), default=0)
        lane = etree.fromstring(f'<lane id="{sign * (outermost + 1)}" type="none" level="false">{_LANE_CONTENT}</lane>')
        group.insert(0 if sign > 0 else len(group), lane)
