"""Lanes of a lane section, and how the sections of a road follow each other."""

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

# A side of a road has at most so many lanes.
_MOST_LANES: Final = 200
# A lane section longer than this, in m, is read as several that follow each other.
_LONGEST_SECTION: Final = 10_000.0
# m; a first section that begins later leaves a road without lanes.
_LATE: Final = 0.1
# m; what is no longer is there because coordinates were rounded.
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
"""Layer of lanes that are there when no roadworks are."""

Polynomial = tuple[float, float, float, float, float]
"""Where it starts in m, and the coefficients of a cubic from there on."""

Section = tuple[float, "dict[int, Lane]"]
"""Where it starts on the road in m, and its lanes by their number."""


@dataclass(frozen=True)
class Lane:
    """A lane of one lane section.

    Attributes
    ----------
    kind : str
        Its type.
    widths, borders : tuple of Polynomial
        Where the file gives widths, its borders do not count, as the standard settles it.
    predecessors, successors : tuple of int
        Lanes that it is linked to; several where it merges or splits.
    reverse : bool, default False
        Whether its traffic runs against the direction that is usual on its side.
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
    """Read the lane sections of a road.

    Parameters
    ----------
    elements : sequence of lxml element
        Its ``laneSection``.
    length : float
        Of the road, in m.
    cuts : iterable of float
        Where a section shall begin even if the file has none there, in m.
    where : str
        File and road, for messages.

    Returns
    -------
    list of Section
        In the order of their starts. Each holds the lanes of both sides, also where the file starts a new section for
        one side only.

    Raises
    ------
    InputError
        A lane cannot be used.
    """
    sides: dict[str, list[_Side]] = {"left": [], "right": []}
    begins = [read_number(element, "s", where, 0.0) for element in elements]
    note_disorder(elements, begins)
    for start, element in sorted(zip(begins, elements, strict=True), key=lambda pair: pair[0]):
        single = element.get("singleSide") in ("true", "1")
        _note_section(element, start, length)
        for side, found in sides.items():
            if not single or element.find(side) is not None:
                if found and found[-1].start == start:
                    why = f"of those that begin at s = {start:g} m, the last one in the file counts"
                    adapt(element, "<laneSection> at the place of another", why, "each begins after the one before")
                found.append(_Side(start, _read_lanes(element, side, where)))
    starts = sorted({one.start for found in sides.values() for one in found})
    if starts and abs(starts[0]) > _LATE:
        raise InputError(f"{where}: its first <laneSection> begins at s = {starts[0]:g} m; let it begin at 0.")
    starts = sorted({*starts, *(cut for cut in cuts if starts[0] < cut < length)})
    for start, end in zip(starts, [*starts[1:], length], strict=True):
        parts = int(np.ceil((end - start) / _LONGEST_SECTION))
        starts = sorted({*starts, *np.linspace(start, end, parts, endpoint=False).tolist()}) if parts > 1 else starts
    begun = {side: [one.start for one in found] for side, found in sides.items()}
    return [
        (
            start,
            {
                number: lane
                for side, found in sides.items()
                for number, lane in _lanes_at(found, begun[side], starts, k).items()
            },
        )
        for k, start in enumerate(starts)
    ]


def _note_section(section: etree._Element, start: float, length: float) -> None:
    """Note what a lane section lacks, or where it lies wrong, in m along a road of that length."""
    if start >= length:
        why = f"begins at s = {start:g} m, but the road ends at {length:g} m: nobody comes there"
        adapt(section, "<laneSection> beyond the end of its road", why, "a <laneSection> begins before its road ends")
    if not unrecorded(section, "center"):
        why = "the line from which the lanes are counted is taken as its centre"
        adapt(section, "<laneSection> without <center>", why, "a <laneSection> has a <center> with the lane 0")


def _lanes_at(side: list[_Side], begun: list[float], starts: list[float], k: int) -> dict[int, Lane]:
    """Lanes of one side, whose sections begin there, between a start and the next.

    They are linked to themselves where no section of the file begins.
    """
    last = bisect_right(begun, starts[k]) - 1
    if last < 0:
        return {}
    one = side[last]
    coming = bisect_left(begun, starts[k + 1]) if k + 1 < len(starts) else len(begun)
    goes_on = k + 1 < len(starts) and begun[coming : coming + 1] != [starts[k + 1]]
    if one.start == starts[k] and not goes_on:
        return one.lanes
    return {
        number: replace(
            lane,
            widths=_shifted(lane.widths, starts[k] - one.start),
            borders=_shifted(lane.borders, starts[k] - one.start),
            predecessors=lane.predecessors if one.start == starts[k] else (number,),
            successors=(number,) if goes_on else lane.successors,
        )
        for number, lane in one.lanes.items()
    }


def _shifted(polynomials: tuple[Polynomial, ...], by: float) -> tuple[Polynomial, ...]:
    return tuple((start - by, a, b, c, d) for start, a, b, c, d in polynomials)


def _read_lanes(section: etree._Element, side: str, where: str) -> dict[int, Lane]:
    found, elements = {}, {}
    for element in section.iterfind(f"{side}/lane"):
        widths = read_polynomials(element.iterfind("width"), "sOffset", where)
        borders = () if widths else read_polynomials(element.iterfind("border"), "sOffset", where)
        number = lane_number(element, where)
        if number in found:
            where = at_line(where, element)
            raise InputError(f"{where}: a <laneSection> has two lanes {number}; keep one of them.")
        if number == 0 or (number > 0) != (side == "left"):
            where = at_line(where, element)
            right = "the lane 0 belongs in <center>" if number == 0 else (
                f"lanes on the {side} have numbers {'above' if side == 'left' else 'below'} 0"
            )  # fmt: skip
            raise InputError(f"{where}: the lane {number} stands in <{side}>; {right}.")
        elements[number] = element
        _note_begin(element, widths or borders)
        if not widths and not borders:
            adapt(element, "<lane> without a width", "is 0 m wide", "a lane has a <width> or a <border>")
        found[number] = Lane(
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
            why = f"there is no lane {inner}, which is taken as 0 m wide"
            adapt(element, f"number {number} of <lane>", why, "lanes are numbered one by one, from the centre on")
    return found


def _note_begin(lane: etree._Element, cubics: Sequence[Polynomial]) -> None:
    """Note where the width of a lane is not given from the begin of its section on."""
    if cubics and abs(begin := cubics[0][0]) > _ROUNDING:
        tag = "width" if lane.find("width") is not None else "border"
        why = f"begins at {begin:g} m of its lane section" + (
            ", and its curve holds before that, too" if begin > 0 else ""
        )
        adapt(lane, f"first <{tag}> of <lane>", why, f"the first <{tag}> begins at the sOffset 0")


def _lane_type(lane: etree._Element) -> str:
    """Type of a lane; nobody drives on what has none that the standard knows."""
    if (kind := lane.get("type")) in _TYPES:
        return str(kind)
    if kind and (meant := same_word(lane, "type", _TYPES)):
        return meant
    why = f"is {repr(kind) if kind else 'missing'}, and is read as 'none'"
    adapt(lane, "type of <lane>", why, "a lane has one of the types of e_laneType")
    return "none"


def _linked(lane: etree._Element, path: str, where: str) -> tuple[int, ...]:
    """Lanes of the permanent layer that a lane is linked to."""
    links = [(lane_number(link, where), is_permanent(link)) for link in lane.iterfind(path)]
    return tuple(number for number, permanent in links if permanent)


def is_permanent(element: etree._Element, *names: str) -> bool:
    """Whether lanes, or the lanes of a link, are those of the permanent layer, by attributes of these names."""
    return all(element.get(name, PERMANENT) == PERMANENT for name in names or ("layer",))


def lane_number(element: etree._Element, where: str, name: str = "id") -> int:
    """Read the number of a lane, or say which attribute is none.

    Raises
    ------
    InputError
        It is not whole, or larger than any road has lanes.
    """
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
    """Read cubics that follow each other, each from where its attribute `name` says.

    Raises
    ------
    InputError
        A number is not finite.
    """
    found: list[Polynomial] = []
    elements = list(elements)
    for e in elements:
        start, a, b, c, d = (read_number(e, key, where, 0.0) for key in (name, "a", "b", "c", "d"))
        found.append((start, a, b, c, d))
    note_disorder(elements, [start for start, *_ in found])
    seen = set[float]()
    for element, (start, *_) in zip(elements, found, strict=True):
        if start in seen:
            why = f"of those that begin at {start:g} m, the last one in the file counts"
            tag = element.tag
            adapt(element, f"<{tag}> at the place of another", why, f"each <{tag}> begins after the one before")
        seen.add(start)
    return tuple(sorted(found, key=lambda one: one[0]))


def evaluate_polynomials(polynomials: tuple[Polynomial, ...], s: FloatArray) -> FloatArray:
    """Value of cubics that follow each other at each s, shape (N,); 0 where there are none."""
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
    """First derivatives of cubics that follow each other."""
    return tuple((start, b, 2.0 * c, 3.0 * d, 0.0) for start, _, b, c, d in polynomials)
