"""Speed limits, signals and priorities of roads; only systems under test and the analysis of fault use them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final, NamedTuple

import numpy as np
from lxml import etree

from cornercase._common.io.tracked_xml import find_untracked
from cornercase._common.typing import FloatArray

_METRES_PER_SECOND: Final = {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704}

SpeedLimits = tuple[tuple[float, float], ...]
"""Start in m, and limit in m/s from there on: infinite for no limit, NaN if unknown."""


class RoadSignal(NamedTuple):
    """A traffic sign or traffic light beside a road, at `s` in m.

    `name` is its id. `faces_forward` tells whether the signal concerns traffic along s, `faces_backward` whether it
    concerns traffic against s. `lanes` are the intervals of lane numbers that the signal concerns; empty for all lanes.
    `country` is the country whose catalogue defines `signal_type`; empty if the file names no country. If a road only
    refers to a signal of another road, `name` is the id of the other road's signal, and `signal_type` is empty.
    """

    name: str
    s: float
    faces_forward: bool
    faces_backward: bool
    signal_type: str
    lanes: tuple[tuple[float, float], ...]
    country: str = ""

    def concerns(self, lane: int, forward: bool) -> bool:
        """Return whether the signal concerns traffic on a lane, along s if `forward` and otherwise against s."""
        is_of_lane = not self.lanes or any(low <= lane <= high for low, high in self.lanes)
        return is_of_lane and (self.faces_forward if forward else self.faces_backward)


def read_road_speed_limits(road: etree._Element) -> SpeedLimits:
    """Return the speed limits along a road, from the <type> elements of the road."""
    types = find_untracked(road, "type")
    return _sort_limits(
        (_read_number_or_nan(element, "s"), next(iter(find_untracked(element, "speed")), None)) for element in types
    )


def read_lane_speed_limits(lane: etree._Element) -> SpeedLimits:
    """Return the speed limits of a lane; starts are measured from the start of the lane section."""
    return _sort_limits((_read_number_or_nan(element, "sOffset"), element) for element in find_untracked(lane, "speed"))


def speed_limit_at(limits: SpeedLimits, s: FloatArray) -> FloatArray:
    """Return the speed limit in m/s that holds at each s, shape (N,); NaN before the first limit."""
    starts = np.array([start for start, _ in limits])
    return np.array([math.nan, *(limit for _, limit in limits)])[np.searchsorted(starts, s, "right")]


def _sort_limits(records: Iterable[tuple[float, etree._Element | None]]) -> SpeedLimits:
    limits = ((start, math.nan if speed is None else _read_limit(speed)) for start, speed in records)
    return tuple(sorted((limit for limit in limits if math.isfinite(limit[0])), key=lambda limit: limit[0]))


def _read_limit(speed: etree._Element) -> float:
    unit = _METRES_PER_SECOND.get(speed.attrib.get("unit", "m/s"), math.nan)
    if speed.attrib.get("max") == "no limit":
        return math.inf
    limit = _read_number_or_nan(speed, "max") * unit
    return limit if limit >= 0.0 else math.nan


def _read_number_or_nan(element: etree._Element, name: str) -> float:
    """Return an attribute as a number; NaN if invalid, so that signs and limits never make a file unusable."""
    try:
        return float(element.attrib.get(name, math.nan))
    except ValueError:
        return math.nan


def read_signals(road: etree._Element) -> tuple[RoadSignal, ...]:
    """Return the signals of a road, including references to signals of other roads, in the order of s."""
    elements = [element for tag in ("signal", "signalReference") for element in find_untracked(road, "signals", tag)]
    signals = [
        RoadSignal(
            element.attrib.get("id", ""),
            _read_number_or_nan(element, "s"),
            element.attrib.get("orientation") != "-",
            element.attrib.get("orientation") != "+",
            element.attrib.get("type", ""),
            tuple(_read_lane_interval(validity) for validity in find_untracked(element, "validity")),
            element.attrib.get("country", ""),
        )
        for element in elements
    ]
    return tuple(
        sorted((signal for signal in signals if signal.name and math.isfinite(signal.s)), key=lambda signal: signal.s)
    )


def _read_lane_interval(validity: etree._Element) -> tuple[float, float]:
    first, last = _read_number_or_nan(validity, "fromLane"), _read_number_or_nan(validity, "toLane")
    return min(first, last), max(first, last)


def read_junction_priorities(junction: etree._Element) -> tuple[tuple[str, str], ...]:
    """Return pairs of roads of a junction: traffic on the first road has right of way over traffic on the second."""
    pairs = ((element.get("high", ""), element.get("low", "")) for element in junction.iterfind("priority"))
    return tuple((high, low) for high, low in pairs if high and low)
