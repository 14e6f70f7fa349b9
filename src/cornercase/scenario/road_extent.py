"""How far a road reaches, and which lanes it has where."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from lxml import etree

from cornercase._common.errors import InputError
from cornercase.scenario.xml import read_xml

# What is rounded to a bound lies on it.
_TOLERANCE = 1e-6


@dataclass(frozen=True)
class RoadExtent:
    """A road without its shape.

    Attributes
    ----------
    length : float
        m.
    sections : tuple of (float, dict of int to str)
        Where each lane section begins, and its lanes with their types.
    """

    length: float
    sections: tuple[tuple[float, dict[int, str]], ...]

    def stretch(self, lane: int, s: float) -> tuple[float, float]:
        """Give the stretch around a place on which there is a lane of a number; the whole road where there is none."""
        here = self._section(s)
        if here is None or lane not in self.sections[here][1]:
            return 0.0, self.length
        first = last = here
        while first > 0 and lane in self.sections[first - 1][1]:
            first -= 1
        while last + 1 < len(self.sections) and lane in self.sections[last + 1][1]:
            last += 1
        end = self.sections[last + 1][0] if last + 1 < len(self.sections) else self.length
        return self.sections[first][0], end

    def lanes_at(self, s: float) -> frozenset[int]:
        """Give the numbers of the lanes at a place, without the middle one."""
        here = self._section(s)
        return frozenset() if here is None else frozenset(self.sections[here][1])

    def alike(self, lane: int, s: float) -> tuple[int, int] | None:
        """Give the first and last of the lanes beside a lane on its side of the road that are of its type."""
        here = self._section(s)
        lanes = {} if here is None else self.sections[here][1]
        if lane not in lanes:
            return None
        low = high = lane
        while lanes.get(low - 1) == lanes[lane]:
            low -= 1
        while lanes.get(high + 1) == lanes[lane]:
            high += 1
        return low, high

    def _section(self, s: float) -> int | None:
        if not -_TOLERANCE <= s <= self.length + _TOLERANCE:
            return None
        begun = [k for k, (start, _) in enumerate(self.sections) if start <= s + _TOLERANCE]
        return begun[-1] if begun else None


def read_extents(path: Path | None) -> dict[str, RoadExtent]:
    """Read how far the roads of a file reach; none of what cannot be read, which is said where the scenario is run.

    Parameters
    ----------
    path : Path or None

    Returns
    -------
    dict of str to RoadExtent
        By the road's id.
    """
    if path is None or not path.is_file():
        return {}
    try:
        root = read_xml(path)
    except InputError:
        return {}
    found = {}
    for road in root.iterfind("road"):
        try:
            found[road.get("id", "")] = _read(road)
        except ValueError:
            continue
    return found


def _read(road: etree._Element) -> RoadExtent:
    sections = []
    for section in road.iterfind("lanes/laneSection"):
        lanes = {int(lane.get("id", "")): lane.get("type", "") for lane in section.iterfind("*/lane")}
        lanes.pop(0, None)
        sections.append((float(section.get("s", "")), lanes))
    return RoadExtent(float(road.get("length", "")), tuple(sorted(sections, key=lambda one: one[0])))
