"""Lanes of lane sections, read from a road file."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.io.tracked_xml import find_untracked, note_adaptation
from cornercase._common.text.element_locations import replace_line_number
from cornercase._common.typing import FloatArray
from cornercase.roads._reference_line import match_enumeration, read_finite_number, record_wrong_order
from cornercase.roads._signs import SpeedLimits, read_lane_speed_limits

# Largest lane number.
_MAX_LANE_NUMBER: Final = 200
# Longer lane sections are split, in m.
_MAX_SECTION_LENGTH: Final = 10_000.0
# Largest start of the first section in m; a later one leaves a road without lanes.
_MAX_FIRST_START: Final = 0.1
# Tolerance in m for rounded coordinates.
_COORDINATE_TOLERANCE: Final = 1e-6
_DRIVABLE_TYPES: Final = (
    "driving", "bidirectional", "entry", "exit", "mwyEntry", "mwyExit", "onRamp", "offRamp", "connectingRamp",
    "slipLane", "bus", "taxi", "HOV",
)  # fmt: skip

_LANE_TYPES: Final = (
    *_DRIVABLE_TYPES,
    "none",
    "stop",
    "shoulder",
    "biking",
    "sidewalk",
    "border",
    "restricted",
    "parking",
    "median",
    "curb",
    "walking",
    "shared",
    "special1",
    "special2",
    "special3",
    "roadWorks",
    "tram",
    "rail",
)

PERMANENT_LAYER: Final = "permanent"
"""Name of the layer of lanes that hold outside of roadworks."""

CubicPolynomial = tuple[float, float, float, float, float]
"""Start in m and coefficients of a cubic, lowest first."""

LaneSection = tuple[float, "dict[int, Lane]"]
"""Start on the road in m, and lanes by number."""


@dataclass(frozen=True)
class Lane:
    """A lane of one lane section.

    As the OpenDRIVE standard demands, `borders` are used only if there are no `widths`. If `is_reversed` is True,
    traffic on the lane drives against the usual direction of this side of the road. A lane with several predecessors or
    successors merges or splits.
    """

    lane_type: str
    widths: tuple[CubicPolynomial, ...]
    borders: tuple[CubicPolynomial, ...]
    predecessors: tuple[int, ...]
    successors: tuple[int, ...]
    is_reversed: bool = False
    speed_limits: SpeedLimits = ()

    @property
    def is_drivable(self) -> bool:
        """True if vehicles may drive on the lane."""
        return self.lane_type in _DRIVABLE_TYPES


class _SideSection(NamedTuple):
    """Lanes on one side of the road, from `start` (in m) to the next section of this side."""

    start: float
    lanes: dict[int, Lane]


def read_lane_sections(
    elements: Sequence[etree._Element], length: float, forced_starts: Iterable[float], location: str
) -> list[LaneSection]:
    """Read the lane sections of a road, sorted by start.

    Each section has the lanes of both sides, even if the file starts a new section on one side only. Sections also
    start at the positions `forced_starts` in m, at which other roads start or end. `location` names file and road, for
    messages.
    """
    sides: dict[str, list[_SideSection]] = {"left": [], "right": []}
    begins = [read_finite_number(element, "s", location, 0.0) for element in elements]
    record_wrong_order(elements, begins)
    for start, element in sorted(zip(begins, elements, strict=True), key=lambda pair: pair[0]):
        single = element.get("singleSide") in ("true", "1")
        _note_problems_of_section(element, start, length)
        for side, side_sections in sides.items():
            if not single or element.find(side) is not None:
                if side_sections and side_sections[-1].start == start:
                    subject = "<laneSection> at the position of another"
                    reason = f"several begin at s = {start:g} m; the last one in the file counts"
                    note_adaptation(element, subject, reason, "each begins after the one before")
                side_sections.append(_SideSection(start, _read_lanes(element, side, location)))
    starts = sorted({section.start for side_sections in sides.values() for section in side_sections})
    if not starts:
        raise InputError(
            f"{location}: <laneSection> has singleSide, but neither <left> nor <right>; give it one of them."
        )
    if abs(starts[0]) > _MAX_FIRST_START:
        raise InputError(f"{location}: the first <laneSection> begins at s = {starts[0]:g} m; it must begin at 0.")
    starts = sorted({*starts, *(cut for cut in forced_starts if starts[0] < cut < length)})
    for start, end in zip(starts, [*starts[1:], length], strict=True):
        count = int(np.ceil((end - start) / _MAX_SECTION_LENGTH))
        starts = sorted({*starts, *np.linspace(start, end, count, endpoint=False).tolist()}) if count > 1 else starts
    side_starts = {side: [section.start for section in side_sections] for side, side_sections in sides.items()}
    return [
        (
            start,
            {
                number: lane
                for side, side_sections in sides.items()
                for number, lane in _side_lanes_at(side_sections, side_starts[side], starts, k).items()
            },
        )
        for k, start in enumerate(starts)
    ]


def _note_problems_of_section(section: etree._Element, start: float, length: float) -> None:
    """Note violations of the standard: a lane section begins beyond the end of the road, or has no center lane."""
    if start >= length:
        reason = f"begins at s = {start:g} m, but the road ends at {length:g} m; it is never reached"
        note_adaptation(
            section, "<laneSection> beyond the end of its road", reason, "a <laneSection> begins before its road ends"
        )
    if not find_untracked(section, "center"):
        reason = "the line from which lanes are numbered is taken as its centre"
        note_adaptation(
            section, "<laneSection> without <center>", reason, "a <laneSection> has a <center> with the lane 0"
        )


def _side_lanes_at(
    side_sections: list[_SideSection], side_starts: list[float], starts: list[float], index: int
) -> dict[int, Lane]:
    """Return the lanes of one side in the section that begins at ``starts[index]``.

    Where a section begins or ends although the file starts no new section on this side, each lane is linked to the lane
    of the same number beyond.
    """
    section_index = bisect_right(side_starts, starts[index]) - 1
    if section_index < 0:
        return {}
    current = side_sections[section_index]
    next_index = bisect_left(side_starts, starts[index + 1]) if index + 1 < len(starts) else len(side_starts)
    goes_on = index + 1 < len(starts) and side_starts[next_index : next_index + 1] != [starts[index + 1]]
    if current.start == starts[index] and not goes_on:
        return current.lanes
    return {
        number: replace(
            lane,
            widths=_shift_polynomials(lane.widths, starts[index] - current.start),
            borders=_shift_polynomials(lane.borders, starts[index] - current.start),
            predecessors=lane.predecessors if current.start == starts[index] else (number,),
            successors=(number,) if goes_on else lane.successors,
            speed_limits=tuple((s - (starts[index] - current.start), limit) for s, limit in lane.speed_limits),
        )
        for number, lane in current.lanes.items()
    }


def _shift_polynomials(polynomials: tuple[CubicPolynomial, ...], offset: float) -> tuple[CubicPolynomial, ...]:
    return tuple((start - offset, a, b, c, d) for start, a, b, c, d in polynomials)


def _read_lanes(section: etree._Element, side: str, location: str) -> dict[int, Lane]:
    lanes, elements = {}, {}
    for element in section.iterfind(f"{side}/lane"):
        widths = read_polynomials(element.iterfind("width"), "sOffset", location)
        borders = () if widths else read_polynomials(element.iterfind("border"), "sOffset", location)
        number = read_lane_number(element, location)
        if number in lanes:
            location = replace_line_number(location, element)
            raise InputError(f"{location}: a <laneSection> has two lanes with the number {number}; keep one of them.")
        if number == 0 or (number > 0) != (side == "left"):
            location = replace_line_number(location, element)
            rule = "the lane 0 belongs in <center>" if number == 0 else (
                f"lanes on the {side} have numbers {'above' if side == 'left' else 'below'} 0"
            )  # fmt: skip
            raise InputError(f"{location}: the lane {number} is in <{side}>; {rule}.")
        elements[number] = element
        _record_late_width(element, widths or borders)
        if not widths and not borders:
            note_adaptation(element, "<lane> without a width", "is 0 m wide", "a lane has a <width> or a <border>")
        lanes[number] = Lane(
            _read_lane_type(element),
            widths,
            borders,
            _read_linked_lanes(element, "link/predecessor", location),
            _read_linked_lanes(element, "link/successor", location),
            element.get("direction") == "reversed",
            read_lane_speed_limits(element),
        )
    for number, element in elements.items():
        inner = number + (1 if number < 0 else -1)
        if inner and inner not in elements:
            reason = f"the lane {inner} is missing and taken as 0 m wide"
            note_adaptation(
                element, f"number {number} of <lane>", reason, "lanes are numbered consecutively from the centre"
            )
    return lanes


def _record_late_width(lane: etree._Element, cubics: Sequence[CubicPolynomial]) -> None:
    """Note a violation of the standard if the widths of a lane do not begin at the start of the lane section."""
    if cubics and abs(start := cubics[0][0]) > _COORDINATE_TOLERANCE:
        tag = "width" if lane.find("width") is not None else "border"
        reason = f"begins at {start:g} m of its lane section" + (
            ", and its curve holds before that, too" if start > 0 else ""
        )
        note_adaptation(lane, f"first <{tag}> of <lane>", reason, f"the first <{tag}> begins at the sOffset 0")


def _read_lane_type(lane: etree._Element) -> str:
    """Return the type of a lane; types that the standard does not know are read as "none", which is not drivable."""
    if (kind := lane.get("type")) in _LANE_TYPES:
        return str(kind)
    if kind and (standard_kind := match_enumeration(lane, "type", _LANE_TYPES)):
        return standard_kind
    reason = f"is {repr(kind) if kind else 'missing'}, and is read as 'none'"
    note_adaptation(lane, "type of <lane>", reason, "a lane has one of the types of e_laneType")
    return "none"


def _read_linked_lanes(lane: etree._Element, path: str, location: str) -> tuple[int, ...]:
    """Return the numbers of the lanes that a lane is linked to; links that hold only during roadworks are ignored."""
    links = [(read_lane_number(link, location), is_in_permanent_layer(link)) for link in lane.iterfind(path)]
    return tuple(number for number, permanent in links if permanent)


def is_in_permanent_layer(element: etree._Element, *layer_attributes: str) -> bool:
    """Return whether an element belongs to the permanent layer (lanes outside of roadworks).

    `layer_attributes` are the attributes that name the layers of the element, by default ``layer``. A missing attribute
    means the permanent layer.
    """
    return all(element.get(name, PERMANENT_LAYER) == PERMANENT_LAYER for name in layer_attributes or ("layer",))


def read_lane_number(element: etree._Element, location: str, attribute: str = "id") -> int:
    """Read the number of a lane; raises `InputError` if the number is not an integer or too large."""
    number = read_finite_number(element, attribute, location)
    if number != int(number):
        location = replace_line_number(location, element)
        raise InputError(
            f"{location}: {attribute} of <{element.tag}> is '{element.get(attribute)}', not a whole number."
        )
    if abs(number) > _MAX_LANE_NUMBER:
        raise InputError(
            f"{replace_line_number(location, element)}: {attribute} of <{element.tag}> is"
            f" '{element.get(attribute)}'; the number of a lane must be between"
            f" -{_MAX_LANE_NUMBER} and {_MAX_LANE_NUMBER}."
        )
    if not (text := element.get(attribute, "").strip()).lstrip("+-").isdigit():
        what = f"{attribute} of <{element.tag}>"
        note_adaptation(
            element, what, f"is '{text}', and is read as {int(number)}", "the number of a lane is a whole number"
        )
    return int(number)


def read_polynomials(
    elements: Iterable[etree._Element], start_attribute: str, location: str
) -> tuple[CubicPolynomial, ...]:
    """Read piecewise cubics; `start_attribute` is the attribute with the start of each piece."""
    cubics: list[CubicPolynomial] = []
    elements = list(elements)
    for e in elements:
        start, a, b, c, d = (read_finite_number(e, key, location, 0.0) for key in (start_attribute, "a", "b", "c", "d"))
        cubics.append((start, a, b, c, d))
    record_wrong_order(elements, [start for start, *_ in cubics])
    seen = set[float]()
    for element, (start, *_) in zip(elements, cubics, strict=True):
        if start in seen:
            reason = f"several begin at {start:g} m; the last one in the file counts"
            tag = element.tag
            note_adaptation(
                element, f"<{tag}> at the position of another", reason, f"each <{tag}> begins after the one before"
            )
        seen.add(start)
    return tuple(sorted(cubics, key=lambda cubic: cubic[0]))


def evaluate_polynomials(polynomials: tuple[CubicPolynomial, ...], s: FloatArray) -> FloatArray:
    """Evaluate piecewise cubics at each s, shape (N,); 0 if there are none."""
    if not polynomials:
        return np.zeros(len(s))
    if len(polynomials) == 1:
        start, *cubic = polynomials[0]
        d = s - start
        return np.asarray(cubic[0] + d * (cubic[1] + d * (cubic[2] + d * cubic[3])))
    table = np.array(polynomials)
    k = np.clip(np.searchsorted(table[:, 0], s, "right") - 1, 0, len(table) - 1)
    d = s - table[k, 0]
    return np.asarray(table[k, 1] + d * (table[k, 2] + d * (table[k, 3] + d * table[k, 4])))


def differentiate_polynomials(polynomials: tuple[CubicPolynomial, ...]) -> tuple[CubicPolynomial, ...]:
    """Return the first derivatives of piecewise cubics."""
    return tuple((start, b, 2.0 * c, 3.0 * d, 0.0) for start, _, b, c, d in polynomials)
