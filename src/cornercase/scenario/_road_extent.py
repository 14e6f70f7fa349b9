"""Lengths and lanes of the roads in a road file, without their geometry."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from lxml import etree

from cornercase._common.errors import InputError
from cornercase.scenario._xml import read_xml

# In m; for rounded positions.
_TOLERANCE = 1e-6


@dataclass(frozen=True)
class RoadExtent:
    """Length of a road in m, and its lane sections: pairs of a start in m, and the lane types by lane number."""

    length: float
    sections: tuple[tuple[float, dict[int, str]], ...]

    def lane_interval(self, lane: int, s: float) -> tuple[float, float]:
        """Return start and end (in m) of the longest interval around `s` in which the lane exists without interruption.

        Return the whole road if the lane does not exist at `s`.
        """
        section = self._section_index(s)
        if section is None or lane not in self.sections[section][1]:
            return 0.0, self.length
        first = last = section
        while first > 0 and lane in self.sections[first - 1][1]:
            first -= 1
        while last + 1 < len(self.sections) and lane in self.sections[last + 1][1]:
            last += 1
        end = self.sections[last + 1][0] if last + 1 < len(self.sections) else self.length
        return self.sections[first][0], end

    def lanes_at(self, s: float) -> frozenset[int]:
        """Return the lane numbers at position `s` (in m), without the center lane 0."""
        section = self._section_index(s)
        return frozenset() if section is None else frozenset(self.sections[section][1])

    def adjacent_lanes_of_same_type(self, lane: int, s: float) -> tuple[int, int] | None:
        """Return the lowest and highest number of the lanes next to each other that have the same type as `lane`.

        The lanes are those at position `s` (in m), on the side of the road of `lane`. None if there is no `lane`.
        """
        section = self._section_index(s)
        lanes = {} if section is None else self.sections[section][1]
        if lane not in lanes:
            return None
        low = high = lane
        while lanes.get(low - 1) == lanes[lane]:
            low -= 1
        while lanes.get(high + 1) == lanes[lane]:
            high += 1
        return low, high

    def _section_index(self, s: float) -> int | None:
        if not -_TOLERANCE <= s <= self.length + _TOLERANCE:
            return None
        started = [k for k, (start, _) in enumerate(self.sections) if start <= s + _TOLERANCE]
        return started[-1] if started else None


def read_road_extents(path: Path | None) -> dict[str, RoadExtent]:
    """Return lengths and lanes of all roads by road id; roads that cannot be read are missing."""
    if path is None or not path.is_file():
        return {}
    try:
        root = read_xml(path)
    except InputError:
        return {}
    extents = {}
    for road in root.iterfind("road"):
        try:
            extents[road.get("id", "")] = _read_road_extent(road)
        except ValueError:
            continue
    return extents


def _read_road_extent(road: etree._Element) -> RoadExtent:
    elements = [
        section
        for lanes in road.iterfind("lanes")
        if lanes.get("layer", "permanent") == "permanent"
        for section in lanes.iterfind("laneSection")
    ]
    sections: list[tuple[float, dict[int, str]]] = []
    sides: dict[str, dict[int, str]] = {"left": {}, "right": {}}
    for start, element in sorted(((float(e.get("s", "")), e) for e in elements), key=lambda pair: pair[0]):
        # On the other side of the road, the lanes of a section with one side go on.
        single = element.get("singleSide") in ("true", "1")
        for side in sides:
            if not single or element.find(side) is not None:
                sides[side] = {
                    int(lane.get("id", "")): lane.get("type", "") for lane in element.iterfind(f"{side}/lane")
                }
        sections.append((start, sides["left"] | sides["right"]))
    return RoadExtent(float(road.get("length", "")), tuple(sections))
