"""Lanes of lane sections, read from a road file."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.places import at_line
from cornercase._common.recorded_xml import adapt, unrecorded
from cornercase._common.typing import FloatArray
from cornercase.roads.reference_line import note_disorder, read_number, same_word

# Largest lane number.
_MOST_LANES: Final = 200
# Longer lane sections are split, in m.
_LONGEST_SECTION: Final = 10_000.0
# Largest start of the first section in m; a later one leaves a road without lanes.
_LATE: Final = 0.1
# Tolerance in m for rounded coordinates.
_ROUNDING: Final = 1e-6
_DRIVABLE: Final = (
    "driving", "bidirectional", "entry", "exit", "mwyEntry", "mwyExit", "onRamp", "offRamp", "connectingRamp",
    "slipLane", "bus", "taxi", "HOV",
)  # fmt: skip

_TYPES: Final = (
    *_DRIVABLE, "none", "stop", "shoulder", "biking", "sidewalk", "border", "restricted", "parking", "median", "curb",
    "walking", "shared", "special1", "special2", "special3", "roadWorks", "tram", "rail",
)  # fmt: skip

PERMANENT: Final = "permanent"
"""Layer of lanes outside of roadworks."""

Polynomial = tuple[float, float, float, float, float]
"""Start in m and coefficients of a cubic, lowest first."""

Section = tuple[float, "dict[int, Lane]"]
"""Start on the road in m, and lanes by number."""


@dataclass(frozen=True)
class Lane:
    """A lane of one lane section; `borders` are used only if there are no `widths`, as the standard demands.

    If `is_reversed`, traffic runs against the usual direction of its side. Several predecessors or successors mean
    that it splits or merges.
    """

    kind: str
    widths: tuple[Polynomial, ...]
    borders: tuple[Polynomial, ...]
    predecessors: tuple[int, ...]
    successors: tuple[int, ...]
    reverse: bool = False

    @property
    def drivable(self) -> bool:
        """Whether vehicles may drive on it."""
        return self.kind in _DRIVABLE


class _Side(NamedTuple):
    """Lanes of one side of the road from `start` on, in m."""

    start: float
    lanes: dict[int, Lane]


def read_sections(
    elements: Sequence[etree._Element], length: float, cuts: Iterable[float], where: str
) -> list[Section]:
    """Read the lane sections of a road, in the order of their starts.

    Each section holds the lanes of both sides, even if the file starts a new section on one side only.
    `forced_starts` are positions in m at which a section has to start; `location` names file and road, for messages.
    """
    sides: dict[str, list[_Side]] = {"left": [], "right": []}
    begins = [read_number(element, "s", where, 0.0) for element in elements]
    note_disorder(elements, begins)
    for start, element in sorted(zip(begins, elements, strict=True), key=lambda pair: pair[0]):
        single = element.get("singleSide") in ("true", "1")
        _note_section(element, start, length)
        for side, side_sections in sides.items():
            if not single or element.find(side) is not None:
                if side_sections and side_sections[-1].start == start:
                    subject = "<laneSection> at the position of another"
                    reason = f"several begin at s = {start:g} m; the last one in the file counts"
                    adapt(element, subject, reason, "each begins after the one before")
                side_sections.append(_Side(start, _read_lanes(element, side, where)))
    starts = sorted({section.start for side_sections in sides.values() for section in side_sections})
    if starts and abs(starts[0]) > _LATE:
        raise InputError(f"{where}: its first <laneSection> begins at s = {starts[0]:g} m; let it begin at 0.")
    starts = sorted({*starts, *(cut for cut in cuts if starts[0] < cut < length)})
    for start, end in zip(starts, [*starts[1:], length], strict=True):
        count = int(np.ceil((end - start) / _LONGEST_SECTION))
        starts = sorted({*starts, *np.linspace(start, end, count, endpoint=False).tolist()}) if count > 1 else starts
    side_starts = {side: [section.start for section in side_sections] for side, side_sections in sides.items()}
    return [
        (
            start,
            {
                number: lane
                for side, side_sections in sides.items()
                for number, lane in _lanes_at(side_sections, side_starts[side], starts, k).items()
            },
        )
        for k, start in enumerate(starts)
    ]


def _note_section(section: etree._Element, start: float, length: float) -> None:
    """Record that a lane section starts behind the end of the road, or has no center lane."""
    if start >= length:
        reason = f"begins at s = {start:g} m, but the road ends at {length:g} m; it is never reached"
        adapt(
            section, "<laneSection> beyond the end of its road", reason, "a <laneSection> begins before its road ends"
        )
    if not unrecorded(section, "center"):
        reason = "the line from which lanes are numbered is taken as its centre"
        adapt(section, "<laneSection> without <center>", reason, "a <laneSection> has a <center> with the lane 0")


def _lanes_at(side: list[_Side], begun: list[float], starts: list[float], k: int) -> dict[int, Lane]:
    """Return the lanes of one side between the k-th start and the next.

    They are linked to themselves where the file starts no section.
    """
    index = bisect_right(begun, starts[k]) - 1
    if index < 0:
        return {}
    current = side[index]
    next_index = bisect_left(begun, starts[k + 1]) if k + 1 < len(starts) else len(begun)
    goes_on = k + 1 < len(starts) and begun[next_index : next_index + 1] != [starts[k + 1]]
    if current.start == starts[k] and not goes_on:
        return current.lanes
    return {
        number: replace(
            lane,
            widths=_shifted(lane.widths, starts[k] - current.start),
            borders=_shifted(lane.borders, starts[k] - current.start),
            predecessors=lane.predecessors if current.start == starts[k] else (number,),
            successors=(number,) if goes_on else lane.successors,
        )
        for number, lane in current.lanes.items()
    }


def _shifted(polynomials: tuple[Polynomial, ...], by: float) -> tuple[Polynomial, ...]:
    return tuple((start - by, a, b, c, d) for start, a, b, c, d in polynomials)


def _read_lanes(section: etree._Element, side: str, where: str) -> dict[int, Lane]:
    lanes, elements = {}, {}
    for element in section.iterfind(f"{side}/lane"):
        widths = read_polynomials(element.iterfind("width"), "sOffset", where)
        borders = () if widths else read_polynomials(element.iterfind("border"), "sOffset", where)
        number = lane_number(element, where)
        if number in lanes:
            where = at_line(where, element)
            raise InputError(f"{where}: a <laneSection> has two lanes {number}; keep one of them.")
        if number == 0 or (number > 0) != (side == "left"):
            where = at_line(where, element)
            rule = "the lane 0 belongs in <center>" if number == 0 else (
                f"lanes on the {side} have numbers {'above' if side == 'left' else 'below'} 0"
            )  # fmt: skip
            raise InputError(f"{where}: the lane {number} is in <{side}>; {rule}.")
        elements[number] = element
        _note_begin(element, widths or borders)
        if not widths and not borders:
            adapt(element, "<lane> without a width", "is 0 m wide", "a lane has a <width> or a <border>")
        lanes[number] = Lane(
            _lane_type(element),
            widths,
            borders,
            _linked(element, "link/predecessor", where),
            _linked(element, "link/successor", where),
            element.get("direction") == "reversed",
        )
    for number, element in elements.items():
        inner = number + (1 if number < 0 else -1)
        if inner and inner not in elements:
            reason = f"the lane {inner} is missing and taken as 0 m wide"
            adapt(element, f"number {number} of <lane>", reason, "lanes are numbered consecutively from the centre")
    return lanes


def _note_begin(lane: etree._Element, cubics: Sequence[Polynomial]) -> None:
    """Record that the width of a lane is not given from the start of its section."""
    if cubics and abs(start := cubics[0][0]) > _ROUNDING:
        tag = "width" if lane.find("width") is not None else "border"
        reason = f"begins at {start:g} m of its lane section" + (
            ", and its curve holds before that, too" if start > 0 else ""
        )
        adapt(lane, f"first <{tag}> of <lane>", reason, f"the first <{tag}> begins at the sOffset 0")


def _lane_type(lane: etree._Element) -> str:
    """Return the type of a lane; "none", which is not drivable, for types that the standard does not know."""
    if (kind := lane.get("type")) in _TYPES:
        return str(kind)
    if kind and (standard_kind := same_word(lane, "type", _TYPES)):
        return standard_kind
    reason = f"is {repr(kind) if kind else 'missing'}, and is read as 'none'"
    adapt(lane, "type of <lane>", reason, "a lane has one of the types of e_laneType")
    return "none"


def _linked(lane: etree._Element, path: str, where: str) -> tuple[int, ...]:
    """Return the lanes of the permanent layer that a lane is linked to."""
    links = [(lane_number(link, where), is_permanent(link)) for link in lane.iterfind(path)]
    return tuple(number for number, permanent in links if permanent)


def is_permanent(element: etree._Element, *names: str) -> bool:
    """Whether an element belongs to the permanent layer, according to attributes of these names."""
    return all(element.get(name, PERMANENT) == PERMANENT for name in names or ("layer",))


def lane_number(element: etree._Element, where: str, name: str = "id") -> int:
    """Read the number of a lane; raises `InputError` if it is no integer or too large."""
    number = read_number(element, name, where)
    if number != int(number):
        where = at_line(where, element)
        raise InputError(f"{where}: {name} of <{element.tag}> is '{element.get(name)}', not a whole number.")
    if abs(number) > _MOST_LANES:
        raise InputError(
            f"{at_line(where, element)}: {name} of <{element.tag}> is '{element.get(name)}'; at most {_MOST_LANES}"
            " lanes are read on each side of a road."
        )
    if not (text := element.get(name, "").strip()).lstrip("+-").isdigit():
        what = f"{name} of <{element.tag}>"
        adapt(element, what, f"is '{text}', and is read as {int(number)}", "the number of a lane is a whole number")
    return int(number)


def read_polynomials(elements: Iterable[etree._Element], name: str, where: str) -> tuple[Polynomial, ...]:
    """Read piecewise cubics; attribute `start_attribute` holds the start of each."""
    cubics: list[Polynomial] = []
    elements = list(elements)
    for e in elements:
        start, a, b, c, d = (read_number(e, key, where, 0.0) for key in (name, "a", "b", "c", "d"))
        cubics.append((start, a, b, c, d))
    note_disorder(elements, [start for start, *_ in cubics])
    seen = set[float]()
    for element, (start, *_) in zip(elements, cubics, strict=True):
        if start in seen:
            reason = f"several begin at {start:g} m; the last one in the file counts"
            tag = element.tag
            adapt(element, f"<{tag}> at the position of another", reason, f"each <{tag}> begins after the one before")
        seen.add(start)
    return tuple(sorted(cubics, key=lambda cubic: cubic[0]))


def evaluate_polynomials(polynomials: tuple[Polynomial, ...], s: FloatArray) -> FloatArray:
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


def differentiated(polynomials: tuple[Polynomial, ...]) -> tuple[Polynomial, ...]:
    """Return the first derivatives of piecewise cubics."""
    return tuple((start, b, 2.0 * c, 3.0 * d, 0.0) for start, _, b, c, d in polynomials)
